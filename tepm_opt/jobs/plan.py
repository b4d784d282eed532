"""Motions from rest to rest: the fastest or gentlest one, as set points for rigs and a reference for controllers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.control.collision.model import tell_rest
from tepm_opt.data.files import output_folder
from tepm_opt.data.frames import Tabular
from tepm_opt.data.setpoints import input_columns, point_columns, write_setpoints
from tepm_opt.data.tables import write_table
from tepm_opt.jobs.output import save_summary
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Outcome
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.planning.objective import Objective
from tepm_opt.solvers.planning.plan import PlanSettings, plan_move, plan_path
from tepm_opt.solvers.planning.program import Obstacle, distance
from tepm_opt.solvers.planning.result import MotionPlan
from tepm_opt.solvers.planning.trajectories import Trajectory

INPUTS, REFERENCE = "inputs.csv", "reference.csv"
DEFAULT = PlanSettings()


@dataclass(frozen=True, eq=False)
class PlanRun(Tabular):
    """A plan and the obstacles it keeps clear of.

    Attributes:
        plan: the motion; without rows where there is none.
        obstacles: that no reference point may enter.
    """

    plan: MotionPlan
    obstacles: tuple[Obstacle, ...] = ()

    def __repr__(self) -> str:
        return f"<PlanRun {self.outcome}; {self.plan.duration:.3g} s of {self.plan.model.robot.name}>"

    @property
    def outcome(self) -> Outcome:
        """Outcome of the planning."""
        return self.plan.outcome

    @property
    def ok(self) -> bool:
        """Whether there is a plan."""
        return self.plan.solved

    def summary(self) -> dict[str, Any]:
        """Numbers of the plan."""
        return self.plan.summary()

    def columns(self) -> dict[str, np.ndarray]:
        """Time, inputs and reference points, a row each."""
        plan, layout = self.plan, self.plan.model.layout
        points = plan.points.reshape(len(plan.time), 3 * layout.points)
        columns = dict(zip(input_columns(layout.actuator_names), plan.setpoints.inputs.T, strict=True))
        return {"time_s": plan.time, **columns, **dict(zip(point_columns(layout.point_names), points.T, strict=True))}

    def save(self, folder: str | Path) -> None:
        """Write inputs.csv (set points), reference.csv (tip over time, for `read_trajectory`) and summary.json.

        Where there is no plan, set points and reference of an earlier one go.

        Raises:
            InputError: the folder cannot be written to.
        """
        folder, plan = output_folder(folder), self.plan
        if self.ok:
            write_setpoints(folder / INPUTS, plan.setpoints, plan.model.layout.actuator_names)
            write_table(folder / REFERENCE, ["time_s", "x_m", "y_m", "z_m"], np.column_stack([plan.time, plan.tips]))
        else:
            for name in (INPUTS, REFERENCE):
                (folder / name).unlink(missing_ok=True)
        save_summary(folder, "plan", self.summary())


def tell_rest_inside(model: CompiledModel, obstacles: Mapping[str, Obstacle]) -> str:
    """Sentence about a reference point of the arm without inputs that is in an obstacle; empty where none is.

    Args:
        model: compiled model.
        obstacles: by names for people.
    """
    rest = solve_statics(model, np.zeros(model.layout.inputs))
    if not rest.solved:
        return ""
    return tell_rest({name: min(float(distance(one)(point)) for point in rest.points) for name, one in obstacles.items()})


def run_plan(
    model: CompiledModel,
    way: Trajectory | tuple[Sequence[float], Sequence[float]],
    objective: Objective = Objective.TIME,
    duration: float | None = None,
    obstacles: Sequence[Obstacle] = (),
    settings: PlanSettings = DEFAULT,
    progress: Progress = silent,
) -> PlanRun:
    """Plan a motion from rest to rest under all limits.

    Args:
        model: compiled model.
        way: a path to keep to, or start and end of the tip in G, (3,) in m each, between which any way will do.
        objective: fastest, or least effort.
        duration: of the least effort in s.
        obstacles: that no reference point may enter.
        settings: limits and accuracy.
        progress: told what is being done.

    Raises:
        InputError: as for `plan_move` and `plan_path`.
    """
    if isinstance(way, Trajectory):
        found = plan_path(model, way, objective, duration, obstacles, settings, progress)
    else:
        found = plan_move(model, *way, objective, duration, obstacles, settings, progress)
    return PlanRun(found, tuple(obstacles))
