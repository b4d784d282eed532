"""Data set and command for fitting a changed machine anew: the samples of a closed loop since the change."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tepm_opt.control.diagnostics.monitor import Changed
from tepm_opt.data.datasets import DataSet, write_dataset
from tepm_opt.data.run import Run
from tepm_opt.models.channels import channels_of

if TYPE_CHECKING:
    from tepm_opt.jobs.closed_loop import ClosedLoop

CHANGED = "changed"
SETTLED = 2.0  # s after a change from which samples are of the machine as it is now
SHORTEST = 5.0  # s of samples that make a run


def refit_command(folder: str | Path) -> str:
    """Command that finds which effect the model lacks since the change; `folder` is that of the loop's results."""
    return f"tepm discrepancy {Path(folder) / CHANGED} --out {Path(folder) / 'refit'}"


def changes_told(changes: Sequence[Changed]) -> list[dict[str, Any]]:
    """Changes as plain data."""
    return [
        {"told_s": each.told, "since_s": each.since, "log_odds": each.evidence, "probabilities": dict(each.probabilities)}
        for each in changes
    ]


def save_changed(loop: ClosedLoop, folder: Path) -> bool:
    """Write the samples since the last change as a data set into a folder's `changed`; whether there were enough of them.

    Raises:
        InputError: the folder cannot be written to.
    """
    since = loop.time >= loop.changes[-1].since + SETTLED
    if not since.any() or np.ptp(loop.time[since]) < SHORTEST:
        return False
    time, robot = loop.time[since], loop.model.robot
    run = Run(
        "since.csv", "fit", time - time[0], np.hstack([loop.pressures, loop.tensions])[since], np.zeros((len(time), 3)), loop.points[since],
        start="measured",
    )  # fmt: skip
    noise = None if robot.tracker is None else robot.tracker.noise_rms_m / np.sqrt(3)
    data = DataSet("since the machine changed", loop.model.source, channels_of(robot), (run,), 1 / loop.period, noise)
    write_dataset(data, folder / CHANGED, overwrite=True)
    return True
