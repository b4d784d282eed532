"""`tepm data new|map|import|check|excite|next`: data sets, and plans of runs to record."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

import tepm_opt as tepm
from tepm_opt.cli.common import SOLVED, UNSOLVED, JsonOption, stdout
from tepm_opt.cli.excite import excite
from tepm_opt.cli.groups import spread
from tepm_opt.cli.next_run import next_run
from tepm_opt.cli.progress import show_progress
from tepm_opt.errors import InputError

if TYPE_CHECKING:
    from tepm_opt.data.checks.findings import Finding

app = typer.Typer(help="Data sets of experiments: start one, import tables, check; plans of runs to record.", no_args_is_help=True)

RobotOption = Annotated[str, typer.Option("--robot", help="Built-in robot or path of a robot file.")]
Files = Annotated[
    list[Path], typer.Argument(metavar="FILE...", help="CSV, TSV or other text, Parquet, MAT, HDF5, ROS bags (.bag, .db3, .mcap, folder).")
]
MOST = 12  # findings that are shown


@app.command()
def new(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder to write; never overwrites a data set.")],
    robot: RobotOption = "kang2017",
    as_json: JsonOption = False,
) -> int:
    """Write a commented dataset.toml and the header of a run, to fill."""
    written = tepm.new_dataset(folder, robot)
    print(json.dumps({"file": str(written)})) if as_json else print(f"wrote {written}: fill it, then run tepm data check {folder}")
    return SOLVED


@app.command("map")
def first_map(
    files: Files,
    robot: RobotOption = "kang2017",
    out: Annotated[Path | None, typer.Option("--out", metavar="MAP", help="Map file to write; else it is printed.")] = None,
) -> int:
    """Guess a first map file from the columns' names, to look through and mend."""
    text = tepm.suggest_map(files, robot)
    if out is None:
        print(text, end="")
        return SOLVED
    if out.exists():
        raise InputError(f"{out} exists; name another file")
    from tepm_opt.data.files import write_atomically

    write_atomically(out, text)
    print(f"wrote {out}: look at every line, then run tepm data import FILE... --map {out} --preview preview.png")
    return SOLVED


@app.command("import")
def import_tables(
    files: Files,
    map_file: Annotated[Path, typer.Option("--map", metavar="MAP", help="Map of the columns (.toml); docs/how-to/importing.md.")],
    out: Annotated[Path | None, typer.Option("--out", metavar="FOLDER", help="Data set to write; without it nothing is.")] = None,
    preview: Annotated[Path | None, typer.Option("--preview", metavar="PNG", help="Draw the preview's figure into this file.")] = None,
    as_json: JsonOption = False,
) -> int:
    """Make a data set of other programs' tables: names, units, clocks, frames as the map says, all columns on one even grid.

    A table of what was understood comes first; without --out it is all. The folder gets the figure, too, as import.png.
    Exit status: 0 done; 1 the data are there and tepm data check finds errors; 2 refused, with the entry of the map that mends it.
    """
    if out is not None:
        from tepm_opt.jobs.import_data import refuse_taken

        refuse_taken(out)
    with show_progress(as_json) as bars:
        run = tepm.run_import(files, map_file, out.name if out else "", bars)
    if not as_json:
        _preview(run)
    if preview is not None or out is not None:
        from tepm_opt.plots.figure import save
        from tepm_opt.plots.importing import preview_figure

        figure = preview_figure(run)
        if preview is not None:
            save(figure, preview)
        if out is not None:
            run.save(out)
            save(figure, out / "import.png")
    if as_json:
        print(json.dumps(run.summary(), indent=2))
    else:
        done = (
            f"[bold]{len(run.runs)} runs[/] written to {escape(str(out))}" if out else "nothing written: --out FOLDER writes the data set"
        )
        stdout.print(done, soft_wrap=True, highlight=False)
    return SOLVED if run.ok else UNSOLVED


def _preview(run: Any) -> None:
    for each in run.runs:
        lasting = f"{(each.rows - 1) / run.rate:.4g} s at {run.rate:g} Hz" if run.rate else "equilibria"
        stdout.print(
            f"[bold]{escape(each.file)}[/] ({each.role}): {each.rows} rows, {lasting}, from {escape(', '.join(each.files))}",
            soft_wrap=True,
            highlight=False,
        )
        table = Table("entry", "columns", "in SI", "samples", "to the grid", "lost")
        for row in run.rows():
            if row["run"] == each.name:
                table.add_row(*map(escape, _cells(row)))
        stdout.print(table)
    for note in run.notes:
        stdout.print(f"- {escape(note)}", soft_wrap=True, highlight=False)
    _show(run.findings)


def _cells(row: dict[str, Any]) -> list[str]:
    """An entry of the map in a few words each."""
    columns = row["columns"]
    names = "constant" if not columns else ", ".join(columns) if len(columns) < 4 else f"{columns[0]} … {columns[-1]} ({len(columns)})"
    between = "text" if row["low"] is None else f"{row['low']:.4g} … {row['high']:.4g}"
    rate = ""
    if row["rate_hz"]:
        rate = f"{row['rate_hz']:.4g} Hz" + (f", ±{100 * row['jitter']:.2g} %" if row["jitter"] > 1e-3 else "")
        rate += f", gap {row['longest_gap_s']:.2g} s" if row["longest_gap_s"] else ""
    driven = row["entry"].partition(".")[0] in ("pressure", "tension", "tip_force", "inputs")
    how = "" if not rate else "as commanded" if driven else "low-pass" if row["filtered"] else "interpolated"
    return [row["entry"], names, between, rate, how, f"{100 * row['lost']:.2g} %" if row["lost"] else ""]


@app.command()
def check(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Folder with dataset.toml and a CSV file a run.")],
    as_json: JsonOption = False,
) -> int:
    """Find wrong units, broken time, frozen, saturated and interchanged sensors, dropouts, spikes, starts not at rest.

    Where there are no such errors, simulations show mistakes of wiring, axes and units.

    Exit status: 0 no errors (warnings at most), 1 errors, 2 not readable at all.
    """
    with show_progress(as_json) as bars:
        run = tepm.run_check(dataset, bars)
    status = SOLVED if run.ok else UNSOLVED
    if as_json:
        print(json.dumps(run.summary(), indent=2))
        return status
    _show(run.findings, most=len(run.findings))
    counted = f"{run.errors} errors, {run.warnings} warnings" if run.findings else "nothing to complain of"
    stdout.print(f"{dataset}: {counted}", soft_wrap=True, highlight=False)
    return status


def _show(findings: tuple[Finding, ...], most: int = MOST) -> None:
    """A table of findings, errors first."""
    if not findings:
        return
    table = Table("", "file", "channel", "finding")
    for finding in sorted(findings, key=lambda found: found.severity)[:most]:
        colour = "red" if finding.severity == "error" else "yellow"
        table.add_row(f"[{colour}]{finding.severity}[/]", *(escape(t) for t in (finding.file, finding.channel, finding.message)))
    stdout.print(table)
    if len(findings) > most:
        stdout.print(f"… and {len(findings) - most} more: tepm data check says all", soft_wrap=True, highlight=False)


app.command("excite")(spread(excite))
app.command("next")(spread(next_run))
