"""Tags before a camera: rendered images are located, a network camera keeps the contract of trackers."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tepm_opt.errors import InputError
from tepm_opt.hw.emulation.tags import Camera, NetworkCamera, Tags
from tepm_opt.hw.trackers import LiveTracker, open_link
from tepm_opt.hw.trackers.camera import calibration_text, read_calibration
from tepm_opt.hw.trackers.frames import Frame
from tepm_opt.hw.trackers.tags import UPRIGHT, TagFinder
from tepm_opt.models.hardware import TrackerLink
from tepm_opt.testing import TrackerContract
from tepm_opt.testing.trackers import Motion, motion_of_arm
from tests.hw.images import cv2, spoiled
from tests.hw.test_tracker_contracts import Sensors

DEVICES, RATE, LATENCY = ("tag 0", "tag 1", "tag 2", "tag 3"), 20.0, 0.35
FACING = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Axes of a tag that faces a camera which looks along y."""


class TagStandIn(Sensors):
    """A network camera before which four tags move. The time in which tags are found counts as age of an image, too."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._camera, self._tags = Camera(centre=(320.0, 60.0)), Tags(cv2, 0.013)
        self._server = NetworkCamera(cv2, self._image, RATE, LATENCY)
        file = folder / "camera.toml"
        file.write_text(calibration_text(self._camera.calibration, []))
        self._motion, finder, times = motion_of_arm(), finder_of(self._camera, 0.013), [time.monotonic()]
        image = self._image(0.0)
        for _ in range(20):
            finder.find(image)
            times.append(time.monotonic())
        self.latency_s = LATENCY + min(np.diff(times))
        options = {"camera": self._server.address, "calibration": str(file), "tag_m": 0.013, "axes": "upright"}
        self.link = TrackerLink(kind="webcam", options=options, devices=DEVICES, rate_hz=RATE)

    def _image(self, when: float) -> np.ndarray:
        shown = []
        for pose in self.poses(when):
            seen = None
            if pose is not None:
                seen = np.eye(4)
                seen[:3, :3], seen[:3, 3] = UPRIGHT.T @ pose[:3, :3] @ FACING, UPRIGHT.T @ pose[:3, 3]
            shown.append(seen)
        return self._tags.image(self._camera, shown)

    def poses(self, when: float) -> list[np.ndarray | None]:
        """See `Sensors`, but at a time on the host's clock in s."""
        if not self._frozen or self._kept is None:
            self._kept = self._motion(when)
            self._kept[:, :3, 3] += self.noise_m * self._random.normal(size=(4, 3))
        return [None if k in self._lost else self._kept[k] for k in range(4)]

    def start(self, motion: Motion) -> None:
        """See `StandIn`."""
        self._motion = motion
        self._server.start()

    def stop(self) -> None:
        """See `StandIn`."""
        self._server.stop()


@pytest.mark.slow
class TestWebcam(TrackerContract):
    """Tags of 13 mm at 0.2 m, 41 px wide, through JPEG images of 640 x 480."""

    position_m = 1e-3  # an image that a busy machine takes 10 ms too late is 1 mm wrong; for the tags alone see `test_poses_of_tags`

    @pytest.fixture(autouse=True)
    def _folder(self, tmp_path: Path) -> None:
        self.folder = tmp_path

    def _frames(self, tracker: LiveTracker, count: int) -> list[Frame]:
        return super()._frames(tracker, count // 6)  # a camera gives fewer

    def stand_in(self) -> TagStandIn:
        """Not started yet."""
        return TagStandIn(self.folder)


def poses_about(camera: Camera, distance: float, random: np.random.Generator) -> list[np.ndarray]:
    """Four tags, one in each quarter of the image, that face the camera within 30 degrees or so; (4, 4) in m."""
    poses = []
    for k in range(4):
        pose, depth = np.eye(4), distance * random.uniform(0.95, 1.05)
        pose[:3, :3] = (Rotation.from_rotvec([np.pi, 0, 0]) * Rotation.from_rotvec(random.uniform(-0.5, 0.5, 3))).as_matrix()
        at = np.array([(k % 2 - 0.5) * 0.4 * camera.width, (k // 2 - 0.5) * 0.4 * camera.height]) + random.uniform(-20, 20, 2)
        pose[:3, 3] = [*(depth / camera.focal * at), depth]
        poses.append(pose)
    return poses


def finder_of(camera: Camera, edge_m: float, distortion: tuple[float, ...] = ()) -> TagFinder:
    """Of AprilTags, in the camera's axes."""
    calibration = camera.calibration.model_copy(update={"distortion": distortion})
    return TagFinder(cv2, "APRILTAG_36h11", edge_m, calibration, np.eye(3))


@pytest.mark.parametrize(("camera", "edge"), [(Camera(), 0.03), (Camera(1280, 720, 1000.0, (640.0, 360.0)), 0.02)])
def test_poses_of_tags(camera: Camera, edge: float) -> None:
    """At 0.5 m, through blur and noise, tags 40 px wide are located within 0.3 mm rms and turned right within 0.5 degrees."""
    random, tags, finder = np.random.default_rng(1), Tags(cv2, edge), finder_of(camera, edge)
    errors, turns = [], []
    for _ in range(5):
        poses = poses_about(camera, 0.5, random)
        found = finder.find(spoiled(tags.image(camera, poses), random))
        assert sorted(found) == list(DEVICES)
        for name, pose in zip(DEVICES, poses, strict=True):
            errors.append(found[name][:3, 3] - pose[:3, 3])
            turns.append(np.degrees(Rotation.from_matrix(found[name][:3, :3].T @ pose[:3, :3]).magnitude()))
    assert np.sqrt((np.array(errors) ** 2).sum(axis=1).mean()) < 3e-4
    assert np.median(turns) < 0.5


def test_distortion_is_taken_out() -> None:
    """Poses are right with the lens's distortion in the calibration, and 1 mm or more wrong without."""
    camera, lens, random = Camera(), (-0.25, 0.08, 0.001, -0.001, 0.0), np.random.default_rng(2)
    poses = poses_about(camera, 0.5, random)
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=2).astype(np.float32)
    ideal = cv2.undistortPoints(pixels.reshape(-1, 1, 2), camera.matrix, np.array(lens), P=camera.matrix).reshape(pixels.shape)
    image = cv2.remap(Tags(cv2, 0.03).image(camera, poses), ideal[..., 0], ideal[..., 1], cv2.INTER_LINEAR)

    def worst(distortion: tuple[float, ...]) -> float:
        found = finder_of(camera, 0.03, distortion).find(image)
        return max(float(np.linalg.norm(found[name][:3, 3] - pose[:3, 3])) for name, pose in zip(DEVICES, poses, strict=True))

    assert worst(lens) < 1e-3 < worst(())


def test_a_tag_that_is_seen_twice_is_lost() -> None:
    camera, tags = Camera(), Tags(cv2, 0.03)
    poses = poses_about(camera, 0.5, np.random.default_rng(3))
    image = np.minimum(tags.image(camera, [*poses[:3], None]), tags.image(camera, [None, None, None, poses[3]]))
    assert finder_of(camera, 0.03).find(image)["tag 0"] is not None
    twice = Tags(cv2, 0.03, 1).image(camera, poses[3:])
    image[camera.height // 2 :, camera.width // 2 :] = twice[camera.height // 2 :, camera.width // 2 :]
    found = finder_of(camera, 0.03).find(image)
    assert found["tag 0"] is None
    assert found["tag 1"] is not None


@pytest.mark.parametrize("name", ["camera.toml", "camera.json"])
def test_a_calibration_file_comes_back(name: str, tmp_path: Path) -> None:
    calibration = Camera().calibration.model_copy(update={"distortion": (0.1, -0.02, 1e-5), "reprojection_px": 0.21})
    is_json = name.endswith("json")
    (tmp_path / name).write_text(json.dumps(calibration.model_dump()) if is_json else calibration_text(calibration, ["a note"]))
    assert read_calibration(tmp_path / name) == calibration


def test_wrong_options_say_what_is_valid(tmp_path: Path) -> None:
    file = tmp_path / "camera.toml"
    file.write_text(calibration_text(Camera().calibration, []))
    right = {"calibration": str(file), "tag_m": 0.03}
    for options, says in [
        ({"tag_m": 0.03}, "missing key 'calibration'"),
        ({**right, "tag_m": 30.0}, "tag_m = 30.0"),
        ({**right, "dictionary": "APRILTAG_36h12"}, "did you mean 'APRILTAG_36h11'"),
        ({**right, "axes": "optic"}, "did you mean 'optical'"),
        ({**right, "calibration": str(tmp_path / "none.toml")}, "cannot be read"),
    ]:
        with pytest.raises(InputError, match=says):
            open_link(TrackerLink(kind="webcam", options=options, devices=DEVICES))


@pytest.mark.slow
def test_images_that_come_too_fast_are_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses stay as young as the newest image where tags take 0.1 s to be found, however many images wait in the network."""
    file, camera, find = tmp_path / "camera.toml", Camera(), TagFinder.find
    monkeypatch.setattr(TagFinder, "find", lambda *arguments: time.sleep(0.1) or find(*arguments))
    file.write_text(calibration_text(camera.calibration, []))
    tags, began = Tags(cv2, 0.03), time.monotonic()

    def taken(when: float) -> np.ndarray:
        """Tags that go away from the camera, 0.1 m a second."""
        poses = [np.diag([1.0, -1.0, -1.0, 1.0]) for _ in DEVICES]
        for k, pose in enumerate(poses):
            pose[:3, 3] = [0.05 * k - 0.075, 0.0, 0.3 + 0.1 * (when - began)]
        return tags.image(camera, poses)

    server = NetworkCamera(cv2, taken, 60.0, 0.0)
    server.start()
    try:
        options = {"camera": server.address, "calibration": str(file), "tag_m": 0.03}
        with open_link(TrackerLink(kind="webcam", options=options, devices=DEVICES, rate_hz=RATE), stale_periods=60) as tracker:
            tracker.first(10.0)
            end, ages = time.monotonic() + 3.0, []
            while time.monotonic() < end:
                if frame := tracker.read(0.5):
                    ages.append(frame.time - began - (frame.points[0, 2] - 0.3) / 0.1)
    finally:
        server.stop()
    assert np.median(ages[-5:]) < 0.5


def test_images_of_another_size_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "camera.toml"
    file.write_text(calibration_text(Camera(width=800).calibration, []))
    server = NetworkCamera(cv2, lambda _: Camera().empty(), RATE, 0.0)
    server.start()
    try:
        options = {"camera": server.address, "calibration": str(file), "tag_m": 0.03}
        wrong = pytest.raises(InputError, match="images have 640 x 480 px; valid: 800 x 480")
        with open_link(TrackerLink(kind="webcam", options=options, devices=DEVICES)) as tracker, wrong:
            tracker.first(1.5)
    finally:
        server.stop()
