"""Bringing a robot into service: what the computer can check, one thing after the other, and what hands have to do. Never arms."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tepm_opt.errors import InputError
from tepm_opt.hw.board.calibration import Calibration
from tepm_opt.hw.board.errors import LinkError, NoBoardError, RefusedError
from tepm_opt.hw.board.limits import Limits, differences
from tepm_opt.hw.board.link import Link
from tepm_opt.hw.board.ports import FoundPort, PortBusyError, find_ports
from tepm_opt.hw.board.protocol import CHANNELS, POSITION_MODE, Result, State
from tepm_opt.hw.board.status import BoardStatus
from tepm_opt.hw.service import checks
from tepm_opt.hw.service.checks import (
    BUSY,
    DIALOUT,
    NO_PORT,
    Check,
    device_of,
    flash,
    flash_limits,
    judge,
    last,
    not_yet,
    right,
    wrong,
)
from tepm_opt.hw.service.line import OpenLine, open_line, open_tracker, tracker_link
from tepm_opt.hw.trackers import LiveTracker
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot, load_robot

BUTTON_S = 30.0
"""Seconds for which the emergency stop button is waited for."""
MENDS: dict[int, str] = {
    Result.ESTOP_PRESSED: "release the emergency stop button; is its wire (closed contact to ground) whole?",
    Result.MONITOR: "is the regulator fed, is its monitor wired, has the air gone? `tepm hw monitor` shows what it measures",
    Result.BUS: "see to the DACs' supply and wires",
}
"""Advice where CLEAR is refused, by the reason."""


def by_hand(port: str, robot: str, actuator: str) -> list[str]:
    """List what hands have to do after the checks, in order, with the commands for this port, robot and actuator."""
    at = f"{port} --robot {robot}" if robot != "kang2017" else port
    jog = f"tepm hw jog {at} {actuator}"
    return [
        "Shut the compressed air off at the source and let it out; keep one hand at the emergency stop button from now on.",
        f"Press the button: {f'tepm hw check {at} --button'} watches whether the board sees it.",
        f"Motors, tendons not hooked on, one after the other: {jog} --tension 1 --no-tendon. It winds, unwinds, in the right direction.",
        f"Dynamometers, motors off, for each: tepm hw calibrate tension {at} --actuator {actuator} --weights-g 0,100,200,500.",
        f"What was measured goes into robot file and firmware, or the board does not arm: {flash_limits(port, robot)}.",
        f"Hook the tendons on, each slack: {jog} --tension 1. The measured tension follows; the other tendons stay slack.",
        f"Air on, nobody near the robot: {jog} --pressure-kPa 50. One muscle stretches, the right one; the others show no pressure.",
        f"Regulators, for each: tepm hw calibrate pressure {at} --actuator {actuator} --at-kPa 0,100,200,300; then as for dynamometers.",
        "Emergency stop under pressure: press the button during a jog; pressure and motors have to go off.",
        f"Tracker: tepm hw calibrate base {at} INPUTS.csv; then put what it prints into the robot file.",
        f"Wiring: tepm record wiring --rig serial:{port} --out wiring, then tepm data check wiring names exchanged hoses and axes.",
        f"Everything together, slowly: tepm play INPUTS.csv --rig serial:{port}.",
    ]


@dataclass
class Commissioning:
    """All checks, in order. Made anew for each run.

    Attributes:
        port: `PORT` or `PORT@BAUD`; None: the only likely one.
        robot: name or path of the robot file.
        clear: whether a stop or fault is cleared once it was shown.
        button: asks a person to press the emergency stop button (True), and again to release it (False); None: nobody is asked.
        open_line, open_tracker, find: how line, tracker and ports are got.
    """

    port: str | None = None
    robot: str = "kang2017"
    clear: bool = False
    button: Callable[[bool], None] | None = None
    open_line: OpenLine = open_line
    open_tracker: Callable[[Robot], LiveTracker | None] = open_tracker
    find: Callable[[], list[FoundPort]] = find_ports
    _found: Robot | None = None
    _usable = False

    def checks(self) -> Iterator[Check]:
        """One after the other, as they are made."""
        yield checks.packages()
        yield self._robot_file()
        yield self._find_port()
        yield self._permission()
        link, opened = self._open()
        yield opened
        yield checks.tools()
        if link is None:
            reason = "needs a board that answers."
            for name in ("last reset", "limits", "state", "emergency stop", "dynamometers", "pressure monitors", "motors", "line"):
                yield not_yet(name, reason)
        else:
            try:
                yield from self._board(link)
            finally:
                link.close()
        yield from self._tracker()

    def _robot_file(self) -> Check:
        name = "robot file"
        try:
            robot = load_robot(self.robot)
            Limits.from_robot(robot)
        except InputError as error:
            return wrong(name, str(error), "compare with `tepm robot show kang2017`; `tepm robot new FILE` writes a file with all parts")
        self._found = robot
        return right(name, f"{self.robot}: {robot.modules * robot.actuators} actuators, and [hardware] says how they are calibrated.")

    def _find_port(self) -> Check:
        name = "serial port"
        found = self.find()
        if self.port is not None:
            device = device_of(self.port)
            known = device in [port.device for port in found] or "://" in device or Path(device).exists()
            others = f"; there is {', '.join(port.device for port in found)}" if found else "; there is no serial port at all"
            self._usable = known
            return judge(name, known, f"{device} is there." if known else f"{device} does not exist{others}.", NO_PORT)
        likely = [port for port in found if port.arduino]
        if len(likely) == 1:
            self.port, self._usable = likely[0].device, True
            return right(name, f"{self.port} ({likely[0].description}) is the only likely one.")
        if likely:
            names = ", ".join(port.device for port in likely)
            return wrong(name, f"several boards: {names}.", f"name yours: tepm hw check {likely[0].device}")
        others = f"; others are {', '.join(port.device for port in found)}" if found else ""
        return wrong(name, f"there is no port that looks like an Arduino{others}.", NO_PORT)

    def _permission(self) -> Check:
        name = "permission"
        device = None if self.port is None else Path(device_of(self.port))
        if device is None or not device.exists():
            return not_yet(name, "needs a port.")
        good = self._usable = os.access(device, os.R_OK | os.W_OK)
        return judge(name, good, f"{device} may {'' if good else 'not '}be read and written.", DIALOUT)

    def _open(self) -> tuple[Link | None, Check]:
        """The link, if the board answers; what is said if it does not."""
        name = "firmware"
        if self.port is None or not self._usable:
            return None, not_yet(name, "needs a port that can be opened.")
        try:
            line = self.open_line(self.port)
        except InputError as error:
            return None, wrong(
                name, f"{error}.", BUSY if isinstance(error, PortBusyError) else "" if "baud rate" in str(error) else NO_PORT
            )
        link = line.link()
        try:
            self._hello = link.hello()
        except NoBoardError as error:
            link.close()
            return None, wrong(name, f"{error.says}.", error.overheard.advise(flash(self.port)))
        except LinkError as error:
            link.close()
            return None, wrong(name, f"{error}.", flash(self.port))
        except BaseException:
            link.close()
            raise
        return link, right(name, f"{self._hello.describe().partition(', last reset')[0]}.")

    def _board(self, link: Link) -> Iterator[Check]:
        """Check a board that answers."""
        yield checks.last_reset(self._hello)
        try:
            link.wait(lambda: link.status is not None, 1.0)
            if link.status is None:
                yield wrong("state", "the board answers but never tells its state.", flash(self.port))
                return
            yield self._limits(link)
            yield self._state(link)
            yield self._button(link)
            link.wait(lambda: False, 0.05)
            yield from self._sensors(link.status)
            yield checks.line_quality(link)
        except LinkError as error:
            yield wrong("line", f"{error}.", "see to cable and plug, then run this again")

    def _limits(self, link: Link) -> Check:
        name = "limits"
        if self._found is None:
            return not_yet(name, "needs a robot file with [hardware].")
        count, actuation = self._found.modules * self._found.actuators, self._found.actuation
        if self._hello.channels < count:
            return wrong(
                name, f"the board drives {self._hello.channels} actuators, the robot has {count}.", "use another board or robot file"
            )
        different = differences(self._found, link.limits())
        hint = f"{flash_limits(self.port, self.robot)}; or use the robot file that the firmware was made for"
        most = f"{actuation.pressure_max_Pa / 1e3:g} kPa, {actuation.tension_max_N:g} N and the calibration are those of the firmware."
        return judge(name, not different, f"{'; '.join(different)}." if different else most, hint)

    def _state(self, link: Link) -> Check:
        name, status = "state", last(link)
        says = status.describe()
        if status.state is State.IDLE:
            return right(name, "IDLE: nothing is wrong, nothing moves.")
        if not self.clear or status.state is State.ARMED:
            hint = "stop the program that armed it" if status.state is State.ARMED else f"see to it, then tepm hw check {self.port} --clear"
            return wrong(name, f"{says}.", hint)
        try:
            link.clear()
        except RefusedError as error:
            return wrong(name, f"{says}; {error}.", MENDS.get(error.result, "see to it, then run this again"))
        return right(name, f"it was {says}; cleared, it is IDLE now.")

    def _button(self, link: Link) -> Check:
        name = "emergency stop"
        if last(link).state is State.ESTOP:
            return wrong(name, "it is in effect: pressed, sent by a program, or its wire is open.", "release the button, then --clear")
        if self.button is None:
            return not_yet(
                name,
                "its contact is closed, as it should be; whether pressing opens it can only be tried.",
                f"tepm hw check {self.port} --button",
            )
        self.button(True)
        if not link.wait(lambda: last(link).state is State.ESTOP, BUTTON_S):
            return wrong(
                name, f"the board saw nothing in {BUTTON_S:g} s.", "is the contact wired to the pin of docs/how-to/hardware.md, and opens?"
            )
        self.button(False)
        end = f"the board stays in ESTOP: release it, then tepm hw check {self.port} --clear"
        for _ in range(round(BUTTON_S)):
            link.wait(lambda: False, 1.0)
            try:
                link.clear()
            except LinkError:
                continue
            return right(name, "pressing it stops the board, and once released it can be cleared.")
        return wrong(name, f"it was seen, but not its release in {BUTTON_S:g} s.", end)

    def _sensors(self, status: BoardStatus) -> Iterator[Check]:
        """Dynamometers, monitors, motors."""
        if self._found is None:
            yield not_yet("dynamometers", "needs a robot file with [hardware].")
            yield not_yet("pressure monitors", "needs a robot file with [hardware].")
        else:
            names, calibration = Layout.from_robot(self._found).actuator_names, Calibration.from_robot(self._found)
            yield checks.dynamometers(names, status.dynamometers, calibration)
            yield checks.monitors(names, status.monitors, calibration, self._hello)
        on = [str(k + 1) for k in range(CHANNELS) if status.enabled & ~POSITION_MODE & 1 << k]
        yield judge("motors", not on, f"on: {', '.join(on)} of the board." if on else "all are off.", "stop the program that moves them")

    def _tracker(self) -> Iterator[Check]:
        name = "tracker"
        if self._found is None or tracker_link(self._found) is None:
            why = "the robot file names none, so positions are not measured" if self._found else "needs a robot file with [hardware]"
            yield not_yet(name, f"{why}.", "give devices in [hardware.tracker] of the robot file" if self._found else "")
            return
        tracker = self.open_tracker(self._found)
        if tracker is None:
            yield not_yet(name, "it cannot be opened.")
            return
        try:
            tracker.first()
            yield right(name, f"{tracker.place} sends {', '.join(tracker.link.devices)}.")
            yield checks.sensors(tracker, Layout.from_robot(self._found).point_names)
        except InputError as error:
            yield wrong(name, f"{error}.", "see that the tracker runs, that its devices have these names, and that no firewall is between")
        finally:
            tracker.close()
