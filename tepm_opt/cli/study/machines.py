"""`tepm study machines`: a controller on many random machines."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from tepm_opt import studies
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, folder_for, load, report
from tepm_opt.cli.driving import DriveOptions
from tepm_opt.cli.groups import TRAJECTORY_HELP, IkOptions, TrajectoryOptions, WorkerOptions
from tepm_opt.cli.progress import show_progress
from tepm_opt.cli.rigs import SeedOption, stopped_by_signals

if TYPE_CHECKING:
    from tepm_opt.studies import MachinesRun


def format_lines(run: MachinesRun, out: Path) -> list[str]:
    """Lines for people: errors of a controller on random machines."""
    told, family = run.summary(), run.family
    text = [f"[bold]{told['controller']}[/] on {family.machines} random machines of seed {family.seed}, files in {escape(str(out))}"]
    if told["mean_m"] is not None:
        text.append(
            f"error of the true tip, rms: mean [bold]{1e3 * told['mean_m']:.3g} mm[/], worst {1e3 * told['worst_m']:.3g} mm "
            f"(machine {told['worst_machine']}); {100 * told['share_within']:.0f} % within {1e3 * run.bound:g} mm"
        )
    if (least := told["smallest_distance_m"]) is not None:
        text.append(f"smallest true distance to obstacles: mean {1e3 * least['mean']:.3g} mm, worst {1e3 * least['worst']:.3g} mm")
    return text if run.ok else [*text, f"[yellow]{escape(run.outcome.message)}[/]"]


def machines(
    path: Annotated[str, typer.Argument(metavar="TRAJ", help=TRAJECTORY_HELP)],
    which: TrajectoryOptions,
    kinematics: IkOptions,
    workers: WorkerOptions,
    drive: DriveOptions,
    count: Annotated[int, typer.Option("--machines", min=1, metavar="N", help="How many; --seed draws them.")] = 30,
    noises: Annotated[int, typer.Option("--noises", min=1, help="How often each machine is driven, with other noise.")] = 2,
    bound: Annotated[float, typer.Option("--bound", min=0.0, metavar="MM", help="Error within which a run is good.")] = 3.0,
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("machines"),
    seed: SeedOption = 0,
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Follow a path, or points, in closed loop on random machines around the robot file: mean and worst error, figure, summary.

    The controller knows the robot file alone. The exit status is 1 where a run ended early.
    """
    drive.check()
    setup = drive.setup("sim", seed)
    which.trajectory(path)  # a wrong one is told before anything is compiled
    with folder_for(out) as folder:
        compiled = load(robot, model)
        targets, course = which.trajectory(path, compiled), drive.course(setup)
        family = studies.Family(count, noises, seed)
        task = studies.DriveTask(compiled.model, targets, course, setup, family, kinematics.settings())
        with stopped_by_signals(), workers.open_executor() as executor, show_progress(as_json) as bars:
            run = studies.run_machines(task, bound / 1e3, executor, bars)
        run.save(folder)
        studies.draw_machines(run, folder)
    return report(run.summary(), format_lines(run, out), as_json, run.ok)
