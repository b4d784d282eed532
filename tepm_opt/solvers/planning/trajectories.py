"""Trajectories of the tip: built-in shapes and files, in the tracker frame G.

A new shape is a function here with `@shape(…)` above it: the commands find its name, its options and their help by themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from tepm_opt.data.sizes import FARTHEST, METRES
from tepm_opt.data.tables import read_table
from tepm_opt.errors import InputError
from tepm_opt.renamed import RenamedMethod

MOST_POINTS = 100_000
POSITION_COLUMNS = (("x", "x_m"), ("y", "y_m"), ("z", "z_m"))
TIME_COLUMNS = ("time_s", "time", "t")


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Tip targets over time.

    Attributes:
        time: (points,) in s, increasing.
        positions: (points, 3) in m in G.
        closed: whether the last point leads back to the first.
        says: what a person should know of it, where it is not what the name says by itself.
    """

    time: np.ndarray
    positions: np.ndarray
    closed: bool = False
    says: str = ""

    def resample(self, points: int) -> Trajectory:
        """Resample the path to `points` equally spaced times, by monotone cubic interpolation (PCHIP, Fritsch and Carlson 1980).

        Raises:
            InputError: fewer than 1 point asked for, or fewer than 2 to interpolate between.
        """
        check_count(points)
        if len(self.time) < 2:
            raise InputError(f"a trajectory of {len(self.time)} point cannot be resampled to {points}; valid: at least 2 points")
        time, positions = self.time, self.positions
        if self.closed:  # the step back to the first point takes as long as the last one
            time, positions = np.append(time, 2 * time[-1] - time[-2]), np.vstack([positions, positions[:1]])
        from scipy.interpolate import PchipInterpolator  # here, because commands that only name shapes start at once

        at = np.linspace(time[0], time[-1], points + 1 if self.closed else points)[:points]
        return Trajectory(at, PchipInterpolator(time, positions)(at), self.closed, self.says)

    resampled = RenamedMethod("resample")


def check_count(points: int) -> None:
    """Refuse a number of points below 1, or absurdly large.

    Raises:
        InputError: naming the number.
    """
    if not 1 <= points <= MOST_POINTS:
        raise InputError(f"points = {points}; valid: 1 … {MOST_POINTS}")


@dataclass(frozen=True)
class ShapeParameter:
    """A number, or several, that a person can choose of a shape.

    Attributes:
        name: of the function's argument.
        option: of the command line, without dashes.
        text: what it is, as a noun; the shapes that have it are added in the help.
        unit: of the value.
        low, high: valid from, to.
        above: whether `low` itself is not valid.
        count: how many numbers.
    """

    name: str
    option: str
    text: str
    unit: str = "m"
    low: float = -FARTHEST
    high: float = FARTHEST
    above: bool = False
    count: int = 1

    def check(self, value: float | Sequence[float], label: str) -> None:
        """Refuse a value out of range or not finite.

        Raises:
            InputError: naming it by `label`.
        """
        values = np.asarray(value, dtype=float)
        inside = (values > self.low if self.above else values >= self.low) & (values <= self.high)
        if not (np.isfinite(values) & inside).all():
            metres = ", not millimetres" if self.unit == "m" and (np.abs(values) > FARTHEST).any() else ""
            raise InputError(f"{label} {value}; valid: {'more than ' * self.above}{self.low:g} … {self.high:g} {self.unit}{metres}")


@dataclass(frozen=True)
class Shape:
    """A built-in path.

    Attributes:
        name: by which commands know it.
        make: called with `points`, `duration` and the parameters, each of which has a default.
        parameters: besides points and duration.
    """

    name: str
    make: Callable[..., Trajectory]
    parameters: tuple[ShapeParameter, ...]


DURATION = ShapeParameter("duration", "duration", "duration of the trajectory, where it has no time", "s", 0.0, 1e6, above=True)
RADIUS = ShapeParameter("radius", "radius", "radius", low=0.0, above=True)
HEIGHT = ShapeParameter("height", "height", "height, z in G,")
START = ShapeParameter("start", "from", "start", count=3)
END = ShapeParameter("end", "to", "end", count=3)
SHAPES: dict[str, Shape] = {}
"""Built-in paths by name."""

Make = TypeVar("Make", bound=Callable[..., Trajectory])


def shape(*parameters: ShapeParameter) -> Callable[[Make], Make]:
    """Offer the function below to the commands, under its own name and with these parameters."""

    def register(make: Make) -> Make:
        SHAPES[make.__name__] = Shape(make.__name__, make, parameters)
        return make

    return register


def shape_parameters() -> dict[str, tuple[ShapeParameter, tuple[str, ...]]]:
    """Parameters of all shapes by name, each with the names of the shapes that have it."""
    found: dict[str, tuple[ShapeParameter, tuple[str, ...]]] = {}
    for one in SHAPES.values():
        for parameter in one.parameters:
            _, names = found.get(parameter.name, (parameter, ()))
            found[parameter.name] = parameter, (*names, one.name)
    return found


def _close_curve(curve: np.ndarray, duration: float) -> Trajectory:
    return Trajectory(duration * np.arange(len(curve)) / len(curve), curve, closed=True)


@shape(RADIUS, HEIGHT)
def circle(points: int = 32, duration: float = 8.0, radius: float = 0.150, height: float = 0.350) -> Trajectory:
    """Eq. (7): x = radius cos w, y = radius sin w, z = height, w = 2 pi k / points.

    Args:
        points: number of them.
        duration: of one lap in s.
        radius: in m; the path lies within it across.
        height: z in G in m.

    Raises:
        InputError: fewer than 1 point.
    """
    check_count(points)
    angle = 2 * np.pi * np.arange(points) / points
    return _close_curve(np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(points, height)], axis=1), duration)


@shape(RADIUS, HEIGHT)
def lissajous(points: int = 64, duration: float = 6.0, radius: float = 0.120, height: float = 0.350) -> Trajectory:
    """Figure of eight: x = radius sin w, y = radius sin 2w, z = height.

    Args:
        points: number of them.
        duration: of one lap in s.
        radius: in m; the path lies within it across.
        height: z in G in m.

    Raises:
        InputError: fewer than 1 point.
    """
    check_count(points)
    angle = 2 * np.pi * np.arange(points) / points
    return _close_curve(np.stack([radius * np.sin(angle), radius * np.sin(2 * angle), np.full(points, height)], axis=1), duration)


@shape(START, END)
def line(
    points: int = 32,
    duration: float = 4.0,
    start: Sequence[float] = (-0.150, 0.0, 0.350),
    end: Sequence[float] = (0.150, 0.0, 0.350),
) -> Trajectory:
    """Straight line at constant speed from `start` to `end`.

    Args:
        points: number of them.
        duration: in s.
        start, end: in G, (3,) in m.

    Raises:
        InputError: fewer than 1 point.
    """
    check_count(points)
    part = np.linspace(0.0, 1.0, points)[:, None]
    return Trajectory(duration * part[:, 0], (1 - part) * np.asarray(start) + part * np.asarray(end))


def read_trajectory(path: str | Path, duration: float | None = None) -> Trajectory:
    """Tip targets from a CSV file: columns x, y, z (or x_m, y_m, z_m) in m in G and, if it has one, time (time_s, time or t).

    Without time the points are spread evenly over `duration` in s (8 s where absent).

    Raises:
        InputError: unreadable file, missing column, no number, time that does not increase,
            a duration for a file that has time, coordinates that must be mm.
    """
    table = read_table(path)
    columns = []
    for names in POSITION_COLUMNS:
        name = next((name for name in names if name in table), names[0])
        columns.append(table.column(name))
        table.refuse(np.abs(columns[-1]) > FARTHEST, name, METRES)
    count = len(columns[0])
    name = next((name for name in TIME_COLUMNS if name in table), None)
    if name and duration is not None:
        raise InputError(f"{path}: has a column {name!r}, so a duration does not fit")
    time = table.read_increasing(name) if name else (duration or 8.0) * np.arange(count) / max(count - 1, 1)
    return Trajectory(time, np.stack(columns, axis=1))
