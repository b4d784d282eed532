"""Inverse kinematics of a trajectory: set points, checked by statics from the set points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.files import output_folder
from tepm_opt.data.frames import Tabular
from tepm_opt.data.setpoints import SetPoints, write_setpoints
from tepm_opt.errors import InputError
from tepm_opt.jobs.output import collect, endings, outcome_of, save_shapes, save_summary, shape_columns
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.progress import Progress, silent, track
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.ik import Configuration, IkSettings, each_configuration
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_statics
from tepm_opt.solvers.planning.trajectories import Trajectory

SAME = 1e-6  # m, tips closer than this belong to the same equilibrium
DEFAULT = IkSettings()


@dataclass(frozen=True, eq=False)
class IkRun(Tabular):
    """Inverse kinematics of a trajectory, checked by statics from the set points.

    Attributes:
        trajectory: targets solved (those before an interruption).
        mode: how axial forces are made.
        configurations: one a target.
        reached: equilibria under the exact set points.
        rounded: equilibria under the set points on the actuators' grids.
        asked: number of targets asked for.
        interrupted: whether the user ended it early.
    """

    model: CompiledModel
    trajectory: Trajectory
    mode: ActuationMode
    configurations: list[Configuration]
    reached: list[Equilibrium]
    rounded: list[Equilibrium]
    asked: int
    interrupted: bool

    def __repr__(self) -> str:
        return f"<IkRun {self.outcome}; {self.asked} points of {self.model.robot.name} in {self.mode.value} mode>"

    @property
    def outcome(self) -> Outcome:
        """Outcome: solved where every target is."""
        return outcome_of(sum(found.solved for found in self.configurations), self.asked, self.interrupted)

    @property
    def ok(self) -> bool:
        """Whether every target was solved."""
        return self.outcome.solved

    def errors(self, equilibria: Sequence[Equilibrium]) -> np.ndarray:
        """Distances of equilibria's tips from the targets in m, (points,)."""
        tips = np.array([at.tip for at in equilibria]).reshape(-1, 3)
        return np.linalg.norm(tips - self.trajectory.positions, axis=1)

    def setpoints(self, rounded: bool = False) -> SetPoints:
        """The set points; rows that failed (not those merely out of reach) are NaN."""
        rows = [c.allocation.rounded if rounded else c.allocation.inputs for c in self.configurations]
        good = [[c.outcome.ending is not Ending.FAILED] for c in self.configurations]
        force = np.array([c.equilibrium.loads[-1] for c in self.configurations])
        return SetPoints(self.trajectory.time, np.where(good, rows, np.nan), force)

    def summary(self) -> dict[str, Any]:
        """Numbers of the run."""
        solved = np.array([c.solved for c in self.configurations], dtype=bool)
        exact, rounded = self.errors(self.reached)[solved], self.errors(self.rounded)[solved]
        differences = [np.ptp(at.lengths, axis=0).max() for at, ok in zip(self.reached, solved, strict=True) if ok]
        return {
            "robot": self.model.robot.name,
            "mode": self.mode.value,
            "points": self.asked,
            "solved": int(solved.sum()),
            "interrupted": self.interrupted,
            "largest_tip_error_m": float(exact.max()) if solved.any() else None,
            "largest_length_difference_m": float(max(differences)) if solved.any() else None,
            "rounded_tip_error_rms_m": float(np.sqrt(np.mean(rounded**2))) if solved.any() else None,
            "largest_rounded_tip_error_m": float(rounded.max()) if solved.any() else None,
            "unsolved": [
                {"point": k, "status": c.outcome.ending.value, "miss_m": c.miss, "limits": list(c.limits), "message": c.outcome.message}
                for k, c in enumerate(self.configurations)
                if not c.solved
            ],
        }

    def columns(self) -> dict[str, np.ndarray]:
        """Targets, exact set points with points, lengths and the tip's error, and how it ended, a row a target."""
        targets = {f"target_{axis}_m": values for axis, values in zip("xyz", self.trajectory.positions.T, strict=True)}
        shapes = shape_columns(self.setpoints(), self.reached, self._good()) if self.configurations else {}
        endings_of = {"ending": endings(found.outcome for found in self.configurations)}
        return {**shapes, **targets, "tip_error_m": self.errors(self.reached), **endings_of}

    def _good(self) -> list[bool]:
        """Whether a row's shape is known."""
        return [at.solved and c.outcome.ending is not Ending.FAILED for at, c in zip(self.reached, self.configurations, strict=True)]

    def save(self, folder: str | Path) -> None:
        """Write inputs.csv, inputs_rounded.csv, shape.csv, lengths.csv and summary.json; nothing where no point was finished.

        Raises:
            InputError: the folder cannot be written to.
        """
        if not self.configurations:
            return
        folder, names = output_folder(folder), self.model.layout.actuator_names
        write_setpoints(folder / "inputs.csv", self.setpoints(), names)
        write_setpoints(folder / "inputs_rounded.csv", self.setpoints(rounded=True), names)
        save_shapes(folder, self.trajectory.time, self.reached, self._good())
        save_summary(folder, "ik", self.summary())


def run_ik(
    model: CompiledModel,
    trajectory: Trajectory,
    mode: ActuationMode = ActuationMode.HYBRID,
    tip_force: Sequence[float] | np.ndarray | None = None,
    mid_tension: float | None = None,
    settings: IkSettings = DEFAULT,
    progress: Progress = silent,
) -> IkRun:
    """Solve the inverse kinematics of a trajectory and re-solve statics from its set points, exact and rounded.

    Args:
        model: compiled model.
        trajectory: targets in G.
        mode: how axial forces are made.
        tip_force: known force on the tip in G, (3,) in N.
        mid_tension: tension that the hybrid mode stays about, N; the middle of the range where absent.
        settings: of the solver.
        progress: told of every point.

    Raises:
        InputError: tip force of a wrong shape or not finite; a tension outside its range.
    """
    highest = model.robot.actuation.tension_max_N
    if mid_tension is not None and not 0 <= mid_tension <= highest:
        raise InputError(f"mid-tension {mid_tension:g}; valid: 0 … {highest:g} N")
    asked = len(trajectory.time)
    found = each_configuration(model, trajectory.positions, mode, tip_force, mid_tension, settings)
    points, interrupted = collect(track(map(_check_equilibria, found), progress, f"inverse kinematics, {mode.value}", asked))
    count = len(points)
    part = Trajectory(trajectory.time[:count], trajectory.positions[:count], trajectory.closed and not interrupted)
    configurations, held, rounded = [p[0] for p in points], [p[1] for p in points], [p[2] for p in points]
    return IkRun(model, part, mode, configurations, held, rounded, asked, interrupted)


def _check_equilibria(found: Configuration) -> tuple[Configuration, Equilibrium, Equilibrium]:
    """A configuration with the equilibria under its exact set points, found from rest, and under its rounded ones, from there.

    From rest, because a network of few segments can have several equilibria under the same set points.
    """
    at, allocation = found.equilibrium, found.allocation
    held = solve_statics(at.model, allocation.inputs, at.loads)
    away = float(np.linalg.norm(held.tip - at.tip))
    if found.solved and not (held.solved and away < SAME):
        message = f"from rest the set points lead elsewhere, {1e3 * away:.2f} mm away: more than one equilibrium, {held.outcome.ending}"
        found = replace(found, outcome=Outcome(Ending.FAILED, message))
    return found, held, solve_statics(at.model, allocation.rounded, at.loads, held)
