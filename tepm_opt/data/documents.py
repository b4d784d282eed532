"""TOML files that people write: read with errors that name file and line, checked by pydantic models, all faults at once if need be."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tepm_opt.errors import InputError, unknown_name

Checked = TypeVar("Checked", bound=BaseModel)
Number = Annotated[float, Field(strict=True, allow_inf_nan=False, description="a number")]


class Section(BaseModel):
    """A table of a file that people write: frozen, unknown keys refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def between(low: float, high: float, unit: str) -> Any:
    """Range that a value in this unit can sensibly have, so that a wrong unit is caught."""
    return Field(ge=low, le=high, allow_inf_nan=False, strict=True, description=f"{low:g} … {high:g} {unit}".rstrip())


def read_toml(path: str | Path) -> dict[str, Any]:
    """A TOML document.

    Raises:
        InputError: unreadable file; no TOML, with line and column.
    """
    path = Path(path)
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a text file (UTF-8)") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error


def toml_string(text: str) -> str:
    """Text as a TOML basic string."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def validated(model: type[Checked], content: Mapping[str, Any], where: str) -> Checked:
    """`content` checked by a pydantic model; `where` names the file in errors.

    Raises:
        InputError: the first fault in one line with file, key, value and what is valid.
    """
    try:
        return model.model_validate(content)
    except ValidationError as failure:
        raise InputError(f"{where}: {explain(model, failure)[0]}") from failure


def explain(model: type[BaseModel], failure: ValidationError) -> list[str]:
    """Each fault of a failed validation in one line: key, value and what is valid."""
    return [_explain(model, error) for error in failure.errors()]


def _explain(model: type[BaseModel], error: Any) -> str:
    location = error["loc"]
    prefix, key = _place(location[:-1]), str(location[-1]) if location else ""
    kind, section = error["type"], _section(model, location[:-1])
    if kind == "extra_forbidden" and section is not None:
        return str(unknown_name("key", key, section.model_fields, prefix))
    field = section.model_fields.get(key) if section is not None else None
    if kind == "literal_error" and field is not None:
        return str(unknown_name(key, str(error["input"]), _literals(field.annotation), prefix))
    description = None if field is None else field.description or _described(field.annotation)
    valid = f"; valid: {description}" if description else ""
    if kind == "value_error":
        message = error["msg"].removeprefix("Value error, ")
        return ": ".join(part for part in (_place(location), message) if part)
    start = f"{prefix}: " if prefix else ""
    if kind == "missing":
        return f"{start}missing key {key!r}{valid}"
    if isinstance(location[-1] if location else key, int):
        return f"{_place(location)} = {error['input']!r}: {error['msg'].lower()}"
    return f"{start}{key} = {error['input']!r}: {error['msg'].lower()}{valid}"


def _place(location: Sequence[int | str]) -> str:
    """`("runs", 1, "role")` as "runs entry 2: role"."""
    parts: list[str] = []
    for part in location:
        if isinstance(part, int):
            parts[-1:] = [f"{parts[-1] if parts else ''} entry {part + 1}".strip()]
        else:
            parts.append(part)
    return ": ".join(parts)


def _section(model: type[BaseModel], location: Sequence[int | str]) -> type[BaseModel] | None:
    """The pydantic model at a place within another."""
    section: Any = model
    for part in location:
        if isinstance(part, str):
            field = getattr(section, "model_fields", {}).get(part)
            section = None if field is None else field.annotation
        else:
            section = next(iter(get_args(section)), None)
    return section if isinstance(section, type) and issubclass(section, BaseModel) else None


def _literals(annotation: Any) -> list[str]:
    if get_origin(annotation) is Literal:
        return [str(value) for value in get_args(annotation)]
    return [value for inner in get_args(annotation) for value in _literals(inner)]


def _described(annotation: Any) -> str | None:
    """The description within an annotation such as `Annotated[float, Field(description=…)] | None`."""
    for inner in get_args(annotation):
        found = getattr(inner, "description", None) or _described(inner)
        if isinstance(found, str):
            return found
    return None
