"""Square tags in images: AprilTags and ArUco tags are found by OpenCV, their corners made exact, and their poses solved for."""

from __future__ import annotations

from typing import Any

import numpy as np

from tepm_opt.errors import unknown_name
from tepm_opt.hw.trackers.camera import CameraCalibration

SHARES, STEPS, WIDE = np.linspace(0.1, 0.9, 17), np.linspace(-1.0, 1.0, 25), 6
"""Places along an edge that are looked at; places across it, in units of the reach; so many of these apart the light is compared."""
REACH, LEAST_REACH_PX, MOST_REACH_PX = 0.1, 1.5, 5.0
"""Distance from an edge that is looked at: a tenth of the edge, less than a module of any dictionary, within these limits."""
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""From the camera's axes (x right, y down, z forward) to those of a level camera in a frame whose z points up (y forward)."""


class TagFinder:
    """Finds tags in images and locates them.

    Args:
        cv2: the module.
        dictionary: family of the tags as OpenCV names it, without `DICT_`.
        edge_m: of a tag's black square.
        calibration: of the camera.
        axes: from the camera's axes to those of the poses, (3, 3).

    Raises:
        InputError: no such dictionary.
    """

    def __init__(self, cv2: Any, dictionary: str, edge_m: float, calibration: CameraCalibration, axes: np.ndarray) -> None:
        families = {name.removeprefix("DICT_") for name in dir(cv2.aruco) if name.startswith("DICT_")}
        if dictionary not in families:
            raise unknown_name("dictionary", dictionary, families, "hardware.tracker.options of webcam")
        family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))
        self._cv2, self._detector, self._axes = cv2, cv2.aruco.ArucoDetector(family), axes
        self._matrix, self._distortion = calibration.matrix, np.array(calibration.distortion or np.zeros(5))
        self._corners = np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * edge_m / 2  # in the order of IPPE_SQUARE

    def find(self, image: np.ndarray) -> dict[str, np.ndarray | None]:
        """Poses of the tags in an image by name, (4, 4) in m; None for one that is in it twice, a copy or a reflection.

        Args:
            image: grey (height, width), or BGR (height, width, 3); bytes.

        Returns:
            Of "tag 0" and so on: origin in the tag's middle, x to its right, y to its top, z out of it.
        """
        grey = image if image.ndim == 2 else self._cv2.cvtColor(image, self._cv2.COLOR_BGR2GRAY)
        corners, numbers, _ = self._detector.detectMarkers(grey)
        if numbers is None or not len(numbers):
            return {}
        found: dict[str, np.ndarray | None] = {}
        for number, at in zip(numbers.ravel(), refine_corners(self._cv2, grey, np.array(corners, float).reshape(-1, 4, 2)), strict=True):
            name = f"tag {number}"
            found[name] = None if name in found else self._locate(at)
        return found

    def _locate(self, at: np.ndarray) -> np.ndarray | None:
        """Pose of a tag from its corners in px, (4, 2), clockwise from its top left; of the two solutions the one that fits better."""
        flags = self._cv2.SOLVEPNP_IPPE_SQUARE
        solved, turn, place = self._cv2.solvePnP(self._corners, at, self._matrix, self._distortion, flags=flags)
        if not solved:
            return None
        turn, place = self._cv2.solvePnPRefineLM(self._corners, at, self._matrix, self._distortion, turn, place)
        pose = np.eye(4)
        pose[:3, :3] = self._axes @ self._cv2.Rodrigues(turn)[0]
        pose[:3, 3] = self._axes @ place.ravel()
        return pose


def refine_corners(cv2: Any, image: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Corners of tags where straight lines through their edges meet, (tags, 4, 2) in px.

    An edge is where light rises from the black square to its white rim, on average of the squared rises. Corners alone would be found too
    far inside, as any blur rounds them. After AprilTag 3 (Krogius, Haggenmiller and Olson, IROS 2019), `refine_edges`.

    Args:
        cv2: the module.
        image: grey, (height, width) of bytes.
        corners: roughly, clockwise in the image.
    """
    fit = np.linalg.pinv(np.stack([1 - SHARES, SHARES], axis=1))  # offsets along an edge -> those of its two ends
    middles = (STEPS[WIDE:] + STEPS[:-WIDE]) / 2
    for _ in range(2):
        along = np.roll(corners, -1, axis=1) - corners
        length = np.linalg.norm(along, axis=2, keepdims=True)
        outward = np.stack([along[..., 1], -along[..., 0]], axis=2) / np.maximum(length, 1e-9)
        reach = np.clip(REACH * length, LEAST_REACH_PX, MOST_REACH_PX)
        places = corners[:, :, None] + SHARES[:, None] * along[:, :, None]
        across = places[:, :, :, None] + (STEPS[:, None] * (reach * outward)[:, :, None])[:, :, None]
        flat = across.reshape(-1, len(SHARES) * len(STEPS), 2).astype(np.float32)
        light = cv2.remap(image, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR).reshape(across.shape[:-1]).astype(float)
        rise = np.maximum(light[..., WIDE:] - light[..., :-WIDE], 0.0) ** 2
        offsets = reach * (rise @ middles) / np.maximum(rise.sum(axis=-1), 1e-9)
        ends = offsets @ fit.T
        first = corners + ends[..., :1] * outward
        direction = corners + along + ends[..., 1:] * outward - first
        corners = _meet(np.roll(first, 1, axis=1), np.roll(direction, 1, axis=1), first, direction)
    return corners


def _meet(a: np.ndarray, along_a: np.ndarray, b: np.ndarray, along_b: np.ndarray) -> np.ndarray:
    """Points at which lines from a and from b meet, all (..., 2)."""

    def cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]

    return a + along_a * (cross(b - a, along_b) / cross(along_a, along_b))[..., None]
