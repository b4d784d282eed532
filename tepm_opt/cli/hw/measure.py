"""`tepm hw measure tracker`: noise and latency of a tracker, for the robot file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

import tepm_opt as tepm
from tepm_opt.cli.common import SOLVED, JsonOption, ModelOption, RobotOption, stdout
from tepm_opt.cli.hw.shared import STOPPED, YesOption, confirm, safely, say
from tepm_opt.cli.progress import show_progress
from tepm_opt.cli.rigs import RigOption, SeedOption, opener, robot_there
from tepm_opt.errors import InputError

if TYPE_CHECKING:
    from tepm_opt.models.robot import Robot
    from tepm_opt.recording.tracker import TrackerMeasurement

app = typer.Typer(help="Measure devices of the robot and write what was found into the robot file.", no_args_is_help=True)


@app.callback()
def measure() -> None:
    """Measure devices of the robot and write what was found into the robot file."""


@app.command()
def tracker(
    rig: RigOption = "sim",
    robot: RobotOption = None,
    model: ModelOption = None,
    actuator: Annotated[
        str | None, typer.Option("--actuator", help="Name of the one that moves, such as 21.", show_default="first of the last module")
    ] = None,
    pressure: Annotated[bool, typer.Option("--pressure", help="Move its muscle, not its tendon.")] = False,
    rest: Annotated[float, typer.Option("--rest", min=1.0, max=600.0, metavar="S", help="Seconds at rest.")] = 5.0,
    write: Annotated[bool, typer.Option("--write", help="Write noise and latency into the robot file.")] = False,
    seed: SeedOption = 0,
    yes: YesOption = False,
    as_json: JsonOption = False,
) -> int:
    """Noise of the tracker at rest, and its latency, from a slow sine of one tendon that the model follows, too."""
    from tepm_opt.hw.service.line import actuators_of
    from tepm_opt.models.layout import Layout
    from tepm_opt.models.robot import builtin_robots
    from tepm_opt.recording.tracker import evaluate_tracker, record_tracker

    name = robot_there(robot, model, rig)
    if write and (name is None or name in builtin_robots()):
        raise InputError(f"--write: {name or 'a model'} is no robot file; valid: --robot with the file to write into")
    compiled = tepm.compile_model(tepm.read_model(model) if model else str(name))
    found = compiled.robot
    names = Layout.from_robot(found).actuator_names
    which = actuators_of(actuator or names[-found.actuators], names)[0]
    pressure = pressure or found.actuation.tension_max_N <= 0

    def work() -> int:
        opened = opener(rig, found, seed)(seed)
        if opened.simulated is None and not rig.startswith("replay:"):
            kind = "muscle" if pressure else "tendon"
            confirm(f"This moves the robot: {kind} {names[which]} swings slowly, up to two fifths of its largest input.", yes)
        with show_progress(as_json) as progress:
            measured = evaluate_tracker(record_tracker(opened, found, which, pressure, rest, progress), compiled, progress)
        written = _write(measured, found, Path(str(name))) if write else {}
        if as_json:
            print(json.dumps(measured.summary() | {"written": written}, indent=2))
            return SOLVED
        _print(measured)
        for table, numbers in (written or _parts(measured, found)).items():
            pairs = ", ".join(f"{key} = {value:g}" for key, value in numbers.items())
            say(f"{'written into' if written else 'for'} [{table}]{f' of {name}' if written else ''}: {pairs}")
        return SOLVED

    return safely(work, STOPPED, STOPPED)


def _parts(measured: TrackerMeasurement, robot: Robot) -> dict[str, dict[str, float]]:
    """Numbers for tables of the robot file: what the controller expects, and how much older poses are than their stamps.

    Raises:
        InputError: a latency that no robot file may have.
    """
    parts = {"tracker": {"noise_rms_m": float(f"{measured.noise_rms_m:.3g}"), "latency_s": round(measured.latency_s, 4)}}
    link = robot.hardware.tracker if robot.hardware else None
    if link is not None and measured.stamps_are_off:
        parts["hardware.tracker"] = {"latency_s": round(link.latency_s + measured.correction_s, 4)}
    for table, numbers in parts.items():
        if not 0 <= numbers["latency_s"] <= 1:
            raise InputError(f"[{table}] latency_s = {numbers['latency_s']:g}: measured, but no latency; valid: 0 … 1 s")
    return parts


def _write(measured: TrackerMeasurement, robot: Robot, path: Path) -> dict[str, dict[str, float]]:
    """Put the numbers into the robot file, and give them back."""
    from tepm_opt.data.files import write_atomically
    from tepm_opt.data.tomltext import with_numbers
    from tepm_opt.models.robot import parse_robot

    text, parts = path.read_text(encoding="utf-8"), _parts(measured, robot)
    for table, numbers in parts.items():
        text = with_numbers(text, table, numbers, str(path))
    parse_robot(text, str(path))
    write_atomically(path, text)
    return parts


def _print(measured: TrackerMeasurement) -> None:
    found = measured.summary()
    say(f"noise {1e3 * measured.noise_rms_m:.3g} mm rms (3-D), latency {1e3 * measured.latency_s:.1f} ms", "bold")
    table = Table("quantity", "value")
    for number, noise in enumerate(found["noise_by_point_m"], start=1):
        table.add_row(f"noise of s{number}", "not seen" if noise is None else f"{1e3 * noise:.3g} mm rms")
    table.add_row("frames a second", f"{measured.rate_Hz:.4g} Hz")
    table.add_row("points lost at rest", f"{100 * measured.lost:.2g} %")
    table.add_row("age by the time stamps", f"{1e3 * measured.age_s:.1f} ms")
    table.add_row("error of the time stamps by the model", f"{1e3 * measured.offset_s:.1f} ± {1e3 * measured.offset_std_s:.1f} ms")
    table.add_row("of which corrected", f"{1e3 * measured.correction_s:.1f} ms")
    table.add_row("coordinates that the model leaves", f"{1e3 * measured.residual_m:.3g} mm rms")
    stdout.print(table)
    if not measured.stamps_are_off:
        say("The motion does not contradict the time stamps; an identified model (--model) tells more.")
