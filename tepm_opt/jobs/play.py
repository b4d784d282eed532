"""Playing set points on a rig: the start approached slowly, every row at its time, back to zero; what was measured becomes a run."""

from __future__ import annotations

from pathlib import Path

from tepm_opt.data.files import output_folder
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Rig
from tepm_opt.models.robot import Robot
from tepm_opt.progress import Progress, silent
from tepm_opt.recording.drive import refuse_unplayable
from tepm_opt.recording.measure import MeasuredRun, RunOutput, journal_path, measure


def play(rig: Rig, setpoints: SetPoints, robot: Robot, out: str | Path, rate: float = 50.0, progress: Progress = silent) -> MeasuredRun:
    """Send set points to a rig and write what was measured meanwhile as a run; see `measure`.

    Samples go to `NAME-1.unfinished.csv` beside `out` one by one; that file stays where the rows were not played to the end.

    Args:
        rig: any, not yet entered.
        setpoints: linear between rows.
        robot: that they are for.
        out: the CSV file to write, a new one.
        rate: of the samples kept, in Hz.
        progress: told of every stage in s.

    Raises:
        InputError: as for `measure`; `out` exists; the set points have one row, or one without inputs.
    """
    out = Path(out)
    if out.exists():
        raise InputError(f"{out} exists; name another file")
    refuse_unplayable(setpoints, "set points")
    journal = journal_path(output_folder(out.parent), out.name)
    measured = measure(rig, setpoints, robot, RunOutput(out, journal, "validation", rate), progress)
    journal.unlink()
    return measured
