"""`tepm data next`: which run would best tell apart what is still indistinguishable?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

import tepm_opt as tepm
from tepm_opt.cli.common import SOLVED, JsonOption, stdout
from tepm_opt.cli.progress import show_progress


def next_run(
    found: Annotated[Path, typer.Argument(metavar="FOUND", help="Folder that tepm discrepancy wrote: verdict.json, model.toml.")],
    out: Annotated[Path, typer.Option("--out", metavar="PLAN", help="Plan file to write, for tepm record.")] = Path("run.toml"),
    seconds: Annotated[float, typer.Option("--seconds", help="Length of the run.")] = 30.0,
    loads: Annotated[bool, typer.Option("--loads/--no-loads", help="Whether a known constant force may act on the tip.")] = True,
    data: Annotated[
        list[Path] | None,
        typer.Option("--data", metavar="DATASET", help="What the verdict is about.", show_default="what verdict.json says"),
    ] = None,
    despite_errors: Annotated[bool, typer.Option("--despite-errors", help="Go on where the check of the data finds errors.")] = False,
    seed: Annotated[int, typer.Option("--seed", min=0, max=2**32 - 1, help="Of the runs that are tried.")] = 0,
    as_json: JsonOption = False,
) -> int:
    """Propose the run that best separates the rivals of a verdict; write its plan.

    Record it (tepm record PLAN --out EXTRA), then go on with it (tepm discrepancy DATASET --add EXTRA).
    """
    with show_progress(as_json) as progress:
        run = tepm.run_next(found, tepm.NextRunOptions(seconds, seed, loads), data or (), despite_errors, progress)
    run.save(out)
    summary = run.summary()
    if as_json:
        print(json.dumps(summary, indent=2))
        return SOLVED
    told = " or ".join(" + ".join(effects) or "nothing" for effects in summary["hypotheses"])
    stdout.print(escape(f"to tell apart: {told}"), soft_wrap=True, highlight=False)
    by_chance = summary["random_run"]
    beside = "none is borne" if by_chance is None else f"{by_chance['sigmas']:g} sigmas, log-odds {by_chance['log_odds']:g}"
    stdout.print(
        f"[bold]{summary['pattern']}, {summary['seconds']:g} s[/] in {escape(str(out))}: {summary['sigmas']:g} sigmas, log-odds "
        f"{summary['log_odds']:g}; a random run of that length: {beside}",
        soft_wrap=True,
        highlight=False,
    )
    return SOLVED
