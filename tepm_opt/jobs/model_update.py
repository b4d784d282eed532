"""Update of a model: record, find the effects it lacks, record further runs where that is not clear, steer with the corrected model."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tepm_opt.data.documents import read_text
from tepm_opt.data.files import output_folder
from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.errors import InputError
from tepm_opt.jobs.closed_loop import LoopSetup
from tepm_opt.jobs.course import Course, whole_reference
from tepm_opt.jobs.discrepancy import MODEL, VERDICT, DiscrepancyOptions, run_discrepancy
from tepm_opt.jobs.excite import standard
from tepm_opt.jobs.mpc import run_closed_loop
from tepm_opt.jobs.next_run import NextRunOptions, run_next
from tepm_opt.jobs.output import save_summary
from tepm_opt.jobs.record import Ask, RigSource, record
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model, read_model, write_model
from tepm_opt.progress import Progress, silent
from tepm_opt.recording.plan import RecordingPlan, read_plan
from tepm_opt.solvers.planning.trajectories import Trajectory

JOB, DATA, FOUND, NEXT, SUMMARY = "close", "data", "found", "next", "summary.json"
KNOWN = "known.toml"
BEFORE, AFTER = "nominal", "corrected"
FURTHER = 2
"""Further runs at most that are asked for where effects cannot be told apart."""


@dataclass(frozen=True, eq=False)
class UpdateTask:
    """Model to update and paths to follow with it before and after.

    Attributes:
        model: what is known of the robot.
        paths: to be followed with the predictive controller, by name.
        plan: to be recorded; the standard one where absent.
        seed: of all random draws.
        further: runs at most that are asked for where effects cannot be told apart.
    """

    model: Model
    paths: Mapping[str, Trajectory]
    plan: RecordingPlan | None = None
    seed: int = 0
    further: int = FURTHER


@dataclass(frozen=True, eq=False)
class ModelUpdate:
    """Result of an update of the model: verdicts, and tracking errors before and after.

    Attributes:
        folder: with everything: `data`, `next_1` …, `found_0` …, a folder for each path and model.
        robot, rig: what it was done with.
        verdicts: verdict.json of every round.
        steering: summaries of the closed loops by path, "nominal" and "corrected".
    """

    folder: Path
    robot: str
    rig: str
    verdicts: tuple[Mapping[str, Any], ...]
    steering: Mapping[str, Mapping[str, Mapping[str, Any]]]

    def __repr__(self) -> str:
        return f"ModelUpdate({self.robot} on {self.rig}: {self.verdicts[-1]['status']}, {len(self.verdicts)} verdicts)"

    @property
    def ok(self) -> bool:
        """Whether something was named, or nothing is missing."""
        return self.verdicts[-1]["status"] in (VerdictStatus.NAMED.value, VerdictStatus.NO_DISCREPANCY.value)

    def error(self, path: str, model: str) -> float | None:
        """The tip's error in m rms, true where the rig knows it, else tracked; None where nothing that counts was seen."""
        errors = self.steering[path][model]["errors"]
        found = errors["true"] or errors["tracked"]
        return found["rms_m"] if found else None

    def summary(self) -> dict[str, Any]:
        """Numbers, plain data."""
        last = self.verdicts[-1]
        return {
            "robot": self.robot,
            "rig": self.rig,
            "status": [verdict["status"] for verdict in self.verdicts],
            "effects": [{key: effect[key] for key in ("name", "detail", "probability")} for effect in last["effects"]],
            "rmse_m": last["rmse_m"],
            "tip_error_m": {path: {model: self.error(path, model) for model in models} for path, models in self.steering.items()},
        }

    def save(self) -> None:
        """Write `summary.json`.

        Raises:
            InputError: the folder cannot be written to.
        """
        save_summary(self.folder, JOB, self.summary())


def run_model_update(
    task: UpdateTask, rig: RigSource, out: str | Path, progress: Progress = silent, ask: Ask = lambda request: None
) -> ModelUpdate:
    """Record the standard plan, explain the data, ask for further runs, and follow paths with the model before and after.

    Every part that is finished in the folder is kept: the same call after an interruption goes on where it was.

    Args:
        task: model and paths.
        rig: opened for every run and loop.
        out: folder.
        progress: told of every piece of work.
        ask: asks a person to do something between runs.

    Raises:
        InputError: as for each part: a plan beyond the limits, data that cannot be used, a rig with another robot.
        RuntimeError, OSError: the rig failed.
    """
    out, model, plan, seed = output_folder(Path(out)), task.model, task.plan, task.seed
    write_model(model, out / KNOWN)
    if plan is None:
        progress("planning the standard runs", 0, 0)
        plan = standard(model).plan
    record(plan, out / DATA, rig, seed, progress, ask)
    folders, verdicts = [out / DATA], [_verdict(out, 0, [out / DATA], seed, progress)]
    while len(verdicts) <= task.further and verdicts[-1]["status"] == VerdictStatus.INDISTINGUISHABLE.value:
        number = len(verdicts)
        proposed, more = out / f"{NEXT}_{number}.toml", out / f"{NEXT}_{number}"
        if not proposed.is_file():
            try:
                found = run_next(out / f"{FOUND}_{number - 1}", NextRunOptions(seed=seed, loads=False), folders, progress=progress)
                found.save(proposed)
            except InputError:  # no run tells them apart
                break
        record(read_plan(proposed), more, rig, seed, progress, ask)
        folders.append(more)
        verdicts.append(_verdict(out, number, folders, seed, progress))
    models = {BEFORE: model, AFTER: read_model(out / f"{FOUND}_{len(verdicts) - 1}" / MODEL)}
    steering: dict[str, dict[str, Any]] = {}
    for path, trajectory in task.paths.items():
        for name, each in models.items():
            folder = out / f"{path}_{name}"
            if not (folder / SUMMARY).is_file():
                compiled = compile_model(each)
                reference = whole_reference(compiled, trajectory, Course(), progress=progress)
                run_closed_loop(compiled, reference, rig.open(seed), LoopSetup(rig=rig.name, seed=seed), folder, progress=progress)
            steering.setdefault(path, {})[name] = json.loads(read_text(folder / SUMMARY))["mpc"]
    done = ModelUpdate(out, model.robot.name, rig.name, tuple(verdicts), steering)
    done.save()
    return done


def _verdict(out: Path, number: int, folders: Sequence[Path], seed: int, progress: Progress) -> Mapping[str, Any]:
    """The verdict of a round, as its file has it.

    Args:
        out: folder of the whole.
        number: of the round.
        folders: data sets, the first one first.
        seed: of random draws.
        progress: told of every piece of work.
    """
    folder = out / f"{FOUND}_{number}"
    if not (folder / VERDICT).is_file():
        run_discrepancy(folders[0], folder, out / KNOWN, options=DiscrepancyOptions(seed, add=folders[1:]), progress=progress)
    return json.loads(read_text(folder / VERDICT))
