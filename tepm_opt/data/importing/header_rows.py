"""Shape of a text table: its header rows, its separator, and the lines of keys and values above it."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from tepm_opt.data.importing.maps import Format
from tepm_opt.data.importing.refusals import quote_columns, refusal, toml
from tepm_opt.data.importing.units import UNITS

SEPARATORS = (",", ";", "\t", "|", " ")
LOOKED_AT = 200  # lines, for how a file is written
ABOVE = 8  # lines above the header in which names of groups may stand
_RATE = re.compile(
    r"(export|capture|camera)?(?:ed|d)?[ _-]*(?:frame|sampl\w*|data|record\w*|acquisition|update)?[ _-]*"
    r"(?:rate|frequency|freq|fps)(?:[ _]*[(\[]?(?:hz|fps)[)\]]?)?",
    re.I,
)
_DIGITS = re.compile(r"[\d.,;:|/\s+-]*(?:[eE][+-]\d+[\d.,;:|/\s+-]*)*")  # also numbers that another separator parts
_NUMBER = re.compile(r"(\d+(?:[.,]\d+)?) ?(?:hz|fps)?", re.I)
_UNITS = {unit.lower() for units in UNITS.values() for unit in units} | {"", "-", "v", "a", "ma", "hz", "°c", "k", "%", "nm"}


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


def is_unit(text: str) -> bool:
    """Whether a field under a name is a unit: "mm", "[kPa]", empty."""
    return text.strip("[]() ").lower() in _UNITS


def stated_rate(lines: Sequence[str], separator: str) -> float | None:
    """Rate in Hz that lines of keys and values state; that of the export where there are several.

    Args:
        lines: above the header.
        separator: of the fields.
    """
    found: dict[str, float] = {}
    for line in lines:
        fields = [part.strip() for field in fields_of(line.strip().lstrip("#%; "), separator) for part in re.split(r"[=:]", field)]
        for name, value in pairwise(fields):
            number, kind = _NUMBER.fullmatch(value), _RATE.fullmatch(name)
            if number and kind and (rate := float(number[1].replace(",", "."))) > 0:
                found[(kind[1] or "").lower()] = rate
    return next((found[kind] for kind in ("export", "", "camera", "capture") if kind in found), None)


def join_names(groups: Sequence[Sequence[str]], names: Sequence[str]) -> list[str]:
    """Names of columns behind those of their groups; a group's name holds until the next one.

    A label above one column that has a name of its own ("Name" above "Time") is no group.
    """
    found = [""] * len(names)
    counted = Counter(names)
    for row in groups:
        cells = [row[k] if k < len(row) else "" for k in range(len(names))]
        starts = [k for k, cell in enumerate(cells) if cell]
        for start, end in pairwise([*starts, len(names)]):
            own = names[start]
            if end - start == 1 and counted[own] == 1 and not is_unit(own) and not is_number(own):
                continue
            for k in range(start, end):
                found[k] = f"{found[k]} {cells[start]}".strip()
    return [f"{group} {name}".strip() for group, name in zip(found, names, strict=True)]


@dataclass(frozen=True)
class Shape:
    """Form in which a file seems to be written, for proposals."""

    path: Path
    lines: list[str]
    form: Format
    separator: str

    def usual(self, separator: str) -> int:
        """Number of fields that most lines have."""
        counts = Counter(len(fields_of(line, separator)) for line in self.lines[:LOOKED_AT] if line.strip())
        return max(counts, key=lambda count: (counts[count], count))

    def fields(self, number: int) -> list[str]:
        """Fields of a line."""
        return fields_of(self.lines[number - 1], self.separator)

    def _numbers(self, number: int) -> tuple[int, int]:
        """Number of fields of a line that are given, and of those of them that are numbers."""
        given = [each for each in self.fields(number) if each]
        return len(given), sum(is_number(each) or _DIGITS.fullmatch(each) is not None for each in given)

    def data(self) -> int:
        """The first line of numbers with as many fields as most lines; 0 where there is none."""
        usual = self.usual(self.separator)
        for number in range(1, min(len(self.lines), LOOKED_AT) + 1):
            given, numbers = self._numbers(number)
            if len(self.fields(number)) == usual and 2 * numbers >= given > 0:
                return number
        return 0

    def header(self) -> int:
        """The line that seems to name the columns: the last one of text before the first of numbers, units left aside; 0: none."""
        usual = self.usual(self.separator)
        found = []
        for number in range(1, (self.data() or min(len(self.lines), LOOKED_AT) + 1)):
            fields, (given, numbers) = self.fields(number), self._numbers(number)
            if len(fields) == usual and len(set(fields)) > 1 and 2 * numbers < given and not all(map(is_unit, fields)):
                found.append(number)
        unique = [number for number in found if len(set(self.fields(number))) == usual and all(self.fields(number))]
        if not found or not unique or found[-1] in unique or self.groups(found[-1]):
            return found[-1] if found else 0
        return unique[-1]

    def groups(self, header: int) -> int:
        """The line above a header whose names tell columns of one name apart; 0 where none does."""
        names = self.fields(header)
        if len(set(names)) == len(names) and all(names):
            return 0
        for number in range(max(1, header - ABOVE), header):
            row = self.fields(number)
            if not 2 <= len(row) <= len(names) or len({each for each in row if each}) < 2:
                continue
            joined = join_names([row], names)
            if len(set(joined)) == len(joined):
                return number
        return 0

    def _entries(self, header: int) -> list[str]:
        """Entries of the map for a header, the names of groups above it and units below it."""
        groups, first = self.groups(header), self.data()
        units = first > header + 1 and bool(self.lines[header].strip()) and all(map(is_unit, self.fields(header + 1)))
        return [
            f"csv.header = {header}",
            *([f"csv.groups = {groups}"] if groups else []),
            *([f"csv.first = {first}"] if units and groups else []),
        ]

    def _join_names(self, header: int) -> list[str]:
        names, groups = self.fields(header), self.groups(header)
        return join_names([self.fields(groups)], names) if groups else names

    def refuse_separator(self, number: int, line: str) -> None:
        """Refuse a line that is one field only, where another separator makes several of it and of the others."""
        if len(fields_of(line, self.separator)) > 1 or len(self.lines) < 2:
            return
        found = {each: self.usual(each) for each in SEPARATORS if each != self.separator}
        best = max(found, key=lambda each: (found[each], -SEPARATORS.index(each)))
        if found[best] > 1:
            columns = quote_columns(fields_of(line, best)) if len(fields_of(line, best)) > 1 else repr(line.strip()[:60])
            what = f"line {number}: {columns} are separated by {best!r}, not {self.separator!r}"
            raise refusal(self.path, what, f"csv.separator = {toml(best)}")

    def refuse_preamble(self, line: str) -> None:
        """Refuse a header with another number of fields than the rows have, where a later line looks like one."""
        usual, own = self.usual(self.separator), self.form.header
        if usual <= 1 or len(fields_of(line, self.separator)) == usual or (number := self.header()) in (0, own):
            return
        found = quote_columns(self._join_names(number))
        what = f"line {own}: {line.strip()[:60]!r} does not name the {usual} columns; line {number} does: {found}"
        raise refusal(self.path, what, *self._entries(number))

    def refuse_group_row(self, names: Sequence[str]) -> None:
        """Refuse a header of groups only, where a row below it names the columns."""
        own = self.form.header
        if self.form.groups is not None or self.form.first is not None or (len(set(names)) == len(names) and all(names)):
            return
        number = self.header()
        if number > own and self.groups(number) == own:
            what = f"line {own} names groups, line {number} their columns: {quote_columns(self._join_names(number))}"
            raise refusal(self.path, what, *self._entries(number))

    def refuse_units_row(self, names: Sequence[str], first: int) -> None:
        """Refuse a first row of text only (units), where numbers follow."""
        rows = [fields_of(line, self.separator) for line in self.lines[first - 1 : first + 9]]
        text = [bool(row) and not any(is_number(each) for each in row if each) for row in rows]
        if text and text[0] and False in text:
            behind = text.index(False)
            shown = ", ".join(f"{name} {value!r}" for name, value in zip(names, rows[0], strict=False))
            what = f"line {first}: text in all columns ({shown}): units?"
            raise refusal(self.path, what, f"csv.first = {first + behind}")

    def refuse_commas(self, names: Sequence[str], number: int, fields: int) -> None:
        """Refuse rows with about twice as many fields as columns: decimal commas between commas."""
        if self.separator == "," and fields in (2 * len(names), 2 * len(names) - 1):
            what = f"line {number}: {fields} fields for {len(names)} columns ({', '.join(names)}): decimal commas between separating commas"
            mended = 'csv = { separator = ";", decimal = "," }'
            raise refusal(self.path, f"{what}; export with another separator, such as ';'", mended)
