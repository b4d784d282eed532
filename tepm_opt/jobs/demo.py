"""The main job: the paper's circle, set points for every actuator, G at every point, closed loops on the simulated rig."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tepm_opt.control.controllers import DEFAULT, find_controller
from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.rigfile import RigFile, load_rig_file
from tepm_opt.hw.simulation.scaling import scale_rig
from tepm_opt.jobs.closed_loop import ClosedLoop, LoopSetup
from tepm_opt.jobs.compare import LoopTask, compare
from tepm_opt.jobs.course import Course
from tepm_opt.jobs.gain import GainRun, run_gain
from tepm_opt.jobs.ik import IkRun, run_ik
from tepm_opt.jobs.output import save_summary
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.planning.scaled_paths import path_for
from tepm_opt.solvers.planning.trajectories import Trajectory

CONTROLLERS = (DEFAULT, "mode2", "mode1")  # the one that takes longest first
NAMES = {name: find_controller(name).title for name in reversed(CONTROLLERS)}
COURSE = Course()
SEED = 1


@dataclass(frozen=True, eq=False)
class DemoRun:
    """The main job on a trajectory; what comes after an interruption is absent.

    Attributes:
        pressure: inverse kinematics with pressure alone.
        hybrid: with pressure and tension.
        gains: along the hybrid set points.
        loops: closed loops on the simulated rig by what they are called; none where there are none.
        note: why there are none.
        interrupted: whether the user ended it early.
    """

    pressure: IkRun
    hybrid: IkRun | None = None
    gains: GainRun | None = None
    loops: dict[str, ClosedLoop] = field(default_factory=dict)
    note: str = ""
    interrupted: bool = False

    def __repr__(self) -> str:
        return f"<DemoRun {self.outcome}; {self.pressure.asked} points of {self.pressure.model.robot.name}, {len(self.loops)} closed loops>"

    @property
    def outcome(self) -> Outcome:
        """Outcome: solved where all points are, and all loops came to their end."""
        if self.interrupted:
            return Outcome(Ending.INTERRUPTED, "by the user")
        if not (self.hybrid and self.gains and self.hybrid.ok and self.gains.ok):
            return Outcome(Ending.FAILED, "not all points are solved")
        if not self.loops or not all(loop.ok for loop in self.loops.values()):
            return Outcome(Ending.FAILED, self.note or "a closed loop ended early")
        return Outcome()

    @property
    def ok(self) -> bool:
        """Whether all of it was solved."""
        return self.outcome.solved

    def summary(self) -> dict[str, Any]:
        """Numbers of all parts."""
        return {
            "interrupted": self.interrupted,
            "ik": self.hybrid and self.hybrid.summary(),
            "ik_pressure": self.pressure.summary(),
            "gain": self.gains and self.gains.summary(),
            "closed_loop": self._loops(),
        }

    def _loops(self) -> dict[str, Any]:
        return {name: loop.summary(timing=False) for name, loop in self.loops.items()}

    def save(self, folder: str | Path) -> None:
        """Write the files of inverse kinematics and gain, and summary.json.

        Raises:
            InputError: the folder cannot be written to.
        """
        if self.hybrid is not None:
            self.hybrid.save(folder)
        if self.gains is not None:
            self.gains.save(folder)
            save_summary(Path(folder), "closed_loop", self._loops())


def run_demo(model: CompiledModel, trajectory: Trajectory | None = None, progress: Progress = silent) -> DemoRun:
    """Do the main job: set points for every actuator, G at every point, closed loops.

    Args:
        model: compiled model.
        trajectory: targets; the paper's circle in the robot's size where absent.
        progress: told of every point, and of the time of the closed loops.
    """
    path = path_for(model, "circle") if trajectory is None else trajectory
    pressure = run_ik(model, path, ActuationMode.PRESSURE, progress=progress)
    if pressure.interrupted:
        return DemoRun(pressure, interrupted=True)
    hybrid = run_ik(model, path, ActuationMode.HYBRID, progress=progress)
    if hybrid.interrupted:
        return DemoRun(pressure, hybrid, interrupted=True)
    try:
        gains = run_gain(model, hybrid.setpoints(), with_map=model.is_c, progress=progress)  # a map takes minutes without a compiler
    except KeyboardInterrupt:
        return DemoRun(pressure, hybrid, interrupted=True)
    if gains.statics.interrupted:
        return DemoRun(pressure, hybrid, gains, interrupted=True)
    if not hybrid.ok:
        return DemoRun(pressure, hybrid, gains, note="not all points of the circle were solved")
    try:
        return DemoRun(pressure, hybrid, gains, closed_loops(model, path, progress))
    except (InputError, RuntimeError) as error:
        return DemoRun(pressure, hybrid, gains, note=" ".join(str(error).split()))
    except KeyboardInterrupt:
        return DemoRun(pressure, hybrid, gains, interrupted=True)


def closed_loops(model: CompiledModel, trajectory: Trajectory, progress: Progress = silent) -> dict[str, ClosedLoop]:
    """Closed loops of all controllers on the simulated rig, by what they are called.

    Args:
        model: the controllers'.
        trajectory: targets.
        progress: told of every controller how many s are done.

    Raises:
        InputError: the loops do not fit the robot.
        RuntimeError: the simulated rig failed.
        KeyboardInterrupt: one was interrupted.
    """
    tasks = [LoopTask(model.model, trajectory, COURSE, rig_of(model), LoopSetup(controller, seed=SEED)) for controller in CONTROLLERS]

    def report_stage(stage: str, done: float, of: float) -> None:
        progress(f"closed loop, {NAMES[stage]}", done, of)

    found = {loop.setup.controller: loop for loop in compare(tasks, os.cpu_count() or 1, report_stage)}
    return {NAMES[name]: found[name] for name in NAMES if name in found}


def rig_of(model: CompiledModel) -> RigFile:
    """The virtual prototype, scaled to the model's robot."""
    return scale_rig(load_rig_file(), model.robot)
