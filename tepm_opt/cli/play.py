"""`tepm play`: a set-point file on a rig."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

import tepm_opt as tepm
from tepm_opt.cli import INTERRUPTED
from tepm_opt.cli.common import JsonOption, RobotOption, folder_for, stdout, warn
from tepm_opt.cli.progress import show_progress
from tepm_opt.cli.rigs import (
    FoxgloveOption,
    RigOption,
    RosOption,
    SeedOption,
    opener,
    publisher,
    report_failure,
    robot_there,
    stopped_by_signals,
)
from tepm_opt.progress import with_prefix

MEASURED = "measured.csv"


def play(
    inputs: Annotated[Path, typer.Argument(metavar="INPUTS", help="Set-point file, such as the inputs.csv of tepm ik.")],
    rig: RigOption = "sim",
    out: Annotated[Path, typer.Option("--out", help="Folder for measured.csv, or a CSV file; never overwritten.")] = Path("played"),
    rate: Annotated[float, typer.Option("--rate", min=0.1, max=10000, help="Samples kept a second, Hz.")] = 50.0,
    seed: SeedOption = 0,
    ros: RosOption = None,
    foxglove: FoxgloveOption = None,
    robot: RobotOption = None,
    as_json: JsonOption = False,
) -> int:
    """Play set points on a rig: approach the first row slowly, every row at its time, back to zero, stop."""
    from tepm_opt.models.layout import Layout
    from tepm_opt.recording.drive import refuse_unplayable
    from tepm_opt.recording.measure import UNFINISHED

    found = tepm.load_robot(robot_there(robot, None, rig) or "kang2017")
    setpoints = tepm.read_setpoints(inputs, Layout.from_robot(found).actuator_names, found.input_max)
    refuse_unplayable(setpoints, str(inputs))
    file = out if out.suffix == ".csv" else out / MEASURED
    left = f"what was measured is in {file.with_suffix('')}-….{UNFINISHED}.csv"
    try:
        with folder_for(file.parent), stopped_by_signals(), publisher(ros, foxglove) as shows, show_progress(as_json) as progress:
            opened = opener(rig, found, seed, shows)(seed)
            measured = tepm.play(opened, setpoints, found, file, rate, with_prefix(progress, inputs.name))
    except KeyboardInterrupt:
        warn(f"interrupted: the rig is stopped; {left}")
        return INTERRUPTED
    except (RuntimeError, OSError) as error:
        return report_failure(error, left)
    run, notes = measured.run, list(measured.notes)
    if as_json:
        print(json.dumps({"file": str(file), "rows": run.rows, "duration_s": run.duration, "notes": notes}, indent=2))
        return 0
    for line in (f"[bold]{run.rows} samples[/] in {escape(str(file))}", *(f"[yellow]{escape(note)}[/]" for note in notes)):
        stdout.print(line, soft_wrap=True, highlight=False)
    return 0
