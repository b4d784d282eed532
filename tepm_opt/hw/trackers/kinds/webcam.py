"""A camera that sees a printed tag on each sensor's place: AprilTags or ArUco tags, found and located by OpenCV."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from tepm_opt.data.documents import Section, require_range
from tepm_opt.hw.trackers.camera import CameraCalibration, load_opencv, open_camera, read_calibration
from tepm_opt.hw.trackers.receiver import CONNECT_S, Inbox, Pose, StreamReceiver
from tepm_opt.hw.trackers.tags import UPRIGHT, TagFinder
from tepm_opt.hw.trackers.tracker import TrackerKind
from tepm_opt.models.hardware import TrackerLink


class WebcamOptions(Section):
    """Options of the camera and its tags.

    Attributes:
        calibration: file that `tepm hw calibrate camera` wrote.
        tag_m: edge of a tag's black square in m.
        camera: number of a camera of this computer, or address or file of a video.
        dictionary: family of the tags as OpenCV names it, without `DICT_`.
        axes: of the frame G. "optical": x right, y down, z forward; "upright": x right, y forward, z up.
    """

    calibration: Annotated[str, Field(min_length=1, description="file that tepm hw calibrate camera wrote")]
    tag_m: Annotated[float, require_range(1e-3, 1, "m")]
    camera: Annotated[int | str, Field(description="number of a camera, or address of a video")] = 0
    dictionary: str = "APRILTAG_36h11"
    axes: Literal["optical", "upright"] = "optical"


class _Video:
    """Poses of the tags in the newest image; a tag that was seen since the start and is not in it is lost.

    A thread of its own takes images as they come. Images wait in the network while tags are looked for, and would get older and older.
    """

    def __init__(self, capture: Any, finder: TagFinder, calibration: CameraCalibration) -> None:
        self._capture, self._finder, self._size = capture, finder, (calibration.height_px, calibration.width_px)
        self._names, self._newest = set[str](), None
        self._changed, self._ended = threading.Condition(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="tracker camera", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        """Take images until they end, or nobody wants more; then let go of the camera."""
        while not self._ended.is_set() and self._capture.grab():
            stamp = time.monotonic()
            decoded, image = self._capture.retrieve()
            if decoded:
                with self._changed:
                    self._newest = (stamp, image)
                    self._changed.notify_all()
        self._capture.release()
        with self._changed:
            self._ended.set()
            self._changed.notify_all()

    def close(self) -> None:
        """Let go of the camera once it has given the image that it is waited for, if that is soon."""
        self._ended.set()
        self._thread.join(CONNECT_S)

    def poll(self, timeout: float) -> list[Pose]:
        """See `Stream`. The time stamp is when the image has come.

        Raises:
            ConnectionError: no more images, or of another size than the calibration's.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._newest or self._ended.is_set(), timeout)
            newest, self._newest = self._newest, None
        if newest is None:
            if self._ended.is_set():
                raise ConnectionError("the camera gives no more images")
            return []
        stamp, image = newest
        if image.shape[:2] != self._size:
            (height, width), size = self._size, image.shape
            raise ConnectionError(f"images have {size[1]} x {size[0]} px; valid: {width} x {height} as in the calibration")
        found = self._finder.find(image)
        self._names |= found.keys()
        return [Pose(name, found.get(name), stamp) for name in sorted(self._names)]


def _receive(link: TrackerLink, options: Section, inbox: Inbox) -> StreamReceiver:
    """Begin to receive.

    Raises:
        InputError: OpenCV is not installed; no calibration file; no such dictionary.
    """
    assert isinstance(options, WebcamOptions)
    cv2, calibration = load_opencv(), read_calibration(options.calibration)
    axes = UPRIGHT if options.axes == "upright" else np.eye(3)
    finder = TagFinder(cv2, options.dictionary, options.tag_m, calibration, axes)
    size = (calibration.width_px, calibration.height_px)

    @contextmanager
    def connect() -> Iterator[_Video]:
        video = _Video(open_camera(cv2, options.camera, size, link.rate_hz), finder, calibration)
        with closing(video):
            yield video

    return StreamReceiver(connect, inbox)


def _place(link: TrackerLink) -> str:
    return f"camera {link.options.get('camera', 0)}"


SERVER = "number of a camera, or address of a video, as option camera"
WEBCAM = TrackerKind("webcam", "tags seen by a camera", _receive, SERVER, WebcamOptions, needs="cv2", place=_place)
