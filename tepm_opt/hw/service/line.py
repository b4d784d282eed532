"""A line to a board as it was opened: port, clock and log together, so that all that is done over it is on one clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from tepm_opt.errors import InputError
from tepm_opt.hw.board.link import Link
from tepm_opt.hw.board.linklog import LinkLog, PlaybackPort
from tepm_opt.hw.board.ports import Clock, Port
from tepm_opt.hw.board.rig import SerialRig, Tendons, open_port
from tepm_opt.hw.trackers import LiveTracker, Tracker, open_link
from tepm_opt.models.hardware import TrackerLink
from tepm_opt.models.robot import Robot

LOG = "log:"


@dataclass(frozen=True, eq=False)
class Line:
    """An open line.

    Attributes:
        port: the line itself.
        clock: tells the time in s.
        log: notes every byte.
        threaded: False where `port.read` lets virtual time pass.
        recorded: whether this is a recording, which nobody answers.
    """

    port: Port
    clock: Clock = time.monotonic
    log: LinkLog | None = None
    threaded: bool = True
    recorded: bool = False

    def link(self) -> Link:
        """The conversation over it; closing that closes the line."""
        return Link(self.port, self.clock, self.log, self.threaded)

    def rig(self, robot: Robot, tracker: Tracker | None = None, tendons: Tendons = "tension") -> SerialRig:
        """The robot behind it; closing that closes the line, also where it cannot be opened.

        Raises:
            InputError, LinkError: as for `SerialRig`.
        """
        try:
            return SerialRig(self.port, robot, tracker, self.clock, self.log, self.threaded, tendons)
        except BaseException:
            self.port.close()
            if self.log is not None:
                self.log.close()
            raise


OpenLine = Callable[[str], Line]


def open_line(target: str) -> Line:
    """A line to the board at `PORT` or `PORT@BAUD`, or a recording of one, `log:FILE`.

    Raises:
        InputError: as for `open_port`; or the file is no link log.
    """
    if target.startswith(LOG):
        port = PlaybackPort(target.removeprefix(LOG))
        return Line(port, port.clock, threaded=False, recorded=True)
    port, log = open_port(target)
    return Line(port, log=log)


def open_tracker(robot: Robot) -> LiveTracker | None:
    """The tracker that a robot file names, connecting by itself; None where it names none."""
    link = tracker_link(robot)
    return None if link is None else open_link(link)


def tracker_link(robot: Robot) -> TrackerLink | None:
    """Get the tracker of a robot file; None where it has none."""
    return None if robot.hardware is None else robot.hardware.tracker


def actuators_of(text: str, names: tuple[str, ...]) -> list[int]:
    """Indices of the actuators that a text names: `11`, `11,23`, or `all`.

    Raises:
        InputError: no such actuator, or one twice.
    """
    wanted = list(names) if text == "all" else [part.strip() for part in text.split(",")]
    if wrong := [name for name in wanted if name not in names]:
        raise InputError(f"actuator {wrong[0]!r}: the robot has no such one; valid: {', '.join(names)}")
    if len(set(wanted)) != len(wanted):
        raise InputError(f"actuator {text!r}: one is named twice; valid: {', '.join(names)}, each once")
    return [names.index(name) for name in wanted]
