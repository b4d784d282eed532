"""Stand-ins for PlusServer: messages given by hand, and packed ones over a socket, a sample with one stamp, at an exact pace."""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType

import numpy as np
from pyigtl import TransformMessage
from scipy.spatial.transform import Rotation

from tepm_opt.hw.trackers import LiveTracker, open_link
from tepm_opt.hw.trackers.frames import Frame, FrameAssembler
from tepm_opt.models.hardware import TrackerLink

DEVICES = ("BaseToTracker", "LowToTracker", "HighToTracker", "TipToTracker")
RATE = 240.0
PERIOD = 1 / RATE
AHEAD = 1000.0  # the server's clock is ahead of the host's by so many s
DELAY = 2e-4
PATIENCE = 60.0  # s until a test gives up on another thread
VALID = {"TransformValid": "True", "TransformStatus": "OK"}
"""Metadata of a valid pose as PlusServer writes it (PlusLib, vtkPlusIgtlMessageCommon.cxx)."""
HEAD, STAMP, LENGTH = 58, 34, 42
"""Bytes of a message's head, and where in it the time stamp (seconds and 2⁻³² seconds) and the length of the body are."""
SIZE = HEAD + 12 + 48 + 2 + sum(8 + len(key) + len(value) for key, value in VALID.items())
"""Bytes of a TRANSFORM message with header version 2 and this metadata."""


def link(**settings: object) -> TrackerLink:
    """Four sensors at 240 Hz."""
    return TrackerLink.model_validate({"devices": DEVICES, "rate_hz": RATE, **settings})


def still(_: float) -> np.ndarray:
    """Four sensors at rest, (4, 4, 4) in mm, turned so that none is the identity."""
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec([[0.1 + 0.2 * i, -0.3, 0.2] for i in range(4)]).as_matrix()
    poses[:, :3, 3] = [[10.0 * i, -5.0, 100.0 * (i + 1)] for i in range(4)]
    return poses


def stamped(data: bytearray, stamp: float) -> bytes:
    """Messages with a time stamp in s written over theirs; their lengths are in their heads."""
    place = 0
    while place < len(data):
        struct.pack_into(">II", data, place + STAMP, int(stamp), int(stamp % 1 * 2**32))
        place += HEAD + struct.unpack_from(">Q", data, place + LENGTH)[0]
    return bytes(data)


class PlusServer:
    """Sends to whoever connects, one client at a time, from a thread.

    Args:
        rate: samples a second.
        poses: (4, 4, 4) in mm at a time in s since the start.
        port: 0 for any that is free; `port` says which.

    Attributes:
        sent: stamps of all samples that were handed to the socket.
        shift: server's clock − `time.monotonic` in s.
    """

    def __init__(self, rate: float = 240.0, poses: Callable[[float], np.ndarray] = still, port: int = 0, shift: float = 1000.0) -> None:
        self.rate, self.poses, self.port, self.shift = rate, poses, port, shift
        self.sent: list[float] = []
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> PlusServer:
        """Listen and send; on the same port as before if it was stopped."""
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", self.port))
        listener.listen()
        self.port = listener.getsockname()[1]
        self._stop.clear()
        self._thread = threading.Thread(target=self._run, args=(listener,), daemon=True)
        self._thread.start()
        return self

    def stop(self) -> None:
        """Close everything."""
        self._stop.set()
        if self._thread:
            self._thread.join()

    def packed(self, elapsed: float) -> bytearray:
        """A sample as one piece of bytes, with a time stamp to be written over."""
        return packed(np.zeros((4, 3)), range(4), self.poses(elapsed))

    def _run(self, listener: socket.socket) -> None:
        with listener:
            while not self._stop.is_set():
                if not select.select([listener], [], [], 0.02)[0]:
                    continue
                client, _ = listener.accept()
                with client, contextlib.suppress(OSError):
                    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    self._send(client)

    def _send(self, client: socket.socket) -> None:
        start = due = time.monotonic()
        while not self._stop.is_set():
            due = max(due + 1 / self.rate, time.monotonic())  # a sample that is late is not caught up with
            time.sleep(max(due - 0.3 / self.rate - time.monotonic(), 0))  # the client's threads have the interpreter meanwhile
            data = self.packed(due - start)
            time.sleep(max(due - time.monotonic(), 0))
            stamp = time.monotonic() + self.shift
            client.sendall(stamped(data, stamp))
            self.sent.append(stamp)
            if select.select([client], [], [], 0)[0] and not client.recv(1 << 12):
                return

    def __enter__(self) -> PlusServer:
        """Started."""
        return self.start()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Stopped."""
        self.stop()


class Feed:
    """Messages given to an assembler by hand: sample k is true at k · PERIOD on the host's clock."""

    def __init__(self, **settings: object) -> None:
        self.frames = FrameAssembler(link(**settings))
        self.poses = still(0)
        self.k = 0

    def sample(self, lost: tuple[int, ...] = (), delay: float = DELAY, ahead: float = AHEAD) -> list[Frame]:
        """One sample, and the frames that can be read when its last message has arrived."""
        self.k += 1
        now = self.k * PERIOD
        for i, (device, pose) in enumerate(zip(DEVICES, self.poses, strict=True)):
            if i not in lost:
                self.frames.take(device, now + ahead, pose, now + delay)
        return self.read(now + delay)

    def read(self, now: float) -> list[Frame]:
        """All frames that are ready at a time on the host's clock."""
        frames = []
        while frame := self.frames.next(now):
            frames.append(frame)
        return frames

    def settle(self) -> Feed:
        """Samples until frames come."""
        while not self.sample():
            pass
        return self


class SteppedServer:
    """A server over a socket on a clock of the test's own: a sample goes out, and time passes, when the test says so, however slow it runs.

    Attributes:
        port: where it listens.
        now: the host's time in s.
        shift: server's clock − host's.
        sent: host's times of all samples.
        lost: indices of sensors of which nothing is sent.
        jump: added to the positions, (4, 3) in mm.
        held: samples are stamped, but sent only with the first one when this is False again.
        connections: accepted so far.
    """

    def __init__(self, rate: float = RATE, shift: float = AHEAD) -> None:
        self.period, self.shift, self.now, self.connections = 1 / rate, shift, 100.0, 0
        self.lost: Sequence[int] = ()
        self.jump, self.held = np.zeros((4, 3)), False
        self.sent: list[float] = []
        self._backlog = b""
        self.port = 0
        self.start()

    def start(self) -> None:
        """Listen; on the same port as before if it was stopped."""
        self._listener = socket.create_server(("127.0.0.1", self.port))
        self._listener.settimeout(PATIENCE)
        self.port = self._listener.getsockname()[1]

    def stop(self) -> None:
        """Close everything."""
        self._listener.close()
        self.client.close()

    def clock(self) -> float:
        """The host's time in s."""
        return self.now

    def tracker(self, **settings: object) -> LiveTracker:
        """A tracker that is connected."""
        tracker = open_link(link(port=self.port, rate_hz=1 / self.period, **settings), self.clock)
        self.accept()
        return tracker

    def accept(self) -> None:
        """Wait for the next connection."""
        self.client, _ = self._listener.accept()
        self.client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.connections += 1

    def sample(self, tracker: LiveTracker, pieces: Sequence[int] = (), garbage: bytes = b"") -> list[Frame]:
        """Let a period pass, send a sample and return the frames that are ready then.

        Args:
            tracker: that has to take it.
            pieces: places at which the bytes are cut; a moment passes after each.
            garbage: sent behind the poses: messages that count as malformed, one or none.
        """
        self.now += self.period
        self.sent.append(self.now)
        sensors = [i for i in range(4) if i not in self.lost]
        self._backlog += stamped(packed(self.jump, sensors), self.now + self.shift) + garbage
        if self.held:
            return list(iter(lambda: tracker.read(0), None))
        messages = len(self._backlog) // SIZE if not garbage else len(sensors)
        before, data, self._backlog = tracker.statistics, self._backlog, b""
        for start, end in zip((0, *pieces), (*pieces, len(data)), strict=True):
            self.client.sendall(data[start:end])
            time.sleep(0.002 if pieces else 0)
        wait_until(
            lambda: (
                tracker.statistics.received == before.received + messages
                and tracker.statistics.malformed == before.malformed + bool(garbage)
            )
        )
        return list(iter(lambda: tracker.read(0), None))

    def samples(self, tracker: LiveTracker, count: int) -> list[Frame]:
        """The frames of so many samples."""
        return [frame for _ in range(count) for frame in self.sample(tracker)]

    def __enter__(self) -> SteppedServer:
        """The server itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Stopped."""
        self.stop()


def packed(jump: np.ndarray, sensors: Sequence[int], poses: np.ndarray | None = None) -> bytearray:
    """A sample as one piece of bytes, with a time stamp to be written over."""
    poses = still(0) if poses is None else poses.copy()
    poses[:, :3, 3] += jump
    return bytearray(b"".join(pose_message(DEVICES[i], poses[i], VALID) for i in sensors))


def pose_message(device: str, pose: np.ndarray, metadata: Mapping[str, str], version: int = 2) -> bytes:
    """A TRANSFORM message as PlusServer sends it, of a pose (4, 4) in mm; metadata only with header version 2 and later."""
    message = TransformMessage(pose, timestamp=0.0, device_name=device)
    message.header_version, message.metadata = version, dict(metadata) if version > 1 else {}
    return message.pack()


def wait_until(true: Callable[[], bool]) -> None:
    """Wait for what another thread is about to do."""
    end = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < end, "nothing happens"
        time.sleep(1e-4)


def read_for(tracker: LiveTracker, seconds: float) -> list[Frame]:
    """All frames of some time."""
    end, frames = time.monotonic() + seconds, []
    while (left := end - time.monotonic()) > 0:
        if frame := tracker.read(left):
            frames.append(frame)
    return frames
