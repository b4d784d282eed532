"""Checks of a run's motion: start at rest, frozen sensors, spikes, repeated rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from scipy.ndimage import median_filter

from tepm_opt.data.checks.findings import Finding, Subject, intervals, spread
from tepm_opt.data.outliers import FEW, far

SPEED, ACCELERATION = 5.0, 50.0
"""Beyond what the paper's robot does, in heights a second (squared): free sway from 2.5 N at the tip reaches 3.5 and 20. Robots that sway
more quickly are allowed more."""
SWAY = 0.01
"""Part of its height that a robot goes under steady inputs if it is not at rest; below, its stand may vibrate."""
ALIKE = 0.5
"""Part of the way of the point that goes farthest that all others go at least if the stand moves; the first points of a robot that sways go
a quarter at most."""
SHORT = 0.2
"""Part of a run for which a point may be frozen and the others still tell."""


def check_motion(subject: Subject) -> Iterator[Finding]:
    """All checks of this file."""
    if subject.run.rows < 10 or not subject.step:
        return
    yield from _rest(subject)
    yield from _repeats(subject)
    yield from _frozen(subject)
    yield from _still(subject)
    yield from _copies(subject)
    yield from _spikes(subject)


def _height(subject: Subject) -> float:
    """The robot's height in m, from the data where the robot is not known."""
    if subject.channels.height is not None:
        return subject.channels.height
    sizes = spread(np.nanmax(subject.points, axis=0, initial=-np.inf))
    return max(float(np.max(sizes, initial=0.0)), 0.1)


def _rest(subject: Subject) -> Iterator[Finding]:
    """Velocity in the steady rows at the start, at most half a second: a run starts in equilibrium under its first row."""
    rows = min(subject.steady_rows, round(0.5 / subject.step) + 1)
    if rows < 8 or rows * subject.step < 0.1:
        yield subject.make_finding(
            "warning", "", "inputs move at once: with half a second of steady inputs one could see that it starts at rest", [0]
        )
        return
    time = (np.arange(rows) - (rows - 1) / 2) * subject.step
    worst, name, speed, ways = 1.0, "", 0.0, {}
    for k, point in enumerate(subject.channels.points):
        start = subject.points[:rows, k]
        seen = np.isfinite(start).all(axis=1) & ~subject.strays[:rows, k]
        if seen.sum() < 8:
            continue
        centred = time[seen] - time[seen].mean()
        slopes = centred @ start[seen] / (centred @ centred)
        doubt = np.nan_to_num(subject.noise[k]) / np.sqrt(centred @ centred)
        excess = np.max(np.abs(slopes) / np.maximum(6 * doubt, 4e-3))
        ways[point] = float(np.max(np.ptp(start[seen], axis=0) - 6 * np.nan_to_num(subject.noise[k])))
        if excess > worst:
            worst, name, speed = excess, point, float(np.linalg.norm(slopes))
    if name:
        message = f"not at rest at the start: moves at {1e3 * speed:.0f} mm/s under steady inputs"
        shaken = len(ways) > 2 and min(ways.values()) > ALIKE * max(ways.values())
        message += "; all points move by as much: does its stand move?" if shaken else ""
        yield subject.make_finding(
            "error" if not shaken and ways[name] > SWAY * _height(subject) else "warning", name, message, range(rows)
        )


def _repeats(subject: Subject) -> Iterator[Finding]:
    """Every pose several times: the tracker is slower than the rows."""
    run = subject.run
    if not 0.3 < subject.repeated < 0.97 or run.rows < 50:
        return
    whole = np.all(subject.points[1:] == subject.points[:-1], axis=(1, 2))
    changes = np.flatnonzero(~whole)
    if changes.size > 10 and np.all(np.isfinite(subject.points[:20])) and np.median(np.diff(changes)) > 1.5:
        often = float(np.median(np.diff(changes)))
        message = f"every pose stands {often:.0f} times: the tracker is slower than the rows; keep the rows in which it is new"
        yield subject.make_finding("warning", "", message)


def _frozen(subject: Subject) -> Iterator[Finding]:
    """The same value for long where there should be noise or motion."""
    run, names = subject.run, subject.channels.points
    least = max(10, int(np.ceil(0.3 / subject.step)))
    if subject.noisy:
        chance = np.log(1e-6 / max(run.rows * 3 * len(names), 1)) / np.log(max(subject.repeated, 0.02))
        least = max(least, int(np.ceil(chance)))
    moving = _moves(subject)
    for k, name in enumerate(names):
        point = subject.points[:, k]
        same = point[1:] == point[:-1]
        stuck = intervals(np.all(same, axis=1))
        if subject.noisy:
            found = [(first, last + 1) for first, last in stuck if last + 2 - first >= least]
            channels = {name: found} if found else {f"{name}_{axis}_m": _long(same[:, j], least) for j, axis in enumerate("xyz")}
        else:
            found = [(first, last + 1) for first, last in stuck if first > 0 and last + 2 - first >= least and moving(k, first, last + 2)]
            channels = {name: found}
        for channel, found in channels.items():
            if found:
                rows = np.concatenate([np.arange(first, last + 1) for first, last in found])
                message = f"frozen: the same value in {len(rows)} rows, {_value(point[rows[0]], channel)} m at first"
                message += "" if subject.noisy else ", while inputs or other points move"
                much = channel != name or len(rows) > SHORT * run.rows
                yield subject.make_finding("error" if subject.noisy and much else "warning", channel, message, rows)


def _value(point: np.ndarray, channel: str) -> str:
    """Format the place of a frozen point (3,), or its coordinate where the channel is one."""
    axis = {"x": 0, "y": 1, "z": 2}.get(channel.split("_")[1]) if "_" in channel else None
    return f"{point[axis]:.4g}" if axis is not None else f"({', '.join(f'{value:.4g}' for value in point)})"


def _long(same: np.ndarray, least: int) -> list[tuple[int, int]]:
    return [(first, last + 1) for first, last in intervals(same) if last + 2 - first >= least]


def _moves(subject: Subject) -> Callable[[int, int, int], bool]:
    """Whether, between two rows, point k should have moved: by 2 mm as the others did, or with inputs that moved by a tenth."""
    points = subject.points
    limits = subject.channels.limits
    whole = spread(points).max(axis=1)

    def moves(k: int, first: int, end: int) -> bool:
        others = spread(np.delete(points[first:end], k, axis=1)).max(initial=0.0)
        share = whole[k] / max(np.delete(whole, k).max(initial=0.0), 1e-9)
        inputs = np.any(spread(subject.run.inputs[first:end]) > np.where(np.isfinite(limits), 0.1 * limits, np.inf))
        return bool(min(share, 1.0) * others > 2e-3 or (others == 0 and inputs)) and float(spread(points[:first, k]).max()) > 1e-3

    return moves


def _still(subject: Subject) -> Iterator[Finding]:
    """A sensor that shows only noise while the robot swings."""
    points = subject.points
    width = max(1, round(0.2 / subject.step))
    count = len(points) // width
    blocks = np.where(np.isfinite(points), points, np.nan)[: count * width].reshape(count, width, *points.shape[1:])
    seen = _median(blocks)
    if len(seen) < 3 or not seen.size:
        return
    motion = spread(seen).max(axis=1)
    least = np.maximum(8 * np.nan_to_num(subject.noise.max(axis=1)) / np.sqrt(width), 2e-4)
    bent = motion.max() * (np.arange(1, len(motion) + 1) / len(motion)) ** 2  # as much as a robot that bends evenly
    for k, name in enumerate(subject.channels.points):
        measured = np.isfinite(points[:, k]).all(axis=1).mean() > 0.5
        if measured and motion.max() > 0.02 and motion[k] < least[k] < bent[k] / 3:
            message = f"stands still (within {1e3 * motion[k]:.2f} mm) while another point moves by {1e3 * motion.max():.0f} mm"
            yield subject.make_finding("error", name, message)


def _median(blocks: np.ndarray) -> np.ndarray:
    """Median of blocks (blocks, width, …) over their width, NaN where a block has no finite value."""
    ordered, count = np.sort(blocks, axis=1), np.isfinite(blocks).sum(axis=1, keepdims=True)
    return np.take_along_axis(ordered, np.maximum(count - 1, 0) // 2, axis=1)[:, 0]


def _spikes(subject: Subject) -> Iterator[Finding]:
    """Samples off their neighbours, and jumps, beyond what the robot's speed and acceleration allow."""
    step, height, quick = subject.step, _height(subject), max(subject.channels.quickness, 1.0)
    speed_most, bend_most = SPEED * quick * height * step, 2 * ACCELERATION * quick**2 * height * step**2
    points = np.where(subject.stuck[:, :, None], np.nan, subject.points)  # what is frozen jumps where it thaws
    share = subject.strays.sum() / max(np.isfinite(points).any(axis=2).sum(), 1)
    for k, name in enumerate(subject.channels.points):
        rows = np.flatnonzero(np.isfinite(points[:, k]).all(axis=1))
        if len(rows) < 12:
            continue
        values, noise = points[rows, k], 10 * np.nan_to_num(subject.noise[k])
        off = np.abs(values - median_filter(values, size=(5, 1), mode="nearest"))
        allowed = np.maximum(noise, max(bend_most, 1e-3))
        spike = np.any(off > allowed, axis=1) & ~far(subject.run.time[rows])
        speed = np.diff(values, axis=0) / (np.diff(subject.run.time[rows]) / step)[:, None]
        jump = np.abs(speed - median_filter(speed, size=(11, 1), mode="nearest"))
        jumps = np.any(jump > np.maximum(noise, max(speed_most, 1e-3)), axis=1)
        jumps[1:] &= ~spike[1:-1]
        jumps &= ~(spike[1:] | spike[:-1])
        if spike.any():
            size = 1e3 * float(off[spike].max())
            message = f"spikes of up to {size:.0f} mm, {100 * share:.2g} % of the run's samples stray; leave such samples empty"
            yield subject.make_finding("error" if share > FEW or spike.mean() > 2 * FEW else "warning", name, message, rows[spike])
        if jumps.any():
            size = 1e3 * float(np.linalg.norm(np.diff(values, axis=0)[jumps], axis=1).max())
            yield subject.make_finding(
                "error", name, f"jumps by up to {size:.0f} mm within a row, faster than the robot can", rows[1:][jumps]
            )


def _copies(subject: Subject) -> Iterator[Finding]:
    """Stretches of three rows and more whose noisy poses stand elsewhere in the run as well: pasted twice."""
    if not subject.noisy:
        return
    points = subject.points
    rows = np.flatnonzero(np.isfinite(points).all(axis=(1, 2)))
    if not points[0].size or len(rows) < 2:
        return
    _, pose = np.unique(points[rows].reshape(len(rows), -1), axis=0, return_inverse=True)
    seen: dict[int, int] = {}
    back = np.zeros(subject.run.rows, dtype=int)  # how many rows before this one the same pose stood; 0: nowhere
    for row, name in zip(rows.tolist(), pose.ravel().tolist(), strict=True):
        back[row] = row - seen.get(name, row)
        seen[name] = row
    again = (back[1:] == back[:-1]) & (back[1:] > 1)
    copied = [np.arange(first, last + 2) for first, last in intervals(again) if last > first]
    if copied:
        source = subject.run.line(int(copied[0][0] - back[copied[0][0]]))
        later = np.concatenate(copied)
        yield subject.make_finding("error", "", f"{len(later)} rows repeat the poses from line {source} on", later)
