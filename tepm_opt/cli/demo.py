"""`tepm demo`: the main job in one command."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from tepm_opt import plots
from tepm_opt.cli import gain as gain_command
from tepm_opt.cli import ik as ik_command
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, load, progress, report, stderr
from tepm_opt.control.controllers import DEFAULT, find_controller
from tepm_opt.data.files import output_folder
from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.rigfile import RigFile, load_rig_file
from tepm_opt.jobs.closed_loop import ClosedLoop, LoopSetup
from tepm_opt.jobs.compare import LoopTask, compare
from tepm_opt.jobs.course import Course
from tepm_opt.jobs.runs import IkRun, run_gain, run_ik, save_summary
from tepm_opt.models.compile import CompiledModel
from tepm_opt.plots import control
from tepm_opt.report import write_page
from tepm_opt.solvers.allocation import ActuationMode
from tepm_opt.solvers.trajectories import Trajectory, circle

CONTROLLERS = (DEFAULT, "mode2", "mode1")  # the one that takes longest first
NAMES = {name: find_controller(name).title for name in reversed(CONTROLLERS)}
COURSE = Course()
SEED = 1
OF_ANY_ROBOT = ("time_delay", "regulator_lag")  # imperfections


def rig_of(model: CompiledModel) -> RigFile:
    """The virtual prototype; for other robots than its own one with its devices, built exactly as the robot file says.

    Raises:
        InputError: the robot's file cannot be found again.
    """
    prototype = load_rig_file()
    if model.robot.model_copy(update={"name": prototype.nominal.name}) == prototype.nominal:
        return prototype
    described = prototype.model_dump(exclude={"parameter_factors", "imperfections"})
    kept = prototype.imperfections.model_dump(include=set(OF_ANY_ROBOT))
    return RigFile.model_validate({**described, "name": model.robot.name, "robot": model.model.source, "imperfections": kept})


def closed_loops(model: CompiledModel, path: Trajectory, run: IkRun, quiet: bool) -> tuple[dict[str, ClosedLoop], str]:
    """The closed loops by their names, or why there are none."""
    if not run.ok:
        return {}, "not all points of the circle were solved"
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    try:
        tasks = [LoopTask(model.model, path, COURSE, rig_of(model), LoopSetup(controller, seed=SEED)) for controller in CONTROLLERS]
        with Progress(*columns, console=stderr, transient=True, disable=quiet or not stderr.is_terminal) as bar:
            shown = {name: bar.add_task(f"closed loop, {NAMES[name]}", total=None) for name in CONTROLLERS}

            def show(stage: str, done: float, of: float) -> None:
                bar.update(shown[stage], completed=done, total=of)  # type: ignore[arg-type]

            found = compare(tasks, os.cpu_count() or 1, show)
    except (InputError, RuntimeError) as error:
        return {}, " ".join(str(error).split())
    by_controller = {loop.setup.controller: loop for loop in found}
    return {NAMES[name]: by_controller[name] for name in NAMES if name in by_controller}, ""


def lines(loops: dict[str, ClosedLoop], note: str) -> list[str]:
    """What the closed loops say to people."""
    if not loops:
        return [f"[yellow]no closed loop: {escape(note)}[/]"]
    errors = ", ".join(f"{name} {1e3 * loop.rms(true=True):.3g}" for name, loop in loops.items())
    return [f"closed loop on the simulated rig, tip error rms in mm: [bold]{errors}[/]"]


def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("demo"),
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """The main job: the paper's circle, set points for every actuator, G at every point, closed loops, figures and one HTML page."""
    folder, compiled, path = output_folder(out), load(robot, model), circle()
    coarse = run_ik(compiled, path, ActuationMode.PRESSURE, track=progress("pressure alone", len(path.time), as_json))
    if coarse.interrupted:
        raise KeyboardInterrupt
    run = run_ik(compiled, path, ActuationMode.HYBRID, track=progress("pressure and tension", len(path.time), as_json))
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
    loops, note = closed_loops(compiled, path, run, as_json)
    told = {name: loop.summary(timing=False) for name, loop in loops.items()}
    save_summary(folder, "closed_loop", told)
    figures = {"ik": folder / "ik.png", "gain": folder / "gain.png", **_draw(loops, folder)}
    write_page(folder / "index.html", run, coarse, gains, loops, note, figures)
    summary = {"interrupted": gains.statics.interrupted, "ik": run.summary(), "ik_pressure": coarse.summary(), "gain": gains.summary()}
    page = escape(str(folder / "index.html"))
    text = [*ik_command.lines(run, out), *gain_command.lines(gains, out), *lines(loops, note), f"open [bold]{page}[/]"]
    good = bool(loops) and all(loop.ok for loop in loops.values())
    return report({**summary, "closed_loop": told}, text, as_json, run.ok and gains.ok and good)


def _draw(loops: dict[str, ClosedLoop], folder: Path) -> dict[str, Path]:
    """Figures of the closed loops, by their names on the page; earlier ones go where there are none."""
    made = {name: folder / f"loop_{name}.png" for name in ("path", "distance", "inputs")}
    if not loops:
        for path in made.values():
            path.unlink(missing_ok=True)
        return {}
    plots.save(control.path_figure(loops), made["path"])
    plots.save(control.distance_figure(loops), made["distance"])
    plots.save(control.inputs_figure(loops[NAMES[DEFAULT]]), made["inputs"])
    return made
