"""A path driven again and again, each time corrected by what was missed before."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.control.references.iterative_learning import DEFAULT, Learner, LearningSettings
from tepm_opt.control.references.reference import Reference, reference_of
from tepm_opt.data.files import output_folder
from tepm_opt.data.tables import read_table, write_table
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Rig
from tepm_opt.jobs.closed_loop import ClosedLoop, LoopSetup
from tepm_opt.jobs.mpc import Observer, run_closed_loop
from tepm_opt.jobs.output import save_summary
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Outcome
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.kinematics.ik import IkSettings

LEARNED = "learned.csv"
COLUMNS = ("time_s", "x_m", "y_m", "z_m")
PARTS = (1.0, 0.5, 0.25)  # of a correction, of which the first is taken whose targets can be reached
IK_DEFAULT = IkSettings()


@dataclass(frozen=True, eq=False)
class RoundsRun:
    """A path driven some times.

    Attributes:
        asked: how many rounds.
        loops: what was done, a closed loop a round.
        correction: what was learned, to add to the path, (periods, 3) in m, and `period`, s.
    """

    asked: int
    loops: tuple[ClosedLoop, ...]
    correction: np.ndarray
    period: float

    def __repr__(self) -> str:
        told = ", ".join(f"{1e3 * loop.rms(self.knows_truth):.2f}" for loop in self.loops)
        return f"RoundsRun({self.outcome}, {len(self.loops)} of {self.asked} rounds: [{told}] mm)"

    @property
    def outcome(self) -> Outcome:
        """Outcome of the last round."""
        return self.loops[-1].outcome

    @property
    def ok(self) -> bool:
        """Whether all rounds came to their end."""
        return len(self.loops) == self.asked and self.outcome.solved

    @property
    def knows_truth(self) -> bool:
        """Whether errors are those of the true tip, which simulated rigs know."""
        return bool(np.isfinite(self.loops[0].truth).any())

    def summary(self) -> dict[str, Any]:
        """Errors of all rounds, and how far targets are corrected."""
        last = self.loops[-1]
        return {
            "controller": last.setup.controller,
            "rig": last.setup.rig,
            "robot": last.model.robot.name,
            "seed": last.setup.seed,
            "asked": self.asked,
            "end": self.outcome.ending.value,
            "message": self.outcome.message,
            "rounds": [
                {"true_rms_m": _finite(loop.rms(True)), "tracked_rms_m": _finite(loop.rms(False)), "doubts": len(loop.doubts)}
                for loop in self.loops
            ],
            "largest_correction_m": float(np.linalg.norm(self.correction, axis=1).max()),
        }

    def save(self, folder: str | Path) -> None:
        """Write learned.csv, for `read_correction`, where something was learned, and summary.json.

        Raises:
            InputError: the folder cannot be written to.
        """
        folder = output_folder(folder)
        if self.correction.any():
            time = self.period * np.arange(len(self.correction))
            write_table(folder / LEARNED, COLUMNS, np.column_stack([np.round(time, 6), self.correction]))
        save_summary(folder, "rounds", self.summary())


def read_correction(path: str | Path) -> np.ndarray:
    """Read the learned correction of a path, (periods, 3) in m.

    Raises:
        InputError: no such file, a column that is missing, a value that is no number, a time that does not increase.
    """
    table = read_table(path)
    table.read_increasing(COLUMNS[0])
    return np.column_stack([table.column(name) for name in COLUMNS[1:]])


@dataclass(frozen=True, eq=False)
class RoundsTask:
    """A path to be driven some times, and learned.

    Attributes:
        reference: the path, see `whole_reference`.
        setup: names what runs.
        rounds: how many.
        learned: what is known of this path from before, (periods, 3) in m.
        kinematics: settings of the inverse kinematics.
        settings: how it learns.
    """

    reference: Reference
    setup: LoopSetup
    rounds: int
    learned: np.ndarray | None = None
    kinematics: IkSettings = IK_DEFAULT
    settings: LearningSettings = DEFAULT


def run_rounds(
    model: CompiledModel, task: RoundsTask, rig: Callable[[int], Rig], folder: str | Path | None = None, progress: Progress = silent,
    observer: Observer | None = None,
) -> RoundsRun:  # fmt: skip
    """Drive a path some times, and learn; a round that ends early is the last one. What was learned is written after every round.

    Args:
        model: the controller's.
        task: path, controller and rounds.
        rig: opens the rig of a round, by its number from 0.
        folder: for the results, with a folder round_1, round_2 … for each; None writes nothing.
        progress: told the stage and how much of it is done.
        observer: given every sample with what was commanded then and the tip's target.

    Raises:
        InputError: see `run_closed_loop`; `learned` is of another path.
        RuntimeError, OSError: the rig failed before the loop was closed.
    """
    reference, rounds = task.reference, task.rounds
    if rounds < 1:
        raise InputError(f"rounds: {rounds}; valid: from 1")
    learner, loops = Learner(reference.path, reference.period, task.settings, task.learned), list[ClosedLoop]()
    for number in range(rounds):
        target = _correct_reference(model, reference, learner, task.kinematics, progress)
        place = None if folder is None else Path(folder) / f"round_{number + 1}"
        loop = run_closed_loop(model, target, rig(number), task.setup, place, progress=progress, observer=observer)
        loops.append(loop)
        if loop.ok:
            learner.learn(np.round(loop.time / reference.period).astype(int), loop.points[:, -1], loop.counted)
        if folder is not None:
            RoundsRun(rounds, tuple(loops), learner.correction, reference.period).save(folder)
        if not loop.ok:
            break
    return RoundsRun(rounds, tuple(loops), learner.correction, reference.period)


def _correct_reference(
    model: CompiledModel, reference: Reference, learner: Learner, kinematics: IkSettings, progress: Progress
) -> Reference:
    """Correct the reference by as much of what was learned as the robot can reach; errors are still measured from the path.

    Args:
        model: the controller's.
        reference: without corrections.
        learner: with what was learned, of which it is told what can be reached.
        kinematics: settings of the inverse kinematics.
        progress: told how many periods are done.
    """
    if not learner.correction.any():
        return reference
    for part in PARTS:
        tips = reference.path + part * learner.correction
        try:
            found = reference_of(model, tips, reference.counted, reference.point, reference.period, kinematics, progress)
        except InputError:
            continue
        learner.correction = part * learner.correction
        return replace(found, wanted=reference.path)
    learner.correction = np.zeros_like(reference.path)
    return reference


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
