"""`tepm simulate`: the motion under a file's inputs, as tables, figures and a film."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

import tepm_opt as tepm
from tepm_opt import plots
from tepm_opt.cli import INTERRUPTED
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, folder_for, load, report, show_compiling, stderr, warn
from tepm_opt.cli.progress import show_progress
from tepm_opt.errors import InputError, unknown_name

if TYPE_CHECKING:
    from tepm_opt.jobs.simulate import SimulateRun
    from tepm_opt.models.compile import CompiledModel
    from tepm_opt.plots.film import Kind
    from tepm_opt.progress import Progress
    from tepm_opt.solvers.mechanics.simulate import Directions, Method

SHORTEST, LONGEST = 0.02, 1000.0  # ms; a step that was meant in s is below
FINEST, COARSEST = 1e-4, 10.0  # mm


def sensitivities(names: str | None, model: CompiledModel, method: str) -> Directions | None:
    """Directions of --sensitivities: parameters by full name and inputs ("pressure_11").

    Raises:
        InputError: an unknown name, or a method that has no sensitivities.
    """
    if names is None:
        return None
    if method != "implicit":
        raise InputError(f"--sensitivities needs --method implicit; found: {method}")
    wanted = list(dict.fromkeys(name.strip() for name in names.split(",")))
    inputs = [name for name in wanted if name.startswith(("pressure_", "tension_")) and name not in model.values]
    return tepm.Directions.from_names(model, [name for name in wanted if name not in inputs], inputs)


def lines(run: SimulateRun, out: Path, took: float, film: Path | None) -> list[str]:
    """Summarize a simulation in lines for the terminal.

    Args:
        run: the simulation.
        out: folder of its files.
        took: time of the computation in s.
        film: path of the film; None where none was drawn.
    """
    told = run.summary()
    where = f", files in {escape(str(out))}" if told["simulated"] else ", nothing to keep"
    speed = f", {told['reached_s'] / took:.3g} times as fast as real time" if told["reached_s"] and took > 0 else ""
    text = [f"[bold]{told['reached_s']:.4g} of {told['duration_s']:.4g} s[/] simulated{speed}{where}"]
    text.append(
        f"{told['method']}: {told['steps']} steps of at most {1e3 * told['step_s']:.4g} ms, {told['halvings']} of them taken shorter"
        + (f", {told['iterations']} Newton iterations" if told["method"] == "implicit" else "")
        + ("" if told["estimated_error_m"] is None else f", error about [bold]{1e3 * told['estimated_error_m']:.2g} mm[/] or less")
    )
    if measured := told.get("measured"):
        points = ", ".join(f"{name} {1e3 * value:.3g}" for name, value in measured["point_error_rms_m"].items() if value is not None)
        text.append(
            f"against the measured points, Eq. (5): [bold]{1e3 * measured['error_rms_m']:.3g} mm[/] RMS, "
            f"{1e3 * measured['largest_error_m']:.3g} mm at most; by point in mm: {points}"
        )
    for name, change in told.get("largest_tip_change_by_1_percent_m", {}).items():
        text.append(f"{escape(name)}: 1 % (of an input: of its range) moves the tip by up to {1e3 * change:.3g} mm")
    if run.hold:
        from tepm_opt.jobs.simulate import TRAJECTORY

        text.append(f"in {TRAJECTORY} inputs hold until the next row; read as a run of a data set they would change linearly")
    if film is not None:
        text.append(f"film: {escape(str(film))}, {film.stat().st_size / 1e6:.1f} MB{_smaller(film)}")
    return text + (["[yellow]interrupted: what was finished is kept[/]"] if run.interrupted else [])


def _smaller(film: Path) -> str:
    """Suggest a way to a smaller film; empty where there is none."""
    from tepm_opt.plots.film import INSTALL, find_ffmpeg

    if film.suffix != ".gif":
        return ""
    return "; --animation mp4 makes a smaller one" if find_ffmpeg() else f"; with ffmpeg it is a far smaller MP4: {escape(INSTALL)}"


def simulate(
    inputs: Annotated[Path, typer.Argument(metavar="INPUTS", help="Set-point file, or a run of a data set to compare with.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("simulate"),
    method: Annotated[str, typer.Option("--method", help="implicit, or rk4 (the paper's).")] = "implicit",
    step: Annotated[
        float | None, typer.Option("--step", metavar="MS", help="Longest step in ms.", show_default="adaptive; safe for rk4")
    ] = None,
    error: Annotated[
        float | None, typer.Option("--error", metavar="MM", help="Error at which adaptive steps aim in mm.", show_default="0.1")
    ] = None,
    hold: Annotated[bool, typer.Option("--hold", help="A row holds until the next one, instead of changing linearly.")] = False,
    by: Annotated[
        str | None, typer.Option("--sensitivities", metavar="NAMES", help="Parameters or inputs, by commas: K_a,c_a,pressure_11.")
    ] = None,
    film: Annotated[
        str | None, typer.Option("--animation", help="mp4, gif or none.", show_default="mp4 where ffmpeg is found, else gif")
    ] = None,
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Simulate the motion under a file's inputs: trajectory (a run of a data set), lengths, figures, film."""
    from tepm_opt.jobs.simulate import LENGTHS, TRAJECTORY
    from tepm_opt.plots.film import choose
    from tepm_opt.solvers.mechanics.simulate import METHODS

    if method not in METHODS:
        raise unknown_name("method", method, METHODS)
    if step is not None and not SHORTEST <= step <= LONGEST:
        raise InputError(f"--step {step:g}; valid: {SHORTEST:g} … {LONGEST:g} ms")
    if error is not None and not FINEST <= error <= COARSEST:
        raise InputError(f"--error {error:g}; valid: {FINEST:g} … {COARSEST:g} mm")
    if error is not None and (step is not None or method != "implicit"):
        raise InputError("--error: steps adapt to it with --method implicit and without --step")
    kind = choose(film)
    chosen: Method = "rk4" if method == "rk4" else "implicit"
    compiled = load(robot, model)
    directions = sensitivities(by, compiled, chosen)
    task = replace(tepm.read_task(inputs, compiled), hold=hold, directions=directions)
    if hold and task.measured is not None:
        raise InputError(f"--hold: {inputs} has measured points, and inputs of recorded runs change linearly between samples")
    if inputs.resolve() in {(out / name).resolve() for name in (TRAJECTORY, LENGTHS)}:
        raise InputError(f"--out {out}: {inputs} would be overwritten; name another folder")
    with show_compiling("the motion"):
        _ = compiled.stepper  # here, so that it does not count as simulating
    kept = "nothing was finished"
    try:
        with folder_for(out) as folder, show_progress(as_json) as progress:
            began = time.perf_counter()
            longest, aim = (None if value is None else 1e-3 * value for value in (step, error))
            run = tepm.run_simulation(compiled, task, chosen, longest, aim, progress)
            took = time.perf_counter() - began
            run.save(folder)
            kept = f"the tables are in {out}"
            progress("drawing", 0, 0)
            plots.draw(run, folder)
            made, whole = _film(run, folder, kind, progress)
    except KeyboardInterrupt:
        warn(f"interrupted: {kept}")
        return INTERRUPTED
    if run.failure:
        stderr.print(f"[bold red]error:[/] {escape(run.failure)}; kept until then", soft_wrap=True, highlight=False)
    status = report(run.summary(), lines(run, out, took, made), as_json, run.ok)
    if whole:
        return status
    warn("interrupted: the film ends early")
    return INTERRUPTED


def _film(run: SimulateRun, folder: Path, kind: Kind, progress: Progress) -> tuple[Path | None, bool]:
    """The film's path, none where it is not wanted, and whether it was not interrupted; an earlier film goes."""
    from tepm_opt.plots import film

    if not len(run.places):
        return None, True
    for name in film.NAMES.values():
        (folder / name).unlink(missing_ok=True)
    if kind == "none" or run.interrupted:
        return None, True
    return film.save(run.simulation, folder, kind, progress)
