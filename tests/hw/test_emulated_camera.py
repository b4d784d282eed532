"""The emulated camera: the robot file that goes with it has the arm where the tags are found."""

from __future__ import annotations

import socket
import threading
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.tomltext import with_numbers
from tepm_opt.errors import InputError
from tepm_opt.hw.emulation.camera import CAMERA, EmulatedCamera, mount_before_camera, tag_edge
from tepm_opt.hw.rig import Command
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import load_rig_file
from tepm_opt.hw.simulation.scaling import scale_rig
from tepm_opt.hw.trackers import open_link
from tepm_opt.hw.trackers.camera import calibration_text
from tepm_opt.models.hardware import TrackerLink
from tepm_opt.models.robot import Robot, parse_robot, robot_text

HANGING = {"gravity_m_per_s2": [0.0, 0.0, -9.81], "base_position_m": [0.3, -0.2, 1.0], "base_rotation_deg": [180.0, 0.0, 0.0]}
STANDING = {"gravity_m_per_s2": [0.0, 0.0, -9.81], "base_position_m": [0.1, 0.4, 0.2], "base_rotation_deg": [0.0, 0.0, 30.0]}


def mounted(mount: dict[str, list[float]]) -> Robot:
    """The prototype, mounted otherwise."""
    return parse_robot(with_numbers(robot_text("kang2017"), "mount", dict(mount), "robot"), "robot")


def bent(robot: Robot) -> SimulatedRig:
    """A perfect arm that rests under 2 N in a tendon."""
    rig = SimulatedRig(scale_rig(load_rig_file("perfect"), robot), watched=False)
    rig.apply(Command.from_inputs(np.eye(12)[9] * 2.0))
    return rig


@pytest.mark.parametrize("mount", [HANGING, STANDING])
def test_points_are_those_of_the_arm_before_the_camera(mount: dict[str, list[float]], tmp_path: Path) -> None:
    """Within 1 mm of a simulation of the robot in the camera's frame, whatever frame the arm itself is simulated in."""
    pytest.importorskip("cv2", reason="opencv-python-headless is not installed (extra webcam)")
    robot = mounted(mount)
    found = {key: list(value) for key, value in mount_before_camera(robot).model_dump().items()}
    expected = bent(mounted(found)).read().points
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"http://127.0.0.1:{free.getsockname()[1]}/"
    (tmp_path / "camera.toml").write_text(calibration_text(CAMERA.calibration, []))
    options = {"camera": address, "calibration": str(tmp_path / "camera.toml"), "tag_m": tag_edge(robot), "axes": "upright"}
    link = TrackerLink(kind="webcam", options=options, devices=("tag 0", "tag 1", "tag 2", "tag 3"), rate_hz=25.0)
    rig, ended = bent(robot), threading.Event()
    camera = EmulatedCamera(link, rig)

    def live() -> None:
        while not ended.wait(0.01):
            camera.show(rig.read())

    thread = threading.Thread(target=live, daemon=True)
    thread.start()
    try:
        with open_link(link) as tracker:
            frame = tracker.first(10.0)
    finally:
        ended.set()
        thread.join(10)
        camera.close()
    assert np.linalg.norm(frame.points - expected, axis=1).max() < 1e-3


def test_arms_whose_tags_are_too_small_are_refused() -> None:
    robot = mounted(STANDING)
    long = robot.model_copy(update={"geometry": robot.geometry.model_copy(update={"modules": 5})})
    with pytest.raises(InputError, match="valid: at most 4"):
        tag_edge(long)
