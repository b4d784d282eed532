"""Changing numbers of a TOML file in place, so that its comments stay."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping

from tepm_opt.errors import InputError

TABLE = re.compile(r"^\s*\[([^\[\]]+)\]\s*(?:#.*)?$")


def with_numbers(text: str, table: str, numbers: Mapping[str, float | list[float]], where: str) -> str:
    """The text with other numbers in a table: in place of those of the same names, else at the table's beginning.

    Args:
        text: of a TOML file.
        table: its name, such as `hardware.tracker`.
        numbers: by their keys; lists of numbers, too.
        where: name of the file, for messages.

    Raises:
        InputError: the file has no such table of its own, or could not be read afterwards.
    """
    lines = text.splitlines()
    heads = [number for number, line in enumerate(lines) if (head := TABLE.match(line)) and head[1].strip() == table]
    if not heads:
        raise InputError(f"{where}: it has no table [{table}] to write into; valid: a file with that table")
    first = heads[0] + 1
    last = next((number for number in range(first, len(lines)) if lines[number].lstrip().startswith("[")), len(lines))
    for key, value in numbers.items():
        pattern = re.compile(rf"^(\s*{re.escape(key)}\s*=\s*)(\[[^\]#]*\]|[^#\s]+)(.*)$")
        at = next((number for number in range(first, last) if pattern.match(lines[number])), None)
        if at is None:
            lines.insert(first, f"{key} = {value!r}")
            last += 1
        else:
            lines[at] = pattern.sub(lambda found, new=value: f"{found[1]}{new!r}{found[3]}", lines[at])
    changed = "\n".join(lines) + "\n"
    if any(_number(changed, [*table.split("."), key]) != value for key, value in numbers.items()):
        raise InputError(f"{where}: the numbers of [{table}] could not be replaced; valid: each key unquoted, on a line of its own")
    return changed


def _number(text: str, keys: list[str]) -> object:
    """The value under a row of keys; None where there is none."""
    try:
        found = tomllib.loads(text)
        for key in keys:
            found = found[key]
    except (tomllib.TOMLDecodeError, KeyError):
        return None
    return found
