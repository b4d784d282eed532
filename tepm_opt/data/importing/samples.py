"""Samples of every wanted column, in SI and with their own times, taken from files as the map says."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tepm_opt.data.importing.maps import ISO, ImportMap, Name, TimeMap, Wanted, fits, time_with
from tepm_opt.data.importing.refusals import lines_of, named, refusal, toml
from tepm_opt.data.importing.resample import Clock
from tepm_opt.data.importing.sources import Sheet, optional
from tepm_opt.data.importing.units import factor
from tepm_opt.errors import InputError

COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")


@dataclass(frozen=True, eq=False)
class Samples:
    """One column of the data set before it is on the grid.

    Attributes:
        wanted: the entry of the map that it belongs to.
        target: column of the data set.
        column: where it comes from; None where its value is constant.
        sheet: the file; None where its value is constant.
        clock: times of the samples in s; None in equilibria and where the value is constant.
        values: (rows,) in SI, or text; one value where it is constant.
        dropped: rows of the file that have no time, or that of another row.
    """

    wanted: Wanted
    target: str
    column: str | None
    sheet: Sheet | None
    clock: Clock | None
    values: np.ndarray
    dropped: int = 0

    def __repr__(self) -> str:
        return f"Samples({self.target}: {len(self.values)} of {self.column!r})"


Rows = slice | np.ndarray


def samples_of(given: ImportMap, wanted: Sequence[Wanted], sheets: Sequence[Sheet], rows: Rows) -> list[Samples]:
    """Samples of one run.

    Args:
        given: the map.
        wanted: what it fills.
        sheets: the run's files.
        rows: of the run in its files; slice(None) for all.

    Raises:
        InputError: names all columns concerned and the entry that mends it.
    """
    placed = _placed(wanted, sheets)
    found: list[Samples] = []
    for each in wanted:
        if not each.columns:
            assert each.source.value is not None
            constant = np.array([each.si * (each.source.scale * each.source.value + each.source.offset)])
            found += [Samples(each, target, None, None, None, constant) for target in each.targets]
            continue
        sheet, names = placed[each.place]
        raw = [sheet.columns[name][rows] for name in names]
        numbers = _numbers(each, sheet, names, raw, rows)
        times = [
            None if given.static else clock_of(given, each, sheet, name, len(values), rows) for name, values in zip(names, raw, strict=True)
        ]
        _refuse_zeros(each, sheet, names, numbers, rows)
        for target, name, values, timed in zip(each.targets, names, numbers, times, strict=True):
            clock, kept = (None, np.arange(len(values))) if timed is None else timed
            scaled = values if values.dtype.kind == "U" else each.si * (each.source.scale * values + each.source.offset)
            found.append(Samples(each, target, name, sheet, clock, scaled[kept], len(values) - len(kept)))
    _refuse_empty(found, rows)
    return found


def _placed(wanted: Sequence[Wanted], sheets: Sequence[Sheet]) -> dict[str, tuple[Sheet, tuple[str, ...]]]:
    """The file of each entry and its columns there."""
    found, missing, entries = {}, [], []
    for each in wanted:
        if not each.columns:
            continue
        pattern = each.source.file
        fitting = [sheet for sheet in sheets if pattern is None or fits(pattern, sheet.path.name) is not None]
        if not fitting:
            names = ", ".join(sheet.path.name for sheet in sheets)
            what = f"{each.place}.file = {pattern!r} fits none of a run's files, {names}; valid: all files of each run"
            raise InputError(f"{sheets[0].path.parent}: {what}")
        full = [sheet for sheet in fitting if all(sheet.name(column) for column in each.columns)]
        if len(full) > 1:
            names = ", ".join(sheet.path.name for sheet in full)
            raise refusal(
                full[0].path,
                f"{each.place}: {named(each.columns)} in several files of the run: {names}",
                f"{each.place}.file = {toml(full[0].path.name)}",
            )
        if full:
            found[each.place] = (full[0], tuple(str(full[0].name(column)) for column in each.columns))
            continue
        sheet = max(fitting, key=lambda one: sum(bool(one.name(column)) for column in each.columns))
        _refuse_twice(each, sheet)
        missing.append((each, sheet, [column for column in each.columns if not sheet.name(column)]))
        entries.append(_nearest(each, sheet))
    if missing:
        where = ", ".join(dict.fromkeys(str(sheet.path) for _, sheet, _ in missing))
        text = "; ".join(f"{each.place}: no {named(columns)}" for each, _, columns in missing)
        there = [name for name in missing[0][1].order if name not in missing[0][1].twice]
        raise refusal(where, f"{text}; found: {', '.join(there)}", *entries)
    return found


def _refuse_twice(each: Wanted, sheet: Sheet) -> None:
    twice = [column for column in dict.fromkeys(each.columns) if column in sheet.twice]
    if not twice:
        return
    counted: dict[Name, int] = {}
    numbers = []
    for column in each.columns:
        if column in sheet.twice:
            places = sheet.twice[str(column)]
            numbers.append(places[min(counted.get(column, 0), len(places) - 1)])
            counted[column] = counted.get(column, 0) + 1
        else:
            numbers.append(sheet.order.index(column) + 1 if isinstance(column, str) else column)
    stand = ", ".join(f"{column!r} as {' and '.join(map(str, sheet.twice[str(column)]))}" for column in twice)
    raise refusal(
        sheet.path, f"{each.place}: {named(twice)} stand more than once ({stand}): numbers tell them apart", _columns_entry(each, numbers)
    )


def _columns_entry(each: Wanted, columns: Sequence[Name]) -> str:
    return (
        f"{each.place}.columns = {toml(list(columns))}" if hasattr(each.source, "columns") else f"{each.place}.column = {toml(columns[0])}"
    )


def _nearest(each: Wanted, sheet: Sheet) -> str:
    """The entry with the columns that are written most alike; empty where some have no like."""
    free = {name.lower(): name for name in sheet.order if name not in sheet.twice and name not in each.columns}
    chosen: list[Name] = []
    for column in each.columns:
        if sheet.name(column):
            chosen.append(column)
            continue
        near = difflib.get_close_matches(str(column).lower(), list(free), n=1, cutoff=0.5)
        if not near:
            return ""
        chosen.append(free.pop(near[0]))
    return _columns_entry(each, chosen)


def _numbers(each: Wanted, sheet: Sheet, names: Sequence[str], raw: Sequence[np.ndarray], rows: Rows) -> list[np.ndarray]:
    """Columns as numbers, what stands for lost samples NaN; of the map's `extra` also as text."""
    lost_numbers = [value for value in each.source.missing if not isinstance(value, str)]
    lost_texts = [value for value in each.source.missing if isinstance(value, str)]
    found, bad = [], {}
    for name, values in zip(names, raw, strict=True):
        if values.dtype.kind in "biuf":
            found.append(values.astype(float))
            continue
        if values.dtype.kind == "M":
            found.append(_instants(values))
            continue
        texts = np.array([str(value) for value in values], dtype=np.str_)
        parsed = np.array([_parsed(text, lost_texts) for text in texts])
        wrong = np.flatnonzero(np.isinf(parsed))
        if wrong.size and each.place.startswith("extra"):
            found.append(texts)
            continue
        if wrong.size:
            bad[name] = (wrong, [str(text) for text in texts[wrong]])
        found.append(np.where(np.isinf(parsed), np.nan, parsed))
    if bad:
        _refuse_text(each, sheet, bad, rows)
    if not lost_numbers or any(values.dtype.kind != "f" for values in found):
        return found
    lost = [np.isin(values, lost_numbers) for values in found]
    if each.place == "position" and len({len(values) for values in found}) == 1:
        lost = list(np.repeat(np.array(lost).reshape(-1, 3, len(found[0])).all(axis=1), 3, axis=0))
    return [np.where(gone, np.nan, values) for gone, values in zip(lost, found, strict=True)]


def _parsed(text: str, lost: Sequence[str]) -> float:
    """A field as a number: NaN where it is empty or stands for a lost sample, infinite where it is neither."""
    if not text or text in lost:
        return np.nan
    try:
        return float(text)
    except ValueError:
        return np.inf


def _refuse_text(each: Wanted, sheet: Sheet, bad: dict[str, tuple[np.ndarray, list[str]]], rows: Rows) -> None:
    texts = list(dict.fromkeys(text for _, found in bad.values() for text in found))
    where = [_line(sheet, row, rows) for row in sorted({int(row) for wrong, _ in bad.values() for row in wrong})]
    what = f"{each.place}: {named(bad)}: text where numbers belong, {', '.join(map(repr, texts[:3]))}{' …' if len(texts) > 3 else ''}"
    commas = all(COMMA.fullmatch(text) for text in texts)
    entry = 'csv.decimal = ","' if commas else f"{each.place}.missing = {toml([*each.source.missing, *texts])}" if len(texts) <= 5 else ""
    raise refusal(f"{sheet.path}: {lines_of(where)}", what + (" (decimal commas)" if commas else ""), entry)


def _line(sheet: Sheet, row: int, rows: Rows) -> int:
    start = int(rows[row]) if isinstance(rows, np.ndarray) else row
    return sheet.line(start)


def _refuse_zeros(each: Wanted, sheet: Sheet, names: Sequence[str], numbers: Sequence[np.ndarray], rows: Rows) -> None:
    """Positions that are (0, 0, 0) now and then: a code for a lost sample."""
    if each.place != "position" or len({len(values) for values in numbers}) != 1:
        return
    points = np.array(numbers).reshape(-1, 3, len(numbers[0]))
    zero = np.all(points == 0, axis=1)
    some = (zero.sum(axis=1) > 1) & ~zero.all(axis=1)
    if some.any():
        concerned = [name for k in np.flatnonzero(some).tolist() for name in names[3 * k : 3 * k + 3]]
        where = [_line(sheet, int(row), rows) for row in np.flatnonzero(zero[some].any(axis=0))]
        what = f"position: {named(concerned)}: all 0 at times, a code for a lost sample?"
        raise refusal(f"{sheet.path}: {lines_of(where)}", what, f"position.missing = {toml([*each.source.missing, 0])}")


def _refuse_empty(found: Iterable[Samples], rows: Rows) -> None:
    """Inputs that are empty now and then, where values do not hold."""
    empty = [
        s for s in found if s.wanted.needed and s.column is not None and s.values.dtype.kind == "f" and not np.isfinite(s.values).all()
    ]
    if of_hold := [s for s in empty if s.wanted.source.between == "hold" and not np.isfinite(s.values).any()]:
        raise InputError(f"{of_hold[0].sheet.path if of_hold[0].sheet else ''}: {named(s.column for s in of_hold)}: empty in all rows")
    empty = [s for s in empty if s.wanted.source.between != "hold"]
    if empty:
        sheet = empty[0].sheet
        assert sheet is not None
        where = [
            _line(sheet, int(row), rows) for row in sorted({int(row) for s in empty for row in np.flatnonzero(~np.isfinite(s.values))})
        ]
        entries = [f'{place}.between = "hold"' for place in dict.fromkeys(s.wanted.place for s in empty)]
        what = f"{named(s.column for s in empty)}: empty; what was put in must be known. Where an empty field means the value before"
        raise refusal(f"{sheet.path}: {lines_of(where)}", what, *entries)


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
    column: Name | None = each.source.time if each.source.time is not None else entry.column
    if column is None and entry.rate_hz is not None:
        return Clock(np.arange(count) / entry.rate_hz, entry.rate_hz), np.arange(count)
    own = sheet.clocks.get(name) if column is None else sheet.name(column)
    if own is None:
        raise _no_time(given, sheet, column)
    if len(sheet.columns[own]) != len(sheet.columns[name]):
        raise _other_rows(each, sheet, name, own)
    time = seconds(given, sheet, own, entry)[rows]
    kept = np.flatnonzero(np.isfinite(time))
    steps = np.diff(time[kept])
    if (back := np.flatnonzero(steps < 0) + 1).size:
        where = [_line(sheet, int(kept[row]), rows) for row in back]
        first = int(back[0])
        what = f"column {own!r} (time) goes back from {time[kept[first - 1]]:g} to {time[kept[first]]:g} s"
        if np.any(time[kept[back]] > (time[kept[0]] + time[kept[back - 1]]) / 2):  # not to the start
            raise InputError(f"{sheet.path}: {lines_of(where)}: {what}; valid: rows in the order of time")
        raise refusal(f"{sheet.path}: {lines_of(where)}", f"{what}; where a new run begins there", f"split = {toml(own)}")
    if (stands := np.flatnonzero(steps == 0) + 1).size:
        if entry.repeated is None:
            where = [_line(sheet, int(kept[row]), rows) for row in stands]
            mended = time_with(given, entry, repeated="first")
            raise refusal(f"{sheet.path}: {lines_of(where)}", f"column {own!r} (time) repeats itself", mended)
        drop = stands if entry.repeated == "first" else stands - 1
        kept = np.delete(kept, drop)
    if len(kept) < 2:
        raise InputError(f"{sheet.path}: column {own!r} (time): {len(kept)} rows; valid: at least two")
    time = time[kept]
    return Clock(time - time[0] if entry.from_start else time), kept


def time_map(given: ImportMap, sheet: Sheet) -> TimeMap:
    """The entry of the map for the time of a file."""
    own = [each for each in given.time if each.file is not None and fits(each.file, sheet.path.name) is not None]
    rest = [each for each in given.time if each.file is None]
    return next(iter(own + rest), TimeMap())


def seconds(given: ImportMap, sheet: Sheet, name: str, entry: TimeMap) -> np.ndarray:
    """A column of times in s, (rows,); NaN where it is empty.

    Args:
        given: the map.
        sheet: the file.
        name: of the column.
        entry: of the map, for this file's time.

    Raises:
        InputError: text that is no time; names the entry that mends it.
    """
    values = sheet.columns[name]
    if values.dtype.kind == "M":
        return _instants(values)
    if sheet.clocks.get(name) == name and entry.column is None:
        return values
    if entry.unit == ISO:
        pandas = optional("pandas", f"{sheet.path}: dates")
        found = pandas.to_datetime(pandas.Series([str(value) for value in values]), errors="coerce", format="ISO8601", utc=True)
        if found.isna().all():
            raise refusal(
                sheet.path,
                f"column {name!r} (time) holds no date and time such as 2026-11-20T10:00:00.02, but {values[0]!r}",
                time_with(given, entry, unit="s"),
            )
        return _instants(found.dt.tz_localize(None).to_numpy(dtype="datetime64[ns]"))
    if values.dtype.kind in "iu":
        one = factor(entry.unit, "time")
        whole = round(1 / one) if one < 1 else 1
        return values // whole + (values % whole) * one if one < 1 else values * one  # to the ns, far from 0
    if values.dtype.kind == "f":
        return values * factor(entry.unit, "time")
    parsed = np.array([_parsed(str(value), ()) for value in values])
    if (wrong := np.flatnonzero(np.isinf(parsed))).size:
        where = [sheet.line(int(row)) for row in wrong]
        text = str(values[wrong[0]])
        date = re.match(r"\d{4}-\d\d-\d\d", text)
        entry_ = time_with(given, entry, unit=ISO) if date else 'csv.decimal = ","' if COMMA.fullmatch(text) else ""
        raise refusal(f"{sheet.path}: {lines_of(where)}", f"column {name!r} (time): {text!r} is no number", entry_)
    return parsed * factor(entry.unit, "time")


def _instants(values: np.ndarray) -> np.ndarray:
    whole = values.astype("datetime64[ns]").astype(np.int64)
    return np.where(np.isnat(values), np.nan, whole // 10**9 + whole % 10**9 / 1e9)


def _no_time(given: ImportMap, sheet: Sheet, column: Name | None) -> InputError:
    from tepm_opt.data.importing.guess import time_column

    found = time_column(sheet)
    entry = "" if found is None else time_with(given, time_map(given, sheet), column=found)
    if column is None:
        what = f"no time in the map for the columns of this file; found: {', '.join(sheet.order)}"
        return refusal(sheet.path, what, entry or time_with(given, time_map(given, sheet), rate_hz=100))
    return refusal(sheet.path, f"time: no {named([column])}; found: {', '.join(sheet.order)}", entry)


def _other_rows(each: Wanted, sheet: Sheet, name: str, own: str) -> InputError:
    rows = len(sheet.columns[name])
    alike = [one for one in each.columns if (found := sheet.name(one)) and len(sheet.columns[found]) == rows]
    fitting = [other for other, values in sheet.columns.items() if len(values) == rows and _increases(values)]
    what = f"{each.place}: {named(alike)}: {rows} rows, but {named([own])} (time) has {len(sheet.columns[own])}"
    return refusal(sheet.path, what, f"{each.place}.time = {toml(fitting[0])}" if fitting else "")


def _increases(values: np.ndarray) -> bool:
    return values.dtype.kind in "iufM" and len(values) > 1 and bool(np.all(np.diff(values.astype(float)) > 0))
