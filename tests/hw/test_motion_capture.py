"""Camera systems by the package motioncapture keep the contract of trackers: the real library against a stand-in for Motive."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.hw.trackers import open_link
from tepm_opt.hw.trackers.receiver import require_package
from tepm_opt.models.hardware import TrackerLink
from tepm_opt.testing import TrackerContract, motion_of_arm
from tepm_opt.testing.trackers import PATIENCE_S, Motion
from tests.hw.natnet import Motive
from tests.hw.test_tracker_contracts import RATE, Sensors

pytest.importorskip("motioncapture", reason="motioncapture is not installed (extra motioncapture)")

BODIES = ("Base", "Low", "High", "Tip")


class OptiTrackStandIn(Sensors):
    """Motive as libmotioncapture hears it: frames come to the data port; lost bodies are left out, stamps are not told.

    Args:
        minor: of the protocol 4.minor.
    """

    def __init__(self, minor: int = 0) -> None:
        super().__init__()
        self._motive = Motive(RATE, BODIES, ("m1",), self.poses, to_data_port=True, minor=minor)
        self.link = TrackerLink(
            kind="motioncapture", devices=BODIES, port=self._motive.port, rate_hz=RATE, options={"system": "optitrack"}
        )  # fmt: skip

    def start(self, motion: Motion) -> None:
        """See `StandIn`."""
        self._motion = motion
        self._motive.start()

    def stop(self) -> None:
        """See `StandIn`."""
        self._motive.stop()


@pytest.mark.slow
class TestOptiTrack(TrackerContract):
    """Rigid bodies of OptiTrack."""

    def stand_in(self) -> OptiTrackStandIn:
        """Not started yet."""
        return OptiTrackStandIn(minor=1)

    def test_a_crash_of_the_library_is_told(self) -> None:
        """Version 1.1 misreads names of NatNet 4.2 and crashes, in its own process; docs/how-to/trackers.md warns of it."""
        server = OptiTrackStandIn(minor=2)
        server.start(motion_of_arm())
        try:
            with self._open(server) as tracker, pytest.raises(InputError, match="motioncapture ended with status -"):
                tracker.first(3.0)
        finally:
            server.stop()

    def test_the_older_protocol(self) -> None:
        """NatNet 4.0."""
        server = OptiTrackStandIn(minor=0)
        server.start(motion_of_arm())
        try:
            with self._open(server) as tracker:
                assert np.isfinite(tracker.first(PATIENCE_S).points).all()
        finally:
            server.stop()


def mock(**settings: object) -> TrackerLink:
    """Bodies that stand still without a server."""
    return TrackerLink.model_validate(
        {"kind": "motioncapture", "devices": BODIES, "rate_hz": RATE, "options": {"system": "mock"}, **settings}
    )  # fmt: skip


@pytest.fixture
def silent_port() -> Iterator[int]:
    """A port where commands arrive and nobody answers."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as deaf:
        deaf.bind(("127.0.0.1", 0))
        yield deaf.getsockname()[1]


def test_bodies_of_the_mock_are_where_they_are_told() -> None:
    with open_link(mock(), stale_periods=60) as tracker:
        frame = tracker.first(PATIENCE_S)
    assert frame.points == pytest.approx(np.array([[0.1, 0, 0], [0.2, 0, 0], [0.3, 0, 0], [0.4, 0, 0]]))
    assert frame.transforms[1, :3, :3] == pytest.approx(np.eye(3))


@pytest.mark.slow
def test_a_server_that_never_answers_does_not_stop_this_process(silent_port: int) -> None:
    """The library would wait for ever and hold Python's lock: a thread of this process runs on meanwhile, and closing ends the wait."""
    link = mock(options={"system": "optitrack"}, port=silent_port)
    gaps, ended = [time.monotonic()], threading.Event()

    def tick() -> None:
        while not ended.wait(0.01):
            gaps.append(time.monotonic())

    ticking = threading.Thread(target=tick)
    ticking.start()
    try:
        with open_link(link) as tracker, pytest.raises(InputError, match="nothing listens there"):
            tracker.first(2.5)
    finally:
        ended.set()
        ticking.join()
    assert np.diff(gaps).max() < 1.5


@pytest.mark.slow
def test_the_process_ends_with_its_host() -> None:
    """A host that is killed leaves none behind: writing to it fails, or the alarm rings."""
    program = (
        "import time; from tests.hw.test_motion_capture import mock; from tepm_opt.hw.trackers import open_link\n"
        "tracker = open_link(mock(), stale_periods=60); tracker.first(20.0); print('on', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as host:
        assert host.stdout is not None
        assert host.stdout.readline() == b"on\n"
        children = Path(f"/proc/{host.pid}/task").glob("*/children")
        (child,) = [int(each) for path in children for each in path.read_text().split()]
        host.kill()
    end = time.monotonic() + PATIENCE_S
    while Path(f"/proc/{child}/cmdline").exists() and Path(f"/proc/{child}/cmdline").read_bytes():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_port_that_is_left_out_is_told() -> None:
    with pytest.raises(InputError, match="usually 801"):
        open_link(mock(options={"system": "vicon"}))


@pytest.mark.parametrize("options", [{}, {"system": "kinect"}])
def test_a_system_that_there_is_not_is_told(options: dict[str, str]) -> None:
    with pytest.raises(InputError, match="system"):
        open_link(mock(options=options))


def test_a_package_that_is_missing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "motioncapture", None)
    words = r"tracker motioncapture needs motioncapture, which is not installed: pip install 'tepm-opt\[motioncapture\]'"
    with pytest.raises(InputError, match=words):
        open_link(mock())
    assert require_package("json", "none", "none").dumps([1]) == "[1]"
