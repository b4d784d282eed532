"""Targets of the tip at every control period, with the equilibria and axial forces that hold it there, which a controller previews."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline

from tepm_opt.errors import InputError
from tepm_opt.models.compile import CompiledModel
from tepm_opt.progress import Progress, silent, track
from tepm_opt.renamed import RenamedMethod
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.ik import IkSettings, each_configuration
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_statics
from tepm_opt.solvers.planning.trajectories import Trajectory

if TYPE_CHECKING:
    from tepm_opt.control.collision.model import CollisionModel

PERIOD = 0.01  # s, of control
IK_DEFAULT = IkSettings()
START_UP = 1.0  # s, in which a path's speed rises from rest and, at its end, falls to it


@dataclass(frozen=True, eq=False)
class Reference:
    """Targets at multiples of the control period; before the first and after the last one the robot rests.

    Attributes:
        tips: (periods, 3) in m in G.
        forces: axial forces F_a, (periods, actuators) in N.
        equilibria: of these, (periods,).
        counted: over which periods the error counts, (periods,) of bool.
        point: number of the target at every period, (periods,); paths are one target.
        period: s.
        wanted: where the tip shall be, (periods, 3) in m in G, where targets are corrected by what was learned; else absent.
        keep_out: obstacles beside the path; None for none.
        moved: how far the tips are from where they were asked for, for the obstacles' sake, (periods,) in m; None where there are none.
    """

    tips: np.ndarray
    forces: np.ndarray
    equilibria: list[Equilibrium]
    counted: np.ndarray
    point: np.ndarray
    period: float = PERIOD
    wanted: np.ndarray | None = None
    keep_out: CollisionModel | None = None
    moved: np.ndarray | None = None

    @property
    def path(self) -> np.ndarray:
        """Targets of the tip by which errors are judged, (periods, 3) in m in G."""
        return self.tips if self.wanted is None else self.wanted

    @cached_property
    def stops(self) -> bool:
        """Whether it stops at several targets, one after the other."""
        return len(np.unique(self.point)) > 1

    def __len__(self) -> int:
        """Number of periods."""
        return len(self.tips)

    def __repr__(self) -> str:
        targets = len(np.unique(self.point))
        return f"Reference({self.duration:.2f} s, {len(self)} periods, counted={int(self.counted.sum())}, targets={targets})"

    @property
    def duration(self) -> float:
        """Time from the first to the last target in s."""
        return self.period * (len(self) - 1)

    @property
    def step(self) -> float:
        """Time between rows in s."""
        return self.period

    def rewind(self) -> Reference:
        """Return the reference at its start, as a controller begins with it."""
        return self

    def is_over(self, period: int) -> bool:
        """Whether a period is beyond the last target."""
        return period >= len(self)

    def govern(self, period: int, errors: np.ndarray) -> None:
        """Take note of the errors that a controller foresees, (stages,) in m, from a period on: time goes on as it does."""

    def rows_at(self, periods: np.ndarray | int) -> np.ndarray:
        """Row numbers of periods, (…,); those beyond the ends are at the ends."""
        return np.clip(periods, 0, len(self) - 1)

    begun, over, at = RenamedMethod("rewind"), RenamedMethod("is_over"), RenamedMethod("rows_at")

    @cached_property
    def levels(self) -> np.ndarray:
        """Free levels, (periods, coordinates) in m."""
        return np.array([at.x[1:].ravel() for at in self.equilibria])

    @cached_property
    def lengths(self) -> np.ndarray:
        """Actuator lengths, (periods, actuators) in m."""
        return np.array([at.lengths.ravel() for at in self.equilibria])


def minimum_jerk(part: np.ndarray) -> np.ndarray:
    """0 … 1 with speed and acceleration zero at both ends (minimum jerk: Flash and Hogan, J. Neurosci. 5, 1985)."""
    s = np.clip(part, 0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)


def reference_of(
    model: CompiledModel,
    tips: np.ndarray,
    counts: np.ndarray | None = None,
    point: np.ndarray | None = None,
    period: float = PERIOD,
    kinematics: IkSettings = IK_DEFAULT,
    progress: Progress = silent,
) -> Reference:
    """Inverse kinematics along tips that are already a control period apart.

    Args:
        model: the controller's.
        tips: (periods, 3) in m in G.
        counts: over which periods the error counts, (periods,) of bool; all where absent.
        point: number of the target at every period, (periods,); one target where absent.
        period: s.
        kinematics: settings of the inverse kinematics.
        progress: told how many periods are done.

    Raises:
        InputError: a tip is out of reach; names the time and why.
    """
    found = []
    each = track(each_configuration(model, tips, ActuationMode.HYBRID, settings=kinematics), progress, "inverse kinematics", len(tips))
    for k, configuration in enumerate(each):
        if not configuration.solved:
            raise InputError(f"reference: at {k * period:.2f} s, {tips[k].round(4).tolist()} m: {configuration.outcome.message}")
        found.append(configuration)
    counts = np.ones(len(tips), dtype=bool) if counts is None else counts
    point = np.zeros(len(tips), dtype=int) if point is None else point
    return Reference(tips, np.array([at.forces for at in found]), [at.equilibrium for at in found], counts, point, period)


def approach(model: CompiledModel, target: np.ndarray, seconds: float, period: float = PERIOD) -> np.ndarray:
    """Tips from where the robot rests without forces to a target, smoothly, (periods, 3) in m.

    Args:
        model: the controller's.
        target: (3,) in m in G.
        seconds: duration of the way in s.
        period: of control in s.
    """
    rest = solve_statics(model, np.zeros(model.layout.inputs)).tip
    part = minimum_jerk(np.arange(0.0, 1.0, period / seconds))[:, None]
    return rest + part * (target - rest)


def sample_tips(
    trajectory: Trajectory, start_up: float = START_UP, laps: float = 1.0, period: float = PERIOD
) -> tuple[np.ndarray, np.ndarray]:
    """Sample the tips along a trajectory, which speeds up to its timing and slows down from it smoothly.

    A closed trajectory is run through before it counts while it speeds up, and on while it slows down, so that what counts has the
    trajectory's own timing. An open one starts and ends at its ends and counts as a whole.

    Args:
        trajectory: path with its time.
        start_up: time in s in which the speed rises from rest and, at the end, falls to it.
        laps: how often a closed trajectory counts.
        period: of control in s.

    Returns:
        Tips (periods, 3) in m in G, and over which periods the error counts, (periods,) of bool.

    Raises:
        InputError: an open trajectory of one point.
    """
    time, positions = trajectory.time - trajectory.time[0], trajectory.positions
    if trajectory.closed:
        lap = 2 * time[-1] - time[-2] if len(time) > 1 else 1.0
        curve = CubicSpline(np.append(time, lap), np.vstack([positions, positions[:1]]), bc_type="periodic")
        clock = np.arange(0.0, laps * lap + 2 * start_up + period / 2, period)
        down = np.maximum(clock - start_up - laps * lap, 0.0)
        passed = _spun_up(clock, start_up) - _spun_up(down, start_up)
        tips = curve(np.mod(passed, lap))
        return tips, (clock >= start_up) & (clock < start_up + laps * lap - period / 2)
    if len(time) < 2:
        raise InputError("trajectory: 1 point is no path; valid: at least 2, or point by point")
    curve = CubicSpline(time, positions)
    start_up = min(start_up, time[-1] / 2)
    clock = np.arange(0.0, time[-1] + start_up + period / 2, period)
    left = clock[-1] - clock
    passed = np.where(clock < clock[-1] / 2, _spun_up(clock, start_up), time[-1] - _spun_up(left, start_up))
    return curve(np.clip(passed, 0.0, time[-1])), np.ones(len(clock), dtype=bool)


def point_by_point(targets: np.ndarray, move: float, stay: float, taken: float, period: float = PERIOD) -> tuple[np.ndarray, ...]:
    """Tips that go from each target to the next and stay there, as in Fig. 12.

    Args:
        targets: (targets, 3) in m in G.
        move: time in s of the way to a target.
        stay: time in s for a target, with the way to it.
        taken: time in s at the end of a stay over which the error counts.
        period: of control in s.

    Returns:
        Tips (periods, 3) in m, whether they count (periods,) of bool, and the number of the target.
    """
    each = round(stay / period)
    inside = period * np.arange(each)
    parts, before = minimum_jerk(inside / move)[:, None], targets[0]
    tips = []
    for target in targets:
        tips.append(before + parts * (target - before))
        before = target
    count = len(targets)
    return np.vstack(tips), np.tile(inside >= stay - taken - period / 2, count), np.repeat(np.arange(count), each)


def _spun_up(clock: np.ndarray, start_up: float) -> np.ndarray:
    """Time along a path whose speed rises smoothly from 0 to 1 within `start_up` s: there t³ − t⁴/2 of it, so half of it at its end."""
    part = np.clip(clock / start_up, 0.0, 1.0)
    return start_up * (part**3 - part**4 / 2) + np.maximum(clock - start_up, 0.0)
