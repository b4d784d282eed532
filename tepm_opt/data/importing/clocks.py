"""Clocks of tables: columns of time, parts of a time, counters, dates; what is none is refused with the entry that makes one."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from tepm_opt.data.importing.dates import are_local_times, local_seconds
from tepm_opt.data.importing.maps import ISO, ImportMap, Name, TimeMap, Wanted, fits, time_with
from tepm_opt.data.importing.refusals import TableError, lines_of, question, quote_columns, refusal, toml
from tepm_opt.data.importing.resample import Clock
from tepm_opt.data.importing.rolling import DAY, HOUR, MINUTE, period_of, time_parts, unroll
from tepm_opt.data.importing.sources import Sheet, optional
from tepm_opt.data.importing.units import factor
from tepm_opt.errors import InputError

COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
PERIODS = {"h": DAY, "min": HOUR, "s": MINUTE, "ms": 1.0, "us": 1e-3, "µs": 1e-3, "ns": 1e-6}  # s, by the unit of the largest part
_COUNTER = re.compile(
    r"(?:.*[/._ -])?(?:sub ?)?(?:frames?|samples?|index|idx|rows?|records?|packets?|counter|count|seq\w*|n|nr|no|#)"
    r"(?:[ _./-]?(?:no|nr|num\w*|id|index|count\w*|#))?[ .:#]*",
    re.I,
)
Rows = slice | np.ndarray


def line_of(sheet: Sheet, row: int, rows: Rows) -> int:
    """Line in the file of a row of a run."""
    return sheet.line(int(rows[row]) if isinstance(rows, np.ndarray) else row)


def counts_rows(sheet: Sheet, name: str) -> bool:
    """Whether a column is by name and steps a counter of frames or samples, no clock."""
    values = sheet.columns[name]
    if _COUNTER.fullmatch(name) is None or values.dtype.kind not in "iuf":
        return False
    steps = np.diff(values[np.isfinite(values)])
    return bool(steps.size) and bool(np.all(steps == np.round(steps))) and float(np.median(steps)) == 1.0


def clock_of(given: ImportMap, each: Wanted, sheet: Sheet, name: str, count: int, rows: Rows) -> tuple[Clock, np.ndarray]:
    """Times of a column's samples, and which of its rows have one.

    Args:
        given: the map.
        each: the entry that the column belongs to.
        sheet: its file.
        name: of the column.
        count: its rows in the run.
        rows: of the run in the file.

    Raises:
        InputError: no time, time of other rows, time that stands or goes back; names the entry that mends it.
    """
    entry = time_map(given, sheet)
    columns: list[Name] = [each.source.time] if each.source.time is not None else entry.names
    if not columns and entry.rate_hz is not None:
        return Clock(np.arange(count) / entry.rate_hz, entry.rate_hz), np.arange(count)
    owns = [sheet.clocks.get(name)] if not columns else [sheet.name(column) for column in columns]
    if None in owns:
        raise _no_time(given, sheet, [column for column, own in zip(columns, owns, strict=False) if own is None])
    names = [str(own) for own in owns]
    own = names[0]
    if other := [one for one in names if len(sheet.columns[one]) != len(sheet.columns[name])]:
        raise _other_rows(each, sheet, name, other[0])
    raw, one, period = _read_counter(given, sheet, names, entry, rows)
    kept = np.flatnonzero(np.isfinite(raw))
    told: tuple[str, ...] = ()
    if period is not None:
        raw[kept], times = unroll(raw[kept], period)
        if times:
            told = (f"{sheet.path.name}: {quote_columns(names)} (time) rolls over at {period * one:g} s, {times} times: counted on",)
    time = raw * one if one >= 1 or not np.all(raw[kept] == np.round(raw[kept])) else _convert_to_seconds(raw, one)
    steps = np.diff(time[kept])
    if (back := np.flatnonzero(steps < 0) + 1).size:
        lines = [line_of(sheet, int(row), rows) for row in kept]
        raise _goes_back(given, sheet, entry, names, _CountedTime(raw[kept], one, lines), back)
    if (stands := np.flatnonzero(steps == 0) + 1).size:
        if entry.repeated is None:
            _refuse_part(given, sheet, entry, own)
            where = [line_of(sheet, int(kept[row]), rows) for row in stands]
            mended = time_with(given, entry, repeated="first")
            raise refusal(f"{sheet.path}: {lines_of(where)}", f"column {own!r} (time) repeats itself", mended)
        drop = stands if entry.repeated == "first" else stands - 1
        kept = np.delete(kept, drop)
    if len(kept) < 2:
        raise InputError(f"{sheet.path}: column {own!r} (time): {len(kept)} rows; valid: at least two")
    time = time[kept]
    known = entry.rate_hz if columns == entry.names else None
    return Clock(time - time[0] if entry.from_start else time, known, told), kept


def _read_counter(given: ImportMap, sheet: Sheet, names: list[str], entry: TimeMap, rows: Rows) -> tuple[np.ndarray, float, float | None]:
    """Time as it is counted (NaN where it is empty), what one of it is in s, and the value at which it rolls over."""
    if len(names) > 1:
        parts = [seconds(given, sheet, name, entry, unit)[rows] for name, unit in zip(names, entry.units, strict=True)]
        return np.sum(parts, axis=0), 1.0, entry.rolls_over_at or max(PERIODS[unit] for unit in entry.units)
    (own,) = names
    values = sheet.columns[own]
    if entry.rate_hz is not None and own == sheet.name(entry.names[0]):
        if values.dtype.kind not in "iuf" or np.any(np.diff(values) % 1 != 0):
            raise refusal(
                sheet.path,
                f"column {own!r} (time) counts no rows, as rate_hz = {entry.rate_hz:g} would have it",
                _clock_entry(given, sheet, entry),
            )
        return values[rows].astype(float), 1 / entry.rate_hz, entry.rolls_over_at
    if counts_rows(sheet, own):
        raise _no_clock(given, sheet, entry, own)
    if values.dtype.kind == "O" and are_local_times(values):
        found, period = local_seconds(sheet, own, values, entry.date, lambda date: time_with(given, entry, date=date))
        return found[rows], 1.0, period
    one = 1.0 if values.dtype.kind == "M" or own in sheet.clocks.values() or ISO in entry.units else factor(entry.units[0], "time")
    return seconds(given, sheet, own, entry, entry.units[0], counted=True)[rows].astype(float), one, entry.rolls_over_at


def _convert_to_seconds(values: np.ndarray, one: float) -> np.ndarray:
    """Convert whole numbers of a small unit to s, to the ns far from 0."""
    whole = round(1 / one)
    return values // whole + (values % whole) * one


@dataclass(frozen=True, eq=False)
class _CountedTime:
    """Time as a file counts it, without empty fields.

    Attributes:
        raw: the counts, (rows,).
        one: one of them in s.
        lines: of the file, one a count.
    """

    raw: np.ndarray
    one: float
    lines: list[int]


def _goes_back(given: ImportMap, sheet: Sheet, entry: TimeMap, names: list[str], counter: _CountedTime, back: np.ndarray) -> TableError:
    """The refusal of a time that goes back: a part of a time, a counter that rolls over, a row that is cut off, a new run."""
    own, raw, one = names[0], counter.raw, counter.one
    where = [counter.lines[row] for row in back]
    first = int(back[0])
    before, behind = float(raw[first - 1]), float(raw[first])
    place, what = f"{sheet.path}: {lines_of(where)}", f"column {own!r} (time) goes back from {before * one:g} to {behind * one:g} s"
    _refuse_part(given, sheet, entry, own)
    if back.tolist() == [1] and sheet.lines:
        return refusal(place, f"{what}: line {counter.lines[0]} is cut off?", f"csv.first = {where[0]}")
    if len(names) == 1 and (period := period_of(raw, back, one)) is not None:
        what = f"{what}: a counter that rolls over at {period:g}? (new runs instead: split = {toml(own)})"
        return refusal(place, what, time_with(given, entry, rolls_over_at=int(period) if period == int(period) else period))
    if np.any(raw[back] > (raw[0] + raw[back - 1]) / 2):  # not to the start
        return TableError(f"{place}: {what}; valid: rows in the order of time")
    return refusal(place, f"{what}; where a new run begins there", f"split = {toml(own)}")


def _refuse_part(given: ImportMap, sheet: Sheet, entry: TimeMap, own: str) -> None:
    """Refuse a column that is a part of a time as the whole of it."""
    parts = time_parts(sheet)
    if own in parts and len(parts) > 1 and len(entry.names) == 1:
        what = f"column {own!r} is a part of a time; the parts are {quote_columns(parts)}"
        raise refusal(sheet.path, what, time_with(given, entry, column=list(parts), unit=list(parts.values())))


def _no_clock(given: ImportMap, sheet: Sheet, entry: TimeMap, own: str) -> TableError:
    """The refusal of a counter of frames as time."""
    what = f"column {own!r} counts rows and is no clock"
    if mended := _clock_entry(given, sheet, entry):
        return refusal(sheet.path, what, mended)
    if sheet.rate is not None:
        return refusal(sheet.path, f"{what}; the file states {sheet.rate:g} Hz", time_with(given, entry, rate_hz=sheet.rate))
    return question(sheet.path, f"{what}; how many rows a second?", "time.rate_hz = 120 or whatever it is")


def _clock_entry(given: ImportMap, sheet: Sheet, entry: TimeMap) -> str:
    """The entry of another column that is a clock; empty where there is none."""
    from tepm_opt.data.importing.guess import time_column

    found = time_column(sheet)
    if found is None or found in (sheet.name(name) for name in entry.names):
        return ""
    return time_with(given, entry, column=found)


def time_map(given: ImportMap, sheet: Sheet) -> TimeMap:
    """The entry of the map for the time of a file."""
    own = [each for each in given.time if each.file is not None and fits(each.file, sheet.path.name) is not None]
    rest = [each for each in given.time if each.file is None]
    return next(iter(own + rest), TimeMap())


def seconds(given: ImportMap, sheet: Sheet, name: str, entry: TimeMap, unit: str, counted: bool = False) -> np.ndarray:
    """A column of times in s, (rows,); NaN where it is empty.

    Args:
        given: the map.
        sheet: the file.
        name: of the column.
        entry: of the map, for this file's time.
        unit: of the column.
        counted: numbers as they are written, not in s.

    Raises:
        InputError: text that is no time; names the entry that mends it.
    """
    values = sheet.columns[name]
    if values.dtype.kind == "M":
        return instants_in_s(values)
    if sheet.clocks.get(name) == name and not entry.names:
        return values
    if unit == ISO:
        pandas = optional("pandas", f"{sheet.path}: dates")
        found = pandas.to_datetime(pandas.Series([str(value) for value in values]), errors="coerce", format="ISO8601", utc=True)
        if found.isna().all():
            raise refusal(
                sheet.path,
                f"column {name!r} (time) holds no date and time such as 2026-11-20T10:00:00.02, but {values[0]!r}",
                time_with(given, entry, unit="s"),
            )
        return instants_in_s(found.dt.tz_localize(None).to_numpy(dtype="datetime64[ns]"))
    one = 1.0 if counted else factor(unit, "time")
    if values.dtype.kind in "biuf":
        return values * one
    parsed = np.array([_number(str(value)) for value in values])
    if (wrong := np.flatnonzero(np.isinf(parsed))).size:
        where = [sheet.line(int(row)) for row in wrong]
        text = str(values[wrong[0]])
        date = re.match(r"\d{4}-\d\d-\d\d", text)
        entry_ = time_with(given, entry, unit=ISO) if date else 'csv.decimal = ","' if COMMA.fullmatch(text) else ""
        raise refusal(f"{sheet.path}: {lines_of(where)}", f"column {name!r} (time): {text!r} is no number", entry_)
    return parsed * one


def instants_in_s(values: np.ndarray) -> np.ndarray:
    """Instants in s since 1970, (rows,); NaN where there is none."""
    whole = values.astype("datetime64[ns]").astype(np.int64)
    return np.where(np.isnat(values), np.nan, whole // 10**9 + whole % 10**9 / 1e9)


def _number(text: str) -> float:
    """A field as a number: NaN where it is empty, infinite where it is none."""
    try:
        return float(text or "nan")
    except ValueError:
        return np.inf


def _no_time(given: ImportMap, sheet: Sheet, columns: list[Name]) -> InputError:
    from tepm_opt.data.importing.guess import time_column

    found, entry = time_column(sheet), time_map(given, sheet)
    parts = time_parts(sheet)
    mended = "" if found is None else time_with(given, entry, column=found)
    if found is None and len(parts) > 1:
        mended = time_with(given, entry, column=list(parts), unit=list(parts.values()))
    if not columns:
        what = f"no time in the map for the columns of this file; found: {', '.join(sheet.order)}"
        return refusal(sheet.path, what, mended or time_with(given, entry, rate_hz=sheet.rate or 100))
    return refusal(sheet.path, f"time: no {quote_columns(columns)}; found: {', '.join(sheet.order)}", mended)


def _other_rows(each: Wanted, sheet: Sheet, name: str, own: str) -> InputError:
    rows = len(sheet.columns[name])
    alike = [one for one in each.columns if (found := sheet.name(one)) and len(sheet.columns[found]) == rows]
    fitting = [other for other, values in sheet.columns.items() if len(values) == rows and _increases(values)]
    what = f"{each.place}: {quote_columns(alike)}: {rows} rows, but {quote_columns([own])} (time) has {len(sheet.columns[own])}"
    return refusal(sheet.path, what, f"{each.place}.time = {toml(fitting[0])}" if fitting else "")


def _increases(values: np.ndarray) -> bool:
    return values.dtype.kind in "iufM" and len(values) > 1 and bool(np.all(np.diff(values.astype(float)) > 0))
