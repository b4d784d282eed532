"""What a job computes and what it leaves in its folder: IK of a trajectory, G along set points, statics at set points.

A run is plain results with `rows` for its tables, a `summary` for people and programs, and `save`. Rows that could not be solved
stay empty in the tables; the summary says which and why.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tepm_opt.data.files import output_folder, write_atomically
from tepm_opt.data.setpoints import SetPoints, gain_columns, length_columns, point_columns, write_setpoints
from tepm_opt.data.tables import write_table
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.solvers.gain import Actuation, Gain, solve_gain
from tepm_opt.solvers.kinematics import ActuationMode, Configuration, each_configuration
from tepm_opt.solvers.statics import Equilibrium, solve_statics, without_inputs
from tepm_opt.solvers.trajectories import Trajectory

SAME = 1e-6  # m, tips closer than this belong to the same equilibrium
Item = TypeVar("Item")
Track = Callable[[Iterable[Item]], Iterable[Item]]


def collect(items: Iterable[Item]) -> tuple[list[Item], bool]:
    """All items, or those so far and True where the user interrupts (Ctrl-C)."""
    found: list[Item] = []
    try:
        for item in items:
            found.append(item)
    except KeyboardInterrupt:
        return found, True
    return found, False


def save_summary(folder: Path, job: str, summary: dict[str, Any]) -> None:
    """Put a job's summary under its name into the folder's summary.json, beside those of other jobs."""
    path = folder / "summary.json"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        content = {}
    content = content if isinstance(content, dict) else {}
    write_atomically(path, json.dumps({**content, job: summary}, indent=2) + "\n")


def _save_shapes(folder: Path, time: np.ndarray, equilibria: Sequence[Equilibrium], good: Sequence[bool]) -> None:
    layout = equilibria[0].model.layout
    points = np.array([e.points.ravel() if ok else np.full(e.points.size, np.nan) for e, ok in zip(equilibria, good, strict=True)])
    lengths = np.array([e.lengths.ravel() if ok else np.full(e.lengths.size, np.nan) for e, ok in zip(equilibria, good, strict=True)])
    write_table(folder / "shape.csv", ["time_s", *point_columns(layout.point_names)], np.column_stack([time, points]))
    write_table(folder / "lengths.csv", ["time_s", *length_columns(layout.actuator_names)], np.column_stack([time, lengths]))


def _mm(metres: Iterable[float]) -> list[float]:
    return [round(1e3 * float(value), 6) for value in metres]


@dataclass(frozen=True, eq=False)
class IkRun:
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

    @property
    def ok(self) -> bool:
        """Whether every target was solved."""
        return not self.interrupted and all(found.solved for found in self.configurations)

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
        good = [at.solved and c.outcome.ending is not Ending.FAILED for at, c in zip(self.reached, self.configurations, strict=True)]
        _save_shapes(folder, self.trajectory.time, self.reached, good)
        save_summary(folder, "ik", self.summary())


def run_ik(
    model: CompiledModel,
    trajectory: Trajectory,
    mode: ActuationMode = ActuationMode.HYBRID,
    tip_force: Sequence[float] | np.ndarray | None = None,
    mid_tension: float | None = None,
    track: Track[tuple[Configuration, Equilibrium, Equilibrium]] = iter,
) -> IkRun:
    """Solve the inverse kinematics of a trajectory and re-solve statics from its set points, exact and rounded.

    Args:
        model: compiled model.
        trajectory: targets in G.
        mode: how axial forces are made.
        tip_force: known force on the tip in G, (3,) in N.
        mid_tension: see `allocate`.
        track: wraps the points, for progress.

    Raises:
        InputError: tip force of a wrong shape or not finite.
    """
    found = each_configuration(model, trajectory.positions, mode, tip_force, mid_tension)
    points, interrupted = collect(track(map(_checked, found)))
    count, asked = len(points), len(trajectory.time)
    part = Trajectory(trajectory.time[:count], trajectory.positions[:count], trajectory.closed and not interrupted)
    configurations, held, rounded = [p[0] for p in points], [p[1] for p in points], [p[2] for p in points]
    return IkRun(model, part, mode, configurations, held, rounded, asked, interrupted)


def _checked(found: Configuration) -> tuple[Configuration, Equilibrium, Equilibrium]:
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


@dataclass(frozen=True, eq=False)
class StaticsRun:
    """Equilibria under set points, in the order of their rows."""

    model: CompiledModel
    setpoints: SetPoints
    equilibria: list[Equilibrium]
    interrupted: bool

    @property
    def ok(self) -> bool:
        """Whether every row was solved."""
        return not self.interrupted and all(at.solved for at in self.equilibria)

    def summary(self) -> dict[str, Any]:
        """Numbers of the run."""
        return {
            "robot": self.model.robot.name,
            "points": len(self.setpoints.time),
            "solved": sum(at.solved for at in self.equilibria),
            "interrupted": self.interrupted,
            "tip_m": [at.tip.tolist() if at.solved else None for at in self.equilibria],
            "smallest_stiffness_eigenvalue_N_per_m": [at.smallest_eigenvalue if at.solved else None for at in self.equilibria],
            "unsolved": _unsolved(self.equilibria),
        }

    def save(self, folder: str | Path) -> None:
        """Write shape.csv, lengths.csv and summary.json.

        Raises:
            InputError: the folder cannot be written to.
        """
        if not self.equilibria:
            return
        folder = output_folder(folder)
        _save_shapes(folder, self.setpoints.time[: len(self.equilibria)], self.equilibria, [at.solved for at in self.equilibria])
        save_summary(folder, "statics", self.summary())


def _unsolved(equilibria: Sequence[Equilibrium]) -> list[dict[str, Any]]:
    return [
        {"point": k, "status": at.outcome.ending.value, "reached": at.reached, "message": at.outcome.message}
        for k, at in enumerate(equilibria)
        if not at.solved
    ]


def _equilibria(model: CompiledModel, setpoints: SetPoints) -> Iterator[Equilibrium]:
    """Equilibria along set points, each started from the last one solved."""
    last = None
    for inputs, force in zip(setpoints.inputs, setpoints.tip_force, strict=True):
        empty = not np.isfinite(inputs).all()
        found = without_inputs(model, inputs, model.check_loads(force)) if empty else solve_statics(model, inputs, force, last)
        last = found if found.solved else last
        yield found


def run_statics(model: CompiledModel, setpoints: SetPoints, track: Track[Equilibrium] = iter) -> StaticsRun:
    """Equilibrium at every row of set points; `track` wraps them, for progress.

    Raises:
        InputError: inputs outside the robot's limits.
    """
    equilibria, interrupted = collect(track(_equilibria(model, setpoints)))
    return StaticsRun(model, setpoints, equilibria, interrupted)


def _measures(gain: Gain, kind: Actuation) -> dict[str, Any]:
    """Singular values in mm, condition (null where a direction cannot be driven) and manipulability of one actuation."""
    condition = gain.condition(kind)
    return {
        "singular_values_mm": _mm(gain.singular_values(kind)),
        "condition": condition if np.isfinite(condition) else None,
        "manipulability_m3": gain.manipulability(kind),
    }


@dataclass(frozen=True, eq=False)
class GainRun:
    """G of a reference point under set points.

    Attributes:
        statics: the operating points.
        gains: one a row; None where the operating point is not stable.
    """

    statics: StaticsRun
    gains: list[Gain | None]

    @property
    def ok(self) -> bool:
        """Whether G was found at every row."""
        return self.statics.ok and all(gain is not None for gain in self.gains)

    def summary(self) -> dict[str, Any]:
        """Numbers of the run: per row the singular values in mm, condition and manipulability in m³, of each actuation."""
        kinds: tuple[Actuation, ...] = ("both", "pressure", "tension")
        rows = [gain and {kind: _measures(gain, kind) for kind in kinds} for gain in self.gains]
        summary = self.statics.summary()
        names = ("robot", "points", "solved", "interrupted", "unsolved")
        point = next((gain.point for gain in self.gains if gain), -1)
        label = self.statics.model.layout.point_names[point]
        return {**{name: summary[name] for name in names}, "reference_point": label, "normalised": rows}

    def save(self, folder: str | Path) -> None:
        """Write gain.csv (G in SI, row by row, one line an operating point) and summary.json.

        Raises:
            InputError: the folder cannot be written to.
        """
        if not self.gains:
            return
        folder, inputs = output_folder(folder), self.statics.model.layout.inputs
        empty = np.full(3 * inputs, np.nan)
        rows = np.array([empty if gain is None else gain.matrix.ravel() for gain in self.gains])
        write_table(folder / "gain.csv", gain_columns(inputs), rows)
        save_summary(folder, "gain", self.summary())


def run_gain(model: CompiledModel, setpoints: SetPoints, point: int = -1, track: Track[Equilibrium] = iter) -> GainRun:
    """G of a reference point (the tip where absent) at every row of set points.

    Raises:
        InputError: inputs outside the robot's limits.
    """
    statics = run_statics(model, setpoints, track)
    return GainRun(statics, [solve_gain(at, point) if at.solved else None for at in statics.equilibria])
