"""`tepm study blind`: how often is a verdict right?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from tepm_opt import studies
from tepm_opt.cli.common import JsonOption, report
from tepm_opt.cli.groups import WorkerOptions
from tepm_opt.cli.progress import show_progress

PAGE = "index.html"


def blind(
    workers: WorkerOptions,
    trials: Annotated[int, typer.Option("--trials", min=1, help="How many.")] = 160,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of all trials: the same seed and number is the same trial.")] = 0,
    family: Annotated[
        str | None,
        typer.Option(
            "--family",
            help="Only this one instead of all in turn: closed, open, wrong, poor or null; or engine, in MuJoCo, or rod, in PyElastica.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("blind"),
    data: Annotated[
        Path | None, typer.Option("--data", metavar="FOLDER", help="Only write the data sets and, in labels/, what is hidden.")
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Hide effects and other causes in simulated data and count how often the discrepancy workflow finds them, and what else it says.

    Appends every answer to trials.jsonl; summary.json, summary.md, figures and a page, index.html, say what all of them say. The same
    command goes on where it was interrupted, or adds trials to those that are there.
    """
    from tepm_opt.studies.blind.run import RESULTS, TABLE, write_trials

    series = studies.TrialSeries(trials, seed, family)
    with show_progress(as_json) as progress:
        if data is not None:
            write_trials(data, series, progress)
            return report({"trials": trials, "data": str(data)}, [f"{trials} data sets in {escape(str(data))}"], as_json, ok=True)
        if workers.scheduler is not None:
            with workers.open_executor() as executor:
                run = studies.run_blind(out, series, executor, progress=progress)
        else:  # processes are made anew where a trial kills one
            run = studies.run_blind(out, series, jobs=workers.jobs, progress=progress)
    run.save(out)
    studies.write_blind_page(out / PAGE, run, studies.draw_blind_trials(run, out))
    lines = [] if run.ok else [f"[yellow]{escape(run.outcome.message)}; the same command goes on from there[/]"]
    lines += [escape(line) for line in (out / TABLE).read_text(encoding="utf-8").splitlines()]
    return report(
        run.summary(),
        [*lines, f"every answer: [bold]{escape(str(out / RESULTS))}[/]; open [bold]{escape(str(out / PAGE))}[/]"],
        as_json,
        run.ok,
    )
