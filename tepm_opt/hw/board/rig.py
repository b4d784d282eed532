"""The real robot: set points over a serial line to the control board, poses from the tracker."""

from __future__ import annotations

import contextlib
import time
from types import TracebackType
from typing import Literal

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.hw.board.calibration import Calibration
from tepm_opt.hw.board.errors import LinkError, RefusedError
from tepm_opt.hw.board.limits import Limits, differences
from tepm_opt.hw.board.link import Link
from tepm_opt.hw.board.linklog import LinkLog, new_log
from tepm_opt.hw.board.ports import BAUD, Clock, Port, SerialPort
from tepm_opt.hw.board.protocol import DISARM, ESTOP, POSITION_MODE, State
from tepm_opt.hw.board.status import BoardStatus, Hello
from tepm_opt.hw.commands import check_command
from tepm_opt.hw.freshness import FreshnessMonitor
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.hw.trackers import Tracker, open_link
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot

STALE = 0.05
"""Seconds after which what the board measured is no longer given."""
SILENT_PERIODS, LEAST_PERIODS, SHARE = 3, 1.2, 0.6
"""Sample periods after which `read` gives a sample without points rather than wait on for the tracker, at most and at least; and the part
of the time for which the board bears a silent host that it takes at most."""
PERIOD = 0.01
"""Seconds between samples where there is no tracker."""

Tendons = Literal["tension", "position"]


def open_port(target: str, clock: Clock = time.monotonic) -> tuple[SerialPort, LinkLog]:
    """A port and the log of what goes over it, from `PORT` or `PORT@BAUD`.

    Raises:
        InputError: the port cannot be opened, or the baud rate is no number.
    """
    from platformdirs import user_log_path

    device, at, baud = target.rpartition("@")
    if at and not baud.isdigit():
        raise InputError(f"serial port {target!r}: baud rate {baud!r}; valid: a number, such as {BAUD}")
    port = SerialPort(device, int(baud)) if at else SerialPort(target)
    return port, new_log(user_log_path("tepm_opt"), clock)


def open_serial(target: str, robot: Robot) -> SerialRig:
    """The real robot behind a serial port, `PORT` or `PORT@BAUD`, with the tracker that its file names.

    Raises:
        InputError: as for `open_port`, `SerialRig`, `open_link` and `LiveTracker.first`.
        LinkError: as for `SerialRig`.
    """
    port, log = open_port(target)
    tracker = None
    try:
        if robot.hardware is not None and robot.hardware.tracker is not None:
            tracker = open_link(robot.hardware.tracker)
            tracker.first()
        return SerialRig(port, robot, tracker, log=log)
    except BaseException:
        port.close()
        log.close()
        if tracker is not None:
            tracker.close()
        raise


class SerialRig:
    """A robot behind a control board. It arms with the first `apply`, and never again by itself once it was stopped or stopped itself.

    The board switches everything off when it hears nothing for 100 ms: send set points all the time, as a control loop does.

    Args:
        port: the line to the board.
        robot: with `[hardware]`, which says how the electronics are calibrated.
        tracker: gives the poses; None: samples have no points.
        clock: tells the time in s; the tracker's frames are on the same clock.
        log: notes every byte that is sent or comes.
        threaded: False where the port lets virtual time pass.
        tendons: whether the board holds tensions (by the dynamometers), or goes to positions that would give them on slack tendons.
        start: seconds in which the board has to answer; an Arduino restarts when its port is opened.

    Attributes:
        robot: as given.
        hello: what the board says about itself.
        limits: what it was compiled with.
        link: the conversation with it.

    Raises:
        InputError: the robot has no calibration or too many actuators.
        LinkError: the board does not answer, speaks another protocol, or has a fault that must be looked at and cleared first.
    """

    def __init__(
        self,
        port: Port,
        robot: Robot,
        tracker: Tracker | None = None,
        clock: Clock = time.monotonic,
        log: LinkLog | None = None,
        threaded: bool = True,
        tendons: Tendons = "tension",
        start: float = 5.0,
    ) -> None:
        self.robot, self.layout = robot, Layout.from_robot(robot)
        self._calibration = Calibration.from_robot(robot)
        self._count = self.layout.inputs // 2
        self._tracker, self._clock, self._tendons = tracker, clock, tendons
        self._armed: bool | None = None  # None: not yet, False: not again
        self._asked = Limits.from_robot(robot)
        self.link = Link(port, clock, log, threaded)
        try:
            self.hello: Hello = self.link.hello(start)
            if self.hello.channels < self._count:
                raise LinkError(f"the board drives {self.hello.channels} actuators, robot {robot.name} has {self._count}")
            self.limits = self.link.limits()
            self._patience = self._waits()
            self.link.wait(lambda: self.link.status is not None, 1.0)
        except BaseException:
            self.link.close()
            raise
        self._origin = self._last = clock()
        link = robot.hardware.tracker if robot.hardware is not None else None
        self._freshness = FreshnessMonitor.of_robot(robot, link.rate_hz if link is not None else robot.tracker.rate_Hz)
        self._commands: np.ndarray | None = None
        self._gauged: float | None = None  # when the board told last what it measures

    def __repr__(self) -> str:
        board = "board silent" if self.link.status is None else self.link.status.describe()
        return f"SerialRig(robot {self.robot.name!r}, {board}, {self.time:.3f} s)"

    @property
    def time(self) -> float:
        """Now, in s since the rig was opened."""
        return self._clock() - self._origin

    @property
    def simulated(self) -> None:
        """The real robot is no simulation."""
        return None

    @property
    def board(self) -> BoardStatus:
        """The last status that the board told.

        Raises:
            LinkError: it has told nothing yet.
        """
        self.link.listen()
        if self.link.status is None:
            raise LinkError("the board has not told its state yet")
        return self.link.status

    def read(self) -> Sample:
        """Wait for the tracker's next frame and give it with what the board measured last.

        Where the tracker is silent for three periods, or for so long that the board would take the host for silent, there is a sample
        without points, so that a controller can react; without a tracker that is every sample. Repeated poses and frozen gauges
        are withheld, see `FreshnessMonitor`.

        Raises:
            LinkError: the line to the board is gone.
        """
        if self._tracker is None:
            self.link.wait(lambda: self._clock() >= self._last + self._patience, self._last + self._patience - self._clock())
            frame = None
        else:
            frame = self._tracker.read(self._patience)
        self._last = self._clock()
        self.link.listen()
        points = np.full((self.layout.points, 3), np.nan) if frame is None else frame.points
        if points.shape != (self.layout.points, 3):
            raise InputError(f"the tracker gives {len(points)} points, robot {self.robot.name} has {self.layout.points}")
        told = [] if frame is None or frame.status == "ok" else [frame.status]
        if frame is None:
            told.append("no tracker" if self._tracker is None else "tracker silent")
        measured, extra = (None, None), {}
        if (status := self.link.status) is not None and self._clock() - status.time <= STALE:
            pressures = self._calibration.pressures(status.monitors) if self.link.monitored else None
            measured = (pressures, self._calibration.tensions(status.dynamometers))
            extra = {"board_time_s": 1e-3 * status.uptime_ms}
        else:
            told.append("board silent")
        if self._armed and status is not None and status.state is not State.ARMED:
            told.append(status.describe())
        at = (self._last if frame is None else frame.time) - self._origin
        transforms = None if frame is None else frame.transforms
        sample = Sample(at, points, *measured, transforms=transforms, status="; ".join(told) or "ok", extra=extra)
        before, self._gauged = self._gauged, status.time if status is not None else None
        return self._freshness.look(sample, self._commands, gauged=self._gauged != before)

    def apply(self, command: Command) -> None:
        """Send set points; the first ones arm the board.

        Raises:
            InputError: a value is NaN or outside the robot's limits or the firmware's; nothing is sent then.
            LinkError: the board has stopped by itself, says nothing or ignores set points, or the line is gone.
        """
        values = check_command(command, self.robot)
        pressures, tensions, on = np.split(values, 3)
        self._commands = np.concatenate([pressures, tensions * on])
        codes = self._calibration.to_codes(pressures, self._asked.pressure_max)
        by_position = self._tendons == "position"
        if by_position:
            goals = self._calibration.to_steps(tensions, self._asked.position_max)
        else:
            goals = self._calibration.to_counts(tensions, self._asked.tension_max)
        self._ensure_armed()
        bits = sum(1 << k for k in range(self._count) if on[k])
        self.link.set(bits | (POSITION_MODE if by_position else 0), codes, goals)

    def stop(self) -> None:
        """Motors off, pressure to zero; `apply` is refused from now on.

        Raises:
            LinkError: the board does not confirm; it stops by itself then, when it has heard nothing for 100 ms.
        """
        if self._armed is False:
            return
        armed, self._armed = self._armed, False
        if armed is None:
            return
        try:
            self.link.request(DISARM)
        except LinkError:
            self.link.request(ESTOP)

    def emergency_stop(self) -> None:
        """Motors off and outputs off at once; takes CLEAR before anything can move again.

        Raises:
            LinkError: the board does not confirm.
        """
        self._armed = False
        self.link.request(ESTOP)

    def clear(self) -> None:
        """Leave a stop or fault that somebody has looked at; the next `apply` may arm again.

        Raises:
            LinkError: the board refuses, as while the emergency stop is pressed.
        """
        self.link.clear()
        self._armed = None

    def close(self) -> None:
        """Stop and give port and tracker free."""
        try:
            self.stop()
        finally:
            self.link.close()
            if self._tracker is not None:
                self._tracker.close()

    def __enter__(self) -> SerialRig:
        """The rig itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Stop and close. An exception that is on its way goes before one that stopping raises."""
        if kind is None:
            self.close()
        else:
            with contextlib.suppress(LinkError):
                self.close()

    def _ensure_armed(self) -> None:
        if self._armed is False:
            raise LinkError("the rig was stopped; open it anew to move again")
        if self._armed is None:
            if self.board.state is not State.IDLE:
                raise LinkError(f"the board is in {self.board.describe()}; see to it, then clear it: tepm hw check PORT --clear")
            if different := differences(self.robot, self.limits):
                raise LinkError(
                    f"firmware and robot file {self.robot.name} disagree: {'; '.join(different)}. Write the robot file's numbers into the "
                    "firmware (tepm hw limits) and flash it, or use the robot file that the firmware was made for"
                )
            self._armed = True  # from now on stopping disarms, whatever interrupts this
            try:
                self.link.arm(self._asked.check)
            except RefusedError:
                self._armed = None
                raise
            except LinkError:
                self._let_go()
                raise
        else:
            try:
                self.link.confirm()
            except LinkError:
                self._let_go()
                raise

    def _let_go(self) -> None:
        """Disarm a board that cannot be relied on any more, or have it stop at once: one try each, and no more set points."""
        self._armed = False
        for kind in (DISARM, ESTOP):
            with contextlib.suppress(LinkError):
                self.link.request(kind, tries=1)
                return

    def _waits(self) -> float:
        """Seconds for which `read` waits for the tracker: the board has to hear of the host meanwhile.

        Raises:
            InputError: the tracker is too slow for that.
        """
        if self._tracker is None:
            return PERIOD
        link = None if self.robot.hardware is None else self.robot.hardware.tracker
        period, most = 1 / link.rate_hz if link else PERIOD, SHARE * 1e-3 * self.hello.timeout_ms
        if LEAST_PERIODS * period > most * (1 + 1e-9):
            why = f"the board stops the robot when it hears nothing for {self.hello.timeout_ms} ms"
            raise InputError(
                f"robot {self.robot.name}: hardware.tracker.rate_hz = {1 / period:g}; valid: at least {LEAST_PERIODS / most:g} Hz ({why})"
            )
        return min(SILENT_PERIODS * period, most)
