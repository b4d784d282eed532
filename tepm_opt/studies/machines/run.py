"""A controller on many random machines: what it reaches where nobody tuned it, as mean, worst and share within a bound."""

from __future__ import annotations

import math
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.files import output_folder
from tepm_opt.data.frames import Tabular
from tepm_opt.data.tables import write_columns
from tepm_opt.errors import InputError
from tepm_opt.jobs.clearance import smallest
from tepm_opt.jobs.closed_loop import LoopSetup
from tepm_opt.jobs.course import Course, whole_reference
from tepm_opt.jobs.executors import sweep
from tepm_opt.jobs.mpc import run_closed_loop
from tepm_opt.jobs.output import save_summary
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tepm_opt.models.robot import builtin_robots
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.kinematics.ik import IkSettings
from tepm_opt.solvers.planning.trajectories import Trajectory

TABLE = "machines.csv"
BOUND = 3e-3  # m
IK_DEFAULT = IkSettings()


@dataclass(frozen=True)
class Family:
    """Machines around a robot file, see `hw.simulation.family`.

    Attributes:
        machines: how many.
        noises: how often each is driven, every time with another noise of its tracker and gauges.
        seed: of all.
    """

    machines: int = 30
    noises: int = 2
    seed: int = 0

    def __post_init__(self) -> None:
        if self.machines < 1 or self.noises < 1 or self.seed < 0:
            raise InputError(f"machines: {self}; valid: at least one machine and one noise, a seed from 0")


@dataclass(frozen=True)
class Drive:
    """Result of one machine with one noise.

    Attributes:
        machine: its number, and `noise`, that of the run.
        rms_m: root mean square of the true tip's error where it counts, in m.
        largest_m: its largest value in m.
        fallbacks: steps that went on with something older.
        end: how it ended, "done" where the reference was followed to its end.
        distance_m: true least distance of the arm to obstacles in m; infinite where there are none.
    """

    machine: int
    noise: int
    rms_m: float
    largest_m: float
    fallbacks: int
    end: str
    distance_m: float = math.inf


@dataclass(frozen=True, eq=False)
class MachinesRun(Tabular):
    """A controller on random machines.

    Attributes:
        setup: what ran.
        family: on which machines.
        bound: error in m within which a run counts as good.
        drives: what was done, by machine and noise.
        interrupted: whether the user ended it before all were done.
    """

    setup: LoopSetup
    family: Family
    bound: float
    drives: tuple[Drive, ...]
    interrupted: bool = False

    @property
    def outcome(self) -> Outcome:
        """Solved where every machine followed the reference to its end."""
        asked = self.family.machines * self.family.noises
        if self.interrupted:
            return Outcome(Ending.INTERRUPTED, f"{len(self.drives)} of {asked} runs are done")
        if early := [drive for drive in self.drives if drive.end != Ending.DONE.value]:
            return Outcome(
                Ending.FAILED, f"{len(early)} of {asked} runs ended early, the first on machine {early[0].machine}: {early[0].end}"
            )
        return Outcome()

    @property
    def ok(self) -> bool:
        """Whether every machine followed the reference to its end."""
        return self.outcome.solved

    @property
    def errors(self) -> np.ndarray:
        """Root mean square of the tip's error, (runs,) in m; infinite where a run ended early."""
        return np.array([drive.rms_m if drive.end == Ending.DONE.value else np.inf for drive in self.drives])

    def summary(self) -> dict[str, Any]:
        """Mean, worst and share within the bound, with what makes the machines again."""
        errors = self.errors
        known = len(errors) > 0
        worst = self.drives[int(np.argmax(errors))] if known else None
        return {
            "controller": self.setup.controller,
            "settings": self.setup.chosen.asked,
            "family": asdict(self.family),
            "end": self.outcome.ending.value,
            "message": self.outcome.message,
            "interrupted": self.interrupted,
            "runs": len(errors),
            "ended_early": int(np.isinf(errors).sum()),
            "mean_m": _finite(errors.mean()) if known else None,
            "median_m": _finite(np.median(errors)) if known else None,
            "worst_m": _finite(errors.max()) if known else None,
            "worst_machine": worst.machine if worst else None,
            "bound_m": self.bound,
            "smallest_distance_m": self._distances(),
            "share_within": float((errors <= self.bound).mean()) if known else None,
            "fallbacks": sum(drive.fallbacks for drive in self.drives),
        }

    def _distances(self) -> dict[str, float] | None:
        """Mean and worst of the least distances to obstacles in m; None where there are none."""
        each = np.array([drive.distance_m for drive in self.drives])
        return {"mean": float(each.mean()), "worst": float(each.min())} if len(each) and np.isfinite(each).all() else None

    def columns(self) -> dict[str, np.ndarray]:
        """The fields of `Drive`, a row a run; no distances where there are no obstacles."""
        columns = {f.name: np.array([getattr(drive, f.name) for drive in self.drives]) for f in fields(Drive)}
        return {name: values for name, values in columns.items() if name != "distance_m" or self._distances()}

    def save(self, folder: str | Path) -> None:
        """Write machines.csv, a row a run, and summary.json.

        Raises:
            InputError: the folder cannot be written to.
        """
        folder = output_folder(folder)
        write_columns(folder / TABLE, self.columns())
        save_summary(folder, "machines", self.summary())

    def __repr__(self) -> str:
        return f"MachinesRun({self.outcome}, {self.setup.kind.title}, {len(self.drives)} runs on {self.family})"


@dataclass(frozen=True)
class DriveTask:
    """A trajectory to be followed on random machines, described so that other processes can do it.

    Attributes:
        model: the controller's; the machines are around its robot file.
        trajectory: targets.
        course: how it is driven.
        setup: which controller.
        family: which machines.
        kinematics: settings of the inverse kinematics.
    """

    model: Model
    trajectory: Trajectory
    course: Course
    setup: LoopSetup
    family: Family
    kinematics: IkSettings = IK_DEFAULT


def drive_machine(task: DriveTask, number: int) -> list[Drive]:
    """Drive a machine, by its number from 0, once with each of its noises."""
    from tepm_opt.hw.simulation.family import random_machine
    from tepm_opt.hw.simulation.rig import SimulatedRig

    found, file = [], random_machine(task.model.source, task.family.seed, number)
    model = compile_model(task.model)
    reference = whole_reference(model, task.trajectory, task.course, task.kinematics)
    for noise in range(1, task.family.noises + 1):
        rig = SimulatedRig(file)
        rig.reseed(noise)
        loop = run_closed_loop(model, reference, rig, task.setup)
        if loop.outcome.ending is Ending.INTERRUPTED:
            raise KeyboardInterrupt
        error = np.linalg.norm(loop.errors(true=True)[loop.counted], axis=1)
        largest = float(error.max()) if len(error) else np.nan
        late = sum(loop.fallbacks.values())
        end = loop.outcome.ending.value
        found.append(Drive(number, noise, loop.rms(true=True), largest, late, end, smallest(loop.steps)))
    return found


def run_machines(task: DriveTask, bound: float = BOUND, executor: Executor | None = None, progress: Progress = silent) -> MachinesRun:
    """Drive random machines along a trajectory with a controller that knows the robot file alone.

    Args:
        task: controller, trajectory and machines.
        bound: error in m within which a run counts as good.
        executor: where machines run; processes of this machine where None. It has to import this package, and is left open.
        progress: told how many machines are done.

    Raises:
        InputError: a robot without a file, a target out of reach.
    """
    source, family = task.model.source, task.family
    if source not in builtin_robots() and not Path(source).is_file():
        raise InputError(f"machines: robot {source!r} has no file to draw machines around; valid: a built-in robot or a robot file")
    numbers = range(family.machines)
    drives, interrupted = sweep(partial(drive_machine, task), numbers, executor, stage="machines", progress=progress)
    return MachinesRun(task.setup, family, bound, tuple(drive for each in drives for drive in each), interrupted)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
