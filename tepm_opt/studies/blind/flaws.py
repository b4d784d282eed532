"""Flaws of an experiment, not of the machine: poor data, and mistakes in the robot file or the data set."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.models.robot import Robot
from tepm_opt.studies.blind.causes import LIBRARY, Cause, Form
from tepm_opt.studies.blind.excitation import ANGLES, COUNT
from tepm_opt.studies.blind.machine import Deviation

SECONDS = (6.0, 15.0)  # of a run
Spoil = Callable[[np.random.Generator, np.ndarray, float], np.ndarray]
"""Points (rows, points, 3) in m as they are recorded, from random numbers, the points measured and their noise (1 sigma per axis)."""


@dataclass(frozen=True)
class Flaw:
    """Flaw that makes data poor.

    Attributes:
        seconds: shortest and longest run.
        fit: number of runs to fit to; drawn where None.
        judges: number of runs to judge by.
        every: part of the samples that is kept is one over this.
        loop: whether a controller follows what is measured.
        partly: whether what is hidden acts in some of the runs only.
        spoil: what becomes of the points.
    """

    seconds: tuple[float, float] = SECONDS
    fit: int | None = None
    judges: int = 2
    every: int = 1
    loop: bool = False
    partly: bool = False
    spoil: Spoil | None = None


def _hide_points(rows: np.ndarray, points: np.ndarray, which: slice | int = slice(None)) -> np.ndarray:
    found = points.copy()
    found[rows, which] = np.nan
    return found


def _gaps(random: np.random.Generator, points: np.ndarray, noise: float) -> np.ndarray:
    """A quarter of all samples are lost, in stretches."""
    lost = np.zeros(len(points), dtype=bool)
    while lost.mean() < 0.25:
        start = int(random.integers(2, len(points)))
        lost[start : start + int(random.integers(5, 40))] = True
    return _hide_points(lost, points)


def _hidden_point(random: np.random.Generator, points: np.ndarray, noise: float) -> np.ndarray:
    """One point, each time another, is not seen for half of the run."""
    start = int(random.integers(1, len(points) // 2))
    return _hide_points(np.arange(start, start + len(points) // 2), points, int(random.integers(points.shape[1])))


def _outliers(random: np.random.Generator, points: np.ndarray, noise: float) -> np.ndarray:
    """A sample in a hundred is off by 3 … 10 mm, one point at a time."""
    found = points.copy()
    rows = np.flatnonzero(random.uniform(size=len(points)) < 0.01)
    away = random.normal(size=(len(rows), 3))
    away *= random.uniform(3e-3, 10e-3, (len(rows), 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    found[rows, random.integers(points.shape[1], size=len(rows))] += away
    return found


def _coarse(random: np.random.Generator, points: np.ndarray, noise: float) -> np.ndarray:
    """Positions are written on a grid of twice the noise."""
    return np.round(points / (2 * noise)) * 2 * noise


POOR: Mapping[str, Flaw] = {
    "one_run": Flaw((10.0, 15.0), fit=1, judges=0),
    "short_runs": Flaw((5.0, 5.0)),
    "slow_sampling": Flaw(every=5),
    "hidden_points": Flaw(spoil=_hidden_point),
    "gaps": Flaw(spoil=_gaps),
    "outliers": Flaw(spoil=_outliers),
    "coarse_grid": Flaw(spoil=_coarse),
    "closed_loop": Flaw(loop=True),
    "some_runs": Flaw(fit=5, partly=True),
}
"""By key."""


def spoil_run(run: Run, flaw: Flaw, random: np.random.Generator, noise: float) -> Run:
    """Spoil a run as poor data record it.

    Args:
        run: as measured.
        flaw: what is wrong.
        random: what is drawn from.
        noise: 1 sigma per axis in m.
    """
    return run if flaw.spoil is None else replace(run, points=flaw.spoil(random, run.points, noise))


FEEDBACK = 1.5e5  # Pa/m, half of what would halve a static error
SLOWLY = 1.0  # s, time constant of the feedback


def add_feedback(asked: SetPoints, measured: np.ndarray, goal: np.ndarray) -> SetPoints:
    """Add a controller's feedback to commands: pressures that push the tip back, slowly, to where it should be.

    Args:
        asked: commands without feedback.
        measured, goal: points, (rows, points, 3) in m.
    """
    error = (goal - measured)[:, -1, :2]
    slow = np.zeros_like(error)
    for k, seconds in enumerate(np.diff(asked.time), start=1):
        slow[k] = error[k - 1] + (slow[k - 1] - error[k - 1]) * np.exp(-seconds / SLOWLY)
    toward = -np.stack([np.cos(ANGLES), np.sin(ANGLES)])  # a longer muscle bends the robot away from its side
    inputs = asked.inputs.copy()
    inputs[:, :COUNT] = np.clip(inputs[:, :COUNT] + FEEDBACK * slow @ toward, 0.0, 0.4e6)
    return SetPoints(asked.time, inputs, asked.tip_force)


def mistaken(robot: Robot) -> dict[str, Cause]:
    """Values of a robot file that are wrong beyond their priors: named `parameter`, with the value's name as detail."""

    def cause(name: str, low: float, high: float) -> Cause:
        def form(random: np.random.Generator) -> Form:
            sign = float(random.choice([-1, 1]))
            at = lambda size: Deviation(factors={name: 1 + sign * size})  # noqa: E731  it is what a form is
            return Form(("parameter",), at, min(1.5 * low, high), low, high, {"parameter": name})

        return form

    beyond = {name: (2.1 * width, 0.75) for name, width in robot.priors.items()}  # whatever the machine's own value is
    return {name: cause(name, *limits) for name, limits in {**beyond, "r": (5e-3, 0.3), "L_0": (1e-3, 0.1)}.items()}


def _shift_inputs(seconds: float) -> Deviation:
    """Let inputs and force act some seconds early, so that positions lead them."""

    def interpolate_ahead(asked: SetPoints) -> SetPoints:
        at = asked.time + seconds
        columns = [np.stack([np.interp(at, asked.time, column) for column in part.T], axis=1) for part in (asked.inputs, asked.tip_force)]
        return SetPoints(asked.time, *columns)

    return Deviation(before=interpolate_ahead)


def clock_ahead(random: np.random.Generator) -> Form:
    """Positions bear earlier times than inputs."""
    return Form((), _shift_inputs, 0.02, 1e-3, 0.3)


def clock_behind(random: np.random.Generator) -> Form:
    """Positions bear later times than inputs, which is what a delay of the machine looks like."""
    return Form((), lambda size: _shift_inputs(-size), 0.02, 1e-3, 0.3, allowed=("time_delay",))


def jitter(random: np.random.Generator) -> Form:
    """Frames are older than they say by times that are drawn anew: late in the mean, which is what a delay looks like."""
    return Form((), lambda size: Deviation({"sample_jitter": {"up_to_s": size}}), 5e-3, 1e-4, 0.05, allowed=("time_delay",))


CLOCKS: Mapping[str, Cause] = {
    "clock_ahead": clock_ahead,
    "clock_behind": clock_behind,
    "clock_skew": LIBRARY["clock_skew"],
    "sample_jitter": jitter,
}
"""By key; one that runs apart has a name."""
