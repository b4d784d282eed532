"""Images of printed tags and boards as a camera of known calibration sees them, and a camera in the network that sends such images."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2", reason="opencv-python-headless is not installed (extra webcam)")

TEXEL, SHARP = 20, 3
"""Pixels of a texture for a module of a tag; pixels of a rendering for a pixel of an image, each way."""


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

    def draw(self, image: np.ndarray, texture: np.ndarray, size_m: tuple[float, float], pose: np.ndarray) -> None:
        """Draw a texture that covers a rectangle about its pose's origin, x to the right, y to the top.

        Args:
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
        edge_m: of the black square.
    """

    def __init__(self, edge_m: float, count: int = 4) -> None:
        family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        black = [cv2.aruco.generateImageMarker(family, number, 8 * TEXEL) for number in range(count)]
        self._textures = [np.pad(each, TEXEL, constant_values=255) for each in black]
        self._size = (1.25 * edge_m, 1.25 * edge_m)

    def image(self, camera: Camera, poses: Sequence[np.ndarray | None]) -> np.ndarray:
        """An image of tags at poses in the camera's axes, (4, 4) in m; None for one that is hidden."""
        image = camera.empty()
        for texture, pose in zip(self._textures, poses, strict=True):
            if pose is not None:
                camera.draw(image, texture, self._size, pose)
        return image


def spoiled(image: np.ndarray, random: np.random.Generator, blur_px: float = 0.7, noise: float = 3.0) -> np.ndarray:
    """An image less sharp, and with noise, as a camera gives it."""
    soft = cv2.GaussianBlur(image, (0, 0), blur_px).astype(float)
    return np.clip(soft + random.normal(0, noise, image.shape), 0, 255).astype(np.uint8)


class NetworkCamera:
    """Sends images as JPEG one after the other over HTTP, as network cameras do.

    Args:
        take: takes an image as it is at a time on the host's clock in s.
        rate_hz: images a second.
        delay_s: age of an image when it is sent.
    """

    def __init__(self, take: Callable[[float], np.ndarray], rate_hz: float, delay_s: float) -> None:
        self._take, self._rate, self._delay = take, rate_hz, delay_s
        self._port, self._listener, self._lines = 0, None, list[socket.socket]()
        self.start()
        self.stop()  # has a port of its own from now on

    @property
    def address(self) -> str:
        """For whoever looks through it."""
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
                data = cv2.imencode(".jpg", self._take(due), [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
                time.sleep(max(due + self._delay - time.monotonic(), 0.0))
                line.sendall(b"--image\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(data) + data + b"\r\n")
                due = max(due + 1 / self._rate, time.monotonic() - self._delay)
