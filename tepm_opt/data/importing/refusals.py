"""Refusals that name all columns concerned and the entry of the map file that mends them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

from tepm_opt.errors import InputError

PUT, BETWEEN = "; put into the map: ", " and "
"""Before the entries that mend what is refused, and between several of them."""


class TableError(InputError):
    """Finding in a table, and the entries of the map that mend it.

    Attributes:
        found: file and finding, without the entries.
        entries: lines of TOML.
        asks: whether only a person can answer it: no entry can be proposed.
    """

    def __init__(self, found: str, entries: Sequence[str] = (), asks: bool = False) -> None:
        super().__init__(found + (PUT + BETWEEN.join(entries) if entries else ""))
        self.found, self.asks = found, asks
        self.entries = tuple(part for entry in entries for part in entry.split(BETWEEN))


def question(where: Any, what: str, *answers: str) -> TableError:
    """A refusal that asks what no table tells, with the answers that are valid."""
    return TableError(f"{where}: {what}; valid: {' or '.join(answers)}", asks=True)


def refusal(where: Any, what: str, *entries: str) -> TableError:
    """A refusal that ends with what to put into the map file.

    Args:
        where: file, or file and line.
        what: what was found there.
        entries: lines of TOML that mend it; none where the file has to be mended itself.
    """
    return TableError(f"{where}: {what}", [entry for entry in entries if entry])


def toml(value: Any) -> str:
    """A value as TOML: text, number, truth, or a list of them; tables inline."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key(name)} = {toml(each)}" for name, each in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def key(name: str) -> str:
    """A key as TOML, quoted where it must be."""
    return name if name and all(letter.isascii() and (letter.isalnum() or letter in "_-") for letter in name) else json.dumps(name)


def quote_columns(columns: Iterable[Any]) -> str:
    """Name columns for people, all of them: "column 'p1'", "columns 'p1', 'p2' and 'p3'"."""
    texts = [repr(each) for each in columns]
    return f"column {texts[0]}" if len(texts) == 1 else f"columns {', '.join(texts[:-1])} and {texts[-1]}"


def lines_of(lines: Sequence[int], most: int = 3) -> str:
    """Lines for people: "line 7", "lines 7, 9 and 12 more"."""
    shown = ", ".join(map(str, lines[:most]))
    return f"line{'s' if len(lines) > 1 else ''} {shown}" + (f" and {len(lines) - most} more" if len(lines) > most else "")
