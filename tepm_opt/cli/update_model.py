"""`tepm update-model`: from a rig to a corrected model that steers it, in one command."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

import tepm_opt as tepm
from tepm_opt.cli import INTERRUPTED
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, folder_for, load, report, warn
from tepm_opt.cli.groups import TRAJECTORY_HELP, TrajectoryOptions
from tepm_opt.cli.progress import show_progress
from tepm_opt.cli.rigs import RigOption, SeedOption, opener, report_failure, robot_there, stopped_by_signals

PAGE = "closed.html"
PATHS = ("circle", "lissajous")


def _label(effect: Mapping[str, Any]) -> str:
    return f"{effect['name']}[{effect['detail']}]" if effect["detail"] else str(effect["name"])


def _gap(rmse: Mapping[str, float]) -> str:
    nominal, corrected, floor = (1e3 * rmse[name] for name in ("nominal", "corrected", "noise_floor"))
    return f"on validation runs: {nominal:.3g} mm nominal, {corrected:.3g} mm corrected (noise {floor:.3g} mm)"


def update_model(
    paths: Annotated[list[str] | None, typer.Argument(metavar="[TRAJ]...", help=TRAJECTORY_HELP, show_default="circle lissajous")] = None,
    rig: RigOption = "sim",
    out: Annotated[Path, typer.Option("--out", help="Folder for everything.")] = Path("closed"),
    plan: Annotated[Path | None, typer.Option("--plan", help="Plan file to record.", show_default="the standard plan")] = None,
    further: Annotated[
        int, typer.Option("--further", min=0, help="Further runs at most, asked for where effects cannot be told apart.")
    ] = 2,
    seed: SeedOption = 0,
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Record a rig, name what the model lacks, and steer with the corrected model: one page.

    What is finished in the folder is kept: the same command after an interruption goes on where it was. Exit status: 0 named or nothing
    missing, 1 indistinguishable or unexplained.
    """
    chosen = paths or list(PATHS)
    with folder_for(out) as folder:
        for path in chosen:
            TrajectoryOptions({}).trajectory(path)  # a wrong one is told before anything is compiled
        known = load(robot_there(robot, model, rig), model)
        targets = {Path(path).stem: TrajectoryOptions({}).trajectory(path, known) for path in chosen}
        planned = None if plan is None else tepm.read_plan(plan)
        opened = opener(rig, known.robot, seed)
        opened(seed)  # a rig that is not there is told before anything is computed
        try:
            with stopped_by_signals(), show_progress(as_json) as bars:
                task = tepm.UpdateTask(known.model, targets, planned, seed, further)
                done = tepm.run_model_update(task, tepm.RigSource(rig, opened), folder, bars, bars.ask)
        except KeyboardInterrupt:
            warn(f"interrupted: what is finished is in {out}; the same command goes on")
            return INTERRUPTED
        except (RuntimeError, OSError) as error:
            return report_failure(error, f"what is finished is in {out}; the same command goes on")
        tepm.write_model_update_page(folder / PAGE, done)
    told = done.summary()
    named = ", ".join(f"{_label(effect)} {effect['probability']:.2f}" for effect in told["effects"]) or "nothing"
    lines = [f"[bold]{told['status'][-1]}[/]: {escape(named)}", _gap(told["rmse_m"])]
    for path, errors in told["tip_error_m"].items():
        before, after = (f"{1e3 * value:.3g} mm" if value is not None else "nothing seen" for value in errors.values())
        lines.append(f"{escape(path)}: {before} rms with the nominal model, [bold]{after}[/] with the corrected one")
    return report(told, [*lines, f"{escape(str(out / PAGE))}"], as_json, done.ok)
