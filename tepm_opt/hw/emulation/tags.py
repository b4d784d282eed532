"""Images of printed tags and boards as a camera of known calibration sees them, and a camera in the network that sends such images."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from tepm_opt.hw.trackers.camera import CameraCalibration

TEXEL, SHARP = 20, 3
"""Pixels of a texture for a module of a tag; pixels of a rendering for a pixel of an image, each way."""
SHIFTS = 64
"""Rows and columns by which noise is shifted from image to image, as drawing it anew takes 5 ms of an image."""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera without distortion, x right, y down, z forward."""

    width: int = 640
    height: int = 480
    focal: float = 640.0
    centre: tuple[float, float] = (320.0, 240.0)

    @property
    def matrix(self) -> np.ndarray:
        """Camera matrix in px, (3, 3)."""
        return np.array([[self.focal, 0, self.centre[0]], [0, self.focal, self.centre[1]], [0, 0, 1]])

    @property
    def calibration(self) -> CameraCalibration:
        """The calibration that a perfect one would find."""
        first, second, third = ((float(row[0]), float(row[1]), float(row[2])) for row in self.matrix)
        return CameraCalibration(width_px=self.width, height_px=self.height, matrix_px=(first, second, third))

    def draw(self, cv2: Any, image: np.ndarray, texture: np.ndarray, size_m: tuple[float, float], pose: np.ndarray) -> None:
        """Draw a texture that covers a rectangle about its pose's origin, x to the right, y to the top.

        Args:
            cv2: the module.
            image: grey, (height, width), drawn into.
            texture: grey.
            size_m: width and height of the rectangle.
            pose: of the rectangle in the camera's axes, (4, 4) in m.
        """
        rows, columns = texture.shape
        metres = np.array(
            [[size_m[0] / columns, 0, (0.5 / columns - 0.5) * size_m[0]], [0, -size_m[1] / rows, (0.5 - 0.5 / rows) * size_m[1]]]
        )
        plane = np.vstack([metres, [[0, 0, 1]]])
        onto = self.matrix @ pose[:3, [0, 1, 3]] @ plane
        ends = onto @ np.array([[0, columns, columns, 0], [0, 0, rows, rows], [1, 1, 1, 1]])
        low = np.floor((ends[:2] / ends[2]).min(axis=1)).astype(int) - 1
        high = np.ceil((ends[:2] / ends[2]).max(axis=1)).astype(int) + 2
        low, high = np.maximum(low, 0), np.minimum(high, (self.width, self.height))
        if (high <= low).any():
            return
        finer = np.array([[SHARP, 0, (SHARP - 1) / 2 - SHARP * low[0]], [0, SHARP, (SHARP - 1) / 2 - SHARP * low[1]], [0, 0, 1]]) @ onto
        size = tuple(int(each) for each in SHARP * (high - low))
        drawn = cv2.warpPerspective(texture, finer, size, flags=cv2.INTER_AREA)
        covered = cv2.warpPerspective(np.full_like(texture, 255), finer, size)
        drawn, covered = (cv2.resize(each, None, fx=1 / SHARP, fy=1 / SHARP, interpolation=cv2.INTER_AREA) for each in (drawn, covered))
        part = image[low[1] : high[1], low[0] : high[0]]
        part[:] = (part * (255.0 - covered) / 255 + drawn).astype(np.uint8)

    def empty(self) -> np.ndarray:
        """An image of a grey wall, (height, width)."""
        return np.full((self.height, self.width), 140, np.uint8)


class Tags:
    """AprilTags 36h11 with a white rim of a module.

    Args:
        cv2: the module.
        edge_m: of the black square.
        count: number of tags.
    """

    def __init__(self, cv2: Any, edge_m: float, count: int = 4) -> None:
        family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        black = [cv2.aruco.generateImageMarker(family, number, 8 * TEXEL) for number in range(count)]
        self._textures = [np.pad(each, TEXEL, constant_values=255) for each in black]
        self._cv2, self._size = cv2, (1.25 * edge_m, 1.25 * edge_m)

    def image(self, camera: Camera, poses: Sequence[np.ndarray | None]) -> np.ndarray:
        """An image of tags at poses in the camera's axes, (4, 4) in m; None for one that is hidden."""
        image = camera.empty()
        for texture, pose in zip(self._textures, poses, strict=True):
            if pose is not None:
                camera.draw(self._cv2, image, texture, self._size, pose)
        return image


class ImageNoise:
    """Makes images less sharp and noisy, as a camera gives them.

    Args:
        cv2: the module.
        camera: that takes the images.
        random: generator.
        blur_px: standard deviation of the blur.
        noise: standard deviation in grey levels.
    """

    def __init__(self, cv2: Any, camera: Camera, random: np.random.Generator, blur_px: float = 0.7, noise: float = 3.0) -> None:
        self._cv2, self._random, self._blur = cv2, random, blur_px
        self._grain = np.rint(random.normal(0, noise, (camera.height + SHIFTS, camera.width + SHIFTS))).astype(np.int16)

    def add(self, image: np.ndarray) -> np.ndarray:
        """An image with blur and noise, (height, width)."""
        (row, column), (height, width) = self._random.integers(0, SHIFTS, 2), image.shape
        soft = self._cv2.GaussianBlur(image, (0, 0), self._blur)
        return self._cv2.add(soft, self._grain[row : row + height, column : column + width], dtype=self._cv2.CV_8U)


class NetworkCamera:
    """Sends images as JPEG one after the other over HTTP, as network cameras do.

    Args:
        cv2: the module.
        take: takes an image as it is at a time on the host's clock in s.
        rate_hz: images a second at most.
        delay_s: age of an image when it is sent.
        port: on the loopback; 0: a free one.

    Raises:
        OSError: the port is taken.
    """

    def __init__(self, cv2: Any, take: Callable[[float], np.ndarray], rate_hz: float, delay_s: float, port: int = 0) -> None:
        self._cv2, self._take, self._rate, self._delay = cv2, take, rate_hz, delay_s
        self._port, self._lines = port, list[socket.socket]()
        self._listener: socket.socket | None = None
        self.start()
        self.stop()  # has a port of its own from now on

    @property
    def address(self) -> str:
        """Address of the stream for whoever looks through the camera."""
        return f"http://127.0.0.1:{self._port}/"

    def start(self) -> None:
        """Begin to serve."""
        self._listener = socket.create_server(("127.0.0.1", self._port))
        self._port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, args=(self._listener,), daemon=True).start()

    def stop(self) -> None:
        """End all connections."""
        if self._listener:
            with suppress(OSError):
                self._listener.shutdown(socket.SHUT_RDWR)
            self._listener.close()
            self._listener = None
        while self._lines:
            with suppress(OSError):
                self._lines[-1].shutdown(socket.SHUT_RDWR)
            self._lines.pop().close()

    def _accept(self, listener: socket.socket) -> None:
        with suppress(OSError):
            while True:
                line, _ = listener.accept()
                self._lines.append(line)
                threading.Thread(target=self._serve, args=(line,), daemon=True).start()

    def _serve(self, line: socket.socket) -> None:
        with suppress(OSError):
            line.recv(4096)
            line.sendall(b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=image\r\n\r\n")
            due = time.monotonic()
            while True:
                data = self._cv2.imencode(".jpg", self._take(due), [self._cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
                time.sleep(max(due + self._delay - time.monotonic(), 0.0))
                line.sendall(b"--image\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(data) + data + b"\r\n")
                due = max(due + 1 / self._rate, time.monotonic() - self._delay)
