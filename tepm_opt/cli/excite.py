"""`tepm data excite`: the standard recording plan of a robot, and what it will tell."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

import tepm_opt as tepm
from tepm_opt.cli.common import SOLVED, UNSOLVED, JsonOption, ModelOption, RobotOption, stdout
from tepm_opt.cli.progress import show_progress
from tepm_opt.errors import InputError


def excite(
    out: Annotated[Path, typer.Option("--out", metavar="PLAN", help="Plan file to write; the prediction goes beside it as .json.")] = Path(
        "plan.toml"
    ),
    robot: RobotOption = None,
    model: ModelOption = None,
    noise: Annotated[
        float | None, typer.Option("--noise", help="Of the tracker, 1 sigma per axis in m.", show_default="the robot file's")
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Write a plan for `tepm record` that excites every effect of the library, for any robot; say beforehand what it will tell.

    Levels come from statics, times from the slowest sway. Printed are, for each effect, the smallest size that is found at 2 sigma, the
    size from which it is large enough to be named, and the closest rival with the size from which it can be told apart.
    """
    if robot and model:
        raise InputError("--robot and --model exclude each other: the model file names its robot")
    with show_progress(as_json) as progress:
        run = tepm.run_excite(tepm.read_model(model) if model else tepm.Model.from_robot(robot or "kang2017"), noise, progress)
    run.save(out)
    summary = run.summary()
    if as_json:
        print(json.dumps(summary, indent=2))
        return SOLVED if run.ok else UNSOLVED
    table = Table("effect (hardest case)", "found at 2 sigma", "large enough to be named", "closest rival", "cosine", "told apart from")
    for each in run.hardest:
        found, material, apart = (run.size(each.move, multiple) for multiple in (each.found, each.material, each.apart))
        rival = escape(each.rival.label) if each.rival else "-"
        table.add_row(escape(each.move.candidate.label), found, material, rival, f"{each.cosine:.4f}", apart if each.rival else "-")
    stdout.print(table)
    stdout.print(
        f"[bold]{summary['runs']} runs, {summary['seconds']:g} s[/] in {escape(str(out))}; sway {summary['sway_Hz']:g} Hz; "
        f"all numbers in {escape(str(out.with_suffix('.json')))}",
        soft_wrap=True,
        highlight=False,
    )
    return SOLVED if run.ok else UNSOLVED
