"""Poses of a ROS 2 graph, by rosbridge: of PoseStamped topics, of TFMessage or of PoseArray."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from tepm_opt.data.documents import Section
from tepm_opt.hw.ros.bridge import PORT, SERVER, Message, Rosbridge
from tepm_opt.hw.trackers.receiver import Inbox, Pose, StreamReceiver, require_package
from tepm_opt.hw.trackers.tracker import TrackerKind
from tepm_opt.models.hardware import TrackerLink

PACKAGES = {"PoseStamped": "geometry_msgs", "PoseArray": "geometry_msgs", "TFMessage": "tf2_msgs"}


class RosOptions(Section):
    """Options of `kind = "ros2"`.

    Attributes:
        type: of the messages. PoseStamped: each device is a topic. TFMessage: a device is a child_frame_id. PoseArray: the devices name its
            poses in their order.
        topic: of TFMessage or PoseArray.
        frame: of which poses are taken, as their header says it; empty: of all.
    """

    type: Literal["PoseStamped", "TFMessage", "PoseArray"] = "PoseStamped"
    topic: Annotated[str, Field(min_length=1)] = "/tf"
    frame: str = ""


class _Topics:
    """Poses of a connection that is subscribed to what the options say."""

    def __init__(self, link: TrackerLink, options: RosOptions) -> None:
        self._devices, self._options = link.devices, options
        self._bridge = Rosbridge(link.host, link.port)
        topics = link.devices if options.type == "PoseStamped" else (options.topic,)
        for topic in topics:
            self._bridge.send("subscribe", topic=topic, type=f"{PACKAGES[options.type]}/msg/{options.type}", compression="none")

    def poll(self, timeout: float) -> Sequence[Pose]:
        """See `Stream`."""
        found = self._bridge.receive(timeout)
        if found is None or found.get("op") != "publish":
            return ()
        try:
            return self._poses(found["topic"], found["msg"])
        except (KeyError, TypeError, AttributeError, ValueError, OverflowError):  # a message of another type
            return ()

    def _poses(self, topic: str, message: Message) -> list[Pose]:
        match self._options.type:
            case "PoseStamped":
                headed = [(topic, message["header"], message["pose"]["position"], message["pose"]["orientation"])]
            case "TFMessage":
                every = [(each["child_frame_id"], each["header"], each["transform"]) for each in message["transforms"]]
                headed = [(name, header, moved["translation"], moved["rotation"]) for name, header, moved in every]
            case "PoseArray":
                pairs = zip(self._devices, message["poses"], strict=False)
                headed = [(name, message["header"], pose["position"], pose["orientation"]) for name, pose in pairs]
        wanted = self._options.frame
        return [
            Pose(name, _matrix(place, turn), header["stamp"]["sec"] + 1e-9 * header["stamp"]["nanosec"])
            for name, header, place, turn in headed
            if not wanted or header["frame_id"] == wanted
        ]

    def __enter__(self) -> _Topics:
        return self

    def __exit__(self, *_: object) -> None:
        self._bridge.close()


def _matrix(place: dict[str, Any], turn: dict[str, Any]) -> np.ndarray | None:
    """A pose, (4, 4); None where a number of it is missing (rosbridge sends null for NaN), or the quaternion is none."""
    numbers = [place[axis] for axis in "xyz"] + [turn[axis] for axis in "xyzw"]
    if not all(isinstance(number, int | float) and math.isfinite(number) for number in numbers):
        return None
    px, py, pz, x, y, z, w = numbers
    if abs(x * x + y * y + z * z + w * w - 1) > 1e-3:
        return None
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), px],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), py],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), pz],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def _receive(link: TrackerLink, options: Section, inbox: Inbox) -> StreamReceiver:
    """Begin to receive.

    Raises:
        InputError: websocket-client is not installed.
    """
    assert isinstance(options, RosOptions)
    require_package("websocket", "ros2", "tracker ros2")
    return StreamReceiver(lambda: _Topics(link, options), inbox)


ROS2 = TrackerKind("ros2", "topics of ROS 2, by rosbridge", _receive, SERVER, RosOptions, PORT, needs="websocket")
