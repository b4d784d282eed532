"""Adaptive implicit steps in Python (see motion_adaptive.c, which says how they work)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.models.backends.interface import JUMP_TIME, Status
from tepm_opt.models.backends.motion_interface import Record
from tepm_opt.models.backends.motion_run import Run, is_bounded
from tepm_opt.models.backends.motion_stages import State, Unsolved
from tepm_opt.models.backends.step_control import FIRST_STEP, LEAST, MEMORY, MOST_OVER, RICHARDSON, SHARE, SHORTEST, STILL


@dataclass
class Carried:
    """State carried from call to call; steps that do not adapt only have `fine`.

    `step` is to be tried next in s, `ratio` what the last pair added over what it may, `error` the largest so far in m, `moved` the
    largest way of a pair of late in m.
    """

    fine: State
    coarse: State
    step: float = FIRST_STEP
    ratio: float = 1.0
    error: float = 0.0
    moved: float = 0.0


@dataclass(frozen=True, eq=False)
class StepPair:
    """Two fine steps of equal length and the coarse one beside them.

    Attributes:
        start: before the steps.
        middle: fine motion between the steps.
        end: after them.
        h: length of a fine step in s.
    """

    start: Carried
    middle: State
    end: Carried
    h: float


def adapt(run: Run, carried: Carried, first: int, last: int, record: Record) -> Status:
    """Move from a sample to a later one with steps that aim at the scheme's error and end at the drive's knots (see motion_adaptive.c).

    Args:
        run: the integration.
        carried: what is moved.
        first, last: numbers of the samples.
        record: what is filled.
    """
    time, knots, scheme = run.drive.time, run.drive.knots, run.scheme
    t, sample = float(time[first]), first + 1
    while t < time[last]:
        if run.drive.hold and len(knots) and np.abs(knots - t).min() <= JUMP_TIME:
            run.jump(carried.fine, t)
            run.jump(carried.coarse, t)
            carried.step = min(carried.step, FIRST_STEP)
        stop = float(min(knots[knots > t + JUMP_TIME], default=time[last]))
        stop = min(stop, float(time[last]))
        h, error, ratio, status = _fit_step(carried.step, stop - t), 0.0, np.inf, Status.SOLVED
        start = replace(carried)
        carried.fine, carried.coarse = (replace(state, d=dict(state.d)) for state in (start.fine, start.coarse))
        middle = carried.fine
        try:
            run.implicit_step(carried.fine, carried.fine, t, h, last_try=False)
            middle = replace(carried.fine, d=dict(carried.fine.d))
            run.implicit_step(carried.fine, carried.fine, t + h, h, last_try=False)
            run.implicit_step(carried.coarse, carried.fine, t, 2 * h, last_try=False)
        except Unsolved:
            status = Status.STUCK
        else:
            error, added, interpolated, moved = _measure_errors(StepPair(start, middle, carried, h))
            error, added = error / run.divisor, added / run.divisor
            carried.moved = max(moved, start.moved * np.exp(-2 * h / STILL))
            aim = min(
                scheme.error, max(SHARE * carried.moved, LEAST * scheme.error)
            )  # small motions are resolved, too, so that estimates hold
            ratio = max(added / np.sqrt(2 * h / MEMORY) / aim, interpolated / aim, 1e-4)
            error += interpolated
        if not ratio < MOST_OVER:
            vars(carried).update(vars(start))
            carried.step = h * (0.5 if status else max(0.2, 0.8 * ratio ** (-1 / 3)))
            run.effort.halvings += 1
            if carried.step < SHORTEST:
                return Status.STUCK
            continue
        run.effort.steps += 2
        run.effort.longest = max(run.effort.longest, h)
        growth = h * min(4.0, max(0.3, 0.9 * ratio**-0.25 * carried.ratio**0.08))  # PI control, Gustafsson 1991
        carried.step = max(carried.step, growth) if h < carried.step else growth  # a step that a stop has shortened says little
        carried.ratio, carried.error = ratio, max(carried.error, LEAST * scheme.error, error)
        begun, t = t, stop if stop - t < 2 * h * (1 + 1e-9) else t + 2 * h
        if not is_bounded(carried.fine):
            return Status.DIVERGED
        run.effort.reached = t
        while sample <= last and time[sample] <= t + JUMP_TIME:
            part, off = float(time[sample] - begun) / (2 * h), 1 / RICHARDSON if scheme.smooth else 0.0
            pair = StepPair(start, middle, carried, h)
            x, v = _interpolate_pair(pair, part, off, lambda state: (state.x, state.v))
            d_x = None
            if carried.fine.d:
                d_x, _ = _interpolate_pair(pair, part, off, lambda state: (state.d["x"], state.d["v"]))
            run.record(record, sample, x, v, d_x)
            sample += 1
    return Status.SOLVED


def _fit_step(wanted: float, left: float) -> float:
    """Length of the next two steps: the one wanted, or what ends them with equal ones at the stop."""
    return left / 2 if 2 * wanted > left * (1 - 1e-9) else left / 4 if 4 * wanted > left else wanted


def _measure_errors(pair: StepPair) -> tuple[float, ...]:
    """Distances in m, of the farthest node: of fine and coarse motion at the end of a pair, by how much the pair has changed it beside what
    the difference of the velocities explains, from an interpolation within its steps, and over the pair."""
    (x_0, v_0), (x_1, v_1) = ((c.fine.x - c.coarse.x, c.fine.v - c.coarse.v) for c in (pair.start, pair.end))
    a, b, h = pair.start.fine, pair.end.fine, pair.h
    off = (a.x + b.x) / 2 + h * (a.v - b.v) / 4 - pair.middle.x
    rest = x_1 - x_0 - h * (v_1 + v_0)
    return tuple(float(np.linalg.norm(e[1:].reshape(-1, 3), axis=1).max()) for e in (x_1, rest, off / 16, b.x - a.x))


Moving = tuple[np.ndarray, np.ndarray]
"""Positions and velocities."""


def _interpolate_pair(pair: StepPair, part: float, off: float, of: Callable[[State], Moving]) -> Moving:
    """Positions and velocities at a part of a pair of steps, with the share `off` of the coarse step's difference taken away."""
    start, middle, end, h = pair.start, pair.middle, pair.end, pair.h
    first, half = (of(middle), of(end.fine)) if part > 0.5 else (of(start.fine), of(middle)), 2 * part - (part > 0.5)
    x, v = _hermite(*first, h, half)
    for scale, a, b in ((off, start.fine, end.fine), (-off, start.coarse, end.coarse)):
        d_x, d_v = _hermite(of(a), of(b), 2 * h, part)
        x, v = x + scale * d_x, v + scale * d_v
    return x, v


def _hermite(a: Moving, b: Moving, h: float, p: float) -> Moving:
    """Cubic through positions and velocities at the ends of a span of length h, at a part of it."""
    q = 1 - p
    x = q * q * (1 + 2 * p) * a[0] + p * p * (1 + 2 * q) * b[0] + h * p * q * (q * a[1] - p * b[1])
    return x, -6 * p * q / h * (a[0] - b[0]) + q * (1 - 3 * p) * a[1] + p * (1 - 3 * q) * b[1]
