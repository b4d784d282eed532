"""`tepm ik`: set points for a trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

import tepm_opt as tepm
from tepm_opt import plots
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, given_force, load, report, unsolved_lines, vector
from tepm_opt.cli.groups import TRAJECTORY_HELP, IkOptions, TrajectoryOptions
from tepm_opt.cli.progress import show_progress
from tepm_opt.data.files import output_folder
from tepm_opt.errors import InputError
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode

if TYPE_CHECKING:
    from tepm_opt.jobs.ik import IkRun


def lines(run: IkRun, out: Path) -> list[str]:
    """Summarize inverse kinematics in lines for the terminal."""
    summary = run.summary()
    text = [f"[bold]{summary['solved']} of {summary['points']}[/] points solved in {run.mode.value} mode, files in {escape(str(out))}"]
    if summary["solved"]:
        text.append(
            f"tip error {1e3 * summary['largest_tip_error_m']:.2e} mm at most, "
            f"{1e3 * summary['largest_rounded_tip_error_m']:.3f} mm with set points on the actuators' grids"
        )
    return text + unsolved_lines(summary)


def ik(
    path: Annotated[str, typer.Argument(metavar="TRAJECTORY", help=TRAJECTORY_HELP)],
    which: TrajectoryOptions,
    kinematics: IkOptions,
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("ik"),
    mode: Annotated[
        ActuationMode, typer.Option("--mode", help="Pressure alone, or coarse pressure and fine tension.")
    ] = ActuationMode.HYBRID,
    tip_force: Annotated[str | None, typer.Option("--tip-force", help="Known force on the tip in G, x,y,z in N.")] = None,
    mid_tension: Annotated[float | None, typer.Option("--mid-tension", help="Tension the hybrid mode stays about, N.")] = None,
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Solve the equal-curvature inverse kinematics of a trajectory: set points, shapes, lengths, figure."""
    which.trajectory(path)  # a wrong one is told before anything is compiled
    vector(tip_force, "--tip-force")
    folder = output_folder(out)
    compiled = load(robot, model)
    force = given_force(compiled, tip_force)
    highest = compiled.robot.actuation.tension_max_N
    if mid_tension is not None and not 0 <= mid_tension <= highest:
        raise InputError(f"--mid-tension {mid_tension:g}; valid: 0 … {highest:g} N")
    targets = which.trajectory(path, compiled)
    with show_progress(as_json) as progress:
        run = tepm.run_ik(compiled, targets, mode, force, mid_tension, kinematics.settings(), progress)
    run.save(folder)
    plots.draw(run, folder)
    return report(run.summary(), lines(run, out), as_json, run.ok)
