"""Where the tip shall go: built-in paths and files, in the tracker frame G."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from tepm_opt.data.tables import read_table
from tepm_opt.errors import InputError

MOST_POINTS = 100_000
FARTHEST = 50.0  # m; beyond it a coordinate is taken for millimetres
POSITION_COLUMNS = (("x", "x_m"), ("y", "y_m"), ("z", "z_m"))
TIME_COLUMNS = ("time_s", "time", "t")


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Tip targets over time.

    Attributes:
        time: (points,) in s, increasing.
        positions: (points, 3) in m in G.
        closed: whether the last point leads back to the first.
    """

    time: np.ndarray
    positions: np.ndarray
    closed: bool = False

    def resampled(self, points: int) -> Trajectory:
        """The same path at `points` equally spaced times, by monotone cubic interpolation (PCHIP, Fritsch and Carlson 1980).

        Raises:
            InputError: fewer than 1 point asked for, or fewer than 2 to interpolate between.
        """
        check_count(points)
        if len(self.time) < 2:
            raise InputError(f"a trajectory of {len(self.time)} point cannot be resampled to {points}; valid: at least 2 points")
        time, positions = self.time, self.positions
        if self.closed:  # the step back to the first point takes as long as the last one
            time, positions = np.append(time, 2 * time[-1] - time[-2]), np.vstack([positions, positions[:1]])
        at = np.linspace(time[0], time[-1], points + 1 if self.closed else points)[:points]
        return Trajectory(at, PchipInterpolator(time, positions)(at), self.closed)


def check_count(points: int) -> None:
    """Refuse a number of points below 1, or absurdly large.

    Raises:
        InputError: naming the number.
    """
    if not 1 <= points <= MOST_POINTS:
        raise InputError(f"points = {points}; valid: 1 … {MOST_POINTS}")


def _closed(curve: np.ndarray, duration: float) -> Trajectory:
    return Trajectory(duration * np.arange(len(curve)) / len(curve), curve, closed=True)


def circle(points: int = 32, duration: float = 8.0, radius: float = 0.150, height: float = 0.350) -> Trajectory:
    """Eq. (7): x = radius cos w, y = radius sin w, z = height, w = 2 pi k / points (m, s).

    Raises:
        InputError: fewer than 1 point.
    """
    check_count(points)
    angle = 2 * np.pi * np.arange(points) / points
    return _closed(np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(points, height)], axis=1), duration)


def lissajous(points: int = 64, duration: float = 6.0, radius: float = 0.120, height: float = 0.350) -> Trajectory:
    """Figure of eight: x = radius sin w, y = radius sin 2w, z = height (m, s).

    Raises:
        InputError: fewer than 1 point.
    """
    check_count(points)
    angle = 2 * np.pi * np.arange(points) / points
    return _closed(np.stack([radius * np.sin(angle), radius * np.sin(2 * angle), np.full(points, height)], axis=1), duration)


def line(
    points: int = 32,
    duration: float = 4.0,
    start: Sequence[float] = (-0.150, 0.0, 0.350),
    end: Sequence[float] = (0.150, 0.0, 0.350),
) -> Trajectory:
    """Straight line at constant speed from `start` to `end` (m in G, s).

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
        table.refuse(np.abs(columns[-1]) > FARTHEST, name, f"metres within {FARTHEST:g} m, not millimetres")
    count = len(columns[0])
    name = next((name for name in TIME_COLUMNS if name in table), None)
    if name and duration is not None:
        raise InputError(f"{path}: has a column {name!r}, so a duration does not fit")
    time = table.increasing(name) if name else (duration or 8.0) * np.arange(count) / max(count - 1, 1)
    return Trajectory(time, np.stack(columns, axis=1))
