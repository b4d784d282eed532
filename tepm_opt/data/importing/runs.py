"""Runs of a data set from files: which files and rows belong to a run, all columns on one grid, and what a person should know of it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from tepm_opt.data.channels import TIME
from tepm_opt.data.importing.clocks import time_map
from tepm_opt.data.importing.maps import ImportMap, Wanted, fits, time_with
from tepm_opt.data.importing.refusals import refusal, toml
from tepm_opt.data.importing.resample import grid_of, reduction, resample_commanded, resample_measured
from tepm_opt.data.importing.samples import Samples
from tepm_opt.data.importing.sources import Sheet
from tepm_opt.data.run import Role
from tepm_opt.errors import InputError

EMPTY = 30.0  # rows a sample: more are no gaps
SLOWEST = 1.0  # Hz; a robot's motion sampled below that is taken for another unit of time


@dataclass(frozen=True, eq=False)
class ImportedRun:
    """A run whose columns are on one grid.

    Attributes:
        name: of the run; its file is NAME.csv.
        role: "fit" or "validation".
        files: it was read from.
        columns: `time_s` (where there is time), then those of the data set, (rows,) each.
        samples: what they were made of.
        start: time in s, on the files' clock, of the first row.
        left_out: seconds at the start and at the end for which some columns have no samples.
    """

    name: str
    role: Role
    files: tuple[str, ...]
    columns: Mapping[str, np.ndarray]
    samples: tuple[Samples, ...]
    start: float = 0.0
    left_out: tuple[float, float] = (0.0, 0.0)

    def __repr__(self) -> str:
        return f"ImportedRun({self.file}: {self.role}, {self.rows} rows, {len(self.columns)} columns)"

    @property
    def file(self) -> str:
        """Name of its CSV file."""
        return f"{self.name}.csv"

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values())))


@dataclass(frozen=True, eq=False)
class Part:
    """Files and rows of one run."""

    name: str
    sheets: tuple[Sheet, ...]
    rows: slice | np.ndarray


def parts_of(given: ImportMap, sheets: Sequence[Sheet], wanted: Sequence[Wanted]) -> list[Part]:
    """Group files into runs: each its own, or those with the same text in place of the patterns' `*`; `split` divides their rows.

    Raises:
        InputError: a file that fits no pattern, or several runs of one name.
    """
    patterns = list(dict.fromkeys(f for f in (*(e.file for e in given.time), *(w.source.file for w in wanted)) if f is not None))
    grouped: dict[str, list[Sheet]] = {}
    for sheet in sheets:
        name = sheet.path.name
        if not patterns:
            grouped.setdefault(sheet.path.stem, []).append(sheet)
            continue
        fitting = [found for pattern in patterns if (found := fits(pattern, name)) is not None]
        if not fitting:
            raise refusal(
                sheet.path,
                f"fits none of the map's patterns {', '.join(patterns)}; leave it out, or give its entry the pattern",
                f"position.file = {toml(_pattern(name))}",
            )
        grouped.setdefault("".join(fitting[0]).strip("_- .") or "run", []).append(sheet)
    if not patterns and (twice := [name for name, found in grouped.items() if len(found) > 1]):
        raise InputError(
            f"{', '.join(str(s.path) for s in grouped[twice[0]])}: would both become {twice[0]}.csv; valid: files of different names"
        )
    whole = [Part(name, tuple(found), slice(None)) for name, found in grouped.items()]
    return whole if given.split is None else [part for each in whole for part in _split(given, each, wanted)]


def _pattern(name: str) -> str:
    stem, dot, suffix = name.rpartition(".")
    _, joint, kind = stem.rpartition("_")
    return f"*{joint}{kind}{dot}{suffix}" if joint else f"*{dot}{suffix}"


def _split(given: ImportMap, part: Part, wanted: Sequence[Wanted]) -> list[Part]:
    """A run for each value of the column that splits, or for each time that its time begins anew."""
    assert given.split is not None
    sheet = part.sheets[0]
    if len(part.sheets) > 1 or sheet.name(given.split) is None:
        names = ", ".join(sheet.order)
        raise InputError(f"{sheet.path}: split = {given.split!r}: valid: a column of the only file of a run; found: {names}")
    values = sheet.columns[str(sheet.name(given.split))]
    times = {sheet.name(name) for entry in given.time for name in entry.names}
    if sheet.name(given.split) in times and values.dtype.kind in "iufM":
        cuts = np.flatnonzero(np.diff(values.astype(float)) < 0) + 1
        names = [f"{part.name}_{k + 1}" for k in range(len(cuts) + 1)]
    else:
        texts = np.array([f"{value:g}" if isinstance(value, float) else str(value) for value in values.tolist()])
        cuts = np.flatnonzero(texts[1:] != texts[:-1]) + 1
        names = [f"{part.name}_{texts[k]}" for k in (0, *cuts)]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise InputError(
                f"{sheet.path}: split = {given.split!r}: {', '.join(twice)} begin more than once; valid: the rows of a run together"
            )
    return [
        Part(re.sub(r"[^\w.+-]", "_", name), part.sheets, rows)
        for name, rows in zip(names, np.split(np.arange(len(values)), cuts), strict=True)
    ]


def roles_of(given: ImportMap, names: Sequence[str], where: str) -> dict[str, Role]:
    """The role of each run: validation where the map's names fit; where it has none, the last of several.

    Raises:
        InputError: a name in the map that fits no run.
    """
    patterns = (names[-1:] if len(names) > 1 else []) if given.validation is None else given.validation
    patterns = [pattern.removesuffix(".csv") for pattern in patterns]
    if unknown := [pattern for pattern in patterns if not any(fnmatchcase(name, pattern) for name in names)]:
        what = f"validation: {', '.join(map(repr, unknown))} fits no run; runs: {', '.join(names)}"
        raise refusal(where, what, f"validation = {toml([names[-1]])}")
    return {name: "validation" if any(fnmatchcase(name, pattern) for pattern in patterns) else "fit" for name in names}


def rate_of(given: ImportMap, found: Sequence[Samples], where: str) -> float:
    """The rate of the grid: the map's, or the slowest of what is measured.

    Raises:
        InputError: faster than what is measured; so slow that time must be in another unit; names the entry that mends it.
    """
    clocks = [
        (s, s.clock)
        for s in found
        if not s.wanted.driven and s.clock is not None and s.wanted.place.partition(".")[0] in ("position", "outputs")
    ]
    if not clocks:
        raise InputError(f"{where}: nothing measured has a time")
    slowest, clock = min(clocks, key=lambda pair: pair[1].rate)
    concerned = list(dict.fromkeys(s.column for s, other in clocks if other.rate <= 1.01 * clock.rate))
    assert slowest.sheet is not None
    path = slowest.sheet.path
    texts = f"{slowest.wanted.place} ({', '.join(map(str, concerned))})"
    asked = given.rate_hz
    if slowest.wanted.place == "position" and clock.rate < (min(0.1 * asked, 3 * SLOWEST) if asked else SLOWEST):
        for unit, times in (("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
            if (0.5 * asked if asked else 3 * SLOWEST) < times * clock.rate < (100 * asked if asked else 3e3):
                what = f"{texts}: samples would be {clock.step:g} s apart; time in {unit}?"
                raise refusal(path, what, time_with(given, time_map(given, slowest.sheet), unit=unit))
    if asked is not None and asked > 1.1 * clock.rate:
        what = f"{texts}: {clock.rate:.4g} samples a second; rate_hz = {asked:g} would invent others"
        raise refusal(path, what, f"rate_hz = {clock.own_rate:g}")
    return asked or clock.own_rate


def import_run(
    given: ImportMap, part: Part, wanted: Sequence[Wanted], role: Role, rate: float | None, found: Sequence[Samples]
) -> ImportedRun:
    """Bring a run onto its grid, from the time at which all columns have begun to that at which the first ends.

    Args:
        given: the map.
        part: files and rows of the run.
        wanted: what the map fills.
        role: of the run.
        rate: of the grid in Hz; None in equilibria.
        found: the run's samples.

    Raises:
        InputError: columns that have no time in common, or of other lengths; names the entry that mends it.
    """
    files = tuple(dict.fromkeys(sheet.path.name for sheet in part.sheets))
    if rate is None:
        return ImportedRun(part.name, role, files, _merge_equilibria(found), tuple(found))
    starts, ends = _spans(found)
    start, end = max(starts.values()), min(ends.values())
    most = max(len(each.values) for each in found)
    if (end - start) * rate > EMPTY * most:
        texts = f"{start:.6g} to {end:.6g} s at {rate:g} Hz would be {(end - start) * rate:.3g} rows of {most} samples"
        raise InputError(
            f"{', '.join(files)}: {texts}: a wrong time among them, or time in another unit; valid: time.unit, or rows without it"
        )
    grid = grid_of(start, end, rate) if end > start else np.empty(0)
    if len(grid) < 2:
        raise _explain_disjoint_times(given, part, starts, ends)
    columns = {TIME: np.arange(len(grid)) / rate}
    for each in found:
        if each.clock is None:
            columns[each.target] = np.full(len(grid), each.values[0])
        elif each.values.dtype.kind == "U":
            place = np.searchsorted(each.clock.time, grid + 1e-9, side="right") - 1
            columns[each.target] = each.values[np.maximum(place, 0)]
        elif each.wanted.driven:
            columns[each.target] = resample_commanded(each.clock, each.values, grid, each.wanted.source.between == "hold")
        else:
            columns[each.target] = resample_measured(each.clock, each.values, grid, rate)
    left = (start - min(starts.values()), max(end for end in ends.values() if np.isfinite(end)) - end)
    return ImportedRun(part.name, role, files, columns, tuple(found), start, left)


def _spans(found: Sequence[Samples]) -> tuple[dict[str, float], dict[str, float]]:
    """First and last time of each column; what holds its value has no end."""
    starts, ends = {}, {}
    for each in found:
        if each.clock is None or each.wanted.place.startswith("extra"):
            continue
        hold = each.wanted.driven and each.wanted.source.between == "hold"
        time = each.clock.time[np.isfinite(each.values)] if hold else each.clock.time
        starts[each.target], ends[each.target] = float(time[0]), np.inf if hold else float(time[-1])
    return starts, ends


def _explain_disjoint_times(given: ImportMap, part: Part, starts: Mapping[str, float], ends: Mapping[str, float]) -> InputError:
    late, early = max(starts, key=starts.__getitem__), min(ends, key=ends.__getitem__)
    alike = {name: [other for other in starts if (starts[other], ends[other]) == (starts[name], ends[name])] for name in (early, late)}
    what = "; ".join(f"{', '.join(alike[name])} from {starts[name]:.6g} to {ends[name]:.6g} s" for name in (early, late))
    entry = "time.from_start = true"
    if len(given.time) > 1:
        entry = f"time = {toml([{**each.model_dump(exclude_defaults=True), 'from_start': True} for each in given.time])}"
    where = ", ".join(str(sheet.path) for sheet in part.sheets)
    return refusal(where, f"columns have no time in common: {what}. Where each file counts from its own start", entry)


def _merge_equilibria(found: Sequence[Samples]) -> dict[str, np.ndarray]:
    """Merge columns of equilibria, row by row."""
    lengths = {len(each.values) for each in found if each.column is not None}
    if len(lengths) > 1:
        texts = ", ".join(f"{each.column!r} {len(each.values)}" for each in found if each.column is not None)
        raise InputError(
            f"{found[0].sheet.path if found[0].sheet else ''}: columns of different lengths ({texts}); valid: a row an equilibrium"
        )
    rows = lengths.pop() if lengths else 1
    return {each.target: each.values if each.column is not None else np.full(rows, each.values[0]) for each in found}


def count_filter_steps(samples: Samples, rate: float | None) -> int:
    """Count the steps of the filter's fine grid that make one of the data set's; 1 where nothing is filtered."""
    unfiltered = samples.clock is None or samples.wanted.driven or samples.values.dtype.kind == "U" or rate is None
    return 1 if unfiltered or samples.clock is None or rate is None else reduction(samples.clock, rate)
