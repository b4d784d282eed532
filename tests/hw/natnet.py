"""A stand-in for OptiTrack's Motive: NatNet 4.0 over UDP on the loopback, packets packed by hand (PacketClient.cpp of the NatNet SDK)."""

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
VERSION = (4, 0, 0, 0)
TICKS = 10_000_000  # a second, of the high-resolution clock
FORGOTTEN_S = 1.0
"""A client that sends nothing for so long is no longer served."""
Poses = Callable[[], "Sequence[np.ndarray | None]"]


def packet(message: int, body: bytes) -> bytes:
    """A message with its head."""
    return struct.pack("<HH", message, len(body)) + body


def text(word: str) -> bytes:
    """A name."""
    return word.encode() + b"\0"


def server_info(data_port: int) -> bytes:
    """Answer to CONNECT: application, its version, that of NatNet, clock, and the data port; unicast."""
    return packet(SERVER_INFO, b"Motive".ljust(256, b"\0") + bytes([3, 0, 0, 0, *VERSION]) + struct.pack("<QH?4x", TICKS, data_port, False))


def model_definitions(bodies: Sequence[str], markers: Sequence[str]) -> bytes:
    """Names: rigid bodies by their numbers from 1, and a marker set "Arm"."""
    sets = struct.pack("<I", 0) + text("Arm") + struct.pack("<I", len(markers)) + b"".join(map(text, markers))
    body = struct.pack("<I", 1 + len(bodies)) + sets
    for number, name in enumerate(bodies, 1):
        body += struct.pack("<I", 1) + text(name) + struct.pack("<Ii3fI", number, -1, 0.0, 0.0, 0.0, 1)
        body += struct.pack("<3fI", 0.01, 0.0, 0.0, 0) + text("Marker1")
    return packet(MODELDEF, body)


def frame(number: int, poses: Sequence[np.ndarray | None], markers: Sequence[np.ndarray | None], stamp: float, param: int = 0) -> bytes:
    """A frame of data.

    Args:
        number: of the frame.
        poses: of the rigid bodies in m, (4, 4) each; None where one is lost: it stays where it was last, with its flag cleared.
        markers: of the set "Arm" in m, (3,) each; None where one is lost: zeros.
        stamp: on the server's clock in s.
        param: 2: the models have changed.
    """
    places = [np.zeros(3) if place is None else place for place in markers]
    body = struct.pack("<II", number, 1) + text("Arm") + struct.pack("<I", len(places))
    body += b"".join(struct.pack("<3f", *place) for place in places) + struct.pack("<II", 0, len(poses))
    for each, pose in enumerate(poses, 1):
        shown = np.diag([-1.0, -1.0, 1.0, 1.0]) if pose is None else pose
        body += struct.pack("<I7f", each, *shown[:3, 3] + 0.001 * (pose is None), *Rotation.from_matrix(shown[:3, :3]).as_quat())
        body += struct.pack("<fH", 1e-4, pose is not None)
    body += struct.pack("<IIII", 0, 0, 0, 0)  # skeletons, labelled markers, force plates, devices
    ticks = int(stamp * TICKS)
    return packet(FRAME, body + struct.pack("<IId3QHI", 0, 0, stamp, ticks, ticks, ticks, param, 0))


class Motive:
    """Answers on a command port and sends frames to whoever asked, from a thread.

    Args:
        rate: frames a second.
        bodies, markers: names of rigid bodies, and of the markers of the set "Arm".
        poses: of the rigid bodies now, in m; of markers, their positions are used.
        to_data_port: send to the port that the server info tells, not to the one that the client asked from.

    Attributes:
        port, data_port: the same after each `start`.
        bodies: names that are told from the next request on.
        param: of the frames: 2 while the models have changed.
    """

    def __init__(self, rate: float, bodies: Sequence[str], markers: Sequence[str], poses: Poses, to_data_port: bool = False) -> None:
        self.rate, self.bodies, self.markers, self.poses, self.param = rate, bodies, markers, poses, 0
        self.port, self.data_port, self._to_data_port = _free_port(), _free_port(), to_data_port
        self._client, self._heard = None, 0.0
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
            commands.sendto(server_info(self.data_port), sender)
        elif message == REQUEST_MODELDEF:
            commands.sendto(model_definitions(self.bodies, self.markers), sender)
            self._client = (sender[0], self.data_port) if self._to_data_port else sender

    def _send(self, commands: socket.socket, number: int) -> None:
        poses = list(self.poses())
        bodies, markers = poses[: len(self.bodies)], [None if pose is None else pose[:3, 3] for pose in poses[-len(self.markers) :]]
        with contextlib.suppress(OSError):  # the client is gone
            commands.sendto(frame(number, bodies, markers, time.monotonic() + 1000.0, self.param), self._client)


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
        trial.bind(("127.0.0.1", 0))
        return trial.getsockname()[1]
