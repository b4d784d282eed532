"""Text tables with rows of several kinds, each named by its first field: `P,0.02,1.5` and `T,0.02,10.1,20.4,30.9`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from tepm_opt.data.importing.header_rows import LOOKED_AT, fields_of, is_number
from tepm_opt.data.importing.refusals import refusal
from tepm_opt.errors import InputError

FEWEST = 5  # rows of a kind
MOST = 8  # kinds
WHOLE = 0.9  # of the rows of a kind that have the same number of fields


def kinds_of(lines: Sequence[str], separator: str, alike: bool = False) -> dict[str, int]:
    """Kinds of rows with their numbers of fields; empty where all rows are of one kind.

    Args:
        lines: of the file.
        separator: of the fields.
        alike: whether kinds may have as many fields as each other.
    """
    begin = next((line for line in reversed(lines[:LOOKED_AT]) if line.strip()), "")
    if not begin or is_number(fields_of(begin, separator)[0] if fields_of(begin, separator) else ""):
        return {}
    rows = [fields_of(line, separator) for line in lines if line.strip()]
    named = [row for row in rows if row and row[0] and not is_number(row[0]) and any(is_number(each) for each in row[1:])]
    counts = Counter(row[0] for row in named)
    kinds = {kind for kind, count in counts.items() if count >= FEWEST}
    if not 2 <= len(kinds) <= MOST or sum(counts[kind] for kind in kinds) < WHOLE * len(rows):
        return {}
    found = {}
    for kind in kinds:
        lengths = Counter(len(row) for row in named if row[0] == kind)
        length, most = lengths.most_common(1)[0]
        if most < WHOLE * counts[kind]:
            return {}
        found[kind] = length
    return found if alike or len(set(found.values())) > 1 else {}


def refuse_kinds(path: Path, lines: Sequence[str], separator: str) -> None:
    """Refuse a table with rows of several kinds that the map takes for one.

    Raises:
        InputError: names the kinds and the entry that tells them apart.
    """
    if found := kinds_of(lines, separator):
        words = ", ".join(f"{kind!r} with {count} fields" for kind, count in found.items())
        raise refusal(path, f"rows of {len(found)} kinds by their first field: {words}", "csv.kinds = true")


def kinds_columns(
    path: Path, lines: Sequence[str], separator: str, read: Callable[[list[str], int], list[np.ndarray]]
) -> dict[str, np.ndarray]:
    """Columns of each kind, `KIND/2` by the number of the field or `KIND/name` where a row of names begins the kind.

    Args:
        path: of the file.
        lines: of the file.
        separator: of the fields.
        read: makes columns of rows of text with so many fields.

    Raises:
        InputError: rows of one kind only.
    """
    found = kinds_of(lines, separator, alike=True)
    if not found:
        raise InputError(f"{path}: rows of one kind only; valid: csv.kinds = false")
    columns: dict[str, np.ndarray] = {}
    for kind, count in found.items():
        rows = [line for line in lines if (fields := fields_of(line, separator)) and fields[0] == kind and len(fields) == count]
        names = [str(k + 1) for k in range(count)]
        first = fields_of(rows[0], separator)
        if not any(is_number(each) for each in first[1:]):
            names, rows = first, rows[1:]
        columns |= {f"{kind}/{name}": values for name, values in list(zip(names, read(rows, count), strict=True))[1:]}
    return columns
