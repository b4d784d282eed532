"""`tepm export`: what other programs read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

import tepm_opt as tepm
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, load, report, warn
from tepm_opt.cli.groups import TRAJECTORY_HELP, IkOptions, TrajectoryOptions, spread
from tepm_opt.cli.progress import show_progress
from tepm_opt.data.files import output_folder

app = typer.Typer(
    help="What other programs read: C, CasADi, MuJoCo, ROS, MCAP. (State space: tepm robot modes --out; tables: to_frame() in Python.)",
    no_args_is_help=True,
)


def _report_files(files: Sequence[Path], as_json: bool, hint: str, without: Mapping[str, str] | None = None) -> int:
    """Report the files that were written; return the exit status.

    Args:
        files: that were written.
        as_json: whether the summary alone is printed.
        hint: what to do with them.
        without: effects that are not in them, with the reason.
    """
    for label, reason in (without or {}).items():
        warn(f"without {label}: {reason}")
    summary = {"files": [str(file) for file in files], "without": dict(without or {})}
    names = ", ".join(file.name for file in files)
    return report(summary, [f"[bold]{escape(names)}[/] in {escape(str(files[0].parent))}", escape(hint)], as_json, ok=True)


def c(
    out: Annotated[Path, typer.Option("--out", help="Folder for the files.")] = Path("robot_c"),
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Statics, gain and motion in C: header, code without a library or memory of its own, example, CMakeLists.txt."""
    files = tepm.export_c(load(robot, model), out)
    return _report_files(files, as_json, "robot.h says how to call it; cmake -B build && cmake --build build && build/example < inputs.txt")


def casadi(
    out: Annotated[Path, typer.Option("--out", help="Folder for the files.")] = Path("robot_casadi"),
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Network, statics, gain and motion as CasADi's function files, for Python, C++, MATLAB and Octave."""
    files = tepm.export_casadi(load(robot, model), out)
    return _report_files(files, as_json, f"casadi.Function.load({str(out / 'statics.casadi')!r}); arguments and results have names")


def mjcf(
    out: Annotated[Path, typer.Option("--out", help="Folder for robot.xml.")] = Path("robot_mjcf"),
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Write the robot for MuJoCo, with the effects that MuJoCo can express; the others are left out and told."""
    compiled = load(robot, model)
    path = output_folder(out) / "robot.xml"
    left_out = tepm.export_mjcf(compiled, path)
    return _report_files([path], as_json, "controls are pressures in Pa, then tensions in N; the world is the tracker's frame G", left_out)


def urdf(
    out: Annotated[Path, typer.Option("--out", help="Folder for robot.urdf.")] = Path("robot_urdf"),
    robot: RobotOption = None,
    as_json: JsonOption = False,
) -> int:
    """Write the robot for ROS: rods through its reference points, for display."""
    from tepm_opt.exports.urdf import export_urdf

    path = output_folder(out) / "robot.urdf"
    export_urdf(tepm.load_robot(robot or "kang2017"), path)
    return _report_files([path], as_json, "examples/ros2 has a package that shows it; --ros of tepm mpc publishes its /joint_states")


def controller(
    path: Annotated[str, typer.Argument(metavar="TRAJ", help=TRAJECTORY_HELP)],
    which: TrajectoryOptions,
    kinematics: IkOptions,
    out: Annotated[Path, typer.Option("--out", help="Folder for the files.")] = Path("controller_c"),
    laps: Annotated[float, typer.Option("--laps", help="How often round a closed path.")] = 1.0,
    stay: Annotated[float | None, typer.Option("--stay", metavar="S", help="Point by point, S seconds each.")] = None,
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Write the predictive controller on a path in C: header, code, its data, example, CMakeLists.txt."""
    from tepm_opt.jobs.course import FULL

    targets, compiled = which.trajectory(path), load(robot, model)
    with show_progress(as_json) as bars:
        reference = tepm.whole_reference(compiled, targets, replace(FULL, laps=laps, stay=stay), kinematics.settings(), bars)
    files = tepm.export_controller(compiled, reference, out)
    return _report_files(
        files, as_json, "controller.h says how to call it; cmake -B build && cmake --build build; build/example reads samples"
    )


def mcap(
    source: Annotated[Path, typer.Argument(metavar="LOG", help="CSV file with time_s (log.csv, trajectory.csv …) or a data set's folder.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the files.")] = Path("mcap"),
    as_json: JsonOption = False,
) -> int:
    """Write logs and data sets for Foxglove, rerun and PlotJuggler."""
    return _report_files(tepm.export_mcap(source, out), as_json, "topics: /log with all columns, /points where there are reference points")


for command in (c, casadi, mjcf, urdf, controller, mcap):
    app.command(command.__name__)(spread(command))
