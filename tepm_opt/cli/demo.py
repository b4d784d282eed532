"""`tepm demo`: the main job in one command."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

import tepm_opt as tepm
from tepm_opt import plots
from tepm_opt.cli import gain, ik
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, load, report
from tepm_opt.cli.progress import show_progress
from tepm_opt.data.files import output_folder

if TYPE_CHECKING:
    from tepm_opt.jobs.demo import DemoRun

PAGE = "index.html"


def lines(run: DemoRun, out: Path) -> list[str]:
    """Summarize a demo in lines for the terminal."""
    loops = run.summary()["closed_loop"]
    errors = ", ".join(f"{name} {1e3 * loop['errors']['true']['rms_m']:.3g}" for name, loop in loops.items() if loop["errors"]["true"])
    answer = f"closed loop on the simulated rig, tip error rms in mm: [bold]{errors}[/]"
    return [
        answer if loops else f"[yellow]no closed loop: {escape(run.note)}[/]",
        *(ik.lines(run.hybrid, out) if run.hybrid else ()),
        *(gain.lines(run.gains, out) if run.gains else ()),
        f"open [bold]{escape(str(out / PAGE))}[/]",
    ]


def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("demo"),
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """The main job: the paper's circle, set points for every actuator, G at every point, closed loops, figures and one HTML page."""
    folder, compiled = output_folder(out), load(robot, model)
    with show_progress(as_json) as progress:
        run = tepm.run_demo(compiled, progress=progress)
    run.save(folder)
    if run.interrupted:
        raise KeyboardInterrupt
    tepm.write_page(folder / PAGE, run, plots.draw(run, folder))
    return report(run.summary(), lines(run, out), as_json, run.ok)
