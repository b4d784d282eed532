"""`tepm record`: an input plan on a rig, stored as a data set."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

import tepm_opt as tepm
from tepm_opt.cli import INTERRUPTED
from tepm_opt.cli.common import JsonOption, RobotOption, stdout, warn
from tepm_opt.cli.progress import show_progress
from tepm_opt.cli.rigs import RigOption, SeedOption, opener, report_failure, robot_there, stopped_by_signals
from tepm_opt.errors import InputError

if TYPE_CHECKING:
    from tepm_opt.recording.plan import RecordingPlan

MADE, DEFAULT = ("standard", "wiring"), "kang2017"


def record(
    plan: Annotated[
        Path, typer.Argument(metavar="PLAN", help="Plan file (.toml, docs/how-to/recording.md), or the word standard or wiring.")
    ],
    out: Annotated[Path, typer.Option("--out", metavar="DATASET", help="Folder of the data set; runs it has are kept.")],
    rig: RigOption = "sim",
    seed: SeedOption = 0,
    robot: RobotOption = None,
    as_json: JsonOption = False,
) -> int:
    """Record a plan's runs on a rig into a data set. Call it again to go on where it was interrupted.

    The plan `standard` is the one that `tepm data excite` writes for the robot, --robot or the rig's; `wiring` moves every muscle and
    tendon alone, so that `tepm data check` finds exchanged hoses. A plan file names its robot itself.
    """
    if robot and str(plan) not in MADE:
        raise InputError(f"--robot {robot}: {plan} names its robot itself; leave the option out, or record the plan {' or '.join(MADE)}")
    planned = _plan_for(str(plan), robot_there(robot, None, rig) or DEFAULT) if str(plan) in MADE else tepm.read_plan(plan)
    try:
        with stopped_by_signals(), show_progress(as_json) as bars:
            done = tepm.record(planned, out, tepm.RigSource(rig, opener(rig, planned.robot, seed)), seed, bars, bars.ask)
    except KeyboardInterrupt:
        warn(f"interrupted: {describe_kept_runs(planned, out)}")
        return INTERRUPTED
    except (RuntimeError, OSError) as error:
        return report_failure(error, describe_kept_runs(planned, out))
    if as_json:
        print(json.dumps(done.summary(), indent=2))
        return 0
    before = f", {len(done.kept)} were there" if done.kept else ""
    stdout.print(f"[bold]{len(done.done)} runs[/] recorded in {out}{before}", soft_wrap=True, highlight=False)
    for file, lines in done.notes.items():
        for line in lines:
            stdout.print(f"[yellow]{file}: {escape(line)}[/]", soft_wrap=True, highlight=False)
    return 0


def _plan_for(name: str, robot: str) -> RecordingPlan:
    """A plan that is made for a robot."""
    return tepm.standard(tepm.Model.from_robot(robot), name).plan


def describe_kept_runs(plan: RecordingPlan, out: Path) -> str:
    """Tell a person in a sentence how many runs are kept where a recording ended early."""
    from tepm_opt.data.datasets import DESCRIPTION, read_description
    from tepm_opt.recording.measure import UNFINISHED

    finished = len(read_description(out).runs) if (out / DESCRIPTION).is_file() else 0
    rest = f", what there is of the next one in {out / UNFINISHED}" if (out / UNFINISHED).is_dir() else ""
    return f"{finished} of {len(plan.runs)} runs are in {out}{rest}; the same command goes on"
