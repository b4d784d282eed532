"""`tepm tune`: settings of the controller's filter from the log of a closed loop."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

import tepm_opt as tepm
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, load, report, stdout
from tepm_opt.cli.progress import show_progress

if TYPE_CHECKING:
    from tepm_opt.jobs.tune import TuneRun


def comparison(run: TuneRun) -> Table:
    """Table of all candidates, the chosen one bold."""
    from tepm_opt.control.estimation.filter_tuning import HORIZONS

    table = Table("travel ×", "friction ×", "strength ×", *(f"error at {horizon:.2f} s, mm" for horizon in HORIZONS), "")
    for each in run.candidates:
        cells = [f"{each.travel:g}", f"{each.friction:g}", f"{each.strength:g}", *(f"{1e3 * error:.2f}" for error in each.errors)]
        note = "chosen" if each is run.chosen else "hand-set" if each.hand_set else ""
        table.add_row(*cells, note, style="bold" if each is run.chosen else None)
    return table


def tune(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="log.csv of tepm mpc, or its folder.")],
    out: Annotated[Path, typer.Option("--out", help="Model file to write.")] = Path("tuned.toml"),
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Tune the filter of the predictive controller on a closed-loop log: travel of the friction and noise levels that predict the tip best.

    Use a path that reverses every muscle, such as the circle, driven with the same model. The result is a model file for --model.
    """
    compiled = load(robot, model)
    with show_progress(as_json) as progress:
        run = tepm.run_tune(compiled, log, progress)
    run.save(out)
    if not as_json:
        stdout.print(comparison(run))
    before, after = (1e3 * each.errors[-1] for each in (run.candidates[0], run.chosen))
    lines = [
        "hand-set values predict best; they are kept"
        if run.chosen.hand_set
        else f"prediction error of the tip at 0.30 s: {before:.2f} mm hand-set, [bold]{after:.2f} mm[/] tuned",
        f"Next: drive with it: tepm mpc circle --model {escape(shlex.quote(str(out)))}",
    ]
    return report(run.summary(), lines, as_json, run.ok)
