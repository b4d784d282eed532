"""A stand-in for OptiTrack's Motive: NatNet over UDP on the loopback, packets packed by hand (PacketClient.cpp of the NatNet SDK)."""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

CONNECT, SERVER_INFO, REQUEST_MODELDEF, MODELDEF, FRAME, KEEP_ALIVE = 0, 1, 4, 5, 7, 10
"""Messages of the protocol."""
TICKS = 10_000_000  # a second, of the high-resolution clock
FORGOTTEN_S = 1.0
"""A client that sends nothing for so long is no longer served."""
UNSEEN = np.array([[-1.0, 0, 0, 0.1], [0, -1, 0, 0.1], [0, 0, 1, 0.1], [0, 0, 0, 1]])
"""Pose that is sent of a lost body."""
Poses = Callable[[], "Sequence[np.ndarray | None]"]


def packet(message: int, body: bytes) -> bytes:
    """A message with its head."""
    return struct.pack("<HH", message, len(body)) + body


def text(word: str) -> bytes:
    """A name."""
    return word.encode() + b"\0"


def counted(items: Sequence[bytes], minor: int) -> bytes:
    """Items with their number, and from 4.1 on with their size in bytes."""
    body = b"".join(items)
    return struct.pack("<I", len(items)) + (struct.pack("<I", len(body)) if minor >= 1 else b"") + body


def server_info(data_port: int, minor: int) -> bytes:
    """Answer to CONNECT: application, its version, that of NatNet (4.minor), clock, and the data port; unicast."""
    words = b"Motive".ljust(256, b"\0") + bytes([3, 0, 0, 0, 4, minor, 0, 0])
    return packet(SERVER_INFO, words + struct.pack("<QH?4x", TICKS, data_port, False))


def model_definitions(bodies: Sequence[str], markers: Sequence[str], minor: int) -> bytes:
    """Names: rigid bodies by their numbers from 1, and a marker set "Arm"."""
    parts = [(0, text("Arm") + struct.pack("<I", len(markers)) + b"".join(map(text, markers)))]
    for number, name in enumerate(bodies, 1):
        turn = struct.pack("<4f", 0.0, 0.0, 0.0, 1.0) if minor >= 2 else b""
        markers_of_body = struct.pack("<I3fI", 1, 0.01, 0.0, 0.0, 0) + text("Marker1")
        parts.append((1, text(name) + struct.pack("<Ii3f", number, -1, 0.0, 0.0, 0.0) + turn + markers_of_body))
    sized = [struct.pack("<I", kind) + (struct.pack("<I", len(part)) if minor >= 1 else b"") + part for kind, part in parts]
    return packet(MODELDEF, struct.pack("<I", len(sized)) + b"".join(sized))


def frame(
    number: int, poses: Sequence[np.ndarray | None], markers: Sequence[np.ndarray | None], stamp: float, param: int, minor: int
) -> bytes:
    """A frame of data.

    Args:
        number: of the frame.
        poses: of the rigid bodies in m, (4, 4) each; None where one is lost: its flag is cleared, whatever its pose says.
        markers: of the set "Arm" in m, (3,) each; None where one is lost: zeros.
        stamp: on the server's clock in s.
        param: 2: the models have changed.
        minor: of the protocol 4.minor.
    """
    places = [np.zeros(3) if place is None else place for place in markers]
    arm = text("Arm") + struct.pack("<I", len(places)) + b"".join(struct.pack("<3f", *place) for place in places)
    bodies = []
    for each, pose in enumerate(poses, 1):
        shown = UNSEEN if pose is None else pose
        placed = struct.pack("<I7f", each, *shown[:3, 3], *Rotation.from_matrix(shown[:3, :3]).as_quat())
        bodies.append(placed + struct.pack("<fH", 1e-4, pose is not None))
    body = struct.pack("<I", number) + counted([arm], minor) + counted([], minor) + counted(bodies, minor)
    body += counted([], minor) * (5 if minor >= 1 else 4)  # skeletons, assets from 4.1 on, labelled markers, force plates, devices
    ticks = int(stamp * TICKS)
    return packet(FRAME, body + struct.pack("<IId3QHI", 0, 0, stamp, ticks, ticks, ticks, param, 0))


class Motive:
    """Answers on a command port and sends frames to whoever asked, from a thread.

    Args:
        rate: frames a second.
        bodies, markers: names of rigid bodies, and of the markers of the set "Arm".
        poses: of the rigid bodies now, in m; of markers, their positions are used.
        to_data_port: send to the port that the server info tells, not to the one that the client asked from.
        minor: of the protocol 4.minor: Motive 2.2 and 3.0 have 4.0, Motive 3.1 has 4.1.

    Attributes:
        port, data_port: the same after each `start`.
        bodies: names that are told from the next request on.
        param: of the frames: 2 while the models have changed.
        damaged: set it, and one packet comes that is no frame.
    """

    def __init__(
        self, rate: float, bodies: Sequence[str], markers: Sequence[str], poses: Poses, to_data_port: bool = False, minor: int = 0
    ) -> None:
        self.rate, self.bodies, self.markers, self.poses, self.param, self.damaged = rate, bodies, markers, poses, 0, False
        self.port, self.data_port, self._to_data_port = _free_port(), _free_port(), to_data_port
        self.minor, self._client, self._heard = minor, None, 0.0
        self._stop, self._thread = threading.Event(), None

    def start(self) -> None:
        """Listen and send."""
        commands = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        commands.bind(("127.0.0.1", self.port))
        self._client = None
        self._stop.clear()
        self._thread = threading.Thread(target=self._run, args=(commands,), daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Close everything."""
        self._stop.set()
        if self._thread:
            self._thread.join()

    def _run(self, commands: socket.socket) -> None:
        number, due = 0, time.monotonic()
        with commands:
            while not self._stop.is_set():
                due = max(due + 1 / self.rate, time.monotonic())  # a frame that is late is not caught up with
                while (left := due - time.monotonic()) > 0:
                    if select.select([commands], [], [], left)[0]:
                        self._answer(commands)
                if self._client and (self._to_data_port or time.monotonic() - self._heard < FORGOTTEN_S):
                    number += 1
                    self._send(commands, number)

    def _answer(self, commands: socket.socket) -> None:
        request, sender = commands.recvfrom(1 << 12)
        message, self._heard = struct.unpack_from("<H", request)[0], time.monotonic()
        if message == CONNECT:
            commands.sendto(server_info(self.data_port, self.minor), sender)
        elif message == REQUEST_MODELDEF:
            commands.sendto(model_definitions(self.bodies, self.markers, self.minor), sender)
            self._client = (sender[0], self.data_port) if self._to_data_port else sender

    def _send(self, commands: socket.socket, number: int) -> None:
        poses = list(self.poses())
        bodies, markers = poses[: len(self.bodies)], [None if pose is None else pose[:3, 3] for pose in poses[-len(self.markers) :]]
        with contextlib.suppress(OSError):  # the client is gone
            if self.damaged:
                self.damaged = False
                commands.sendto(packet(FRAME, b"\xff" * 9), self._client)
            commands.sendto(frame(number, bodies, markers, time.monotonic() + 1000.0, self.param, self.minor), self._client)


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
        trial.bind(("127.0.0.1", 0))
        return trial.getsockname()[1]
