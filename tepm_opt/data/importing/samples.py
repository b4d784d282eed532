"""Samples of every wanted column, in SI and with their own times, taken from files as the map says."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tepm_opt.data.importing.clocks import COMMA, Rows, clock_of, instants_in_s, line_of
from tepm_opt.data.importing.held import new_rows
from tepm_opt.data.importing.lost_codes import as_written, far_codes, lost_points, words_of
from tepm_opt.data.importing.maps import ImportMap, Name, Wanted, fits
from tepm_opt.data.importing.refusals import lines_of, quote_columns, refusal, toml
from tepm_opt.data.importing.resample import Clock
from tepm_opt.data.importing.sources import Sheet
from tepm_opt.errors import InputError


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
    placed = _locate_columns(wanted, sheets)
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
        _refuse_codes(each, sheet, names, numbers, rows)
        fresh = _fresh_rows(each, numbers)
        for target, name, values, timed, own in zip(each.targets, names, numbers, times, fresh, strict=True):
            clock, kept = (None, np.arange(len(values))) if timed is None else timed
            scaled = values if values.dtype.kind == "U" else each.si * (each.source.scale * values + each.source.offset)
            dropped = len(values) - len(kept)
            if clock is not None and own is not None:
                clock, kept = _slower(clock, kept, own, f"{sheet.path.name}: {each.place}")
            found.append(Samples(each, target, name, sheet, clock, scaled[kept], dropped))
    _refuse_empty(found, rows)
    return found


def _locate_columns(wanted: Sequence[Wanted], sheets: Sequence[Sheet]) -> dict[str, tuple[Sheet, tuple[str, ...]]]:
    """Locate the file of each entry and its columns there."""
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
                f"{each.place}: {quote_columns(each.columns)} in several files of the run: {names}",
                f"{each.place}.file = {toml(full[0].path.name)}",
            )
        if full:
            found[each.place] = (full[0], tuple(str(full[0].name(column)) for column in each.columns))
            continue
        sheet = max(fitting, key=lambda one: sum(bool(one.name(column)) for column in each.columns))
        _refuse_twice(each, sheet)
        _refuse_undecoded(each, sheet)
        missing.append((each, sheet, [column for column in each.columns if not sheet.name(column)]))
        entries.append(f"csv.groups = {sheet.groups}" if sheet.groups else _nearest(each, sheet))
    if missing:
        where = ", ".join(dict.fromkeys(str(sheet.path) for _, sheet, _ in missing))
        text = "; ".join(f"{each.place}: no {quote_columns(columns)}" for each, _, columns in missing)
        there = [name for name in missing[0][1].order if name not in missing[0][1].twice]
        raise refusal(where, f"{text}; found: {', '.join(there)}", *dict.fromkeys(entries))
    return found


def _refuse_undecoded(each: Wanted, sheet: Sheet) -> None:
    """Refuse columns of a bag's topic whose messages cannot be decoded."""
    for topic, words in sheet.undecoded.items():
        if any(str(column).startswith(f"{topic}/") for column in each.columns):
            raise InputError(f"{sheet.path}: {each.place}: {words}")


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
        sheet.path,
        f"{each.place}: {quote_columns(twice)} stand more than once ({stand}): numbers tell them apart",
        _columns_entry(each, numbers),
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
            found.append(instants_in_s(values))
            continue
        texts = np.array([str(value) for value in values], dtype=np.str_)
        parsed = np.array([_parse_field(text, lost_texts) for text in texts])
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


def _parse_field(text: str, lost: Sequence[str]) -> float:
    """Read a field as a number: NaN where it is empty or stands for a lost sample, infinite where it is neither."""
    if not text or text in lost:
        return np.nan
    try:
        return float(text)
    except ValueError:
        return np.inf


def _refuse_text(each: Wanted, sheet: Sheet, bad: dict[str, tuple[np.ndarray, list[str]]], rows: Rows) -> None:
    texts = list(dict.fromkeys(text for _, found in bad.values() for text in found))
    where = [line_of(sheet, row, rows) for row in sorted({int(row) for wrong, _ in bad.values() for row in wrong})]
    what = (
        f"{each.place}: {quote_columns(bad)}: text where numbers belong, {', '.join(map(repr, texts[:3]))}{' …' if len(texts) > 3 else ''}"
    )
    commas = all(COMMA.fullmatch(text) for text in texts)
    entry = 'csv.decimal = ","' if commas else f"{each.place}.missing = {toml([*each.source.missing, *texts])}" if len(texts) <= 5 else ""
    raise refusal(f"{sheet.path}: {lines_of(where)}", what + (" (decimal commas)" if commas else ""), entry)


def _refuse_zeros(each: Wanted, sheet: Sheet, names: Sequence[str], numbers: Sequence[np.ndarray], rows: Rows) -> None:
    """Positions that are (0, 0, 0) now and then: a code for a lost sample."""
    if each.place != "position" or len({len(values) for values in numbers}) != 1:
        return
    points = np.array(numbers).reshape(-1, 3, len(numbers[0]))
    zero = np.all(points == 0, axis=1)
    some = (zero.sum(axis=1) > 1) & ~zero.all(axis=1)
    if some.any():
        concerned = [name for k in np.flatnonzero(some).tolist() for name in names[3 * k : 3 * k + 3]]
        where = [line_of(sheet, int(row), rows) for row in np.flatnonzero(zero[some].any(axis=0))]
        what = f"position: {quote_columns(concerned)}: all 0 at times, a code for a lost sample?"
        raise refusal(f"{sheet.path}: {lines_of(where)}", what, f"position.missing = {toml([*each.source.missing, 0])}")


def _is_measured(each: Wanted) -> bool:
    return not each.driven and not each.place.startswith("extra")


def _points_of(each: Wanted, numbers: Sequence[np.ndarray]) -> np.ndarray | None:
    """Columns of a position as (points, 3, rows); None where they are none, or of several lengths."""
    if each.place != "position" or len({len(values) for values in numbers}) != 1:
        return None
    return np.array(numbers).reshape(-1, 3, len(numbers[0]))


def _refuse_codes(each: Wanted, sheet: Sheet, names: Sequence[str], numbers: Sequence[np.ndarray], rows: Rows) -> None:
    """Refuse measurements that hold one number far outside all others in many rows: a code for lost samples."""
    if not _is_measured(each) or any(values.dtype.kind != "f" for values in numbers):
        return
    if (points := _points_of(each, numbers)) is not None:
        lost, codes = lost_points(points)
        concerned = [name for k in np.flatnonzero(lost.any(axis=1)).tolist() for name in names[3 * k : 3 * k + 3]]
        where, same = np.flatnonzero(lost.any(axis=0)), "the same three numbers"
    else:
        by_column = {name: found for name, values in zip(names, numbers, strict=True) if (found := far_codes(values))}
        concerned, codes = list(by_column), sorted({code for found in by_column.values() for code in found}, key=lambda code: -abs(code))
        chosen = [values for name, values in zip(names, numbers, strict=True) if name in by_column]
        where = np.unique(np.concatenate([np.flatnonzero(np.isin(values, codes)) for values in chosen])) if chosen else np.empty(0)
        same = "the same number"
    if concerned:
        what = f"{each.place}: {quote_columns(concerned)}: {same}, {words_of(codes)}, in {len(where)} rows: a code for lost samples?"
        place = lines_of([line_of(sheet, int(row), rows) for row in where])
        raise refusal(f"{sheet.path}: {place}", what, f"{each.place}.missing = {toml([*each.source.missing, *map(as_written, codes)])}")


def _fresh_rows(each: Wanted, numbers: Sequence[np.ndarray]) -> list[np.ndarray | None]:
    """Rows in which new samples of a slower sensor begin, for each column; None where all rows are samples."""
    if not _is_measured(each) or any(values.dtype.kind != "f" for values in numbers):
        return [None] * len(numbers)
    if (points := _points_of(each, numbers)) is not None:
        return [rows for point in points for rows in [new_rows(point)] * 3]
    return [new_rows(values[None, :]) for values in numbers]


def _slower(clock: Clock, kept: np.ndarray, fresh: np.ndarray, what: str) -> tuple[Clock, np.ndarray]:
    """The clock and the rows of a slower sensor's own samples."""
    own = np.flatnonzero(np.isin(kept, fresh))
    time = clock.time[own]
    rate = (len(time) - 1) / float(time[-1] - time[0])
    told = f"{what} holds each sample for {clock.rate / rate:.3g} rows: a slower sensor of {rate:.4g} Hz, only its new samples are used"
    even = clock.known is not None and len(set(np.diff(own).tolist())) == 1
    return Clock(time, clock.known / int(own[1] - own[0]) if even and clock.known else None, (*clock.told, told)), kept[own]


def _refuse_empty(found: Iterable[Samples], rows: Rows) -> None:
    """Inputs that are empty now and then, where values do not hold."""
    empty = [
        s for s in found if s.wanted.needed and s.column is not None and s.values.dtype.kind == "f" and not np.isfinite(s.values).all()
    ]
    if of_hold := [s for s in empty if s.wanted.source.between == "hold" and not np.isfinite(s.values).any()]:
        raise InputError(
            f"{of_hold[0].sheet.path if of_hold[0].sheet else ''}: {quote_columns(s.column for s in of_hold)}: empty in all rows"
        )
    empty = [s for s in empty if s.wanted.source.between != "hold"]
    if empty:
        sheet = empty[0].sheet
        assert sheet is not None
        where = [
            line_of(sheet, int(row), rows) for row in sorted({int(row) for s in empty for row in np.flatnonzero(~np.isfinite(s.values))})
        ]
        entries = [f'{place}.between = "hold"' for place in dict.fromkeys(s.wanted.place for s in empty)]
        what = (
            f"{quote_columns(s.column for s in empty)}: empty; what was put in must be known. Where an empty field means the value before"
        )
        raise refusal(f"{sheet.path}: {lines_of(where)}", what, *entries)
