"""Text tables as columns: separators, decimal commas, headers anywhere. What looks wrong is refused with the entry that mends it."""

from __future__ import annotations

import io
import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.importing.header_rows import Shape, fields_of, is_number, join_names, stated_rate
from tepm_opt.data.importing.kinds import kinds_columns, refuse_kinds
from tepm_opt.data.importing.maps import Format
from tepm_opt.data.importing.refusals import quote_columns, refusal, toml
from tepm_opt.data.importing.short_rows import without_short_rows
from tepm_opt.errors import InputError


@dataclass(frozen=True, eq=False)
class TextColumns:
    """Columns of a text table.

    Attributes:
        columns: by name; by number as text where it has none.
        lines: of the rows.
        twice: names that stand twice, with their numbers.
        rate: in Hz, where the lines above the header state it.
        told: words about rows that were left out.
        groups: line above the header whose names would tell columns apart; 0: none.
    """

    columns: Mapping[str, np.ndarray]
    lines: tuple[int, ...]
    twice: Mapping[str, tuple[int, ...]]
    rate: float | None = None
    told: tuple[str, ...] = ()
    groups: int = 0


def separator_of(path: Path, form: Format) -> str:
    """The separator that the map names, else the usual one of the suffix."""
    return form.separator or ("\t" if path.suffix.lower() == ".tsv" else ",")


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
    if form.kinds:
        kinds = kinds_columns(path, lines, separator, lambda rows, count: _frame(pandas, rows, count, separator, form.decimal))
        return TextColumns(kinds, (), {})
    refuse_kinds(path, lines, separator)
    names, first = _header(path, lines, form, separator)
    body = [(number, line) for number, line in enumerate(lines[first - 1 :], first) if line.strip()]
    if not body:
        raise InputError(f"{path}: has no rows from line {first} on; valid: at least two")
    shape = Shape(path, lines, form, separator)
    shape.refuse_units_row(names, first)
    count = len(names)
    if wrong := [number for number, line in body if line.count(separator) >= count and len(fields_of(line, separator)) > count]:
        fields = fields_of(lines[wrong[0] - 1], separator)
        if len(wrong) > len(body) // 2:
            shape.refuse_commas(names, wrong[0], len(fields))
        what = f"line {wrong[0]}: {len(fields)} fields for {count} columns ({', '.join(names)})"
        raise InputError(f"{path}: {what}; mend or remove such lines, {len(wrong)} in all")
    body, told = without_short_rows(path, body, count, form, separator)
    if not body:
        raise InputError(f"{path}: has no whole rows from line {first} on; valid: at least two")
    found = _frame(pandas, [line for _, line in body], count, separator, form.decimal)
    columns, twice = {}, {}
    counted = Counter(names)
    for k, name in enumerate(names):
        repeated = counted[name] > 1
        if repeated:
            twice[name] = tuple(j + 1 for j, other in enumerate(names) if other == name)
        columns[f"{name} ({k + 1})" if repeated else name] = found[k]
    columns |= {name: np.empty(0) for name in twice}
    rate = stated_rate(lines[: (form.header or first) - 1], separator)
    return TextColumns(
        columns, tuple(number for number, _ in body), twice, rate, tuple(told), shape.groups(form.header) if twice and form.header else 0
    )


def _frame(pandas: Any, rows: list[str], count: int, separator: str, decimal: str) -> list[np.ndarray]:
    """Columns of rows of text."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of columns that hold text here and numbers there
        frame = pandas.read_csv(
            io.StringIO("\n".join(rows)),
            sep=r"\s+" if separator == " " else separator,
            decimal=decimal,
            header=None,
            names=range(count),
            index_col=False,
            skipinitialspace=True,
            low_memory=False,
        )
    return [_values(frame[k]) for k in range(count)]


def _values(series: Any) -> np.ndarray:
    if series.dtype.kind in "biuf":
        return series.to_numpy()
    return np.array(["" if missing else str(value).strip() for value, missing in zip(series, series.isna(), strict=True)], dtype=object)


def _header(path: Path, lines: list[str], form: Format, separator: str) -> tuple[list[str], int]:
    """Names of the columns, numbers where there are none, and the line of the first row."""
    shape = Shape(path, lines, form, separator)
    if form.header > len(lines):
        raise refusal(path, f"csv.header = {form.header}, but the file has {len(lines)} lines", f"csv.header = {shape.header()}")
    first = form.first or form.header + 1
    if form.header == 0:
        body = next((line for line in lines[first - 1 :] if line.strip()), "")
        shape.refuse_separator(first, body)
        count = max(len(fields_of(body, separator)), shape.usual(separator))
        return [str(k + 1) for k in range(count)], first
    line = lines[form.header - 1]
    shape.refuse_preamble(line)
    shape.refuse_separator(form.header, line)
    names = fields_of(line, separator)
    if all(is_number(name) for name in names):
        what = (
            f"line {form.header}: {quote_columns(names[:6])}{' …' if len(names) > 6 else ''}: numbers where the names of the columns belong"
        )
        raise refusal(path, what, f"csv.header = {shape.header()}")
    shape.refuse_group_row(names)
    above = [] if form.groups is None else [form.groups] if isinstance(form.groups, int) else form.groups
    if wrong := [number for number in above if not 0 < number < form.header]:
        what = f"csv.groups = {wrong[0]} is no line above the header, line {form.header}"
        raise refusal(path, what, f"csv.groups = {shape.groups(form.header) or 1}")
    names = join_names([shape.fields(number) for number in above], names) if above else names
    return [name or str(k + 1) for k, name in enumerate(names)], first
