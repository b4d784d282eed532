"""`tepm data check`: is a data set what it says?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

import tepm_opt as tepm
from tepm_opt.cli.common import SOLVED, UNSOLVED, JsonOption, stdout

app = typer.Typer(help="Data sets of experiments: check.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Keeps `check` a command of its own while it is the only one."""


@app.command()
def check(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Folder with dataset.toml and a CSV file a run.")],
    as_json: JsonOption = False,
) -> int:
    """Find wrong units, broken time, frozen, saturated and interchanged sensors, dropouts, spikes, starts not at rest.

    Exit status: 0 no errors (warnings at most), 1 errors, 2 not readable at all.
    """
    run = tepm.run_check(dataset)
    status = SOLVED if run.ok else UNSOLVED
    if as_json:
        print(json.dumps(run.summary(), indent=2))
        return status
    if run.findings:
        table = Table("", "file", "channel", "finding")
        for finding in sorted(run.findings, key=lambda found: found.severity):
            colour = "red" if finding.severity == "error" else "yellow"
            table.add_row(f"[{colour}]{finding.severity}[/]", *(escape(t) for t in (finding.file, finding.channel, finding.message)))
        stdout.print(table)
    counted = f"{run.errors} errors, {run.warnings} warnings" if run.findings else "nothing to complain of"
    stdout.print(f"{dataset}: {counted}", soft_wrap=True, highlight=False)
    return status
