"""A run in ROS messages: samples, commands, targets and what is wrong, as rosbridge has them in JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from tepm_opt.hw.rig import Command, Sample
from tepm_opt.hw.ros.bridge import Message
from tepm_opt.hw.ros.joints import RodChain
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot

FRAME, TRACKED = "tracker", "tracked_"
"""Name of G in ROS, and what stands before a reference point's name in its measured frame."""
OK, WARN, ERROR = 0, 1, 2
"""Levels of diagnostic_msgs/DiagnosticStatus."""
_POSE, _NUMBERS = "geometry_msgs/msg/PoseStamped", "std_msgs/msg/Float64MultiArray"
TIP, TARGET, TF, JOINTS, DIAGNOSTICS = "/tepm/tip", "/tepm/target", "/tf", "/joint_states", "/diagnostics"
PRESSURES, TENSIONS = "/tepm/pressures", "/tepm/tensions"
PRESSURE_COMMANDS, TENSION_COMMANDS = "/tepm/pressure_commands", "/tepm/tension_commands"
TOPICS: Mapping[str, str] = {
    TIP: _POSE,
    TARGET: _POSE,
    TF: "tf2_msgs/msg/TFMessage",
    JOINTS: "sensor_msgs/msg/JointState",
    PRESSURES: _NUMBERS,
    TENSIONS: _NUMBERS,
    PRESSURE_COMMANDS: _NUMBERS,
    TENSION_COMMANDS: _NUMBERS,
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}
"""Types of the topics of a run."""
_NO_TURN = np.eye(3)


def header(stamp: float, frame: str = FRAME) -> Message:
    """A std_msgs/Header with a time in s since 1970."""
    whole, nanoseconds = divmod(round(stamp * 1e9), 1_000_000_000)
    return {"stamp": {"sec": whole, "nanosec": nanoseconds}, "frame_id": frame}


def number_array(values: np.ndarray, label: str) -> Message:
    """A std_msgs/Float64MultiArray of one dimension, (n,); its label says the unit and what the numbers are of."""
    size = len(values)
    return {"layout": {"dim": [{"label": label, "size": size, "stride": size}], "data_offset": 0}, "data": values.tolist()}


def pose_stamped(place: np.ndarray, stamp: float, turn: np.ndarray = _NO_TURN) -> Message:
    """A geometry_msgs/PoseStamped of a position (3,) in m and a rotation (3, 3) in G."""
    return {"header": header(stamp), "pose": {"position": _vector(place), "orientation": _quaternion(turn)}}


def diagnostics(levels: Sequence[tuple[str, int, str]], stamp: float, numbers: Mapping[str, str]) -> Message:
    """A diagnostic_msgs/DiagnosticArray.

    Args:
        levels: name, level and message of each status.
        stamp: time in s.
        numbers: of the first status.
    """
    status = [
        {
            "level": level,
            "name": f"tepm: {name}",
            "message": message,
            "hardware_id": "tepm",
            "values": [] if row else [{"key": key, "value": value} for key, value in numbers.items()],
        }
        for row, (name, level, message) in enumerate(levels)
    ]
    return {"header": header(stamp, ""), "status": status}


class RunMessages:
    """Messages of a robot's runs.

    Args:
        robot: that is driven.
    """

    def __init__(self, robot: Robot) -> None:
        self._chain, actuators = RodChain(robot), ", ".join(Layout.from_robot(robot).actuator_names)
        self._labels = f"Pa: {actuators}", f"N: {actuators}"

    def of_sample(self, sample: Sample, stamp: float) -> dict[str, Message]:
        """Messages by topic; lost points and what is not measured are left out.

        Args:
            sample: as measured.
            stamp: when it was true, in s since 1970.
        """
        transforms = np.tile(np.eye(4), (len(sample.points), 1, 1)) if sample.transforms is None else sample.transforms
        seen = [int(at) for at in np.flatnonzero(np.isfinite(sample.points).all(axis=1))]
        turns = {at: turn if np.isfinite(turn := transforms[at, :3, :3]).all() else _NO_TURN for at in seen}
        found: dict[str, Message] = {}
        if seen:
            moved = [(self._chain.points[at], _vector(sample.points[at]), _quaternion(turns[at])) for at in seen]
            found[TF] = {
                "transforms": [
                    {
                        "header": header(stamp),
                        "child_frame_id": TRACKED + name,
                        "transform": {"translation": place, "rotation": turn},
                    }
                    for name, place, turn in moved
                ]
            }
        if len(sample.points) - 1 in seen:
            found[TIP] = pose_stamped(sample.points[-1], stamp, turns[seen[-1]])
        if len(seen) == len(self._chain.points):
            positions = self._chain.positions(sample.points).tolist()
            joints = {"name": list(self._chain.joints), "position": positions, "velocity": [], "effort": []}
            found[JOINTS] = {"header": header(stamp), **joints}
        for topic, values, label in zip((PRESSURES, TENSIONS), (sample.pressures, sample.tensions), self._labels, strict=True):
            if values is not None:
                found[topic] = number_array(values, label)
        return found

    def of_command(self, command: Command) -> dict[str, Message]:
        """Messages by topic."""
        values = command.pressures, command.tensions
        topics = PRESSURE_COMMANDS, TENSION_COMMANDS
        return {topic: number_array(each, label) for topic, each, label in zip(topics, values, self._labels, strict=True)}


def _vector(place: np.ndarray) -> Message:
    return dict(zip("xyz", place.tolist(), strict=True))


def _quaternion(turn: np.ndarray) -> Message:
    return dict(zip("xyzw", Rotation.from_matrix(turn).as_quat().tolist(), strict=True))
