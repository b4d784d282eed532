"""Calibration of a camera from images of a printed ChArUco board: a chessboard whose white squares hold tags."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.hw.trackers.camera import CameraCalibration, load_opencv, open_camera

DICTIONARY, TAG_SHARE = "DICT_5X5_100", 0.75
"""Family of the tags in the white squares, and their edge in squares."""
FEWEST_CORNERS, FEWEST_VIEWS = 8, 6
"""Corners that a view has to show, and views that have to be taken: fewer do not tell distortion from perspective."""
STRAY = 3.0
"""A view that fits so many times worse than the median one is left out: it was moved while it was taken, or the board was bent."""
MOVED_SHARE = 0.08
"""Share of the image's width: a board that moved less on average, compared with each view so far, tells nothing new."""
DOTS_PER_INCH, MM_PER_INCH = 300, 25.4
ENDINGS = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"}


@dataclass(frozen=True)
class CharucoBoard:
    """A board of columns x rows squares.

    Attributes:
        columns, rows: of squares.
        square_m: edge of a square in m.
    """

    columns: int = 9
    rows: int = 6
    square_m: float = 0.028

    def opencv_board(self, cv2: Any) -> Any:
        """The same as OpenCV's own object."""
        family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, TAG_SHARE * self.square_m, family)

    def image(self) -> np.ndarray:
        """The board to be printed with 300 dots an inch, grey, with a rim of half a square."""
        pixels = round(1e3 * self.square_m / MM_PER_INCH * DOTS_PER_INCH)
        rim = pixels // 2
        board = self.opencv_board(load_opencv())
        return board.generateImage((self.columns * pixels + 2 * rim, self.rows * pixels + 2 * rim), marginSize=rim)


@dataclass(frozen=True, eq=False)
class _Fit:
    """A fitted camera.

    Attributes:
        rms: root mean square of the reprojection errors in px.
        matrix: (3, 3) in px.
        distortion: (5,).
        focal_std: standard deviations of both focal lengths in px, (2,).
        errors: rms of each view in px, (views,).
    """

    rms: float
    matrix: np.ndarray
    distortion: np.ndarray
    focal_std: np.ndarray
    errors: np.ndarray


class Views:
    """Corners of a board in images of a camera.

    Args:
        board: in front of the camera.

    Attributes:
        size: width and height of the images in px; None before the first.
    """

    def __init__(self, board: CharucoBoard) -> None:
        self._cv2 = load_opencv()
        self._board = board.opencv_board(self._cv2)
        self._detector = self._cv2.aruco.CharucoDetector(self._board)
        self._corners, self._numbers = list[np.ndarray](), list[np.ndarray]()
        self.size: tuple[int, int] | None = None

    def __len__(self) -> int:
        return len(self._corners)

    def add(self, image: np.ndarray, only_new: bool = False) -> bool:
        """Take an image if it shows enough of the board; whether it does.

        Args:
            image: grey or BGR.
            only_new: leave out a view in which the board is where it was in another.

        Raises:
            InputError: it has another size than those before.
        """
        size = (image.shape[1], image.shape[0])
        if self.size is not None and size != self.size:
            raise InputError(f"an image has {size[0]} x {size[1]} px; valid: {self.size[0]} x {self.size[1]} as the ones before")
        self.size = size
        corners, numbers, *_ = self._detector.detectBoard(image)
        if corners is None or numbers is None or len(numbers) < FEWEST_CORNERS:
            return False
        at, which = corners.reshape(-1, 2), numbers.ravel()
        if only_new and any(self._mean_distance(k, at, which) < MOVED_SHARE * size[0] for k in range(len(self))):
            return False
        self._corners.append(at)
        self._numbers.append(which)
        return True

    def _mean_distance(self, view: int, at: np.ndarray, which: np.ndarray) -> float:
        """Mean distance in px of the corners that an earlier view has, too; infinite without such."""
        _, here, there = np.intersect1d(which, self._numbers[view], return_indices=True)
        return float(np.linalg.norm(at[here] - self._corners[view][there], axis=1).mean()) if len(here) else np.inf

    def calibrate(self) -> tuple[CameraCalibration, list[str]]:
        """The calibration that fits best, after views that fit badly are left out, and notes for people.

        Raises:
            InputError: too few views show the board.
        """
        if len(self) < FEWEST_VIEWS or self.size is None:
            raise InputError(f"the board was found in {len(self)} images; valid: at least {FEWEST_VIEWS}, from different sides")
        kept = np.arange(len(self))
        fit = self._fit(kept)
        good = fit.errors <= STRAY * np.median(fit.errors)
        if FEWEST_VIEWS <= good.sum() < len(kept):
            kept = kept[good]
            fit = self._fit(kept)
        rows = tuple(tuple(float(value) for value in row) for row in fit.matrix)
        content = {"width_px": self.size[0], "height_px": self.size[1], "matrix_px": rows, "reprojection_px": fit.rms}
        lens = tuple(float(value) for value in fit.distortion)
        corners = sum(len(self._numbers[k]) for k in kept)
        notes = [
            f"{len(kept)} views, {len(self) - len(kept)} left out, {corners} corners, reprojection error {fit.rms:.3f} px rms",
            f"focal length {rows[0][0]:.1f} x {rows[1][1]:.1f} px (± {fit.focal_std[0]:.1f}, ± {fit.focal_std[1]:.1f})",
        ]
        return CameraCalibration.model_validate({**content, "distortion": lens}), notes

    def _fit(self, kept: np.ndarray) -> _Fit:
        """The camera that fits some views best."""
        pairs = [self._board.matchImagePoints(self._corners[k][:, None], self._numbers[k][:, None]) for k in kept]
        objects, images = zip(*pairs, strict=True)
        rms, matrix, distortion, _, _, stds, _, errors = self._cv2.calibrateCameraExtended(objects, images, self.size, None, None)
        return _Fit(float(rms), matrix, distortion.ravel(), stds.ravel()[:2], errors.ravel())


def read_images(folder: Path) -> Iterator[tuple[Path, np.ndarray]]:
    """Images of a folder by name, grey, with their paths.

    Raises:
        InputError: there is no such folder, or no image in it.
    """
    cv2 = load_opencv()
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in ENDINGS) if folder.is_dir() else []
    if not paths:
        raise InputError(f"{folder}: no images there; valid: a folder with images ({', '.join(sorted(ENDINGS))})")
    for path in paths:
        if (image := cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)) is not None:
            yield path, image


def capture_images(camera: int | str, seconds: float) -> Iterator[np.ndarray]:
    """Images of a camera as they come, for so many seconds.

    Raises:
        InputError: it does not open, or gives no more.
    """
    cv2 = load_opencv()
    try:
        capture = open_camera(cv2, camera)
    except ConnectionError as error:
        raise InputError(f"{error}; valid: number of a camera, or address of a video") from error
    try:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            given, image = capture.read()
            if not given:
                raise InputError(f"camera {camera} gives no more images")
            yield image
    finally:
        capture.release()


def write_board(board: CharucoBoard, path: Path) -> None:
    """Write the board as a PNG to be printed.

    Raises:
        InputError: the file is there, or cannot be written.
    """
    if path.exists() or path.suffix.lower() != ".png":
        raise InputError(f"{path}: {'exists' if path.exists() else 'is no PNG'}; name a new file that ends with .png")
    cv2 = load_opencv()
    if not cv2.imwrite(str(path), board.image()):
        raise InputError(f"{path}: cannot be written; valid: a file in a folder that is there")
