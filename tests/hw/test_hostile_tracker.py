"""A tracker's server that is broken or hostile: bounded memory, no exception out of the reader, and good poses again once they come."""

from __future__ import annotations

import contextlib
import random
import select
import socket
import struct
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pyigtl import TransformMessage

from tepm_opt.hw.trackers import open_link
from tepm_opt.hw.trackers.frames import LARGEST_CROWD, FrameAssembler
from tepm_opt.hw.trackers.kinds.openigtlink import LARGEST_POSE, Client
from tepm_opt.hw.trackers.receiver import Inbox
from tests.hw.igtl import AHEAD, DELAY, DEVICES, PERIOD, Feed, PlusServer, link, stamped, still

MEGABYTE = 1 << 20


def header(kind: bytes = b"TRANSFORM", name: bytes = b"BaseToTracker", size: int = 48, version: int = 1, seconds: int = 1) -> bytes:
    """The head of a message."""
    return struct.pack(">H12s20sIIQQ", version, kind, name, seconds, 0, size, 0)


def pose(name: str, **extra: str) -> bytes:
    """A good message of a device."""
    message = TransformMessage(still(0)[0], timestamp=1.0, device_name=name)
    if extra:
        message.header_version, message.metadata = 2, extra
    return message.pack()


class Script:
    """A server that does to each client, one after the other, what a function says, and hangs up when that ends."""

    def __init__(self, does: Callable[[socket.socket, int], object]) -> None:
        self.does, self.connections, self.listener = does, 0, socket.create_server(("127.0.0.1", 0))
        self.port, self.over = self.listener.getsockname()[1], threading.Event()
        self.thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self.over.is_set():
            if select.select([self.listener], [], [], 0.02)[0]:
                client, _ = self.listener.accept()
                self.connections += 1
                client.settimeout(0.2)
                with client, contextlib.suppress(OSError):
                    self.does(client, self.connections)

    def __enter__(self) -> Script:
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.over.set()
        self.thread.join()
        self.listener.close()


@pytest.fixture
def unraised() -> Iterator[list[threading.ExceptHookArgs]]:
    """Exceptions that left a thread; there must be none."""
    raised: list[threading.ExceptHookArgs] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(threading, "excepthook", raised.append)
        yield raised
    assert not raised


def good(client: socket.socket, over: threading.Event) -> None:
    """What a PlusServer sends, at 240 Hz."""
    sender = PlusServer()
    data = sender.packed(0.0)
    while not over.wait(PERIOD):
        client.sendall(stamped(bytearray(data), time.monotonic() + 1000))


def flood(client: socket.socket, data: bytes, seconds: float) -> None:
    """Bytes without end, for some time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        client.sendall(data)


class Fed:
    """A connection that gives bytes in pieces of a size and then ends."""

    def __init__(self, data: bytes, size: int) -> None:
        self.data, self.size, self.at = data, size, 0

    def settimeout(self, _: float) -> None:
        """Nothing is waited for."""

    def recv(self, count: int) -> bytes:
        """The next piece."""
        piece = self.data[self.at : self.at + min(self.size, count)]
        self.at += len(piece)
        return piece


def unstarted(frames: FrameAssembler, clock: Callable[[], float] = lambda: 0.0) -> Client:
    """A client without a thread: the test calls what its thread would."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(threading.Thread, "start", lambda _: None)
        return Client("", 0, Inbox(frames, threading.Condition(), clock))


@pytest.mark.slow
@pytest.mark.sample(3)
@pytest.mark.parametrize(
    ("head", "says"),
    [
        (header(size=1 << 26), "no usable pose came for 1 s"),
        (header(b"IMAGE", size=1 << 26), "no usable pose came for 1 s"),
        (header(size=1 << 63), f"not OpenIGTLink (a message of version 1 with {1 << 63} bytes)"),
        (header(b"IMAGE", size=(1 << 27) + 1), "not OpenIGTLink (a message of version 1 with 134217729 bytes)"),
        (header(version=0xABCD), "not OpenIGTLink (a message of version 43981 with 48 bytes)"),
        (
            b"HTTP/1.1 400 Bad Request\r\nContent-Type: text/plain; charset=utf-8\r\n\r\n",
            "not OpenIGTLink (a message of version 18516 with ",
        ),
    ],
    ids=["pose of 64 MB", "image of 64 MB", "pose of 8 EB", "image of 128 MB", "version", "HTTP"],
)
def test_a_length_is_not_believed(head, says, unraised):
    """No memory for what a header claims; the connection is given up with a reason, and frames come from the next one."""

    def does(client: socket.socket, connection: int) -> None:
        if connection == 1:
            client.sendall(head)
            for _ in range(63):
                client.sendall(b"x" * MEGABYTE)
                time.sleep(0.03)
        else:
            script.over.wait(0.5)  # so long that the tracker says that it hears nothing
            good(client, script.over)

    with Script(does) as script:
        tracemalloc.start()
        try:
            with open_link(link(port=script.port), stale_periods=60) as tracker:
                reasons, frame, end = set(), None, time.monotonic() + 15
                while frame is None and time.monotonic() < end:
                    frame = tracker.read(0.05)
                    reasons.add(tracker.status)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert frame is not None
    assert any(says in reason for reason in reasons), reasons
    assert peak < 8 * MEGABYTE


def test_what_is_no_pose_goes_by():
    """An image of 2 MB and a pose with too much behind it between poses: skipped, and no frame is lost."""
    image = header(b"IMAGE", size=2 * MEGABYTE) + bytes(2 * MEGABYTE)
    big = header(size=LARGEST_POSE + 1) + bytes(LARGEST_POSE + 1)
    poses = PlusServer().packed(0.0)
    client = unstarted(frames := FrameAssembler(link()))
    line = Fed(b"".join(image + stamped(poses, AHEAD + k * PERIOD) + big for k in range(20)), 1 << 16)
    with pytest.raises(ConnectionError, match="closed by the server"):
        client._listen(line)
    assert (frames.counts["received"], frames.counts["malformed"]) == (80, 20)
    assert frames.counts["frames"] + frames.counts["settling"] == 20


@pytest.mark.slow
@pytest.mark.parametrize("where", ["head", "body", "image", "text"])
def test_a_trickle_is_silence(where, unraised):
    """A byte every 20 ms, and never a whole pose: a new connection after the same second as if nothing came."""
    first = {"head": b"", "body": header(size=1000), "image": header(b"IMAGE", size=1 << 26), "text": b""}[where]
    then = header(b"STRING", size=2) + b"ab" if where == "text" else pose("BaseToTracker")[:50]
    times = []

    def does(client: socket.socket, connection: int) -> None:
        times.append(time.monotonic())
        if connection > 1:
            return good(client, script.over)
        client.sendall(first)
        k = 0
        while True:
            client.sendall(then[k % len(then) : k % len(then) + 1] if where != "head" or k < 50 else b"")
            k += 1
            if select.select([client], [], [], 0.02)[0] and not client.recv(100):
                return None

    with Script(does) as script, open_link(link(port=script.port), stale_periods=60) as tracker:
        frame = tracker.read(6.0)
    assert frame is not None
    assert 0.9 < times[1] - times[0] < 3.0


def test_a_trickle_does_not_hold_a_frame_back():
    """A sensor that sends nothing, and half a message byte by byte: the frame is made without it after 1.5 periods."""

    class Line:
        """A connection in which everything is at once there."""

        def __init__(self, *pieces: bytes) -> None:
            self.pieces = list(pieces)

        def settimeout(self, _: float) -> None:
            pass

        def recv(self, _: int) -> bytes:
            now[0] += 0.7 * PERIOD
            return self.pieces.pop(0)

    now = [0.0]
    frames = FrameAssembler(link())
    client = unstarted(frames, lambda: now[0])
    part = b"".join(pose(name) for name in DEVICES[:3])
    with pytest.raises(ConnectionError, match="closed by the server"):
        client._listen(Line(part, b"\0", b"\1", b"T", b"R", b""))
    assert frames.counts["settling"] == 1


def test_names_are_bounded_and_can_be_printed(unraised):
    """A new name with each message, and names that would move a terminal's cursor."""

    def does(client: socket.socket, _: int) -> None:
        for k in range(4_000):
            client.sendall(pose(f"Device{k}") if k % 2 else pose("\x1b[2J\r"))

    with Script(does) as script, open_link(link(port=script.port)) as tracker:
        end = time.monotonic() + 20
        while tracker.statistics.malformed < 1000 and time.monotonic() < end:
            time.sleep(0.05)
        assert tracker.statistics.malformed >= 1000
        assert len(tracker._frames.seen) == LARGEST_CROWD
        assert all(name.isprintable() for name in tracker._frames.seen)
    feed = Feed()
    for k in range(2 * LARGEST_CROWD):
        feed.frames.take(f"other {k}", 1.0, None, 0.0)
    assert feed.settle().frames.seen >= set(DEVICES)  # the link's own are never crowded out


@pytest.mark.parametrize("ahead", [3e9, 60.0, 1.0])
@pytest.mark.parametrize("sensor", range(4))
def test_a_wild_stamp_breaks_no_clock(ahead, sensor):
    """One message from far in the future: no other frame is lost, none has another time."""
    feed = Feed().settle()
    feed.frames.take(DEVICES[sensor], AHEAD + ahead, feed.poses[sensor], feed.k * PERIOD + 2 * DELAY)
    assert feed.frames.counts["malformed"] == 1
    for _ in range(10):
        (frame,) = feed.sample()
        assert frame.time == pytest.approx(feed.k * PERIOD + DELAY, abs=1e-9)
        assert frame.status == "ok"


def test_wild_stamps_do_not_agree_by_themselves():
    """One now and then, each somewhere else."""
    feed = Feed().settle()
    for k in range(50):
        feed.frames.take(DEVICES[k % 4], AHEAD * 10 ** (k % 5) + 100 + k, feed.poses[0], feed.k * PERIOD + 2 * DELAY)
        (frame,) = feed.sample()
        assert frame.time == pytest.approx(feed.k * PERIOD + DELAY, abs=1e-9)
    assert feed.frames.counts["malformed"] == 50


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3.4e38, 0.0])
def test_poses_of_nonsense_over_the_wire(value, unraised):
    """A matrix of such elements is a lost sensor."""
    matrix = still(0)
    matrix[1, :3, :3] = value

    def does(client: socket.socket, _: int) -> None:
        data = bytearray(
            b"".join(TransformMessage(each, timestamp=0.0, device_name=name).pack() for each, name in zip(matrix, DEVICES, strict=True))
        )
        while not script.over.wait(PERIOD):
            client.sendall(stamped(data, time.monotonic()))

    with Script(does) as script, open_link(link(port=script.port), stale_periods=60) as tracker:
        frame = tracker.read(10.0)
    assert frame is not None
    assert "tracker lost s2" in frame.status
    assert np.isfinite(frame.points).all(axis=1).tolist() == [True, False, True, True]


MESSAGES = st.one_of(
    st.binary(max_size=200),
    st.builds(
        lambda kind, name, size, version, seconds, body: header(kind, name, size, version, seconds) + body,
        st.sampled_from([b"TRANSFORM", b"IMAGE", b"STRING", b"\xff\xfe", b""]),
        st.one_of(st.sampled_from([each.encode() for each in DEVICES]), st.binary(max_size=20)),
        st.one_of(st.integers(0, 200), st.sampled_from([0, 48, 60, LARGEST_POSE, LARGEST_POSE + 1, 1 << 27, (1 << 64) - 1])),
        st.sampled_from([0, 1, 2, 3, 4, 65535]),
        st.sampled_from([0, 1, 2**31, 2**32 - 1]),
        st.binary(max_size=200),
    ),
    st.builds(
        lambda name, state: pose(name, Status=state), st.sampled_from(DEVICES), st.text(st.characters(max_codepoint=127), max_size=20)
    ),
)


@given(st.lists(MESSAGES, max_size=20), st.integers(1, 300))
@example([pose(DEVICES[0], Status="OK")], 1)
def test_any_bytes(messages, size):
    """Whatever comes: the connection's end is an OSError, nothing else leaves the reader; what is remembered stays small."""
    frames = FrameAssembler(link())
    client = unstarted(frames)
    with pytest.raises(OSError, match=r"closed by the server|not OpenIGTLink"):
        client._listen(Fed(b"".join(messages), size))
    assert len(client._bytes) <= LARGEST_POSE + size
    assert len(frames.pending) <= len(DEVICES)
    assert all(np.isfinite(frame.time) for frame in frames.ready)


@pytest.mark.slow
def test_noise_and_then_a_server(unraised):
    """Two seconds of random bytes on many connections, then a server: the thread is alive, and reads it."""
    noise = random.Random(1)

    def does(client: socket.socket, _: int) -> None:
        if time.monotonic() < start + 2:
            flood(client, header(size=48) + noise.randbytes(noise.randrange(1, 300)), 0.1)
        else:
            good(client, script.over)

    start = time.monotonic()
    with Script(does) as script, open_link(link(port=script.port), stale_periods=60) as tracker:
        while time.monotonic() < start + 2:
            tracker.read(0.1)
        end, frame = time.monotonic() + 15, None
        while time.monotonic() < end and not (frame and frame.status == "ok"):
            frame = tracker.read(0.5)
    assert frame is not None
    assert frame.status == "ok"
    assert script.connections > 5
