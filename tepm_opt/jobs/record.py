"""Recording a plan on a rig: run by run into a data set that is whole at every moment."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from tepm_opt.data.datasets import DESCRIPTION, Description, RunEntry, read_description, write_description
from tepm_opt.data.documents import read_text
from tepm_opt.data.files import output_folder, remove_leftovers, write_atomically
from tepm_opt.data.journal import mend_journal
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Rig
from tepm_opt.models.robot import builtin_robots
from tepm_opt.progress import Progress, silent, with_prefix
from tepm_opt.recording.measure import UNFINISHED, RunOutput, journal_path, measure
from tepm_opt.recording.plan import RecordingPlan

LOG, ROBOT = "recording.json", "robot.toml"
Ask = Callable[[str], None]
"""Asks a person to do something and waits until it is done."""


@dataclass(frozen=True)
class RigSource:
    """Rig that is opened anew for every run.

    Attributes:
        name: as a person names it; stands in records.
        open: opens it, with this seed where the rig has chance in it.
    """

    name: str
    open: Callable[[int], Rig]


@dataclass(frozen=True)
class RecordResult:
    """Files of a recording.

    Attributes:
        folder: of the data set.
        done: files recorded now.
        kept: files that were there before.
        notes: what a person should know of a run, by file.
    """

    folder: Path
    done: tuple[str, ...]
    kept: tuple[str, ...]
    notes: Mapping[str, tuple[str, ...]]

    def __repr__(self) -> str:
        return f"RecordResult({str(self.folder)!r}, {len(self.done)} recorded, {len(self.kept)} kept, {len(self.notes)} with notes)"

    def summary(self) -> dict[str, Any]:
        """Folder, files and notes as plain data, for JSON."""
        notes = {file: list(lines) for file, lines in self.notes.items()}
        return {"dataset": str(self.folder), "recorded": list(self.done), "kept": list(self.kept), "notes": notes}


def seed_of(seed: int, file: str) -> int:
    """The seed of one run: it does not depend on which runs are recorded with it."""
    return int(np.random.SeedSequence([seed, crc32(file.encode())]).generate_state(1)[0])


def record(
    plan: RecordingPlan,
    folder: str | Path,
    rig: RigSource,
    seed: int = 0,
    progress: Progress = silent,
    ask: Ask = lambda request: None,
) -> RecordResult:
    """Record the runs of a plan that the data set does not have yet.

    Every run starts on a rig opened anew, from zero. Samples go to `unfinished/NAME-1.unfinished.csv` line by line; a finished run becomes
    `NAME.csv`, then stands in `dataset.toml`, and only then its journal goes. Whatever ends the program, `dataset.toml` lists
    finished runs and nothing else, and all samples of the others are in `unfinished/`.

    Args:
        plan: what to record.
        folder: of the data set, made if need be.
        rig: its name stands in `recording.json`; runs of different rigs are not mixed.
        seed: of everything random on the rig.
        progress: told of every stage in s; stages begin with the run's file and its number.
        ask: is asked for another tip force where the rig cannot push; at first there is none.

    Raises:
        InputError: the folder holds another data set, runs of another plan, rig or seed, or cannot be written; the rig has another robot.
    """
    folder = output_folder(folder)
    log = _open(plan, folder, rig.name, seed)
    for name in (DESCRIPTION, LOG, ROBOT, *(run.file for run in plan.runs)):
        remove_leftovers(folder / name)
    _tidy(folder, log)
    finished = {entry.file for entry in read_description(folder).runs}
    done, kept, notes, hanging = [], [], {}, np.zeros(3)
    for number, planned in enumerate(plan.runs, start=1):
        file, setpoints = planned.file, planned.setpoints
        if file in finished:
            kept.append(file)
            continue
        journal = journal_path(output_folder(folder / UNFINISHED), file)
        opened, force = rig.open(seed_of(seed, file)), setpoints.tip_force[0]
        if opened.simulated is None and np.any(force != hanging):
            ask(f"{file}: make the force on the tip x, y, z = {', '.join(f'{value:g}' for value in force)} N")
            hanging = force
        told = with_prefix(progress, f"{file} ({number} of {len(plan.runs)})")
        out = RunOutput(folder / file, journal, planned.role, plan.sample_rate)
        measured = measure(opened, setpoints, plan.robot, out, told, at_once=True)
        finished.add(file)
        log["runs"][file] = {
            "fingerprint": planned.fingerprint(plan.robot, plan.sample_rate),
            "recorded_at": datetime.now(UTC).isoformat(timespec="seconds"),
            "journal": journal.name,
            "notes": measured.notes,
        }
        write_atomically(folder / LOG, json.dumps(log, indent=2) + "\n")
        _list(plan, folder, finished)
        _tidy(folder, log)
        done.append(file)
        notes |= {file: measured.notes} if measured.notes else {}
    return RecordResult(folder, tuple(done), tuple(kept), notes)


def _open(plan: RecordingPlan, folder: Path, rig: str, seed: int) -> dict[str, Any]:
    """The log of a data set that belongs to this plan, rig and seed; a new data set where there is none, or one without runs."""
    head, path = {"rig": rig, "seed": seed}, folder / LOG
    if (folder / DESCRIPTION).exists():
        if not path.is_file():
            raise InputError(f"{folder} holds a data set that was not recorded here ({LOG} is missing); name another folder")
        description = read_description(folder)
        if description.runs:
            return _go_on(plan, folder, description, head)
    write_atomically(path, json.dumps({**head, "runs": {}}, indent=2) + "\n")
    if plan.source not in builtin_robots():
        write_atomically(folder / ROBOT, read_text(Path(plan.source)))
    _list(plan, folder, set())
    return {**head, "runs": {}}


def _go_on(plan: RecordingPlan, folder: Path, description: Description, head: Mapping[str, Any]) -> dict[str, Any]:
    """The log of a data set with runs, if these are what the plan would record."""
    path = folder / LOG
    try:
        log = json.loads(read_text(path))
        runs = {entry.file: log["runs"][entry.file] for entry in description.runs}
        found = {name: log[name] for name in head}
        prints = {file: str(run["fingerprint"]) for file, run in runs.items()}
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: is damaged; record into another folder") from error
    for name, value in head.items():
        if found[name] != value:
            raise InputError(f"{folder} was recorded with {name} {found[name]!r}, not {value!r}; name another folder")
    expected = _description(plan, set(runs))
    if expected.model_copy(update={"runs": []}) != description.model_copy(update={"runs": []}):
        raise InputError(f"{folder / DESCRIPTION}: name, robot, rate or noise differ from the plan's; name another folder")
    planned = {run.file: run for run in plan.runs}
    for file, fingerprint in prints.items():
        if file not in planned:
            raise InputError(f"{folder}: {file} is not in the plan; add it there or name another folder")
        if fingerprint != planned[file].fingerprint(plan.robot, plan.sample_rate):
            raise InputError(f"{folder}: {file} was recorded under other inputs than the plan's; name another folder")
    if description != expected:
        _list(plan, folder, set(runs))
    return {**head, "runs": runs}


def _description(plan: RecordingPlan, files: set[str]) -> Description:
    robot = plan.source if plan.source in builtin_robots() else ROBOT
    runs = [RunEntry(file=run.file, role=run.role) for run in plan.runs if run.file in files]
    return Description(name=plan.name, robot=robot, sample_rate_hz=plan.sample_rate, position_noise_m=plan.position_noise, runs=runs)


def _list(plan: RecordingPlan, folder: Path, files: set[str]) -> None:
    write_description(folder, _description(plan, files))


def _tidy(folder: Path, log: Mapping[str, Any]) -> None:
    """Remove journals of finished runs and empty ones, cut torn lines off the others; remove the folder where nothing is left."""
    place = folder / UNFINISHED
    if not place.is_dir():
        return
    of_finished = {entry.get("journal") for entry in log["runs"].values()}
    for path in place.glob(f"*.{UNFINISHED}.csv"):
        if path.name in of_finished or mend_journal(path) == 0:
            path.unlink()
    if not any(place.iterdir()):
        place.rmdir()
