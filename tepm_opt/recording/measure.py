"""One run on a rig: driven, written to a journal row by row, then to a CSV file as a whole."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from tepm_opt.data.channels import Channels
from tepm_opt.data.journal import Journal, mend_journal
from tepm_opt.data.run import Role, Run, read_run, write_run
from tepm_opt.data.setpoints import SetPoints, length_columns
from tepm_opt.data.tables import field_texts
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Rig, Sample
from tepm_opt.models.channels import channels_of
from tepm_opt.models.robot import Robot
from tepm_opt.progress import Progress, silent
from tepm_opt.recording.drive import Driver, Row

STATUS, GOOD = "status", "ok"
UNFINISHED = "unfinished"


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """A run that was measured, and what a person should know of it.

    Attributes:
        run: as it stands in its file.
        notes: lines for people.
    """

    run: Run
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"MeasuredRun({self.run.file!r}, {self.run.rows} rows, {len(self.notes)} notes)"


@dataclass(frozen=True)
class RunOutput:
    """Files of a run that is recorded, with its role and rate.

    Attributes:
        file: the CSV file to write in the end.
        journal: for samples as they come, a new file.
        role: of the run.
        rate: of the samples kept, in Hz.
    """

    file: Path
    journal: Path
    role: Role
    rate: float


def measure(
    rig: Rig, setpoints: SetPoints, robot: Robot, out: RunOutput, progress: Progress = silent, at_once: bool = False
) -> MeasuredRun:
    """Bring a rig to rest under the first row, send the set points, bring it back to zero, and write what was measured meanwhile.

    The rig is stopped whatever happens; the journal has all samples until then. It stays: the caller removes it.

    Args:
        rig: any rig, not yet entered.
        setpoints: linear between rows.
        robot: that they are for.
        out: files to write, role and rate.
        progress: told of every stage in s.
        at_once: a rig of virtual time may rest under the first row from the start, and need not come back.

    Raises:
        InputError: the rig has another robot, cannot push as the set points want, or a file cannot be written.
        RuntimeError: the rig gave no sample, or was stopped because of what it measured (`hw.guard.Stopped`).
    """
    channels, force, name = channels_of(robot), setpoints.tip_force, out.file.name
    at_once = at_once and rig.simulated is not None
    with rig:
        if channels_of(rig.robot) != channels:
            raise InputError(f"the rig's robot is {rig.robot.name!r}, the set points are for {robot.name!r}; name the robot that is there")
        if rig.simulated is None and np.any(force != force[0]):
            raise InputError(f"{name}: the tip force changes, but this rig cannot push; hang a weight and give a constant force")
        driver = Driver(rig, channels, progress)
        rested = driver.start(setpoints, at_once)
        write_journal(out.journal, driver.follow(setpoints, out.rate), driver.sample, channels)
        if not at_once:
            driver.finish()
    run = run_from_journal(out.journal, name, out.role, channels)
    if run is None:
        raise RuntimeError(f"{name}: the rig gave no sample")
    write_run(out.file, run, channels)
    notes = [] if rested else ["the robot did not come to rest before the start"]
    if STATUS in run.extra:
        odd = run.extra[STATUS][run.extra[STATUS] != GOOD]
        notes.append(f"{len(odd)} samples with a status, the first: {odd[0]}")
    return MeasuredRun(run, tuple(notes))


def journal_path(folder: Path, file: str) -> Path:
    """A path in the folder for the journal of a run that is not taken: those of attempts that did not finish are kept."""
    number = 1
    while (path := folder / f"{Path(file).stem}-{number}.{UNFINISHED}.csv").exists():
        number += 1
    return path


@cache
def _measured_columns(names: tuple[str, ...]) -> tuple[list[str], list[str], list[str]]:
    """Columns of measured pressures, tensions and lengths: `pressure_11_measured_Pa`, …, `length_11_m`, …"""
    return [f"pressure_{name}_measured_Pa" for name in names], [f"tension_{name}_measured_N" for name in names], length_columns(names)


def _others(sample: Sample, channels: Channels) -> dict[str, float]:
    """Collect the measurements of a sample besides positions, by column."""
    columns: dict[str, float] = {}
    for values, labels in zip((sample.pressures, sample.tensions, sample.lengths), _measured_columns(channels.actuators), strict=True):
        if values is not None:
            columns |= zip(labels, values.tolist(), strict=True)
    return columns | {name: float(value) for name, value in sample.extra.items()}


def write_journal(path: Path, rows: Iterable[Row], first: Sample, channels: Channels) -> int:
    """Append every row as it comes, in the columns of SPEC section 4 and those that `first` measures; how many came.

    Args:
        path: of a new file.
        rows: as they are driven.
        first: a sample that says what the rig measures.
        channels: of the robot.

    Raises:
        InputError: the file exists or cannot be written.
    """
    extra = list(_others(first, channels))
    count, start = 0, 0.0
    with Journal(path, [*channels.columns, *extra, STATUS]) as journal:
        for row in rows:
            start = row.time if count == 0 else start
            values = [float(round(row.time - start, 6)), *row.inputs.tolist(), *row.tip_force.tolist(), *row.sample.points.ravel().tolist()]
            others = _others(row.sample, channels)
            values += [others.get(name, np.nan) for name in extra]
            late = f" (commands {row.late:.3f} s late)" if row.late else ""
            journal.append([*field_texts(values), row.sample.status + late])
            count += 1
    return count


def run_from_journal(path: Path, file: str, role: Role, channels: Channels) -> Run | None:
    """The run that a journal holds as far as it got; None without a row. The status is kept where it was not always good.

    Args:
        path: of the journal.
        file: that the run shall have.
        role: of the run.
        channels: of the robot.

    Raises:
        InputError: the journal cannot be read.
    """
    try:
        if mend_journal(path) == 0:
            return None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    run = read_run(path, role, channels)
    extra = {name: values for name, values in run.extra.items() if name != STATUS or np.any(values != GOOD)}
    return replace(run, file=file, extra=extra, lines=())
