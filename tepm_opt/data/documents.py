"""TOML files that people write: read with errors that name file and line, checked by pydantic models, all faults at once if need be."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from tepm_opt.data.foreign import TOML, kind_of, refuse_foreign
from tepm_opt.errors import InputError, unknown_name

Checked = TypeVar("Checked", bound=BaseModel)
Number = Annotated[float, Field(strict=True, allow_inf_nan=False, description="a number")]
Vector = Annotated[tuple[Number, Number, Number], Field(description="three numbers")]


class Section(BaseModel):
    """A table of a file that people write: frozen, unknown keys refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def require_range(low: float, high: float, unit: str) -> Any:
    """Constrain a field to the range that a value in this unit can sensibly have, so that a wrong unit is caught."""
    return Field(ge=low, le=high, allow_inf_nan=False, strict=True, description=f"{low:g} … {high:g} {unit}".rstrip())


def read_text(path: Path, way: str = TOML) -> str:
    """The text of a file that a person names; a byte order mark is left out.

    Args:
        path: of the file.
        way: to a file that is read here, for whoever has one of another program.

    Raises:
        InputError: it cannot be read, is of another program, or is not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        refuse_foreign(path, way)
        raise InputError(f"{path}: is not a text file (UTF-8)") from error


def read_json(path: Path, writer: str) -> dict[str, Any]:
    """Content of a JSON file that a command wrote.

    Args:
        path: of the file.
        writer: the command, for messages.

    Raises:
        InputError: it cannot be read, or holds no object.
    """
    text = read_text(path)
    try:
        content = json.loads(text)
    except ValueError as error:
        raise InputError(f"{path}: is damaged: {error}; run {writer} again") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: is damaged; run {writer} again")
    return content


def parse_toml(text: str, where: str, way: str = TOML) -> dict[str, Any]:
    """A TOML document from its text.

    Args:
        text: of the document.
        where: names the file in errors.
        way: to such a file, for whoever has one of another program.

    Raises:
        InputError: a file of another program; no TOML, with line and column.
    """
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        if kind := kind_of(text.encode()):
            raise InputError(f"{where} is {kind}; {way}") from error
        raise InputError(f"{where}: not valid TOML: {error}") from error


def read_toml(path: str | Path, way: str = TOML) -> dict[str, Any]:
    """A TOML document.

    Args:
        path: of the file.
        way: to such a file, for whoever has one of another program.

    Raises:
        InputError: unreadable file; a file of another program; no TOML, with line and column.
    """
    return parse_toml(read_text(Path(path), way), str(path), way)


def toml_string(text: str) -> str:
    """Text as a TOML basic string."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def validate(model: type[Checked], content: Mapping[str, Any], where: str) -> Checked:
    """Check `content` by a pydantic model; `where` names the file in errors.

    Raises:
        InputError: one fault in one line with file, key, value and what is valid.
    """
    try:
        return model.model_validate(content)
    except ValidationError as failure:
        raise refusal(model, failure, where) from failure


def refusal(model: type[BaseModel], failure: ValidationError, where: str) -> InputError:
    """The error that names one fault of a failed validation: a key nobody knows, which explains a missing one, or else the first."""
    error = min(failure.errors(), key=lambda entry: entry["type"] != "extra_forbidden")
    return InputError(f"{where}: {_explain(model, error)}")


def explain(model: type[BaseModel], failure: ValidationError) -> list[str]:
    """Each fault of a failed validation in one line: key, value and what is valid."""
    return [_explain(model, error) for error in failure.errors()]


def _explain(model: type[BaseModel], error: Any) -> str:
    place = _Place.locate(model, error["loc"])
    kind, value, message = error["type"], error["input"], error["msg"].lower().replace(" after validation", "")
    valid = f"; valid: {place.valid}" if place.valid else ""
    if kind == "value_error":
        found = f"{place.text} = {value!r}" if place.is_value else place.text
        return ": ".join(part for part in (found, error["msg"].removeprefix("Value error, ")) if part)
    if kind == "missing" and isinstance(place.key, int):  # of a list of fixed length
        return f"{place.around} = {list(value)!r}: too few values{valid}"
    if kind == "extra_forbidden" and place.section is not None:
        return str(unknown_name("key", str(place.key), _keys_of(place.section), place.around))
    if kind == "literal_error" and (names := _literals(place.annotation)):
        return str(unknown_name(str(place.key), str(value), names, place.around))
    start = f"{place.around}: " if place.around else ""
    if kind == "missing":
        return f"{start}missing key {place.key!r}{valid}"
    return f"{place.text} = {value!r}: {message}{valid}"


def _keys_of(section: type[BaseModel]) -> list[str]:
    """Keys of a table as they stand in a file."""
    return [field.alias or name for name, field in section.model_fields.items()]


@dataclass(frozen=True)
class _Place:
    """Place of a fault in a document.

    Attributes:
        named: keys and indices that lead there.
        section: the table that holds the key; None where it is in none.
        annotation: type of what belongs there; None where unknown.
        valid: description of what belongs there, or of the list or table it is in.
    """

    named: tuple[int | str, ...]
    section: type[BaseModel] | None
    annotation: Any
    valid: str | None

    @staticmethod
    def locate(model: type[BaseModel], location: Sequence[int | str]) -> _Place:
        """Follow pydantic's location through tables, lists and alternatives, whose own names are left out."""
        at, section, valid, named = model, None, None, []
        for part in location:
            at, section = _without_none(at), None
            if isinstance(part, str) and get_origin(at) in (Union, UnionType):
                at = None  # the name of an alternative, which is none of the document's
                continue
            named.append(part)
            if isinstance(at, type) and issubclass(at, BaseModel):
                section, field = at, at.model_fields.get(str(part))
                at, valid = (None, None) if field is None else (field.annotation, field.description or find_description(field.annotation))
            else:
                at = _get_entry_type(at, part)
                valid = valid or find_description(at)
        return _Place(tuple(named), section, _without_none(at), valid)

    @property
    def key(self) -> int | str:
        """The last key or index."""
        return self.named[-1] if self.named else ""

    @property
    def is_value(self) -> bool:
        """Whether a value belongs there, not a table."""
        return not (isinstance(self.annotation, type) and issubclass(self.annotation, BaseModel))

    @property
    def around(self) -> str:
        """The list or table that the last key or index is in, in words."""
        return _words(self.named[:-1])

    @property
    def text(self) -> str:
        """The place in words."""
        return _words(self.named)


def _words(named: Sequence[int | str]) -> str:
    """`("runs", 1, "role")` as "runs entry 2: role"."""
    parts: list[str] = []
    for part in named:
        if isinstance(part, int):
            parts[-1:] = [f"{parts[-1] if parts else ''} entry {part + 1}".strip()]
        else:
            parts.append(part)
    return ": ".join(parts)


def _without_none(annotation: Any) -> Any:
    """`X` of `Annotated[X, …]` and of `X | None`."""
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    kinds = [kind for kind in get_args(annotation) if kind is not type(None)]
    optional = get_origin(annotation) in (Union, UnionType) and len(kinds) == 1
    return _without_none(kinds[0]) if optional else annotation


def _get_entry_type(annotation: Any, part: int | str) -> Any:
    """Get the type of an entry of a list or a table; None where unknown."""
    kinds = get_args(annotation)
    if isinstance(part, str):
        return kinds[1] if get_origin(annotation) is dict else None
    fixed = get_origin(annotation) is tuple and Ellipsis not in kinds
    return kinds[part] if fixed and part < len(kinds) else next(iter(kinds), None)


def _literals(annotation: Any) -> list[str]:
    if get_origin(annotation) is Literal:
        return [str(value) for value in get_args(annotation)]
    return [value for inner in get_args(annotation) for value in _literals(inner)]


def find_description(annotation: Any) -> str | None:
    """Find the description within an annotation, such as `Annotated[float, Field(description=…)] | None`."""
    for inner in get_args(annotation):
        found = inner.description if isinstance(inner, FieldInfo) else find_description(inner)
        if found:
            return found
    return None
