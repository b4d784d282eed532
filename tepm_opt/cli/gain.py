"""`tepm gain`: the open-loop gain matrix along set points."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

import tepm_opt as tepm
from tepm_opt import plots
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, load, report, unsolved_lines
from tepm_opt.cli.groups import WorkerOptions
from tepm_opt.cli.progress import show_progress
from tepm_opt.data.files import output_folder
from tepm_opt.errors import InputError, unknown_name

if TYPE_CHECKING:
    from tepm_opt.jobs.gain import GainRun


def lines(run: GainRun, out: Path) -> list[str]:
    """Summarize gain matrices in lines for the terminal."""
    summary = run.summary()
    rows = summary["normalised"]
    text = [f"[bold]G at {sum(row is not None for row in rows)} of {len(rows)}[/] operating points, files in {escape(str(out))}"]
    for kind, (low, high) in summary["singular_values_m_per_range"].items():
        text.append(f"{kind}: singular values {1e3 * low:.1f} … {1e3 * high:.1f} mm per full range")
    return text + unsolved_lines(summary)


def gain(
    inputs: Annotated[Path, typer.Argument(help="Set-point file, such as the inputs.csv of tepm ik.")],
    workers: WorkerOptions,
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("gain"),
    point: Annotated[str | None, typer.Option("--point", help="Reference point (s1 …); the tip where absent.")] = None,
    with_map: Annotated[bool, typer.Option("--map", help="Also map G over the workspace (some seconds).")] = False,
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Compute the open-loop gain matrix G of Eq. (6) at every row of a set-point file."""
    if workers.given and not with_map:
        raise InputError("--jobs and --scheduler are for --map; leave them out, or map the workspace")
    compiled = load(robot, model)
    names = compiled.layout.point_names
    if point is not None and point not in names:
        raise unknown_name("reference point", point, names)
    setpoints = tepm.read_setpoints(inputs, compiled.layout.actuator_names, compiled.input_max)
    folder = output_folder(out)
    with workers.open_executor() as executor, show_progress(as_json) as progress:
        run = tepm.run_gain(compiled, setpoints, names.index(point) if point else -1, with_map, progress, executor)
    run.save(folder)
    plots.draw(run, folder)
    return report(run.summary(), lines(run, out), as_json, run.ok)
