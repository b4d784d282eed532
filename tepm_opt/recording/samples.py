"""Rows of a journal while a run is recorded, and the run that comes of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from tepm_opt.data.channels import Channels
from tepm_opt.data.journal import Journal, mend_journal
from tepm_opt.data.run import Role, Run, read_run
from tepm_opt.data.setpoints import length_columns
from tepm_opt.data.tables import field_text
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Sample
from tepm_opt.recording.drive import Row

STATUS, GOOD = "status", "ok"
UNFINISHED = "unfinished"


def journal_path(folder: Path, file: str) -> Path:
    """A path in the folder for the journal of a run that is not taken: those of attempts that did not finish are kept."""
    number = 1
    while (path := folder / f"{Path(file).stem}-{number}.{UNFINISHED}.csv").exists():
        number += 1
    return path


def measured(sample: Sample, channels: Channels) -> dict[str, float]:
    """What a rig measured besides positions, by column: `pressure_11_measured_Pa`, `length_11_m`, …"""
    columns: dict[str, float] = {}
    names = channels.actuators
    for values, labels in (
        (sample.pressures, [f"pressure_{name}_measured_Pa" for name in names]),
        (sample.tensions, [f"tension_{name}_measured_N" for name in names]),
        (sample.lengths, length_columns(names)),
    ):
        if values is not None:
            columns |= dict(zip(labels, (float(value) for value in values), strict=True))
    return columns | {name: float(value) for name, value in sample.extra.items()}


def write_journal(path: Path, rows: Iterable[Row], first: Sample, channels: Channels) -> int:
    """Append every row as it comes, in the columns of SPEC section 4 and those that `first` measures; how many came.

    Raises:
        InputError: the file exists or cannot be written.
    """
    extra = list(measured(first, channels))
    count, start = 0, 0.0
    with Journal(path, [*channels.columns, *extra, STATUS]) as journal:
        for row in rows:
            start = row.time if count == 0 else start
            values = [round(row.time - start, 6), *row.inputs, *row.tip_force, *row.sample.points.ravel()]
            others = measured(row.sample, channels)
            values += [others.get(name, np.nan) for name in extra]
            late = f" (commands {row.late:.3f} s late)" if row.late else ""
            journal.append([*(field_text(float(value)) for value in values), row.sample.status + late])
            count += 1
    return count


def run_from_journal(path: Path, file: str, role: Role, channels: Channels) -> Run | None:
    """The run that a journal holds as far as it got; None without a row. The status is kept where it was not always good.

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
