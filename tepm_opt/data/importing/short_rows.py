"""Rows with fewer fields than columns: the first and the last of a log that begins and ends within a line, and others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tepm_opt.data.importing.header_rows import fields_of
from tepm_opt.data.importing.maps import Format
from tepm_opt.data.importing.refusals import TableError, lines_of, refusal

Line = tuple[int, str]


def without_short_rows(path: Path, body: Sequence[Line], count: int, form: Format, separator: str) -> tuple[list[Line], list[str]]:
    """Rows of a table without those that are cut off, and words about those that were left out.

    Args:
        path: of the file.
        body: number and text of each row.
        count: columns.
        form: how the file is written.
        separator: of the fields.

    Raises:
        InputError: short rows that the map does not speak of; names the entry that leaves them out.
    """
    short = [place for place, (_, line) in enumerate(body) if _count(line, separator) < count]
    if not short or form.short_rows == "empty":
        return list(body), []
    ends = [place for place in short if place in (0, len(body) - 1)]
    leaves = short if form.short_rows == "all" else ends if form.short_rows == "ends" else []
    if rest := [place for place in short if place not in leaves]:
        raise _refusal(path, [body[place] for place in rest], count, separator, len(rest) == len(ends), len(body))
    told = [f"{path.name}: {_words([body[place]], count, separator)}: left out" for place in leaves[:4]]
    if len(leaves) > 4:
        told.append(f"{path.name}: {len(leaves) - 4} more short rows left out")
    gone = set(leaves)
    return [line for place, line in enumerate(body) if place not in gone], told


def _count(line: str, separator: str) -> int:
    """Fields of a line, blank ones at its end included."""
    if separator == " ":
        return len(line.split())
    return line.count(separator) + 1  # quoted separators make more of it: never a short row


def _words(lines: Sequence[Line], count: int, separator: str) -> str:
    return ", ".join(f"line {number} has {len(fields_of(line, separator))} of {count} fields" for number, line in lines)


def _refusal(path: Path, lines: Sequence[Line], count: int, separator: str, ends: bool, rows: int) -> TableError:
    if ends:
        return refusal(path, f"{_words(lines, count, separator)}: cut off?", 'csv.short_rows = "ends"')
    where = lines_of([number for number, _ in lines])
    first = len(fields_of(lines[0][1], separator))
    what = f"{where}: {first} of {count} fields; {len(lines)} of {rows} rows are short"
    return TableError(f'{path}: {what}; valid: whole rows, csv.short_rows = "all" (left out) or "empty" (filled up)')
