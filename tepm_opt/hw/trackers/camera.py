"""A camera and its calibration: the file that `tepm hw calibrate camera` writes, and images through OpenCV."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from tepm_opt.data.documents import Number, Section, Vector, read_json, read_toml, require_range, validate
from tepm_opt.hw.trackers.receiver import CONNECT_S, require_package

Pixels = Annotated[int, Field(strict=True, ge=16, le=20000, description="16 … 20000 px")]


class CameraCalibration(Section):
    """Pinhole camera with OpenCV's distortion, for images of one size.

    Attributes:
        width_px, height_px: of the images.
        matrix_px: camera matrix K in px.
        distortion: k1, k2, p1, p2, k3 and so on, as OpenCV orders them.
        reprojection_px: root mean square of what the fit left, in px; not used.
    """

    width_px: Pixels
    height_px: Pixels
    matrix_px: Annotated[tuple[Vector, Vector, Vector], Field(description="three rows of three numbers")]
    distortion: Annotated[tuple[Number, ...], Field(max_length=14, description="up to 14 numbers")] = ()
    reprojection_px: Annotated[float, require_range(0, 100, "px")] = 0.0

    @property
    def matrix(self) -> np.ndarray:
        """K in px, (3, 3)."""
        return np.array(self.matrix_px)


def read_calibration(path: str | Path) -> CameraCalibration:
    """The calibration in a TOML file, or in one whose name ends with .json.

    Raises:
        InputError: it cannot be read, or is none.
    """
    is_json = Path(path).suffix.lower() == ".json"
    return validate(CameraCalibration, read_json(Path(path), "tepm hw calibrate camera") if is_json else read_toml(path), str(path))


def calibration_text(calibration: CameraCalibration, notes: Sequence[str]) -> str:
    """A calibration as a TOML file, with a line of comment for each note."""
    rows = "".join(f"    {list(row)},\n" for row in calibration.matrix_px)
    lines = [
        *(f"# {note}" for note in notes),
        f"width_px = {calibration.width_px}",
        f"height_px = {calibration.height_px}",
        f"matrix_px = [\n{rows}]",
        f"distortion = {list(calibration.distortion)}",
        f"reprojection_px = {calibration.reprojection_px}",
    ]
    return "\n".join(lines) + "\n"


def open_camera(cv2: Any, camera: int | str, size: tuple[int, int] | None = None, rate_hz: float | None = None) -> Any:
    """A `cv2.VideoCapture` that holds back no images.

    Args:
        cv2: the module.
        camera: number of a camera of this computer, or address or file of a video.
        size: width and height in px that a camera is asked for.
        rate_hz: images a second that a camera is asked for.

    Raises:
        ConnectionError: it does not open.
    """
    if isinstance(camera, str):
        patience = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, int(1e3 * CONNECT_S), cv2.CAP_PROP_READ_TIMEOUT_MSEC, int(1e3 * CONNECT_S)]
        # each thread of the decoder keeps an image back
        capture = cv2.VideoCapture(camera, cv2.CAP_FFMPEG, [*patience, cv2.CAP_PROP_N_THREADS, 1])
    else:
        capture = cv2.VideoCapture(camera)
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter_fourcc(*"MJPG"))  # uncompressed images come slowly through USB
        if size:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
        if rate_hz:
            capture.set(cv2.CAP_PROP_FPS, rate_hz)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    if not capture.isOpened():
        raise ConnectionError(f"camera {camera} does not open")
    return capture


def load_opencv() -> Any:
    """OpenCV, told to say nothing on the error stream about a camera that is away, and to leave the other cores to the controller.

    Raises:
        InputError: it is not installed.
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    cv2 = require_package("cv2", "webcam", "tracker webcam")
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    cv2.setNumThreads(1)
    return cv2
