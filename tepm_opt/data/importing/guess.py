"""A first map from the names of columns, for a person to look through."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.channels import Channels
from tepm_opt.data.importing.advice import entries_of
from tepm_opt.data.importing.clocks import counts_rows
from tepm_opt.data.importing.dates import are_local_times
from tepm_opt.data.importing.lost_codes import as_written, far_codes, lost_points
from tepm_opt.data.importing.maps import Format
from tepm_opt.data.importing.refusals import toml
from tepm_opt.data.importing.rolling import period_of, time_parts
from tepm_opt.data.importing.sources import TEXT, Sheet, read_sheet
from tepm_opt.data.importing.units import UNITS, USUAL, factor, likely
from tepm_opt.errors import InputError

ZEROS = 0.01  # of the rows: fewer zeros are asked about by the import
_TIME = re.compile(r"(?:.*[/._])?(?:t|time|timestamp|stamp|seconds?|zeit|datetime)(?:[ _(\[/]*(s|ms|us|µs|ns|sec|min)?[)\]]*)", re.I)
_TURN = re.compile(
    r"(?:.*[/._ -])?(?:q[wxyz0-4]|q[oxyz0][a-z]|quat\w*[ _./]?[wxyz]?|orientation[/._][wxyz]|r[1-3_]?[1-3][1-3]?|rot\w*|roll|pitch|yaw)"
    r"(?:[ _(\[].*)?",
    re.I,
)
_UNIT = re.compile(r"[ _(\[/]([A-Za-zµ]+)[)\]]?$")
_PRESSURE = re.compile(r"(?:.*[/._ -])?(?:pressures?|druck|valves?|muscles?|regulators?|p)(?![a-z]).*\d.*", re.I)
_TENSION = re.compile(r"(?:.*[/._ -])?(?:tensions?|tendons?|cables?|wires?|lambda|load_?cells?|f|t)(?![a-z]).*\d.*", re.I)
_PLACE = re.compile(r"(.*(?:pos|place|marker|point|tip|xyz)[a-z]*[/._])(\d+)", re.I)
_AXIS = re.compile(r"(?<![A-Za-z])([xyz])(?![A-Za-z])", re.I)


def time_column(sheet: Sheet) -> str | None:
    """The column that looks most like time; None where none does. Counters of rows and parts of a time are none."""
    parts = time_parts(sheet)
    free = [name for name in sheet.order if name not in sheet.twice and name not in parts and not counts_rows(sheet, name)]
    named = [name for name in free if _TIME.fullmatch(name)]
    named += [name for name in free if name not in named and (_hold_local_times(sheet.columns[name]))]
    rising = [name for name in free if _rises(sheet.columns[name])]
    return next(iter([name for name in named if name in rising] + named + ([] if parts else rising)), None)


def _hold_local_times(values: np.ndarray) -> bool:
    return values.dtype.kind == "O" and len(values) > 0 and are_local_times(values)


def _rises(values: np.ndarray) -> bool:
    if values.dtype.kind not in "iufM" or len(values) < 2:
        return False
    steps = np.diff(values.astype(float))
    return bool(np.nanmin(steps) >= 0 and np.nanmax(steps) > 0 and np.nanmean(steps > 0) > 0.5)


def orientations(sheet: Sheet) -> list[str]:
    """Columns that hold quaternions, rotation matrices or angles of turning: by their names, or by values that nothing else has."""
    found = {name for name in sheet.order if _TURN.fullmatch(name) and not _TIME.fullmatch(name)}
    for count, is_turn in ((4, _quaternion), (9, _rotation)):
        for k in range(len(sheet.order) - count + 1):
            names = sheet.order[k : k + count]
            values = [sheet.columns[name] for name in names]
            if len({len(each) for each in values}) == 1 and all(each.dtype.kind == "f" for each in values) and is_turn(np.array(values)):
                found |= set(names)
    return [name for name in sheet.order if name in found]


def _quaternion(values: np.ndarray) -> bool:
    """Whether rows (4, rows) all have the length 1."""
    values = values[:, np.isfinite(values).all(axis=0)]
    return values.shape[1] > 1 and bool(np.allclose((values**2).sum(axis=0), 1, atol=3e-5))


def _rotation(values: np.ndarray) -> bool:
    """Whether rows (9, rows) are all rotation matrices."""
    matrices = values[:, np.isfinite(values).all(axis=0)].T.reshape(-1, 3, 3)
    return len(matrices) > 1 and bool(np.allclose(matrices @ matrices.transpose(0, 2, 1), np.eye(3), atol=1e-3))


def open_sheet(path: Path) -> tuple[Sheet, Format]:
    """A file read as it seems to be written, and how that is: each refusal says what to try next.

    Raises:
        InputError: it cannot be read in any way.
    """
    form = Format()
    for _ in range(6):
        try:
            return read_sheet(path, form), form
        except InputError as error:
            ways = [tomllib.loads(entry) for entry in entries_of(error)]
            if not ways or any("csv" not in way for way in ways):
                raise
            for way in ways:
                form = form.model_copy(update=way["csv"])
    return read_sheet(path, form), form


def guess_map(paths: Sequence[Path], channels: Channels, robot: str) -> str:
    """Text of a first map for files of one kind, by the first of them; what is not certain is marked.

    Args:
        paths: files.
        channels: of the robot.
        robot: its name or file.

    Raises:
        InputError: the file cannot be read.
    """
    sheet, form = open_sheet(paths[0])
    if sheet.path.suffix.lower() in TEXT and any(_comma(values) for values in sheet.columns.values()):
        form = form.model_copy(update={"decimal": ","})
        sheet = read_sheet(paths[0], form)
    used: set[str] = set()
    lines = [
        f"# A guess by the columns of {paths[0].name}: look at every line, then: tepm data import FILE… --map MAP --preview look.png",
        f"robot = {toml(robot)}",
    ]
    given = form.model_dump(exclude_defaults=True)
    lines += [f"csv = {toml(given)}"] if given else []
    if not sheet.clocks:
        columns, line = _time_entry(sheet)
        used |= columns
        lines.append(line)
    used |= {name for name in sheet.columns if sheet.clocks.get(name) == name}
    turned = orientations(sheet)
    free = [name for name in sheet.order if name not in used and name not in turned and name not in sheet.twice]
    points = triples(free)
    measured = [name for name in free if re.search(r"meas|sens|actual|fb|_m\d|ist", name, re.I)]
    flat = [name for names in points for name in names]
    limits = {"pressure": channels.pressure_max, "tension": channels.tension_max, "position": 3.0}
    for place, pattern, dimension in (("pressure", _PRESSURE, "pressure"), ("tension", _TENSION, "force")):
        names = [name for name in free if pattern.match(name) and name not in measured and name not in flat and name not in used][
            : len(channels.actuators)
        ]
        used |= set(names)
        if not names and place == "pressure" and sheet.undecoded:
            raise InputError(f"{sheet.path}: no pressure found; {'; '.join(sheet.undecoded.values())}")
        lines.append(
            _entry(place, names, channels.actuators, dimension, sheet, limits[place]) if names else f"# {place}: none found, taken as 0"
        )
    points = points[-len(channels.points) :]
    used |= {name for names in points for name in names}
    lines.append(
        _entry("position", [n for names in points for n in names], channels.points, "length", sheet, limits["position"])
        if points
        else "# position = { columns = … }: no x, y, z found"
    )
    if rest := [name for name in sheet.order if name not in used]:
        lines.append(f"# not in this map: {', '.join(rest)}")
    lines += [f"# {words}" for words in sheet.undecoded.values()]
    if others := [path.name for path in paths[1:] if open_sheet(path)[0].order != sheet.order]:
        lines.append(f"# other columns, which are not in this map: {', '.join(others)}")
    return "\n".join(lines) + "\n"


def _time_entry(sheet: Sheet) -> tuple[set[str], str]:
    """Columns of the time, and the map's line for it."""
    time, parts = time_column(sheet), time_parts(sheet)
    stated = "" if sheet.rate is None else f"  # the file states {sheet.rate:g} Hz"
    if time is not None:
        values = sheet.columns[time]
        if _hold_local_times(values):
            return {time}, f"time = {{ column = {toml(time)} }}{stated}"
        unit = _time_unit(sheet, time)
        keys: dict[str, Any] = {"column": time, "unit": unit}
        if values.dtype.kind in "iuf":
            seen = values[np.isfinite(values)].astype(float)
            back = np.flatnonzero(np.diff(seen) < 0) + 1
            if back.size and (period := period_of(seen, back, factor(unit, "time"))) is not None:
                keys["rolls_over_at"] = int(period) if period == int(period) else period
        return {time}, f"time = {toml(keys)}{stated}"
    if parts:
        return set(parts), f"time = {toml({'column': list(parts), 'unit': list(parts.values())})}{stated}"
    counters = [name for name in sheet.order if counts_rows(sheet, name)]
    if sheet.rate is not None:
        keys = ({"column": counters[0]} if counters else {}) | {"rate_hz": sheet.rate}
        return set(counters[:1]), f"time = {toml(keys)}{stated}"
    if counters:
        return {counters[0]}, f"time = {{ column = {toml(counters[0])} }}  # counts rows: add rate_hz, rows a second"
    return set(), "time = { rate_hz = 100 }  # no column looks like time"


def _comma(values: np.ndarray) -> bool:
    return values.dtype.kind == "O" and any(re.fullmatch(r"[+-]?\d*,\d+", str(value)) for value in values[:50])


def triples(names: Iterable[str]) -> list[tuple[str, str, str]]:
    """Names that differ in x, y and z only."""
    names = list(names)
    groups: dict[str, dict[str, str]] = {}
    for name in names:
        if (found := list(_AXIS.finditer(name.replace("_", " ")))) or (found := list(re.finditer(r"([xyz])(?=\d*$)", name, re.I))):
            axis = found[-1]
            groups.setdefault(name[: axis.start(1)] + "*" + name[axis.end(1) :], {})[axis[1].lower()] = name
    found = [(each["x"], each["y"], each["z"]) for each in groups.values() if len(each) == 3]
    return found or _columns_of_matrix(names) or _columns_of_letters(names)


def _columns_of_letters(names: Sequence[str]) -> list[tuple[str, str, str]]:
    """Points that a letter behind the axis tells apart: `Xa`, `Ya`, `Za`."""
    found: dict[str, dict[str, str]] = {}
    for name in names:
        if lettered := re.fullmatch(r"([XYZxyz])[ _]?([a-zA-Z])", name):
            found.setdefault(lettered[2], {})[lettered[1].lower()] = name
    return [(each["x"], each["y"], each["z"]) for each in found.values() if len(each) == 3]


def _columns_of_matrix(names: Iterable[str]) -> list[tuple[str, str, str]]:
    """Columns of a matrix of positions, three a point: `pos_1`, `pos_2` …"""
    matrices: dict[str, list[str]] = {}
    for name in names:
        if found := _PLACE.fullmatch(name):
            matrices.setdefault(found[1], []).append(name)
    return [(each[k], each[k + 1], each[k + 2]) for each in matrices.values() if len(each) % 3 == 0 for k in range(0, len(each), 3)]


def _entry(place: str, names: Sequence[str], valid: Sequence[str], dimension: str, sheet: Sheet, limit: float) -> str:
    keys = {"columns": list(names), "unit": _unit(names, dimension, sheet, limit)}
    count = len(names) // (3 if place == "position" else 1)
    if count < len(valid):
        keys |= {"of": list(valid[-count:] if place == "position" else valid[:count])}
    if place == "position" and (codes := _codes(names, sheet)):
        keys["missing"] = codes
    return f"{place} = {toml(keys)}"


def _codes(names: Sequence[str], sheet: Sheet) -> list[float]:
    """Numbers that stand for lost samples of points; zeros where they are many."""
    columns = [sheet.columns[name] for name in names]
    if len(names) % 3 or len({len(values) for values in columns}) != 1 or any(values.dtype.kind not in "iuf" for values in columns):
        return []
    points = np.array(columns, dtype=float).reshape(-1, 3, len(columns[0]))
    codes = [as_written(code) for code in lost_points(points)[1]]
    zero = np.all(points == 0, axis=1)
    return [*codes, 0] if np.any((zero.mean(axis=1) > ZEROS) & ~zero.all(axis=1)) else codes


def _time_unit(sheet: Sheet, name: str) -> str:
    values = sheet.columns[name]
    if values.dtype.kind == "M" or (values.dtype.kind == "O" and re.match(r"\d{4}-\d\d-\d\d", str(values[0]))):
        return "iso"
    found = _TIME.fullmatch(name)
    if found and found[1]:
        return {"sec": "s"}.get(found[1].lower(), found[1].lower())
    step = float(np.nanmedian(np.diff(values.astype(float)))) if values.dtype.kind in "iuf" and len(values) > 1 else 0.01
    return next((unit for unit, one in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)) if step * one < 1.0), "ns")


def _unit(names: Sequence[str], dimension: str, sheet: Sheet, limit: float) -> str:
    """The unit that the first name ends with, else the usual one that fits the robot's limit (positions: 3 m)."""
    units = UNITS[dimension]
    alike = {unit.lower(): unit for unit in reversed(list(units))}
    if (found := _UNIT.search(names[0])) and found[1].lower() in alike:
        return alike[found[1].lower()]
    values = [sheet.columns[name].astype(float) for name in names if sheet.columns[name].dtype.kind in "iuf"]
    values = [each[~np.isin(each, far_codes(each))] for each in values]
    largest = max((float(np.nanmax(np.abs(each), initial=0.0)) for each in values), default=0.0)
    if dimension == "length":
        return "m" if largest < limit else "mm"
    return likely(largest, limit, dimension) or USUAL[dimension][0]
