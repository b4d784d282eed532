"""`tepm demo`: the main job in one command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from tepm_opt import plots
from tepm_opt.cli import gain as gain_command
from tepm_opt.cli import ik as ik_command
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, load, progress, report
from tepm_opt.data.files import output_folder
from tepm_opt.report import write_page
from tepm_opt.runs import run_gain, run_ik
from tepm_opt.solvers.allocation import Mode
from tepm_opt.solvers.trajectories import circle


def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("demo"),
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """The main job: the paper's circle, set points for every actuator, G at every point, figures and one HTML page."""
    folder, compiled, path = output_folder(out), load(robot, model), circle()
    coarse = run_ik(compiled, path, Mode.PRESSURE, track=progress("pressure alone", len(path.time), as_json))
    if coarse.interrupted:
        raise KeyboardInterrupt
    run = run_ik(compiled, path, Mode.HYBRID, track=progress("pressure and tension", len(path.time), as_json))
    run.save(folder)
    if run.interrupted:
        raise KeyboardInterrupt
    plots.save(plots.ik_figure(run), folder / "ik.png")
    gains = run_gain(compiled, run.setpoints(), track=progress("gain", len(path.time), as_json))
    gains.save(folder)
    workspace = gain_command.grid_map(compiled, as_json) if compiled.is_c else None  # minutes without a compiler
    if workspace is not None:
        gain_command.save_map(workspace, folder / "gain_map.csv")
    plots.save(plots.gain_figure(gains, gain_command.curves(compiled), workspace), folder / "gain.png")
    write_page(folder / "index.html", run, coarse, gains, {"ik": folder / "ik.png", "gain": folder / "gain.png"})
    summary = {"interrupted": gains.statics.interrupted, "ik": run.summary(), "ik_pressure": coarse.summary(), "gain": gains.summary()}
    page = escape(str(folder / "index.html"))
    text = [*ik_command.lines(run, out), *gain_command.lines(gains, out), f"open [bold]{page}[/]"]
    return report(summary, text, as_json, run.ok and gains.ok)
