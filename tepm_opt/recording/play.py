"""Playing set points on a rig: the start approached slowly, every row at its time, back to zero; what was measured becomes a run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tepm_opt.data.files import output_folder
from tepm_opt.data.run import Run, write_run
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Rig
from tepm_opt.models.robot import Robot
from tepm_opt.recording.drive import Driver, Show, Virtual
from tepm_opt.recording.robots import channels_of
from tepm_opt.recording.samples import journal_path, run_from_journal, write_journal


def play(
    rig: Rig, setpoints: SetPoints, robot: Robot, out: str | Path, rate: float = 50.0, show: Show = lambda stage, done, of: None
) -> Run:
    """Send set points to a rig and write what was measured meanwhile as a run.

    The rig is stopped whatever happens. Samples go to `NAME-1.unfinished.csv` beside `out` line by line; that file stays where the rows
    were not played to the end, and is removed when `out` is written.

    Args:
        rig: any rig, from rest.
        setpoints: linear between rows.
        robot: that they are for.
        out: the CSV file to write.
        rate: of the samples kept, in Hz.
        show: is told about progress.

    Raises:
        InputError: the rig has another robot, a file cannot be written, `out` exists, or the set points have one row.
    """
    out = Path(out)
    channels, force = channels_of(robot), setpoints.tip_force
    known = getattr(rig, "robot", None)
    if known is not None and channels_of(known) != channels:
        raise InputError(f"the rig's robot is {known.name!r}, the set points are for {robot.name!r}")
    if not isinstance(rig, Virtual) and force.any():
        raise InputError("set points with a tip force need a rig that can push; a simulated one can")
    if out.exists():
        raise InputError(f"{out} exists; name another file")
    refuse_unplayable(setpoints)
    journal = journal_path(output_folder(out.parent), out.name)
    with rig:
        driver = Driver(rig, channels, show)
        driver.approach(setpoints.inputs[0])
        write_journal(journal, driver.follow(setpoints, rate), driver.sample, channels)
        driver.finish()
    run = run_from_journal(journal, out.name, "validation", channels)
    if run is None:
        raise RuntimeError("the rig gave no sample")
    write_run(out, run, channels)
    journal.unlink()
    return run


def refuse_unplayable(setpoints: SetPoints) -> None:
    """Refuse set points that have no duration or rows without inputs (where inverse kinematics failed).

    Raises:
        InputError: naming the row.
    """
    if len(setpoints.time) < 2:
        raise InputError("set points: one row has no duration; valid: at least two rows of increasing time")
    empty = ~np.isfinite(setpoints.inputs).all(axis=1)
    if empty.any():
        raise InputError(f"set points: row {int(np.argmax(empty)) + 1} has no inputs; a rig cannot play it")
