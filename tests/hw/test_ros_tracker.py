"""The tracker of ROS topics: it keeps the contract of trackers, against a stand-in for rosbridge."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from tepm_opt.errors import InputError
from tepm_opt.hw.trackers import open_link
from tepm_opt.hw.trackers.receiver import require_package
from tepm_opt.models.hardware import TrackerLink
from tepm_opt.testing import TrackerContract, motion_of_arm
from tepm_opt.testing.trackers import Motion
from tests.hw.rosbridge import RosbridgeStandIn
from tests.hw.test_tracker_contracts import RATE, Sensors

pytest.importorskip("websocket")
NAMES = ("/base", "/lower", "/upper", "/tip")
OFFSET = 1.7e9  # s that the clock of the ROS machine is ahead of the host's


def header(stamp: float, frame: str = "tracker") -> dict[str, Any]:
    """A std_msgs/Header."""
    return {"stamp": {"sec": int(stamp), "nanosec": int(1e9 * (stamp % 1))}, "frame_id": frame}


def position_and_turn(pose: np.ndarray) -> tuple[dict[str, float], dict[str, float]]:
    """Vector and quaternion of a pose, (4, 4)."""
    quaternion = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return dict(zip("xyz", pose[:3, 3].tolist(), strict=True)), dict(zip("xyzw", quaternion.tolist(), strict=True))


def pose_message(pose: np.ndarray) -> dict[str, Any]:
    """A geometry_msgs/Pose."""
    return dict(zip(("position", "orientation"), position_and_turn(pose), strict=True))


def transform_message(name: str, pose: np.ndarray, stamp: float) -> dict[str, Any]:
    """A geometry_msgs/TransformStamped."""
    moved = dict(zip(("translation", "rotation"), position_and_turn(pose), strict=True))
    return {"header": header(stamp), "child_frame_id": name, "transform": moved}


class RosStandIn(Sensors):
    """A ROS node that publishes the sensors' poses.

    Args:
        form: type of the messages.
    """

    def __init__(self, form: str) -> None:
        super().__init__()
        self._form, self._bridge, self._going = form, RosbridgeStandIn(), threading.Event()
        self._bridge.start()
        self._bridge.stop()  # has a port of its own from now on
        devices = NAMES if form == "PoseStamped" else tuple(name.lstrip("/") for name in NAMES)
        options = {"type": form} if form == "PoseStamped" else {"type": form, "topic": "/poses", "frame": "tracker"}
        self.link = TrackerLink(kind="ros2", devices=devices, port=self._bridge.port, rate_hz=RATE, options=options)

    def start(self, motion: Motion) -> None:
        """See `StandIn`."""
        self._motion = motion
        self._going.set()
        self._bridge.start()
        threading.Thread(target=self._publish, daemon=True).start()

    def stop(self) -> None:
        """See `StandIn`."""
        self._going.clear()
        self._bridge.stop()

    def _publish(self) -> None:
        due = time.monotonic()
        while self._going.is_set():
            poses, stamp = self.poses(), OFFSET + time.monotonic()
            seen = [(name, pose) for name, pose in zip(self.link.devices, poses, strict=True) if pose is not None]
            if self._form == "PoseStamped":
                for name, pose in seen:
                    self._bridge.publish(name, {"header": header(stamp), "pose": pose_message(pose)})
            else:
                other = {**transform_message(self.link.devices[0], np.eye(4), stamp), "header": header(stamp, "map")}
                moved = [*(transform_message(name, pose, stamp) for name, pose in seen), other]
                self._bridge.publish("/poses", {"transforms": moved})
            due += 1 / RATE
            time.sleep(max(due - time.monotonic(), 0))


class _RosContract(TrackerContract):
    form = ""

    def stand_in(self) -> RosStandIn:
        """Not started yet."""
        return RosStandIn(self.form)


@pytest.mark.slow
class TestPoseStamped(_RosContract):
    """A topic for each sensor."""

    form = "PoseStamped"


@pytest.mark.slow
class TestTransforms(_RosContract):
    """A topic of transforms, some of them in a frame that is not the tracker's."""

    form = "TFMessage"


def test_poses_of_an_array_are_the_devices_in_order() -> None:
    """A null (rosbridge's NaN) and a quaternion of zeros are lost sensors; what is of another type is let pass."""
    bridge, poses = RosbridgeStandIn(), motion_of_arm()(0.3)
    bridge.start()
    names = ("a", "b", "c", "d")
    link = TrackerLink(kind="ros2", devices=names, port=bridge.port, options={"type": "PoseArray", "topic": "/array"})
    sent = [pose_message(pose) for pose in poses]
    sent[1]["position"]["y"] = None
    sent[2]["orientation"] = dict.fromkeys("xyzw", 0.0)
    try:
        with open_link(link, stale_periods=60) as tracker:
            end, frame = time.monotonic() + 5, None
            while frame is None and time.monotonic() < end:
                bridge.publish("/array", {"data": 1.0})
                bridge.publish("/array", {"header": header(OFFSET + time.monotonic()), "poses": sent})
                frame = tracker.read(0.01)
            assert frame is not None, tracker.status
            np.testing.assert_allclose(frame.transforms[[0, 3]], poses[[0, 3]], atol=1e-9)
            assert np.isnan(frame.points[1:3]).all()
            assert "lost s2, s3" in frame.status
    finally:
        bridge.stop()


def test_a_wrong_option_is_refused() -> None:
    """With the valid ones."""
    link = TrackerLink(kind="ros2", devices=("/tip",), options={"type": "Odometry"})
    with pytest.raises(InputError, match=r"type.*PoseStamped"):
        open_link(link)


def test_an_option_is_no_list() -> None:
    with pytest.raises(ValidationError, match="not an option; valid: text, a number, true or false"):
        TrackerLink.model_validate({"kind": "ros2", "devices": ["/tip"], "options": {"type": ["PoseStamped"]}})


def test_a_package_that_is_missing() -> None:
    """The message says how to install it."""
    with pytest.raises(InputError, match=r"tracker ros2 needs no_such_module, .* pip install 'tepm-opt\[ros2\]'"):
        require_package("no_such_module", "ros2", "tracker ros2")
