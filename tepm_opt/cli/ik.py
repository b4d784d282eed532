"""`tepm ik`: set points for a trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.markup import escape

from tepm_opt import plots
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, load, progress, report, unsolved_lines, vector
from tepm_opt.data.files import output_folder
from tepm_opt.errors import InputError
from tepm_opt.jobs.runs import IkRun, run_ik
from tepm_opt.solvers.allocation import ActuationMode
from tepm_opt.solvers.trajectories import FARTHEST, Trajectory, circle, line, lissajous, read_trajectory

SHAPES = ("circle", "line", "lissajous")
LARGEST = {"duration": 1e6, "radius": FARTHEST, "height": FARTHEST, "start": FARTHEST, "end": FARTHEST}


def trajectory(
    name: str, points: int | None, duration: float | None, radius: float | None, height: float | None, start: str | None, end: str | None
) -> Trajectory:
    """A trajectory by built-in name or from a file, with the options given; the others keep their defaults.

    Raises:
        InputError: an option that does not fit the trajectory, or a wrong value.
    """
    options = {"duration": duration, "radius": radius, "height": height, "start": vector(start, "--from"), "end": vector(end, "--to")}
    given = {key: value for key, value in options.items() if value is not None}
    spelled = {"start": "from", "end": "to"}
    for key, value in given.items():
        positive = key in ("duration", "radius")
        if not (np.isfinite(value).all() and np.abs(value).max() <= LARGEST[key] and (not positive or value > 0)):
            low = "more than 0" if positive else f"-{LARGEST[key]:g}"
            raise InputError(f"--{spelled.get(key, key)} {value}; valid: {low} … {LARGEST[key]:g} {'s' if key == 'duration' else 'm'}")
    fits = {"line": {"duration", "start", "end"}, "circle": {"duration", "radius", "height"}, "lissajous": {"duration", "radius", "height"}}
    if misfits := sorted(given.keys() - fits.get(name, {"duration"})):
        raise InputError(f"option --{spelled.get(misfits[0], misfits[0])} does not fit trajectory {name!r}")
    if name in SHAPES:
        make = {"circle": circle, "line": line, "lissajous": lissajous}[name]
        return make(**given, **({} if points is None else {"points": points}))  # type: ignore[arg-type]
    if not name.endswith(".csv"):
        raise InputError(f"unknown trajectory {name!r}: valid: {', '.join(SHAPES)} or a .csv file")
    path = read_trajectory(name, **given)  # type: ignore[arg-type]
    return path if points is None else path.resampled(points)


def lines(run: IkRun, out: Path) -> list[str]:
    """What a run says to people."""
    summary = run.summary()
    text = [f"[bold]{summary['solved']} of {summary['points']}[/] points solved in {run.mode.value} mode, files in {escape(str(out))}"]
    if summary["solved"]:
        text.append(
            f"tip error {1e3 * summary['largest_tip_error_m']:.2e} mm at most, "
            f"{1e3 * summary['largest_rounded_tip_error_m']:.3f} mm with set points on the actuators' grids"
        )
    return text + unsolved_lines(summary)


def ik(
    path: Annotated[str, typer.Argument(metavar="TRAJECTORY", help="circle, line, lissajous or a CSV file with x, y, z in m in frame G.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("ik"),
    mode: Annotated[
        ActuationMode, typer.Option("--mode", help="Pressure alone, or coarse pressure and fine tension.")
    ] = ActuationMode.HYBRID,
    points: Annotated[int | None, typer.Option("--points", help="Number of points; files are resampled.")] = None,
    duration: Annotated[float | None, typer.Option("--duration", help="Duration in s where the trajectory has no time.")] = None,
    radius: Annotated[float | None, typer.Option("--radius", help="Of circle and lissajous, m.")] = None,
    height: Annotated[float | None, typer.Option("--height", help="Of circle and lissajous, z in G, m.")] = None,
    start: Annotated[str | None, typer.Option("--from", help="Start of a line, x,y,z in m.")] = None,
    end: Annotated[str | None, typer.Option("--to", help="End of a line, x,y,z in m.")] = None,
    tip_force: Annotated[str | None, typer.Option("--tip-force", help="Known force on the tip in G, x,y,z in N.")] = None,
    mid_tension: Annotated[float | None, typer.Option("--mid-tension", help="Tension the hybrid mode stays about, N.")] = None,
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Solve the equal-curvature inverse kinematics of a trajectory: set points, shapes, lengths, figure."""
    targets = trajectory(path, points, duration, radius, height, start, end)
    force = vector(tip_force, "--tip-force")
    folder = output_folder(out)
    compiled = load(robot, model)
    highest = compiled.robot.actuation.tension_max_N
    if mid_tension is not None and not 0 <= mid_tension <= highest:
        raise InputError(f"--mid-tension {mid_tension:g}; valid: 0 … {highest:g} N")
    run = run_ik(compiled, targets, mode, force, mid_tension, progress("inverse kinematics", len(targets.time), as_json))
    run.save(folder)
    if run.configurations:
        plots.save(plots.ik_figure(run), folder / "ik.png")
    return report(run.summary(), lines(run, out), as_json, run.ok)
