"""A robot behind ROS nodes keeps the contract of rigs; a run on any rig is published, and stopped by a service."""

from __future__ import annotations

import json
import struct
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.hw.registry import open_rig, robot_of
from tepm_opt.hw.rig import Command, Rig, Sample
from tepm_opt.hw.ros.messages import TOPICS, RunMessages
from tepm_opt.hw.ros.node import parse_address
from tepm_opt.hw.ros.publishing import STOP, to_foxglove, to_ros
from tepm_opt.hw.ros.rig import COMMAND, GAUGES, POINTS
from tepm_opt.models.robot import load_robot
from tepm_opt.testing import RigContract, motion_of_arm
from tests.hw.rosbridge import RosbridgeStandIn
from tests.hw.test_ros_tracker import header, pose_message

pytest.importorskip("websocket")
PATIENCE = 20.0  # s, for machines that do other things besides


@pytest.fixture
def bridge() -> Iterator[RosbridgeStandIn]:
    """A rosbridge that serves."""
    found = RosbridgeStandIn()
    found.start()
    yield found
    found.reading.set()
    found.stop()


def wait(until: Callable[[], Any]) -> None:
    """Wait until something holds."""
    end = time.monotonic() + PATIENCE
    while not until():
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.005)


class Robot:
    """ROS nodes of a robot: an arm that swings whatever is commanded, and gauges that show the commands.

    Attributes:
        silent: set: it publishes nothing.
    """

    def __init__(self, bridge: RosbridgeStandIn) -> None:
        self.silent, self._over = threading.Event(), threading.Event()
        self._bridge, self._thread = bridge, threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        motion, random = motion_of_arm(), np.random.default_rng(1)
        while not self._over.wait(0.01):
            now, poses = time.monotonic(), motion(time.monotonic())
            poses[:, :3, 3] += 1e-4 * random.normal(size=(4, 3))
            if not self.silent.is_set():
                commands = self._bridge.messages[COMMAND]
                gauges = np.array(commands[-1]["data"][:12] if commands else np.zeros(12)) + 1e-3 * random.random(12)
                self._bridge.publish(GAUGES, {"data": [None if k == 2 else value for k, value in enumerate(gauges.tolist())]})
                self._bridge.publish(POINTS, {"header": header(now), "poses": [pose_message(pose) for pose in poses]})

    def stop(self) -> None:
        """End it."""
        self._over.set()
        self._thread.join()


@pytest.fixture
def robot(bridge: RosbridgeStandIn) -> Iterator[Robot]:
    """Nodes of a robot on that rosbridge."""
    found = Robot(bridge)
    yield found
    found.stop()


class TestRosRig(RigContract):
    """The contract, over topics."""

    @pytest.fixture(autouse=True)
    def _where(self, bridge: RosbridgeStandIn, robot: Robot) -> None:
        self.address = f"127.0.0.1:{bridge.port}"

    def open_rig(self) -> Rig:
        """The rig of this address."""
        return open_rig(f"ros2:{self.address}")


def test_commands_gauges_silence_and_stop(bridge: RosbridgeStandIn, robot: Robot) -> None:
    """Commands arrive in Pa, N and 1 for a motor that is on; gauges come back; leaving it commands nothing with all motors off."""
    command = Command(np.linspace(1e4, 6e4, 6), np.linspace(0.5, 1.0, 6), np.array([True, False] * 3))
    with open_rig(f"ros2:127.0.0.1:{bridge.port}") as rig:
        rig.apply(command)
        wait(lambda: bridge.messages[COMMAND])
        assert bridge.messages[COMMAND][-1]["data"] == [*command.pressures, *command.tensions, 1, 0, 1, 0, 1, 0]
        samples = [rig.read() for _ in range(10)]
        assert samples[-1].pressures is not None
        assert samples[-1].tensions is not None
        assert np.isnan(samples[-1].pressures[2])
        np.testing.assert_allclose(np.delete(samples[-1].pressures, 2), np.delete(command.pressures, 2), atol=1e-2)
        np.testing.assert_allclose(samples[-1].tensions, command.tensions, atol=1e-2)
        robot.silent.set()
        time.sleep(0.1)
        while (silent := rig.read()).status != "tracker silent":
            pass
        assert np.isnan(silent.points).all()
        assert silent.tensions is None
    wait(lambda: bridge.messages[COMMAND][-1]["data"] == [0.0] * 18)
    with pytest.raises(RuntimeError, match="stopped"):
        rig.apply(command)


def test_a_rosbridge_that_ends_is_an_error_for_who_commands(bridge: RosbridgeStandIn, robot: Robot) -> None:
    """Set points are not kept for later."""
    with open_rig(f"ros2:127.0.0.1:{bridge.port}") as rig:
        bridge.stop()
        with pytest.raises(ConnectionError, match="ROS: "):
            wait(lambda: rig.apply(Command.from_inputs(np.zeros(12))))


def test_a_run_is_published(bridge: RosbridgeStandIn) -> None:
    """Every sample and command, what is wrong, and the target; the rig's own members stay."""
    with to_ros(f"127.0.0.1:{bridge.port}") as ros, ros.watch(open_rig("sim")) as rig:
        command = Command.from_inputs(0.1 * rig.robot.input_max)
        rig.apply(command)
        samples = [rig.read() for _ in range(5)]
        assert rig.simulated is not None
        samples += rig.simulated.read_many(3)
        assert rig.simulated.true_points.shape == (4, 3)
        ros.aim(np.array([0.1, 0.2, 0.3]), {"gauge 13": "pressure gauge 13 frozen"})
        rig.read()
        ros.aim(np.zeros(3))
        rig.read()
    found = bridge.messages
    wait(lambda: len(found["/tepm/tip"]) == 10)
    tips = [message["pose"]["position"] for message in found["/tepm/tip"]]
    np.testing.assert_allclose([[tip[axis] for axis in "xyz"] for tip in tips[:8]], [sample.points[-1] for sample in samples])
    assert [each["child_frame_id"] for each in found["/tf"][0]["transforms"]] == [f"tracked_s{k}" for k in (1, 2, 3, 4)]
    assert found["/tepm/pressure_commands"][0]["data"] == command.pressures.tolist()
    assert found["/tepm/tension_commands"][0]["layout"]["dim"][0]["label"] == "N: 11, 12, 13, 21, 22, 23"
    np.testing.assert_allclose(found["/tepm/tensions"][-1]["data"], command.tensions, rtol=0.1)
    assert found["/tepm/target"][0]["pose"]["position"] == {"x": 0.1, "y": 0.2, "z": 0.3}
    stamps = [message["header"]["stamp"] for message in found["/tepm/tip"]]
    assert all(abs(stamp["sec"] + 1e-9 * stamp["nanosec"] - time.time()) < 60 for stamp in stamps)
    told = [[(status["name"], status["level"]) for status in message["status"]] for message in found["/diagnostics"]]
    assert told[0] == [("tepm: rig", 0)]
    assert told[-2:] == [[("tepm: rig", 0), ("tepm: gauge 13", 2)], [("tepm: rig", 0), ("tepm: gauge 13", 0)]]
    assert bridge.types["/joint_states"] == "sensor_msgs/msg/JointState"


def test_lost_points_and_gauges_that_there_are_not(bridge: RosbridgeStandIn) -> None:
    """They are left out; without all points there are no joints."""
    points = np.ones((4, 3)) * np.arange(4)[:, None]
    points[3] = np.nan
    found = RunMessages(load_robot("kang2017")).of_sample(Sample(1.0, points), 5.25)
    assert set(found) == {"/tf"}
    assert len(found["/tf"]["transforms"]) == 3
    assert found["/tf"]["transforms"][0]["header"]["stamp"] == {"sec": 5, "nanosec": 250_000_000}


def test_a_rosbridge_that_stalls_delays_nobody(bridge: RosbridgeStandIn) -> None:
    """What it does not take is dropped, oldest first, and counted; when it goes on so does the publisher."""
    with to_ros(f"127.0.0.1:{bridge.port}") as ros, ros.watch(open_rig("sim:perfect")) as rig:
        rig.apply(Command.from_inputs(0.1 * rig.robot.input_max))
        messages, sample = RunMessages(rig.robot), rig.read()
        wait(lambda: bridge.messages["/tepm/tip"])
        bridge.reading.clear()
        longest = 0.0
        while ros.node.dropped < 1000:
            began = time.perf_counter()
            ros.show(messages, sample, 0.0)
            longest = max(longest, time.perf_counter() - began)
        assert longest < 0.5  # a connection that is not served blocks for a second
        bridge.reading.set()
        time.sleep(0.1)
        before = len(bridge.messages["/tepm/target"])
        ros.aim(np.zeros(3))
        wait(lambda: len(bridge.messages["/tepm/target"]) > before)


def test_the_service_stops(bridge: RosbridgeStandIn) -> None:
    """It is answered, and acts as Ctrl-C does in the main thread, also after rosbridge was away."""
    with to_ros(f"127.0.0.1:{bridge.port}") as ros:
        bridge.stop()
        wait(lambda: ros.node.trouble)
        bridge.types.clear()
        bridge.start()
        wait(lambda: STOP in bridge.types)
        with pytest.raises(KeyboardInterrupt):
            _call_and_wait(bridge)
        assert bridge.types[STOP] == "std_srvs/srv/Trigger"


def _call_and_wait(bridge: RosbridgeStandIn) -> None:
    response = bridge.call(STOP)
    assert response["values"]["success"] is True
    assert response["result"] is True
    time.sleep(PATIENCE)


def test_addresses() -> None:
    """A host alone has rosbridge's port; what is none is refused with what is valid."""
    assert parse_address("arm.local") == ("arm.local", 9090)
    assert parse_address("10.0.0.2:9091") == ("10.0.0.2", 9091)
    assert parse_address("[::1]:9091") == ("::1", 9091)
    assert parse_address("::1") == ("::1", 9090)
    for wrong in ("arm:", "arm:x", ":9090", "arm:70000"):
        with pytest.raises(InputError, match="HOST:PORT"):
            parse_address(wrong)


def test_nobody_answers() -> None:
    """The message says what has to run there; the rig's robot is known without it."""
    bridge = RosbridgeStandIn()
    bridge.start()
    bridge.stop()
    assert robot_of(f"ros2:127.0.0.1:{bridge.port}") == "kang2017"
    with pytest.raises(InputError, match=r"nobody answers .*rosbridge"):
        open_rig(f"ros2:127.0.0.1:{bridge.port}")


def test_foxglove_gets_the_same_topics_and_stops() -> None:
    """A client of its protocol (foxglove.websocket.v1, little endian) reads a pose in Foxglove's own schema and calls the service."""
    pytest.importorskip("foxglove")
    websocket, stopped = pytest.importorskip("websocket"), threading.Event()
    with to_foxglove(0, stopped.set) as ros, ros.watch(open_rig("sim:perfect")) as rig:
        line = websocket.create_connection(f"ws://127.0.0.1:{ros.node.port}", timeout=PATIENCE, subprotocols=["foxglove.sdk.v1"])
        channels, services = dict[str, dict[str, Any]](), dict[str, int]()
        while len(channels) < len(TOPICS) or not services:
            told = json.loads(line.recv())
            channels |= {each["topic"]: each for each in told.get("channels", ())}
            services |= {each["name"]: each["id"] for each in told.get("services", ())}
        assert channels["/tepm/tip"]["schemaName"] == "foxglove.PoseInFrame"
        line.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": 7, "channelId": channels["/tepm/tip"]["id"]}]}))
        time.sleep(0.2)
        rig.apply(Command.from_inputs(0.1 * rig.robot.input_max))
        sample = rig.read()
        data = line.recv()
        assert (data[0], struct.unpack("<I", data[1:5])[0]) == (1, 7)
        pose = json.loads(data[13:])
        assert pose["pose"]["position"] == dict(zip("xyz", sample.points[-1].tolist(), strict=True))
        assert abs(pose["timestamp"]["sec"] - time.time()) < 60
        line.send_binary(struct.pack("<BIII", 2, services[STOP], 1, 4) + b"json{}")
        assert json.loads(line.recv()[17:]) == {"success": True, "message": ""}
        assert stopped.wait(PATIENCE)
        line.close()
