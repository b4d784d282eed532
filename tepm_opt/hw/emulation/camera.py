"""A camera that looks at the simulated arm: a tag on each reference point, in images that come over HTTP."""

from __future__ import annotations

import math
import threading
from urllib.parse import urlsplit

import numpy as np
from scipy.spatial.transform import Rotation

from tepm_opt.errors import InputError
from tepm_opt.hw.emulation.openigtlink import taken_port
from tepm_opt.hw.emulation.tags import Camera, ImageNoise, NetworkCamera, Tags
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.trackers.camera import load_opencv
from tepm_opt.hw.trackers.tags import UPRIGHT
from tepm_opt.models.hardware import TrackerLink
from tepm_opt.models.robot import Mount, Robot

CAMERA = Camera(480, 480, 640.0, (240.0, 240.0))
MOST_HZ = 25.0
"""Images a second: every fourth frame of the virtual prototype, so that all images are of the same age."""
DISTANCE, EDGE = 1.5, 0.6
"""From the base to the camera in lengths of the arm, which leaves it an eighth of its length to move above its tip; edge of a tag in
distances of reference points, which leaves room for rims. Of an arm with two modules a tag is 64 px wide then."""
MOST_MODULES = 4
"""Tags of an arm with more are narrower than 30 px."""
FACING = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Axes of a tag on a plate, in the plate's: it looks along -y, towards the camera."""
AGE_S, NOISE_RMS_M = 0.03, 1e-4
"""Until an image is drawn, sent and its tags are found; noise of a position. `tepm hw measure tracker` measures both."""
PATIENCE_S = 1.0
"""An arm that does not move on for so long is shown as it is."""


def frames_per_image(rig: SimulatedRig) -> int:
    """Number of the rig's frames from one image to the next."""
    return max(math.ceil(rig.file.tracker.rate_hz / MOST_HZ), 1)


def tag_edge(robot: Robot) -> float:
    """Edge of a tag's black square in m.

    Raises:
        InputError: the arm has so many points that their tags would be too small.
    """
    if robot.modules > MOST_MODULES:
        raise InputError(f"robot {robot.name} has {robot.modules} modules, whose tags are too small to see; valid: at most {MOST_MODULES}")
    return EDGE * robot.parameters.L_0 / 2


def mount_before_camera(robot: Robot) -> Mount:
    """Mount of the base plate in the frame G of the camera (axes "upright"), which looks along the base plate's y axis.

    Args:
        robot: in a frame G of its own.
    """
    length = robot.modules * robot.parameters.L_0
    middle = (length + robot.parameters.L_0 / 2) / 2  # of the reference points
    gravity = robot.mount.rotation.T @ robot.mount.gravity_m_per_s2
    return Mount(
        gravity_m_per_s2=_round_vector(gravity),
        base_position_m=_round_vector([0, DISTANCE * length, -middle]),
        base_rotation_deg=(0.0, 0.0, 0.0),
    )


def _round_vector(vector: np.ndarray | list[float]) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 9) + 0.0 for value in vector)
    return x, y, z


class EmulatedCamera:
    """Takes images while somebody looks, in a thread for each who does; an image that is not ready for the next one is left out.

    Tags turn with the plates on which they stand. The arm itself is not drawn and hides nothing. A point that the rig's tracker loses is
    not drawn either; its noise is the camera's own.

    Args:
        link: address of the images on the loopback, and the tags' size.
        rig: the arm.

    Raises:
        InputError: OpenCV is not installed, or the port is taken.
    """

    def __init__(self, link: TrackerLink, rig: SimulatedRig) -> None:
        self._cv2, self._rig, self._every = load_opencv(), rig, frames_per_image(rig)
        self._tags = Tags(self._cv2, float(link.options["tag_m"]), rig.layout.points)
        self._place, self._mount = np.array(mount_before_camera(rig.robot).base_position_m), rig.robot.mount
        self._corners = rig.robot.parameters.r * np.stack(
            [np.cos(rig.robot.angles), np.sin(rig.robot.angles), 0 * rig.robot.angles], axis=1
        )
        self._poses, self._frames, self._changed, self._seen = list[np.ndarray | None](), 0, threading.Condition(), threading.local()
        self._noise = ImageNoise(self._cv2, CAMERA, np.random.default_rng(rig.file.seed))
        port = urlsplit(str(link.options["camera"])).port or 0
        try:
            self._server = NetworkCamera(self._cv2, self._image, math.inf, 0.0, port)
            self._server.start()
        except OSError as error:
            raise taken_port("127.0.0.1", port, error) from error

    def show(self, sample: Sample) -> None:
        """Expose an image of the arm as it is, if it is time for one."""
        self._frames += 1
        if self._frames % self._every == 0:
            poses = [None if np.isnan(point).any() else pose for pose, point in zip(self._look(), sample.points, strict=True)]
            with self._changed:
                self._poses = poses
                self._changed.notify_all()

    def _look(self) -> list[np.ndarray]:
        """Poses of the tags in the camera's axes, (4, 4) in m."""
        turn, base = self._mount.rotation, np.array(self._mount.base_position_m)
        nodes = np.einsum("pj,jik->pik", self._rig.layout.point_weights, self._rig.true_nodes) @ turn
        poses = []
        for point, corners in zip((self._rig.true_points - base) @ turn, nodes, strict=True):
            plate = Rotation.align_vectors(corners - corners.mean(axis=0), self._corners - self._corners.mean(axis=0))[0]
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = UPRIGHT.T @ plate.as_matrix() @ FACING, UPRIGHT.T @ (point + self._place)
            poses.append(pose)
        return poses

    def _image(self, _: float) -> np.ndarray:
        """The newest image that this thread has not seen, once there is one."""
        with self._changed:
            self._changed.wait_for(lambda: self._poses is not getattr(self._seen, "poses", None), PATIENCE_S)
            self._seen.poses = poses = self._poses
        return self._noise.add(self._tags.image(CAMERA, poses) if poses else CAMERA.empty())

    def close(self) -> None:
        """End all connections; a second time does nothing."""
        self._server.stop()
