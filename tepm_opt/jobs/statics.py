"""Statics at set points: shape, actuator lengths, stability."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.files import output_folder
from tepm_opt.data.frames import Tabular
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.jobs.output import collect, endings, outcome_of, save_shapes, save_summary, shape_columns
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Outcome
from tepm_opt.progress import Progress, silent, track
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_statics, without_inputs


@dataclass(frozen=True, eq=False)
class StaticsRun(Tabular):
    """Equilibria under set points.

    Attributes:
        model: compiled model.
        setpoints: what was asked for.
        equilibria: one a row, in their order; fewer where it was interrupted.
        interrupted: whether the user ended it early.
    """

    model: CompiledModel
    setpoints: SetPoints
    equilibria: list[Equilibrium]
    interrupted: bool

    def __repr__(self) -> str:
        return f"<StaticsRun {self.outcome}; {len(self.setpoints.time)} rows of {self.model.robot.name}>"

    @property
    def outcome(self) -> Outcome:
        """Outcome: solved where every row is."""
        return outcome_of(sum(at.solved for at in self.equilibria), len(self.setpoints.time), self.interrupted)

    @property
    def ok(self) -> bool:
        """Whether every row was solved."""
        return self.outcome.solved

    def summary(self) -> dict[str, Any]:
        """Numbers of the run."""
        return {
            "robot": self.model.robot.name,
            "points": len(self.setpoints.time),
            "solved": sum(at.solved for at in self.equilibria),
            "interrupted": self.interrupted,
            "tip_m": [at.tip.tolist() if at.solved else None for at in self.equilibria],
            "tip_tilt_deg": [float(np.degrees(at.tip_tilt)) if at.solved else None for at in self.equilibria],
            "smallest_stiffness_eigenvalue_N_per_m": [at.smallest_eigenvalue if at.solved else None for at in self.equilibria],
            "unsolved": _list_unsolved(self.equilibria),
        }

    def columns(self) -> dict[str, np.ndarray]:
        """Set points, points, lengths and how it ended, a row each."""
        shapes = shape_columns(self.setpoints, self.equilibria, [at.solved for at in self.equilibria])
        return shapes | {"ending": endings(at.outcome for at in self.equilibria)}

    def save(self, folder: str | Path) -> None:
        """Write shape.csv, lengths.csv and summary.json.

        Raises:
            InputError: the folder cannot be written to.
        """
        if not self.equilibria:
            return
        folder = output_folder(folder)
        save_shapes(folder, self.setpoints.time[: len(self.equilibria)], self.equilibria, [at.solved for at in self.equilibria])
        save_summary(folder, "statics", self.summary())


def _list_unsolved(equilibria: Sequence[Equilibrium]) -> list[dict[str, Any]]:
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


def run_statics(model: CompiledModel, setpoints: SetPoints, progress: Progress = silent) -> StaticsRun:
    """Solve the equilibrium at every row of set points.

    Args:
        model: compiled model.
        setpoints: inputs and tip force of every row.
        progress: told of every row.

    Raises:
        InputError: inputs outside the robot's limits.
    """
    count = len(setpoints.time)
    equilibria, interrupted = collect(track(_equilibria(model, setpoints), progress, "statics", count))
    return StaticsRun(model, setpoints, equilibria, interrupted)
