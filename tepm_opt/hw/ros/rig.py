"""A robot behind ROS nodes: `--rig ros2:HOST:PORT`.

It publishes /robot/command and takes /robot/points (geometry_msgs/PoseArray, the reference points in G from the base to the tip) and
/robot/gauges. /robot/command and /robot/gauges are std_msgs/Float64MultiArray: all pressures in Pa, all tensions in N; a command has 1 or
0 for each motor after them. Whatever drives the robot has to switch off by itself where commands no longer come.
"""

from __future__ import annotations

import time
from types import TracebackType

import numpy as np

from tepm_opt.hw.commands import check_command
from tepm_opt.hw.freshness import FreshnessMonitor
from tepm_opt.hw.rig import Command, Rig, Sample
from tepm_opt.hw.ros.bridge import Message
from tepm_opt.hw.ros.messages import number_array
from tepm_opt.hw.ros.node import RosNode, parse_address
from tepm_opt.hw.trackers import open_link
from tepm_opt.models.hardware import TrackerLink
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot, load_robot

COMMAND, POINTS, GAUGES = "/robot/command", "/robot/points", "/robot/gauges"
NUMBERS = "std_msgs/msg/Float64MultiArray"
STALE_S, SILENT_PERIODS = 0.05, 3
"""Seconds after which gauges are no longer given; sample periods after which there is a sample without points."""


class RosRig:
    """A rig of topics.

    Args:
        address: `HOST:PORT` of rosbridge.
        robot: with `[hardware.tracker]` its points come from there, else from /robot/points.

    Attributes:
        robot: as given.

    Raises:
        InputError: nobody answers, websocket-client is not installed, or no points come.
    """

    simulated = None

    def __init__(self, address: str, robot: Robot) -> None:
        self.robot, self._layout = robot, Layout.from_robot(robot)
        host, port = parse_address(address)
        options: dict[str, bool | int | float | str] = {"type": "PoseArray", "topic": POINTS}
        own = TrackerLink(
            kind="ros2", host=host, port=port, devices=self._layout.point_names, options=options, rate_hz=min(robot.tracker.rate_Hz, 1000.0)
        )
        link = robot.hardware.tracker if robot.hardware is not None and robot.hardware.tracker is not None else own
        self._gauges, self._gauged = np.full(self._layout.inputs, np.nan), -np.inf
        self._node = RosNode(address, {COMMAND: NUMBERS}, {GAUGES: (NUMBERS, self._take)}, most=1)
        self._tracker = open_link(link)
        try:
            self._tracker.first()
        except BaseException:
            self._close()
            raise
        self._patience, self._origin = SILENT_PERIODS / link.rate_hz, time.monotonic()
        self._freshness = FreshnessMonitor.of_robot(robot, link.rate_hz)
        self._last, self._commands, self._seen, self._stopped = 0.0, None, -np.inf, False

    def __repr__(self) -> str:
        return f"RosRig(robot {self.robot.name!r}, {self._node.trouble or 'connected'}, {self.time:.3f} s)"

    @property
    def time(self) -> float:
        """Now, in s since the rig was opened."""
        return time.monotonic() - self._origin

    def read(self) -> Sample:
        """The next frame of points with the gauges' last values; where none comes for three periods a sample without points."""
        while True:
            frame, count = self._tracker.read(self._patience), self._layout.points
            at = self.time if frame is None else frame.time - self._origin
            if at > self._last:
                break
        self._last, gauges, gauged = at, self._gauges, self._gauged
        status = "tracker silent" if frame is None else frame.status
        measured = None, None
        if time.monotonic() - gauged <= STALE_S:
            measured = tuple(None if np.isnan(part).all() else part for part in np.split(gauges, 2))
        points = np.full((count, 3), np.nan) if frame is None else frame.points
        sample = Sample(at, points, *measured, transforms=None if frame is None else frame.transforms, status=status)
        before, self._seen = self._seen, gauged
        return self._freshness.look(sample, self._commands, gauged=gauged != before)

    def apply(self, command: Command) -> None:
        """Publish a command; the newest wins.

        Raises:
            InputError: a value is NaN or outside the robot's limits.
            RuntimeError: the rig was stopped.
            ConnectionError: there is no connection.
        """
        checked = check_command(command, self.robot)
        if self._stopped:
            raise RuntimeError("the rig was stopped; open it again")
        if self._node.trouble:
            raise ConnectionError(f"ROS: {self._node.trouble}")
        self._commands = checked[: self._layout.inputs]
        self._publish(checked)

    def stop(self) -> None:
        """Motors off, pressure to zero; a second time does nothing more."""
        self._stopped = True
        self._publish(np.zeros(3 * self._layout.inputs // 2))

    def _publish(self, values: np.ndarray) -> None:
        self._node.publish(lambda: {COMMAND: number_array(values, "Pa, N, enabled")})

    def _take(self, message: Message) -> None:
        """Gauges, in the node's thread; rosbridge sends null for NaN."""
        values = np.array([np.nan if value is None else value for value in message["data"]], dtype=float)
        if len(values) != self._layout.inputs:
            raise ConnectionError(f"{GAUGES} has {len(values)} numbers; valid: {self._layout.inputs} (all pressures, all tensions)")
        self._gauges, self._gauged = values, time.monotonic()

    def _close(self) -> None:
        self._node.close()
        self._tracker.close()

    def __enter__(self) -> RosRig:
        """The rig itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Stop and close the connections."""
        self.stop()
        self._close()


def open_ros(target: str, robot: Robot | None) -> Rig:
    """The robot behind the rosbridge at `HOST:PORT`.

    Raises:
        InputError: as for `RosRig`.
    """
    return RosRig(target or "localhost", robot or load_robot("kang2017"))
