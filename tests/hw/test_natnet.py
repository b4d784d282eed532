"""OptiTrack's NatNet by the package natnet keeps the contract of trackers, against a stand-in for Motive on the loopback."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.hw.trackers import open_link
from tepm_opt.hw.trackers.poses import marker_position, rigid_body_pose
from tepm_opt.models.hardware import TrackerLink
from tepm_opt.testing import TrackerContract, motion_of_arm
from tepm_opt.testing.trackers import PATIENCE_S, Motion
from tests.hw.natnet import Motive
from tests.hw.test_tracker_contracts import RATE, Sensors

pytest.importorskip("natnet", reason="natnet is not installed (extra natnet)")

BODIES, MARKERS = ("Base", "Low", "High", "Tip"), ("m1", "m2", "m3", "m4")


class MotiveStandIn(Sensors):
    """Motive: unicast, in m; a lost body has its flag cleared, a lost marker is at the origin.

    Args:
        devices: rigid bodies, or markers "Arm/m1".
        minor: of the protocol 4.minor.
    """

    def __init__(self, devices: tuple[str, ...] = BODIES, minor: int = 0) -> None:
        super().__init__()
        self.rotations = devices == BODIES
        self.motive = Motive(RATE, BODIES, MARKERS, self.poses, minor=minor)
        self.link = TrackerLink(kind="natnet", devices=devices, port=self.motive.port, rate_hz=RATE)

    def start(self, motion: Motion) -> None:
        """See `StandIn`."""
        self._motion = motion
        self.motive.start()

    def stop(self) -> None:
        """See `StandIn`."""
        self.motive.stop()


@pytest.mark.slow
class TestRigidBodies(TrackerContract):
    """Poses of rigid bodies."""

    def stand_in(self) -> MotiveStandIn:
        """Not started yet."""
        return MotiveStandIn(minor=1)

    def test_rotations_are_those_of_the_bodies(self) -> None:
        """Of the last one, which turns most: within the angle that it turns by in a tenth of a second."""
        server, motion = self.stand_in(), motion_of_arm()
        server.start(motion)
        try:
            with self._open(server) as tracker:
                frame = tracker.first(PATIENCE_S)
        finally:
            server.stop()
        truth = motion(frame.time - server.latency_s)
        assert frame.transforms[3, :3, :3] == pytest.approx(truth[3, :3, :3], abs=0.1)

    def test_names_that_change_are_asked_for_again(self) -> None:
        """Where Motive says that its models have changed, poses go on under the new names."""
        server = self.stand_in()
        server.start(motion_of_arm())
        devices = ("New", *BODIES[1:])
        try:
            with open_link(server.link.model_copy(update={"devices": devices}), stale_periods=60) as tracker:
                self._wait_for_frame(tracker, lambda frame: bool(np.isnan(frame.points[0]).all()))
                server.motive.bodies, server.motive.param = devices, 2
                self._wait_for_frame(tracker, lambda frame: bool(np.isfinite(frame.points).all()))
        finally:
            server.stop()

    @pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
    def test_a_damaged_packet_is_survived(self) -> None:
        """It ends the client's thread; poses come again over a new connection."""
        server = self.stand_in()
        server.start(motion_of_arm())
        try:
            with self._open(server) as tracker:
                tracker.first(PATIENCE_S)
                server.motive.damaged = True
                self._wait_for_frame(tracker, lambda _: tracker.statistics.reconnects > 0)
        finally:
            server.stop()

    @pytest.mark.parametrize("minor", [0, 2])
    def test_other_versions(self, minor: int) -> None:
        """Versions 4.0 and 4.2, whose messages differ, tell the same names and poses."""
        server = MotiveStandIn(minor=minor)
        server.start(motion_of_arm())
        try:
            with self._open(server) as tracker:
                assert np.isfinite(tracker.first(PATIENCE_S).points).all()
        finally:
            server.stop()


@pytest.mark.slow
class TestMarkers(TrackerContract):
    """Positions of a marker set's markers."""

    def stand_in(self) -> MotiveStandIn:
        """Not started yet."""
        return MotiveStandIn(tuple(f"Arm/{name}" for name in MARKERS))


def test_lost_poses_are_none() -> None:
    """Zeros and NaN say that nothing is seen; so does a quaternion of zeros."""
    turn = (0.0, 0.0, 0.0, 1.0)
    assert marker_position((0.0, 0.0, 0.0)) is None
    assert marker_position((0.0, np.nan, 1.0)) is None
    assert rigid_body_pose((0.0, 0.0, 0.0), turn) is None
    assert rigid_body_pose((1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)) is None
    assert rigid_body_pose((1.0, 0.0, 0.0), (np.nan, 0.0, 0.0, 1.0)) is None


def test_quaternions_are_x_y_z_w() -> None:
    """Half a turn about x."""
    pose = rigid_body_pose((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))
    assert pose is not None
    assert pose == pytest.approx(np.array([[1, 0, 0, 1], [0, -1, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]]))


def test_a_wrong_option_is_told() -> None:
    with pytest.raises(InputError, match="interfaces"):
        open_link(TrackerLink(kind="natnet", devices=BODIES, options={"interfaces": "0.0.0.0"}))


def test_closing_is_quick_where_nobody_answers() -> None:
    """The request for the version is given up after a second."""
    tracker = MotiveStandIn()
    opened = open_link(tracker.link)
    began = time.monotonic()
    opened.close()
    assert time.monotonic() - began < 2.5
