"""Text tables as columns: separators, decimal commas, headers anywhere. What looks wrong is refused with the entry that mends it."""

from __future__ import annotations

import csv
import io
import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.importing.maps import Format
from tepm_opt.data.importing.refusals import named, refusal, toml
from tepm_opt.errors import InputError

SEPARATORS = (",", ";", "\t", "|", " ")
LOOKED_AT = 200  # lines, for how a file is written


@dataclass(frozen=True, eq=False)
class TextColumns:
    """Columns of a text table by name (numbers as text where it has none), the rows' lines, names that stand twice with their numbers."""

    columns: Mapping[str, np.ndarray]
    lines: tuple[int, ...]
    twice: Mapping[str, tuple[int, ...]]


def separator_of(path: Path, form: Format) -> str:
    """The separator that the map names, else the usual one of the suffix."""
    return form.separator or ("\t" if path.suffix.lower() == ".tsv" else ",")


def fields_of(line: str, separator: str) -> list[str]:
    """Fields of a line; blanks separate in any number. Blank ones behind a last separator are none."""
    if separator == " ":
        return line.split()
    found = [each.strip() for each in next(csv.reader([line], delimiter=separator), [])]
    while len(found) > 1 and not found[-1]:
        found.pop()
    return found


def is_number(text: str) -> bool:
    """Whether a field is a number (with a point or a comma), or empty."""
    try:
        float(text.replace(",", ".", 1) if text else "0")
    except ValueError:
        return False
    return True


def text_lines(path: Path, encoding: str) -> list[str]:
    """Lines of a text file.

    Raises:
        InputError: it cannot be read; another encoding; empty.
    """
    try:
        text = path.read_text(encoding="utf-8-sig" if encoding.lower() in ("utf-8", "utf8") else encoding)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except LookupError as error:
        raise refusal(
            path, f"csv.encoding = {encoding!r} is no encoding; valid: utf-8, latin-1, utf-16 …", 'csv.encoding = "utf-8"'
        ) from error
    except UnicodeError as error:
        raw = path.read_bytes()
        wide = raw[:2] in (b"\xff\xfe", b"\xfe\xff")
        at = getattr(error, "start", 0)
        line = raw[:at].count(b"\n") + 1
        around = raw[max(at - 20, raw.rfind(b"\n", 0, at) + 1) : at + 20].split(b"\n")[0].decode("latin-1").strip() if not wide else ""
        what = f"is not {encoding}" + (f": line {line}: {around!r}" if around else "")
        raise refusal(path, what, f"csv.encoding = {toml('utf-16' if wide else 'latin-1')}") from error
    lines = text.splitlines()
    if not any(line.strip() for line in lines):
        raise InputError(f"{path}: is empty; valid: a table with at least two rows")
    return lines


def text_columns(path: Path, form: Format, pandas: Any) -> TextColumns:
    """A text table.

    Args:
        path: of the file.
        form: how it is written.
        pandas: the module.

    Raises:
        InputError: another separator, header, decimal sign or encoding than the map says; says which entry mends it.
    """
    lines = text_lines(path, form.encoding)
    separator = separator_of(path, form)
    names, first = _header(path, lines, form, separator)
    body = [(number, line) for number, line in enumerate(lines[first - 1 :], first) if line.strip()]
    if not body:
        raise InputError(f"{path}: has no rows from line {first} on; valid: at least two")
    shape = _Shape(path, lines, form, separator)
    shape.refuse_units_row(names, first)
    count = len(names)
    if wrong := [number for number, line in body if line.count(separator) >= count and len(fields_of(line, separator)) > count]:
        fields = fields_of(lines[wrong[0] - 1], separator)
        if len(wrong) > len(body) // 2:
            shape.refuse_commas(names, wrong[0], len(fields))
        what = f"line {wrong[0]}: {len(fields)} fields for {count} columns ({', '.join(names)})"
        raise InputError(f"{path}: {what}; mend or remove such lines, {len(wrong)} in all")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of columns that hold text here and numbers there
        frame = pandas.read_csv(
            io.StringIO("\n".join(line for _, line in body)),
            sep=r"\s+" if separator == " " else separator,
            decimal=form.decimal,
            header=None,
            names=range(count),
            index_col=False,
            skipinitialspace=True,
            low_memory=False,
        )
    columns, twice = {}, {}
    counted = Counter(names)
    for k, name in enumerate(names):
        repeated = counted[name] > 1
        if repeated:
            twice[name] = tuple(j + 1 for j, other in enumerate(names) if other == name)
        columns[f"{name} ({k + 1})" if repeated else name] = _values(frame[k])
    columns |= {name: np.empty(0) for name in twice}
    return TextColumns(columns, tuple(number for number, _ in body), twice)


def _values(series: Any) -> np.ndarray:
    if series.dtype.kind in "biuf":
        return series.to_numpy()
    return np.array(["" if missing else str(value).strip() for value, missing in zip(series, series.isna(), strict=True)], dtype=object)


def _header(path: Path, lines: list[str], form: Format, separator: str) -> tuple[list[str], int]:
    """Names of the columns, numbers where there are none, and the line of the first row."""
    shape = _Shape(path, lines, form, separator)
    if form.header > len(lines):
        raise refusal(path, f"csv.header = {form.header}, but the file has {len(lines)} lines", f"csv.header = {shape.header()}")
    first = form.first or form.header + 1
    if form.header == 0:
        body = next((line for line in lines[first - 1 :] if line.strip()), "")
        shape.refuse_separator(first, body)
        return [str(k + 1) for k in range(len(fields_of(body, separator)))], first
    line = lines[form.header - 1]
    shape.refuse_preamble(line)
    shape.refuse_separator(form.header, line)
    names = fields_of(line, separator)
    if all(is_number(name) for name in names):
        what = f"line {form.header}: {named(names[:6])}{' …' if len(names) > 6 else ''}: numbers where the names of the columns belong"
        raise refusal(path, what, "csv.header = 0")
    return [name or str(k + 1) for k, name in enumerate(names)], first


@dataclass(frozen=True)
class _Shape:
    """How a file seems to be written, for proposals."""

    path: Path
    lines: list[str]
    form: Format
    separator: str

    def usual(self, separator: str) -> int:
        """How many fields most lines have."""
        counts = Counter(len(fields_of(line, separator)) for line in self.lines[:LOOKED_AT] if line.strip())
        return max(counts, key=lambda count: (counts[count], count))

    def header(self) -> int:
        """The line that seems to name the columns: the last one of text before the first of numbers; 0 where there is none."""
        usual = self.usual(self.separator)
        for number, line in enumerate(self.lines[:LOOKED_AT], 1):
            fields = fields_of(line, self.separator)
            if len(fields) == usual and not any(is_number(each) for each in fields if each) and len(set(fields)) > 1:
                return number
        return 0

    def refuse_separator(self, number: int, line: str) -> None:
        """Refuse a line that is one field only, where another separator makes several of it and of the others."""
        if len(fields_of(line, self.separator)) > 1 or len(self.lines) < 2:
            return
        found = {each: self.usual(each) for each in SEPARATORS if each != self.separator}
        best = max(found, key=lambda each: (found[each], -SEPARATORS.index(each)))
        if found[best] > 1:
            columns = named(fields_of(line, best)) if len(fields_of(line, best)) > 1 else repr(line.strip()[:60])
            what = f"line {number}: {columns} are separated by {best!r}, not {self.separator!r}"
            raise refusal(self.path, what, f"csv.separator = {toml(best)}")

    def refuse_preamble(self, line: str) -> None:
        """Refuse a header with fewer fields than the rows have, where a later line looks like one."""
        usual = self.usual(self.separator)
        if usual > 1 and len(fields_of(line, self.separator)) < usual and (number := self.header()) not in (0, self.form.header):
            names = named(fields_of(self.lines[number - 1], self.separator))
            what = f"line {self.form.header}: {line.strip()[:60]!r} does not name the {usual} columns; line {number} does: {names}"
            raise refusal(self.path, what, f"csv.header = {number}")

    def refuse_units_row(self, names: list[str], first: int) -> None:
        """Refuse a first row of text only (units), where numbers follow."""
        rows = [fields_of(line, self.separator) for line in self.lines[first - 1 : first + 9]]
        text = [bool(row) and not any(is_number(each) for each in row if each) for row in rows]
        if text and text[0] and False in text:
            behind = text.index(False)
            shown = ", ".join(f"{name} {value!r}" for name, value in zip(names, rows[0], strict=False))
            what = f"line {first}: text in all columns ({shown}): units?"
            raise refusal(self.path, what, f"csv.first = {first + behind}")

    def refuse_commas(self, names: list[str], number: int, fields: int) -> None:
        """Refuse rows with about twice as many fields as columns: decimal commas between commas."""
        if self.separator == "," and fields in (2 * len(names), 2 * len(names) - 1):
            what = f"line {number}: {fields} fields for {len(names)} columns ({', '.join(names)}): decimal commas between separating commas"
            mended = 'csv = { separator = ";", decimal = "," }'
            raise refusal(self.path, f"{what}; export with another separator, such as ';'", mended)
