"""Values that a robot cannot have: another unit or another frame, with the entry of the map that mends it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations, product
from operator import eq

import numpy as np

from tepm_opt.data.channels import Channels
from tepm_opt.data.importing.maps import QUANTITIES, Frame, ImportMap, Wanted
from tepm_opt.data.importing.refusals import quote_columns, refusal, toml
from tepm_opt.data.importing.runs import ImportedRun
from tepm_opt.data.importing.units import UNITS, USUAL, likely
from tepm_opt.data.setpoints import AXES

FAR, NEAR = 8.0, 0.02  # times the distance from the base that the robot's size lets expect, as the checks of data sets have it
TILT = np.cos(np.deg2rad(50))  # of the robot at the start of a run, as they have it
LEAST, MOST = 1.2e-3, 1 + 1e-6  # of the limit, as they have it


def refuse_implausible(run: ImportedRun, given: ImportMap, wanted: Sequence[Wanted], channels: Channels) -> None:
    """Refuse inputs and positions whose size only another unit explains, and a robot that lies on its side.

    Args:
        run: on its grid.
        given: the map.
        wanted: what it fills.
        channels: limits and size of the robot.

    Raises:
        InputError: names all columns concerned and the entry that mends it.
    """
    for each in wanted:
        if not each.columns or each.place not in QUANTITIES:
            continue
        values = np.array([run.columns[target] for target in each.targets])
        if each.place == "position":
            _distances(run, each, values, channels)
        elif each.place.startswith(("pressure", "tension")):
            limit = channels.pressure_max if each.place.startswith("pressure") else channels.tension_max
            _sizes(run, each, values, limit)
    if "frame" not in given.model_fields_set:
        _upright(run, next((each for each in wanted if each.place == "position" and each.columns), None), channels)


def _where(run: ImportedRun, each: Wanted) -> str:
    return ", ".join(dict.fromkeys(str(s.sheet.path) for s in run.samples if s.wanted.place == each.place and s.sheet is not None))


def _sizes(run: ImportedRun, each: Wanted, values: np.ndarray, limit: float) -> None:
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    if (
        not np.isfinite(limit)
        or largest == 0
        or LEAST * limit < largest <= MOST * limit
        or (each.place.endswith("measured") and largest < 1.2 * limit)
    ):
        return
    assert each.dimension is not None
    best = likely(largest / each.si, limit, each.dimension)
    if best is None:
        return  # the check of the data set says more about it
    si = "Pa" if each.dimension == "pressure" else "N"
    read = f"reaches {largest:.4g} {si} if it is in {each.source.unit or si}"
    what = f"{each.place} ({', '.join(map(str, each.columns))}) {read}; the robot's limit is {limit:g} {si}"
    raise refusal(_where(run, each), what, f"{each.place}.unit = {toml(best)}")


def _compute_rest_distances(each: Wanted, channels: Channels) -> np.ndarray:
    """Compute the distance from the base in m that each mapped point has at rest, (points,)."""
    assert channels.height is not None
    names = list(dict.fromkeys(target.partition("_")[0] for target in each.targets))
    return channels.height * np.array([channels.points.index(name) + 1 for name in names]) / len(channels.points)


def _distances(run: ImportedRun, each: Wanted, values: np.ndarray, channels: Channels) -> None:
    if channels.height is None:
        return
    points = values.reshape(-1, 3, values.shape[1])

    def ratio(times: float) -> float:
        with np.errstate(all="ignore"):
            distance = np.linalg.norm(times * points - np.array(channels.base)[None, :, None], axis=1)
        seen = [float(np.median(one[np.isfinite(one)])) if np.isfinite(one).any() else np.nan for one in distance]
        return float(np.nanmedian(np.array(seen) / _compute_rest_distances(each, channels))) if np.isfinite(seen).any() else 1.0

    if NEAR <= (found := ratio(1.0)) <= FAR:
        return
    best = min(USUAL["length"], key=lambda unit: abs(np.log(max(ratio(UNITS["length"][unit] / each.si), 1e-12))))
    read = f"if in {each.source.unit or 'm'}"
    what = f"position: {quote_columns(each.columns)}: {found:.3g} times as far from the base as the robot's size allows {read}"
    raise refusal(_where(run, each), what, f"position.unit = {toml(best)}")


def _upright(run: ImportedRun, each: Wanted | None, channels: Channels) -> None:
    """The last point has to be above the base at the start; else the axes are proposed that put it there."""
    if each is None or channels.height is None:
        return
    start = np.array([run.columns[target][:50] for target in each.targets[-3:]])
    start = start[:, np.isfinite(start).all(axis=0)]
    if not start.size:
        return
    place = np.median(start, axis=1)
    axis, base = np.array(channels.axis), np.array(channels.base)

    def rise(turn: np.ndarray) -> float:
        direction = turn @ place - base
        return float(direction @ axis / np.linalg.norm(direction))

    if rise(np.eye(3)) >= TILT:
        return
    frames = [
        Frame(axes=[sign + one for sign, one in zip(signs, order, strict=True)])
        for order in permutations("xyz")
        for signs in product(("", "-"), repeat=3)
    ]
    right = [frame for frame in frames if np.linalg.det(frame.rotation) > 0]
    best = max(
        right, key=lambda frame: (round(rise(frame.rotation), 6), sum(map(eq, frame.axes, AXES)), "".join(frame.axes).count("-") == 0)
    )
    found = f"x, y, z = {', '.join(f'{value:.3f}' for value in place)} m"
    what = f"position: {quote_columns(each.columns[-3:])}: not above the base at the start, {found}"
    entry = f"frame.axes = {toml(best.axes)}" if rise(best.rotation) >= TILT else ""
    raise refusal(
        _where(run, each),
        f"{what}: other axes than G's? ({toml(list(AXES))} keeps them; how they lie about the vertical is yours to know)",
        entry,
    )


def notes_of(given: ImportMap, wanted: Sequence[Wanted], channels: Channels | None) -> list[str]:
    """List in words what a robot's map leaves open."""
    if channels is None:
        return []
    found = []
    if given.pressure is None:
        found.append("no pressure in the map: 0 Pa throughout")
    if given.tension is None:
        found.append("no tension in the map: 0 N throughout (no tendons, or tendons that follow)")
    filled = {target for each in wanted for target in each.targets}
    for place, names, form in (("pressure", channels.actuators, "pressure_{}_Pa"), ("tension", channels.actuators, "tension_{}_N")):
        lacking = [name for name in names if form.format(name) not in filled]
        if lacking and getattr(given, place) is not None:
            found.append(f"no {place} of {', '.join(lacking)} in the map: 0 throughout")
    if lost := [name for name in channels.points if f"{name}_x_m" not in filled]:
        found.append(f"{', '.join(lost)}: not measured, left empty")
    if np.linalg.det(given.frame.rotation) < 0:
        found.append("frame.axes mirrors the tracker's frame: right only where that is left-handed")
    return found


def left_out(sheets: Mapping[str, Sequence[str]], orientations: Sequence[str]) -> list[str]:
    """Words about columns that are not in the map.

    Args:
        sheets: such columns of each file.
        orientations: those of them that hold orientations.
    """
    names = list(dict.fromkeys(name for columns in sheets.values() for name in columns))
    found = []
    if turned := [name for name in names if name in orientations]:
        found.append(f"left out, a data set has no place for orientations: {_some(turned)}")
    if others := [name for name in names if name not in orientations]:
        found.append(f"left out, not in the map: {_some(others)}")
    return found


def _some(names: Sequence[str], most: int = 24) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
