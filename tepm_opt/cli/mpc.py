"""`tepm mpc`: a closed loop on any rig."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from tepm_opt import plots
from tepm_opt.cli.common import INTERRUPTED, UNSOLVED, JsonOption, ModelOption, RobotOption, load, report, stderr
from tepm_opt.cli.ik import trajectory
from tepm_opt.cli.progress import shown
from tepm_opt.cli.rigs import RigOption, SeedOption, failed, opener, stopped_by_signals
from tepm_opt.cli.simulate import folder_for
from tepm_opt.control.controllers import DEFAULT, controllers
from tepm_opt.control.controllers.mpc import Use
from tepm_opt.control.reference import Reference
from tepm_opt.hw.rig import Command, Rig, Sample
from tepm_opt.jobs.closed_loop import LOG, ClosedLoop, LoopSetup
from tepm_opt.jobs.course import Course, whole_reference
from tepm_opt.jobs.mpc import Look, run_closed_loop
from tepm_opt.models.compile import CompiledModel
from tepm_opt.plots import control

COURSE = Course()
KINDS = "; ".join(f"{kind.name}: the {kind.description}" for kind in controllers())
FIGURES = {
    "path.png": lambda loop: control.path_figure({loop.setup.controller: loop}),
    "errors.png": control.error_figure,
    "inputs.png": control.inputs_figure,
    "times.png": control.times_figure,
}


@contextmanager
def live(wanted: bool, rig: Rig) -> Iterator[Look | None]:
    """The live view in rerun, where it is wanted.

    Raises:
        InputError: rerun is not installed.
    """
    if not wanted:
        yield None
        return
    from tepm_opt.hw.simulation.view import RerunStream

    stream = RerunStream("tepm mpc")

    def look(sample: Sample, command: Command) -> None:
        stream.show(sample, command, nodes=None if rig.simulated is None else rig.simulated.true_nodes)

    try:
        yield look
    finally:
        stream.close()


def draw(loop: ClosedLoop, folder: Path) -> None:
    """Figures into the folder."""
    for name, make in FIGURES.items():
        plots.save(make(loop), folder / name)


def error_line(told: dict[str, Any]) -> str:
    """The tip's errors in one line."""
    parts = []
    for kind, name in (("true", "true tip"), ("tracked", "tracked")):
        if found := told["errors"][kind]:
            parts.append(f"{name} [bold]{1e3 * found['rms_m']:.3g} mm[/] rms, {1e3 * found['largest_m']:.3g} mm at most")
    return "error: " + "; ".join(parts) if parts else "error: nothing that counts was tracked"


def lines(loop: ClosedLoop, out: Path) -> list[str]:
    """What a closed loop says to people."""
    told = loop.summary()
    where = f"files in {escape(str(out))}" if told["samples"] else "nothing to keep"
    text = [f"[bold]{told['controller']}[/]: {told['reached_s']:.2f} of {told['duration_s']:.2f} s, {told['samples']} samples, {where}"]
    if told["samples"]:
        text.append(error_line(told))
    if told["counted_samples"]:
        shares = [f"{100 * band['share_of_tension']:.0f} %" for band in told["actuation"] if band["share_of_tension"] is not None]
        bands = ", ".join(f"{band['from_Hz']:g}–{band['to_Hz']:g}" for band in told["actuation"])
        middle = told["mean_tension_of_mid_range"] or 0.0
        text.append(
            f"pressures: {told['pressure_moves_per_s']:.3g} moves a second; tensions: {middle:.2f} of mid-range on average; "
            f"their share of the power at {bands} Hz: {', '.join(shares)}"
        )
    if times := told["step_seconds"]:
        kept = sum(told["fallbacks"].values())
        late = f"; {kept} steps went on with an older plan" if kept else ""
        text.append(f"control step: median {1e3 * times['median']:.2g} ms, 99 % within {1e3 * times['percentile_99']:.2g} ms{late}")
    if told["interrupted"]:
        text.append("[yellow]interrupted: what was done is kept[/]")
    elif not loop.ok:
        text.append(f"[yellow]ended early: {escape(told['end'])}" + (f": {escape(told['message'])}" if told["message"] else "") + "[/]")
    return text


def mpc(
    path: Annotated[
        str,
        typer.Argument(metavar="TRAJ", help="circle, line, lissajous or a CSV file, such as reference.csv of tepm plan."),
    ],
    rig: RigOption = "sim",
    controller: Annotated[str, typer.Option("--controller", help=f"{KINDS}.")] = DEFAULT,
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("mpc"),
    duration: Annotated[float | None, typer.Option("--duration", help="Of the trajectory in s, where it has no time.")] = None,
    laps: Annotated[float, typer.Option("--laps", help="How often round a closed path.")] = 1.0,
    points: Annotated[int | None, typer.Option("--points", help="Number of points of the trajectory.")] = None,
    stay: Annotated[
        float | None, typer.Option("--stay", metavar="S", help="Point by point, S seconds each, of which the last third counts.")
    ] = None,
    radius: Annotated[float | None, typer.Option("--radius", help="Of circle and lissajous, m.")] = None,
    height: Annotated[float | None, typer.Option("--height", help="Of circle and lissajous, z in G, m.")] = None,
    start: Annotated[str | None, typer.Option("--from", help="Start of a line, x,y,z in m.")] = None,
    end: Annotated[str | None, typer.Option("--to", help="End of a line, x,y,z in m.")] = None,
    nonlinear: Annotated[bool, typer.Option("--nonlinear", help="MPC: linearised along its last plan, not about the reference.")] = False,
    rule: Annotated[bool, typer.Option("--rule", help="MPC: motors on only near the target, as in mode 2.")] = False,
    use: Annotated[str | None, typer.Option("--use", help="MPC: both, tension or pressure.", show_default=Use.BOTH.value)] = None,
    view: Annotated[bool, typer.Option("--view", help="Live 3-D view in rerun.")] = False,
    seed: SeedOption = 0,
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Follow a path, or points, in closed loop on a rig: log, figures, summary.

    A real robot is brought to the start slowly and refused if it is not where the model has it. The loop stops on a limit, a blind
    tracker or a tip that is far off, and with Ctrl-C.
    """
    given = {"rule": rule, "nonlinear": nonlinear, "use": use or ""}
    setup = LoopSetup.of(controller, rig, seed, {name: value for name, value in given.items() if value})
    targets = trajectory(path, points, duration, radius, height, start, end)
    with folder_for(out) as folder:
        compiled = load(robot, model)
        device = opener(rig, compiled.robot, seed)(seed)
        course = Course(COURSE.approach, COURSE.pause, laps, stay, COURSE.start_up, steps=setup.kind.jumps)
        with shown(as_json) as bars:
            reference = whole_reference(compiled, targets, course, bars)
        try:
            loop = _run(compiled, reference, device, setup, folder, view, as_json)
        except (RuntimeError, OSError) as error:
            return failed(error, "nothing was finished")
        try:
            if len(loop.time):
                draw(loop, folder)
        except KeyboardInterrupt:
            stderr.print(f"interrupted: {LOG} is in {escape(str(out))}, figures are not", style="yellow", soft_wrap=True, highlight=False)
            return INTERRUPTED
    status = report(loop.summary(), lines(loop, out), as_json, loop.ok)
    if as_json and status == UNSOLVED:
        stderr.print(f"ended early: {escape(loop.outcome.message)}", style="yellow", soft_wrap=True, highlight=False)
    return status


def _run(compiled: CompiledModel, reference: Reference, device: Rig, setup: LoopSetup, folder: Path, view: bool, quiet: bool) -> ClosedLoop:
    with stopped_by_signals(), live(view, device) as look, shown(quiet) as bars:
        return run_closed_loop(compiled, reference, device, setup, folder, progress=bars, look=look)
