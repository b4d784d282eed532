"""`tepm hw`: bringing a real robot into service, looking at it, and stopping it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.live import Live
from rich.markup import escape
from rich.text import Text

from tepm_opt.cli.common import SOLVED, UNSOLVED, JsonOption, RobotOption, stderr, stdout
from tepm_opt.cli.hw import shared
from tepm_opt.cli.hw.calibrate import app as calibrate_app
from tepm_opt.cli.hw.emulate import emulate
from tepm_opt.cli.hw.extend import new_rig, new_tracker, trackers
from tepm_opt.cli.hw.measure import app as measure_app
from tepm_opt.cli.hw.monitor import monitor
from tepm_opt.cli.hw.rig import app as rig_app
from tepm_opt.cli.hw.shared import STOPPED, PortArgument, YesOption, confirm, safely, say
from tepm_opt.errors import InputError
from tepm_opt.hw.board.errors import LinkError
from tepm_opt.hw.board.link import Link
from tepm_opt.hw.board.ports import PortBusyError, find_ports
from tepm_opt.hw.board.protocol import ESTOP, State

if TYPE_CHECKING:
    import numpy as np

    from tepm_opt.hw.service.checks import Check
    from tepm_opt.hw.service.moves import Single

COLOURS = {"RIGHT": "green", "WRONG": "red", "OPEN": "yellow"}  # by the names of marks
ESTOP_S, RESTARTED_S = 8.0, 5.0
"""Time in s for which ESTOP is sent; age of a board's clock below which opening the port has restarted the board."""

app = typer.Typer(help="The real robot: ports, commissioning, calibration, a look at it, emergency stop; rig files.", no_args_is_help=True)
app.command("monitor")(monitor)
app.command("emulate")(emulate)
app.command("trackers")(trackers)
app.command("new-tracker")(new_tracker)
app.command("new-rig")(new_rig)
app.add_typer(calibrate_app, name="calibrate")
app.add_typer(measure_app, name="measure")
app.add_typer(rig_app, name="rig")


@app.command()
def ports(as_json: JsonOption = False) -> int:
    """List serial ports, likely boards first."""
    found = find_ports()
    if as_json:
        print(json.dumps([{"device": port.device, "description": port.description, "arduino": port.arduino} for port in found], indent=2))
        return SOLVED if found else UNSOLVED
    for port in found:
        likely = "  [green]likely a board[/]" if port.arduino else ""
        stdout.print(f"[bold]{escape(port.device)}[/]  {escape(port.description)}{likely}", soft_wrap=True, highlight=False)
    if not found:
        say("There is no serial port on this computer.", "bold")
        say("Plug the board in with a USB cable that carries data; many cables only charge.")
        say("Driver: Linux needs none (sudo dmesg | tail says what was plugged in); clones with a CH340 need theirs on Windows and macOS.")
        say("Permission (Linux): sudo usermod -aG dialout $USER, then log out and in again.")
    elif not any(port.arduino for port in found):
        say("None of them looks like an Arduino; unplug the board and plug it in again to see which one comes and goes.")
    return SOLVED if found else UNSOLVED


@app.command()
def check(
    port: Annotated[str | None, typer.Argument(metavar="[PORT]", help="Serial port; the only likely one where it is absent.")] = None,
    robot: RobotOption = None,
    clear: Annotated[bool, typer.Option("--clear", help="Send CLEAR once the stop or fault was shown.")] = False,
    button: Annotated[bool, typer.Option("--button", help="Try the emergency stop button: asks to press and release it.")] = False,
    as_json: JsonOption = False,
) -> int:
    """Walk through commissioning: what is right, what is wrong, what to do next. Never arms."""

    from tepm_opt.hw.service.checks import Mark
    from tepm_opt.hw.service.commissioning import Commissioning, by_hand

    def ask_for_button(press: bool) -> None:
        what = "Press the emergency stop button now" if press else "Seen. Release the button now"
        stderr.print(f"[bold]{what}[/] (30 s)", highlight=False)

    name = robot or "kang2017"
    walk = Commissioning(port, name, clear, ask_for_button if button else None, shared.open_line, shared.open_tracker)

    def work() -> int:
        made: list[Check] = []
        for entry in walk.checks():
            made.append(entry)
            if not as_json:
                _print_check(len(made), entry)
        good = not any(entry.mark is Mark.WRONG for entry in made)
        steps = by_hand(walk.port or "PORT", name, "11")
        if as_json:
            entries = [
                {"number": k + 1, "name": entry.name, "mark": entry.mark.name.lower(), "says": entry.says, "next": entry.next}
                for k, entry in enumerate(made)
            ]
            print(json.dumps({"ok": good, "port": walk.port, "robot": name, "checks": entries, "by_hand": steps}, indent=2))
        else:
            _print_end(made, steps)
        return SOLVED if good else UNSOLVED

    return safely(work, "nothing was moved", "nothing was moved")


def _print_check(number: int, entry: Check) -> None:
    colour = COLOURS[entry.mark.name]
    stdout.print(
        f"{number:2d}. [{colour}]{entry.mark.value}[/] [bold]{entry.name}[/]: {escape(entry.says)}", soft_wrap=True, highlight=False
    )
    if entry.next:
        stdout.print(f"      → {escape(entry.next)}", soft_wrap=True, highlight=False)


def _print_end(made: list[Check], steps: list[str]) -> None:
    from tepm_opt.hw.service.checks import Mark

    counts = {mark: sum(entry.mark is mark for entry in made) for mark in Mark}
    marks = f"{counts[Mark.RIGHT]} right, {counts[Mark.WRONG]} wrong, {counts[Mark.OPEN]} not yet"
    first = next((entry for entry in made if entry.mark is Mark.WRONG), None)
    say(f"\n{marks}{f'; begin with: {first.name}' if first else ''}.", "bold")
    say("\nThen by hand, in this order (docs/how-to/hardware.md says more):", "bold")
    for number, step in enumerate(steps, start=1):
        say(f"{number:2d}. {step}")


@app.command()
def limits(
    robot: RobotOption = None,
    out: Annotated[Path | None, typer.Option("--out", help="Header to write, for make LIMITS=FILE; printed without it.")] = None,
) -> int:
    """Write the limits and calibration of a robot file as a header of the firmware. Both have to agree, or the robot cannot be armed."""
    from tepm_opt.data.files import write_atomically
    from tepm_opt.hw.board.limits import TITLE, Limits
    from tepm_opt.hw.service.checks import flash_command
    from tepm_opt.models.robot import load_robot

    found = load_robot(robot or "kang2017")
    text = Limits.from_robot(found).header(found.name)
    if out is None:
        print(text, end="")
        return SOLVED
    if out.exists() and not (out.is_file() and out.read_bytes().startswith(TITLE.encode())):
        raise InputError(f"--out {out}: it exists and was not written by this command; name a new file, or one that was")
    write_atomically(out, text)
    actuation = found.actuation
    say(f"{out}: {actuation.pressure_max_Pa / 1e3:g} kPa, {actuation.tension_max_N:g} N and the calibration of robot {found.name}")
    say(f"Now flash the firmware: {flash_command(None)} LIMITS={out.resolve()}")
    return SOLVED


@app.command()
def jog(
    port: PortArgument,
    actuator: Annotated[str, typer.Argument(metavar="ACTUATOR", help="Name such as 11 or 23.")],
    pressure: Annotated[float | None, typer.Option("--pressure-kPa", help="Pressure to go to, kPa.")] = None,
    tension: Annotated[float | None, typer.Option("--tension", help="Tension to go to, N.")] = None,
    seconds: Annotated[float, typer.Option("--seconds", min=1, max=60, help="For going there and back.")] = 3.0,
    no_tendon: Annotated[
        bool,
        typer.Option("--no-tendon", help="The tendon is not hooked on: turn the motor as far as this tension would take, and back."),
    ] = False,
    robot: RobotOption = None,
    yes: YesOption = False,
) -> int:
    """Move one actuator to a value and back; all others stay at 0, their motors off."""
    import numpy as np

    from tepm_opt.hw.board.calibration import Calibration
    from tepm_opt.hw.service import moves
    from tepm_opt.hw.service.line import actuators_of
    from tepm_opt.models.layout import Layout
    from tepm_opt.models.robot import load_robot

    if (pressure is None) == (tension is None):
        raise InputError("give either --pressure-kPa or --tension")
    if no_tendon and tension is None:
        raise InputError("--no-tendon goes with --tension, which says how far the motor turns")
    found = load_robot(robot or "kang2017")
    which = actuators_of(actuator, Layout.from_robot(found).actuator_names)
    if len(which) != 1:
        raise InputError(f"actuator {actuator!r}: one at a time; valid: {', '.join(Layout.from_robot(found).actuator_names)}")
    single = moves.Single(found, which[0], tension is not None)
    scale, unit = (1.0, "N") if single.tension else (1e3, "kPa")
    value = tension if tension is not None else 1e3 * (pressure or 0.0)
    moves.refuse_outside(value / scale, single.most / scale, "--tension" if single.tension else "--pressure-kPa", unit)

    def work() -> int:
        what = f"actuator {single.name} goes to {value / scale:g} {unit} and back in {seconds:g} s"
        confirm(f"This moves the robot: {what}.", yes)
        line = shared.open_line(port)
        kept: list[float] = []
        steps, others = 0, 0.0
        with line.rig(found, tendons="position" if no_tendon else "tension") as rig, _live() as show:
            single.refuse(value, rig)
            for now, commanded, sample in moves.jog(rig, single, value, seconds):
                measured = single.read_measured(sample)
                if moves.is_held(now, seconds):
                    kept.append(measured)
                position = rig.board.positions[single.actuator]
                steps = max(steps, position)
                others = max(others, _others(single, sample.tensions if single.tension else sample.pressures))
                wound = f", motor at {position} steps" if single.tension else ""
                show(f"{single.name}: {commanded / scale:.2f} {unit} commanded, {measured / scale:.2f} {unit} measured{wound}")
            rig.stop()
        mean = float(np.nanmean(kept)) if np.isfinite(kept).any() else float("nan")
        travel = steps / Calibration.from_robot(found).steps_mm[single.actuator]
        wound = f", the motor wound {steps} steps, {travel:.2f} mm of tendon" if single.tension else ""
        say(f"{single.name}: {value / scale:g} {unit} commanded, {mean / scale:.3g} {unit} measured while held{wound}.")
        if not no_tendon and not abs(mean - value) < max(0.1 * value, 0.02 * single.most):
            say("That is far off: is it the right actuator, is the air on, is the calibration right? See tepm hw monitor.", "yellow")
        if no_tendon and mean > 0.5 * value:
            say("The dynamometer felt it: a tendon is hooked on; then leave --no-tendon out.", "yellow")
        if others > 0.05 * single.most:
            say(f"Another actuator showed up to {others / scale:.3g} {unit}: are wires or hoses mixed up?", "yellow")
        say("Stopped: motors off, no pressure." + (f" Everything on the line is in {line.log.path}" if line.log else ""))
        return SOLVED

    return safely(work, STOPPED, STOPPED)


def _others(single: Single, values: np.ndarray | None) -> float:
    """The most that any other actuator shows, in Pa or N."""
    return 0.0 if values is None else max((float(v) for k, v in enumerate(values) if k != single.actuator), default=0.0)


@contextmanager
def _live() -> Iterator[Callable[[str], None]]:
    """Writes a line on the error stream over and over, on a terminal."""
    if not stderr.is_terminal:
        yield lambda text: None
        return
    with Live(console=stderr, transient=True, refresh_per_second=10) as live:
        yield lambda text: live.update(Text(text))


@app.command()
def estop(port: PortArgument) -> int:
    """Emergency stop over the line. The button is faster and always works."""

    def work() -> int:
        begin = time.monotonic()
        try:
            line = shared.open_line(port)
        except InputError as error:
            if isinstance(error, PortBusyError):
                raise InputError(
                    f"{error}; only that program can stop the robot over this line: press the emergency stop button, "
                    "or stop that program (Ctrl-C there stops the robot)"
                ) from error
            raise InputError(f"{error}; press the emergency stop button") from error
        link = line.link()
        try:
            tries = _send_estop(link, line.clock)
            link.wait(lambda: link.status is not None and link.status.state is State.ESTOP, 1.0)
            young = link.status is not None and 1e-3 * link.status.uptime_ms < RESTARTED_S + ESTOP_S
        finally:
            link.close()
        say(f"ESTOP acknowledged {time.monotonic() - begin:.1f} s after the start: motors off, pressure outputs off.", "bold green")
        if young:
            say("Opening the port had already restarted the board, which switches everything off.")
        say(f"It stays in ESTOP until tepm hw check {port} --clear, or until a program opens the port, which restarts the board.")
        if tries > 1:
            say(f"It took {tries} attempts.")
        return SOLVED

    left = "press the emergency stop button or unplug motors and valves now"
    return safely(work, left, left)


def _send_estop(link: Link, clock: Callable[[], float]) -> int:
    """Send ESTOP until it is acknowledged; in how many attempts.

    Raises:
        LinkError: it is not.
    """
    end, tries = clock() + ESTOP_S, 0
    while True:
        tries += 1
        try:
            link.request(ESTOP)
            return tries
        except LinkError as error:
            if "gone" in str(error):
                raise
            if clock() >= end:
                raise LinkError(
                    f"ESTOP was not acknowledged within {ESTOP_S:g} s: is the firmware on it, is the baud rate right"
                ) from error
