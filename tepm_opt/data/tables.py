"""CSV tables with named columns: read with errors that say file, line and column; written whole or not at all."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tepm_opt.data.files import write_atomically
from tepm_opt.data.foreign import CSV, kind_of, refuse_foreign
from tepm_opt.errors import InputError


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of a CSV file; an empty field is NaN.

    Attributes:
        path: of the file.
        columns: values by name, in file order, (rows,) each; numbers, or text where text is allowed.
        lines: line number in the file of each row.
    """

    path: Path
    columns: Mapping[str, np.ndarray]
    lines: tuple[int, ...]

    def __repr__(self) -> str:
        return f"Table({self.path}: {len(self.lines)} rows, {len(self.columns)} columns)"

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def column(self, name: str, may_be_empty: np.ndarray | bool = False) -> np.ndarray:
        """One column, all values finite but for the rows (rows,) that may be empty.

        Raises:
            InputError: it is missing, or a value is empty, NaN or infinite.
        """
        if name not in self.columns:
            raise InputError(f"{self.path}: column {name!r} is missing; found: {', '.join(self.columns)}")
        values = self.columns[name]
        self.refuse(~np.isfinite(values) & ~np.asarray(may_be_empty), name, "a finite number")
        return values

    def refuse(self, wrong: np.ndarray, name: str, valid: str) -> None:
        """Raise for the first row where `wrong` (rows,) is true.

        Raises:
            InputError: naming file, line, column, value and what is valid.
        """
        if wrong.any():
            row = int(np.argmax(wrong))
            value = self.columns[name][row]
            found = "is empty" if np.isnan(value) else f"= {value:g}"
            raise InputError(f"{self.path}: line {self.lines[row]}: {name} {found}; valid: {valid}")

    def read_increasing(self, name: str) -> np.ndarray:
        """Read a column of finite values, each larger than the one before.

        Raises:
            InputError: as for `column`, or a value that does not increase.
        """
        values = self.column(name)
        self.refuse(np.diff(values, prepend=-np.inf) <= 0, name, "larger than in the row before")
        return values


def read_table(path: str | Path, text: Callable[[str], bool] = lambda name: False) -> Table:
    """Read a CSV file with a header.

    Args:
        path: of the file.
        text: which columns may hold text. Such a column is text where its first field that is not empty is not a number.

    Raises:
        InputError: unreadable file, a file of another program, no header, no rows, a row of another length, text where a number belongs.
    """
    path = Path(path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            rows = [(reader.line_num, row) for row in reader if row]
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        refuse_foreign(path, CSV)
        raise InputError(f"{path}: is not a CSV text file: {error}") from error
    if not rows:
        raise InputError(f"{path}: is empty; valid: a header line and at least one row")
    if kind := kind_of("\n".join(",".join(row) for _, row in rows[:10]).encode()):
        raise InputError(f"{path} is {kind}; {CSV}")
    names = [name.strip() for name in rows[0][1]]
    if len(names) == 1 and ";" in names[0]:
        raise InputError(f"{path}: line {rows[0][0]}: columns are separated by ';'; valid: ','")
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"{path}: line {rows[0][0]}: column {twice[0]!r} stands twice")
    if len(rows) == 1:
        raise InputError(f"{path}: has no rows; valid: at least one row under the header")
    lines = tuple(line for line, _ in rows[1:])
    for line, row in rows[1:]:
        if len(row) != len(names):
            raise InputError(f"{path}: line {line}: {len(row)} fields, the header has {len(names)}")
    words = {name: k for k, name in enumerate(names) if text(name) and _is_text(row[k] for _, row in rows[1:])}
    numeric = [k for k, name in enumerate(names) if name not in words]
    values = np.array([_numbers(path, line, names, row, numeric) for line, row in rows[1:]])
    columns = {names[k]: values[:, place] for place, k in enumerate(numeric)}
    columns |= {name: np.array([row[k] for _, row in rows[1:]], dtype=np.str_) for name, k in words.items()}
    return Table(path, {name: columns[name] for name in names}, lines)


def _is_text(fields: Iterable[str]) -> bool:
    first = next((field for field in fields if field.strip()), "0")
    try:
        float(first)
    except ValueError:
        return True
    return False


def _numbers(path: Path, line: int, names: Sequence[str], row: Sequence[str], numeric: Sequence[int]) -> list[float]:
    at = 0
    try:
        return [float(field) if (field := row[at := k]).strip() else np.nan for k in numeric]
    except ValueError as error:
        raise InputError(f"{path}: line {line}: {names[at]} = {row[at]!r} is not a number") from error


def write_table(path: str | Path, names: Sequence[str], rows: np.ndarray) -> None:
    """Write rows (rows, columns) under the names; numbers in the shortest form that reads back equal, NaN as an empty field.

    Raises:
        InputError: the folder cannot be written to.
    """
    lines = [",".join(names), *(",".join(field_texts(row)) for row in np.asarray(np.atleast_2d(rows), dtype=float).tolist())]
    write_atomically(path, "\n".join(lines) + "\n")


def field_texts(values: Iterable[float]) -> list[str]:
    """Python's own floats in the shortest form that reads back equal; NaN is empty."""
    return ["" if text == "nan" else text for text in map(repr, values)]


def column_texts(values: np.ndarray) -> list[str]:
    """A column (rows,) of numbers or text as fields that read back equal."""
    return list(values) if values.dtype.kind == "U" else field_texts(values.astype(float).tolist())


def write_columns(path: str | Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns (rows,) of numbers or text so that they read back equal (text where it is allowed).

    Raises:
        InputError: a text column that would read back as numbers; the folder cannot be written to.
    """
    fields = []
    for name, values in columns.items():
        if values.dtype.kind == "U" and not _is_text(values):
            raise InputError(f"{path}: column {name!r} holds text that reads as numbers; write numbers or another text in its first row")
        fields.append(column_texts(values))
    write_atomically(path, csv_text([list(columns), *zip(*fields, strict=True)]))


def csv_text(rows: Iterable[Sequence[str]]) -> str:
    """Lines of a CSV file, each ended; fields are quoted where they must be (the csv module forgets about a lone carriage return)."""
    return "".join(map(_line, rows))


def _line(row: Sequence[str]) -> str:
    line = ",".join(row)
    if line.count(",") > len(row) - 1 or any(mark in line for mark in '"\r\n'):
        line = ",".join(map(_quote, row))
    return line + "\n" if line or len(row) != 1 else '""\n'


def _quote(field: str) -> str:
    return '"' + field.replace('"', '""') + '"' if any(mark in field for mark in ',"\r\n') else field
