"""`tepm hw calibrate pressure|tension|base|camera`: measured lines and the base's place, as lines to put into a robot file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tepm_opt.cli.common import SOLVED, RobotOption, stderr
from tepm_opt.cli.hw import shared
from tepm_opt.cli.hw.camera import camera
from tepm_opt.cli.hw.shared import STOPPED, PortArgument, YesOption, confirm, safely, say
from tepm_opt.cli.progress import show_progress
from tepm_opt.data.files import write_atomically
from tepm_opt.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from tepm_opt.hw.board.rig import SerialRig
    from tepm_opt.hw.service.calibrate import CalibrationFit
    from tepm_opt.hw.service.moves import Single
    from tepm_opt.hw.service.registration import Registration
    from tepm_opt.models.robot import Robot

AVERAGED_S = 1.0
"""Seconds over which readings are averaged."""
app = typer.Typer(help="Measure calibration lines and the base's place; prints what to put into the robot file.", no_args_is_help=True)
app.command()(camera)
ActuatorOption = Annotated[str, typer.Option("--actuator", help="Name such as 11; several by commas, or all.")]
OutOption = Annotated[Path | None, typer.Option("--out", help="File for the TOML lines; printed without it. Never overwritten.")]


@app.command()
def tension(
    port: PortArgument,
    actuator: ActuatorOption,
    weights: Annotated[str, typer.Option("--weights-g", help="Masses to hang on, g, increasing, by commas.")] = "0,100,200,500",
    out: OutOption = None,
    robot: RobotOption = None,
) -> int:
    """Dynamometers: hang weights on, one after the other. Nothing moves."""
    import numpy as np

    from tepm_opt.hw.service import calibrate
    from tepm_opt.models.layout import Layout

    found, which = _load_robot_and_actuators(robot, actuator, out)
    most = 1e3 * found.actuation.tension_max_N / calibrate.STANDARD_GRAVITY
    masses = calibrate.parse_increasing(weights, "--weights-g", 0, most, "g (the robot's largest tension)")
    names = Layout.from_robot(found).actuator_names

    def work() -> int:
        line = shared.open_line(port)
        link = line.link()
        lines: dict[int, CalibrationFit] = {}
        try:
            link.hello()
            for k in which:
                counts = []
                for mass in masses:
                    what = f"hang {mass:g} g on" if mass else "take all weight off"
                    shared.ask(f"Dynamometer {names[k]}: {what}, let it rest, then press Enter:")
                    link.listen()
                    taken = calibrate.collect(link, AVERAGED_S).dynamometers
                    counts.append(taken.mean(axis=0))
                    noise = taken[:, k].std()
                    stderr.print(f"  {mass:g} g: {counts[-1][k]:.1f} counts, standard deviation {noise:.1f}", highlight=False)
                calibrate.refuse_mixed_up(np.ptp(counts, axis=0), k, names, "dynamometer")
                lines[k] = calibrate.fit_line(np.array(masses) * 1e-3 * calibrate.STANDARD_GRAVITY, np.array(counts)[:, k])
        finally:
            link.close()
        part = calibrate.tension_part(found, lines)
        notes = [_words(f"dynamometer {names[k]}", fit, "counts", "N", 1.0, "N") for k, fit in lines.items()]
        return _give({"hardware.tension": part}, notes, "tension", out, _firmware(robot, port))

    return safely(work, "nothing was moved", "nothing was moved")


@app.command()
def pressure(
    port: PortArgument,
    actuator: ActuatorOption,
    at: Annotated[str, typer.Option("--at-kPa", help="Pressures to drive, kPa, increasing, by commas.")] = "0,100,200,300",
    gauge: Annotated[bool, typer.Option("--gauge", help="Ask for the reading of a gauge at each; fits the commands, too.")] = False,
    out: OutOption = None,
    robot: RobotOption = None,
    yes: YesOption = False,
) -> int:
    """Regulators and their monitors: drives pressures, one actuator after the other, and reads the monitors."""
    import numpy as np

    from tepm_opt.hw.service import calibrate, moves
    from tepm_opt.models.layout import Layout

    found, which = _load_robot_and_actuators(robot, actuator, out)
    levels = calibrate.parse_increasing(at, "--at-kPa", 0, found.actuation.pressure_max_Pa / 1e3, "kPa")
    names = Layout.from_robot(found).actuator_names

    def work() -> int:
        confirm(f"This moves the robot: {', '.join(names[k] for k in which)} go to {levels[-1]:g} kPa, one after the other.", yes)
        line = shared.open_line(port)
        monitors: dict[int, CalibrationFit] = {}
        commands: dict[int, CalibrationFit] = {}
        with line.rig(found) as rig:
            if not rig.link.monitored:
                raise InputError("this board has no inputs for pressure monitors; valid: a board that has, such as a Mega 2560")
            for k in which:
                single = moves.Single(found, k)
                single.refuse(1e3 * levels[-1], rig)
                true, volts, counts = _drive(rig, single, levels, gauge, line.threaded)
                calibrate.refuse_mixed_up(np.ptp(counts, axis=0), k, names, "pressure monitor")
                monitors[k] = calibrate.fit_line(true, calibrate.monitor_volts(counts[:, k]))
                if gauge:
                    commands[k] = calibrate.fit_line(true, volts)
            rig.stop()
        part = calibrate.pressure_part(found, monitors, commands)
        notes = [_words(f"monitor {names[k]}", fit, "V", "MPa", 1e3, "kPa") for k, fit in monitors.items()]
        notes += [_words(f"command {names[k]}", fit, "V", "MPa", 1e3, "kPa") for k, fit in commands.items()]
        notes += [] if gauge else ["without --gauge what was commanded is taken as true"]
        return _give({"hardware.pressure": part}, notes, "pressure", out, _firmware(robot, port))

    return safely(work, STOPPED, STOPPED)


def _drive(
    rig: SerialRig, single: Single, levels: Sequence[float], gauge: bool, threaded: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pressures in MPa that are taken as true, volts of the commands, both (levels,), and mean counts of all monitors, (levels, 6)."""
    import numpy as np

    from tepm_opt.hw.board.calibration import Calibration
    from tepm_opt.hw.service import calibrate, moves

    calibration = Calibration.from_robot(single.robot)
    true, volts, counts, last = [], [], [], 0.0
    for level in levels:
        value = 1e3 * level
        moves.glide(rig, single, last, value)
        settled, last = moves.settle(rig, single, value), value
        taken = moves.monitors(rig, single, value, AVERAGED_S)
        counts.append(taken.mean(axis=0))
        code = calibration.to_codes(single.command(value).pressures, rig.limits.pressure_max)[single.actuator]
        volts.append(calibrate.command_volts(single.robot, single.actuator, code))
        true.append(1e-3 * level)
        read = calibration.pressures(tuple(counts[-1]))[single.actuator]
        mark = "" if settled else ", which did not settle within 15 s"
        stderr.print(f"  {single.name} at {level:g} kPa: monitor {read / 1e3:.1f} kPa{mark}", highlight=False)
        if gauge:
            with moves.keep_sending(rig, single.command(value), threaded):
                true[-1] = 1e-3 * _ask_gauge_pressure(f"Gauge at actuator {single.name}, kPa:", single.most / 1e3)
    moves.glide(rig, single, last, 0.0)
    return np.array(true), np.array(volts), np.array(counts)


def _ask_gauge_pressure(question: str, most: float) -> float:
    """Ask a person for a pressure in kPa, again until it is one."""
    while True:
        text = shared.ask(question)
        try:
            value = float(text.replace(",", "."))
        except ValueError:
            value = math.nan
        if -0.1 * most <= value <= 1.5 * most:
            return value
        stderr.print(f"  {text!r}; valid: a number of kPa up to {1.5 * most:g}", style="yellow", highlight=False, markup=False)


@app.command()
def base(
    port: PortArgument,
    inputs: Annotated[Path, typer.Argument(metavar="INPUTS", help="Set-point file whose rows bend the arm to all sides.")],
    hold: Annotated[float, typer.Option("--hold", min=0.2, max=60, help="Seconds at each row over which poses are averaged.")] = 2.0,
    known_holders: Annotated[bool, typer.Option("--known-holders", help="Take holders_m of the robot file as they are.")] = False,
    out: OutOption = None,
    robot: RobotOption = None,
    yes: YesOption = False,
) -> int:
    """Locate the base in the tracker's frame and the sensors on the arm: rests at each row, compares with the model's statics."""
    from tepm_opt.data.setpoints import read_setpoints
    from tepm_opt.hw.service import calibrate
    from tepm_opt.hw.service.line import tracker_link
    from tepm_opt.models.layout import Layout
    from tepm_opt.recording.drive import refuse_unplayable
    from tepm_opt.recording.register import record_poses, register

    found = _load_calibrated_robot(robot, out)
    setpoints = read_setpoints(inputs, Layout.from_robot(found).actuator_names, found.input_max)
    refuse_unplayable(setpoints, str(inputs))
    link = tracker_link(found)
    if link is None:
        raise InputError(f"robot {found.name}: the file has no [hardware.tracker], which says where poses come from")
    if len(link.devices) != Layout.from_robot(found).points:
        raise InputError(f"robot {found.name}: {len(link.devices)} devices in [hardware.tracker]; valid: {Layout.from_robot(found).points}")

    def work() -> int:
        confirm(f"This moves the robot: it goes slowly through the {len(setpoints.time)} rows of {inputs}.", yes)
        tracker = shared.open_tracker(found)
        if tracker is None:
            raise InputError(f"robot {found.name}: the file has no [hardware.tracker], which says where poses come from")
        try:
            tracker.first()
            rig = shared.open_line(port).rig(found, tracker)
        except BaseException:
            tracker.close()
            raise
        with show_progress(False) as progress:
            recording = record_poses(rig, setpoints, found, hold, progress)
            progress("comparing with the model", 0, 0)
            registration, notes = register(found, setpoints, recording.poses, known_holders)
        restless = [str(k + 1) for k, rested in enumerate(recording.rested) if not rested]
        notes += [f"rows at which the robot did not come to rest: {', '.join(restless)}"] if restless else []
        parts = {"mount": calibrate.mount_part(registration)}
        if not known_holders:
            parts |= {"hardware.tracker": calibrate.holders_part(registration)}
        return _give(parts, _registration_words(registration) + notes, "base", out)

    return safely(work, STOPPED, STOPPED)


def _registration_words(found: Registration) -> list[str]:
    def numbers(values: np.ndarray, scale: float, digits: int) -> str:
        return ", ".join(f"{scale * value:.{digits}f}" for value in values)

    words = [
        f"{found.samples} rows, {found.outliers} outliers, residual {1e3 * found.rms_m:.2f} mm rms",
        f"base at ({numbers(found.position_m, 1e3, 1)}) mm ± ({numbers(found.position_std_m, 1e3, 1)}) mm",
        f"turned by ({numbers(found.rotation_deg, 1, 2)})° ± ({numbers(found.rotation_std_deg, 1, 2)})°",
    ]
    for k, (holder, std) in enumerate(zip(found.holders_m, found.holders_std_m, strict=True), start=1):
        words.append(f"holder of s{k}: ({numbers(holder, 1e3, 1)}) mm ± ({numbers(std, 1e3, 1)}) mm")
    return words


def _load_calibrated_robot(robot: str | None, out: Path | None) -> Robot:
    """Load a robot that has a calibration, after a check that the result's file can be written.

    Raises:
        InputError: it has no calibration, or the file is there.
    """
    if out is not None and (out.exists() or not out.parent.is_dir()):
        raise InputError(f"--out {out}: {'it exists' if out.exists() else 'there is no such folder'}; name a new file")
    from tepm_opt.hw.board.calibration import Calibration
    from tepm_opt.models.robot import load_robot

    found = load_robot(robot or "kang2017")
    Calibration.from_robot(found)
    return found


def _load_robot_and_actuators(robot: str | None, actuator: str, out: Path | None) -> tuple[Robot, list[int]]:
    """Load the robot and the actuators that are calibrated.

    Raises:
        InputError: as for `_load_calibrated_robot`, or no such actuator.
    """
    from tepm_opt.hw.service.line import actuators_of
    from tepm_opt.models.layout import Layout

    found = _load_calibrated_robot(robot, out)
    return found, actuators_of(actuator, Layout.from_robot(found).actuator_names)


def _words(name: str, line: CalibrationFit, unit: str, of: str, scale: float, small: str) -> str:
    """A fitted line: what it is, what is left, how sure it is."""
    std = "" if math.isnan(line.slope_std) else f" (± {_short(line.zero_std)} {unit}, ± {_short(line.slope_std)} {unit}/{of})"
    return f"{name}: {line.zero:.6g} {unit} + {line.slope:.6g} {unit}/{of}{std}, residual {_short(scale * line.rms_x)} {small} rms"


def _short(value: float) -> str:
    """Two digits, and 0 where rounding of numbers is all there is."""
    return f"{round(value, 6):.2g}"


def _firmware(robot: str | None, port: str) -> str:
    """Tell how a changed calibration of the robot file gets into the firmware."""
    from tepm_opt.hw.service.checks import flash_limits

    return f"; then into the firmware, which does not arm otherwise: {flash_limits(port, robot or 'ROBOT.toml')}"


def _give(parts: dict[str, dict[str, list]], notes: list[str], kind: str, out: Path | None, then: str = "") -> int:
    """Print or write what goes into the robot file.

    Args:
        parts: of the robot file.
        notes: lines for people.
        kind: of the calibration.
        out: file for the parts; None prints them.
        then: what has to be done then.
    """
    from tepm_opt.hw.service.calibrate import snippet

    for note in notes:
        say(note)
    text = snippet(parts, [f"tepm hw calibrate {kind}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC", *notes])
    say(f"Put these lines{f' ({out})' if out else ''} into the robot file, in place of those of the same names{then}")
    if out is None:
        print(text, end="")
    else:
        write_atomically(out, text)
    return SOLVED
