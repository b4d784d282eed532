"""The contract of a tracker, tested against a stand-in for its server."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from tepm_opt.errors import InputError
from tepm_opt.hw.freshness import DeclaredNoise, FreshnessMonitor
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.trackers import LiveTracker, open_link
from tepm_opt.hw.trackers.frames import Frame
from tepm_opt.models.hardware import TrackerLink
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import load_robot

Motion = Callable[[float], np.ndarray]
"""Poses of the sensors in m, (sensors, 4, 4), at a time on the host's monotonic clock in s."""
PATIENCE_S = 10.0
"""Time until a test gives up on another thread."""


class StandIn(Protocol):
    """Stands for a tracker's server on this machine, on the loopback, and moves its sensors as it is told.

    Attributes:
        link: how the tracker finds it. Four devices, from the base to the tip.
        latency_s: age of a pose when it gets its time stamp, or when it arrives where stamps are not sent.
        noise_m: standard deviation of a coordinate that it adds.
        rotations: whether it tells rotations.
    """

    link: TrackerLink
    latency_s: float
    noise_m: float
    rotations: bool

    def start(self, motion: Motion) -> None:
        """Begin to serve."""
        ...

    def lose(self, devices: frozenset[int]) -> None:
        """Say from now on that these sensors, from 0, are not seen; none: all are seen."""
        ...

    def freeze(self, frozen: bool) -> None:
        """Send the last poses again and again, with new time stamps; or go on."""
        ...

    def stop(self) -> None:
        """End all connections and stop listening; `start` begins anew at the same address."""
        ...


def motion_of_arm(period: float = 2.0, amplitude: float = 0.03) -> Motion:
    """Four sensors on an arm that swings: the n-th from the base by n/4 of the amplitude, in m, once in a period in s."""

    def poses(when: float) -> np.ndarray:
        share, angle = np.arange(1, 5) / 4, 2 * math.pi * when / period
        found = np.tile(np.eye(4), (4, 1, 1))
        found[:, :3, 3] = np.stack([amplitude * share * np.sin(angle), 0.2 + amplitude * share * np.cos(angle), -0.1 * share], axis=1)
        found[:, :3, :3] = Rotation.from_rotvec(np.stack([0.2 + 0 * share, 0.3 * share * np.sin(angle), 0.1 * share], axis=1)).as_matrix()
        return found

    return poses


class TrackerContract:
    """Subclass it in a test file, give `stand_in`, and pytest runs what every tracker has to keep.

    Tolerances follow from the declared noise, and from the threads of a machine that does other work beside.
    """

    position_m = 1e-4
    """Largest error of a position in m beside the noise."""

    def stand_in(self) -> StandIn:
        """A stand-in that has not started yet."""
        raise NotImplementedError

    def _open(self, server: StandIn) -> LiveTracker:
        return open_link(server.link, stale_periods=60)

    def _frames(self, tracker: LiveTracker, count: int) -> list[Frame]:
        frames, end = list[Frame](), time.monotonic() + PATIENCE_S
        while len(frames) < count:
            if frame := tracker.read(0.5):
                frames.append(frame)
            assert time.monotonic() < end, f"{len(frames)} of {count} frames within {PATIENCE_S:g} s: {tracker.status}"
        return frames

    def test_points_are_where_the_sensors_are_when_they_are(self) -> None:
        """Positions, latency and noise follow from a motion that is known: both numbers of the stand-in come back within a tenth."""
        server, motion = self.stand_in(), motion_of_arm()
        server.start(motion)
        try:
            with self._open(server) as tracker:
                tracker.first(PATIENCE_S)
                frames = self._frames(tracker, 400)
        finally:
            server.stop()
        times = np.array([frame.time for frame in frames])
        assert np.all(np.diff(times) > 0)
        points = np.array([frame.points for frame in frames])
        late = _least(lambda delay: float(np.nanmean((points - _places(motion, times - delay)) ** 2)))
        rest = points - _places(motion, times - late)
        scatter = float(np.sqrt(np.nanmean((rest - np.nanmean(rest, axis=0)) ** 2)))
        assert abs(np.nanmean(rest, axis=0)).max() < self.position_m + 0.3 * server.noise_m
        assert abs(late - server.latency_s) < 0.1 * server.latency_s + 1e-3, late
        assert abs(scatter - server.noise_m) < 0.1 * server.noise_m + self.position_m, scatter

    def test_a_lost_sensor_is_told_and_comes_back(self) -> None:
        """Its point is NaN and its name in the status; the others stay."""
        server = self.stand_in()
        server.start(motion_of_arm())
        try:
            with self._open(server) as tracker:
                tracker.first(PATIENCE_S)
                server.lose(frozenset({3}))
                lost = self._wait_for_frame(tracker, lambda frame: bool(np.isnan(frame.points[3]).all()))
                assert "s4" in lost.status
                assert np.isfinite(lost.points[:3]).all()
                server.lose(frozenset())
                self._wait_for_frame(tracker, lambda frame: bool(np.isfinite(frame.points).all()))
        finally:
            server.stop()

    def test_poses_that_repeat_are_withheld(self) -> None:
        """The monitor of a rig takes them out, whatever their time stamps say."""
        server, robot = self.stand_in(), load_robot("kang2017")
        noise = DeclaredNoise.of_robot(robot)
        monitor = FreshnessMonitor(Layout.from_robot(robot), robot.input_max, noise, server.link.rate_hz)
        server.start(motion_of_arm())
        try:
            with self._open(server) as tracker:
                tracker.first(PATIENCE_S)
                samples = [monitor.look(Sample(frame.time, frame.points)) for frame in self._frames(tracker, 20)]
                fresh = samples[-1]
                assert np.isfinite(fresh.points).all()
                server.freeze(True)
                end = time.monotonic() + PATIENCE_S
                while np.isfinite(fresh.points).any() and time.monotonic() < end:
                    if frame := tracker.read(0.5):
                        fresh = monitor.look(Sample(frame.time, frame.points))
                assert np.isnan(fresh.points).all()
        finally:
            server.stop()

    def test_a_server_that_ends_is_told_and_found_again(self) -> None:
        """Frames end, the status says so; when it is back, frames come by themselves, later than those before."""
        server = self.stand_in()
        server.start(motion_of_arm())
        try:
            with self._open(server) as tracker:
                before = tracker.first(PATIENCE_S)
                server.stop()
                self._wait(lambda: tracker.status.startswith("tracker silent for"))
                while tracker.read(0.0):
                    pass
                server.start(motion_of_arm())
                assert self._wait_for_frame(tracker, lambda _: True).time > before.time
                assert tracker.status == "ok"
        finally:
            server.stop()

    def test_nobody_there(self) -> None:
        """The error says where it looked, and what has to run there."""
        server = self.stand_in()
        with self._open(server) as tracker:
            with pytest.raises(InputError, match="valid:") as failure:
                tracker.first(0.5)
            assert any(str(place) in str(failure.value) for place in (server.link.host, *server.link.options.values()))

    def test_a_name_that_is_not_sent(self) -> None:
        """The error names it, and the names that are sent."""
        server = self.stand_in()
        server.start(motion_of_arm())
        devices = (*server.link.devices[:3], "Nobody")
        try:
            link = server.link.model_copy(update={"devices": devices})
            with open_link(link) as tracker, pytest.raises(InputError, match="Nobody"):
                tracker.first(3.0)
        finally:
            server.stop()

    def test_closing_ends_its_thread(self) -> None:
        """Within moments; twice does nothing."""
        server = self.stand_in()
        server.start(motion_of_arm())
        others = set(threading.enumerate())
        try:
            tracker = self._open(server)
            tracker.first(PATIENCE_S)
            tracker.close()
            tracker.close()
            self._wait(lambda: not any(each.name == "tracker" and each.is_alive() for each in set(threading.enumerate()) - others))
        finally:
            server.stop()

    def _wait_for_frame(self, tracker: LiveTracker, so: Callable[[Frame], bool]) -> Frame:
        """The first frame for which something holds."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            if (frame := tracker.read(0.5)) and so(frame):
                return frame
        raise AssertionError(f"it did not come within {PATIENCE_S:g} s: {tracker.status}")

    def _wait(self, so: Callable[[], bool]) -> None:
        """Wait until something holds."""
        end = time.monotonic() + PATIENCE_S
        while not so():
            assert time.monotonic() < end, f"it did not come within {PATIENCE_S:g} s"
            time.sleep(0.02)


def _places(motion: Motion, times: np.ndarray) -> np.ndarray:
    """Points of a motion at some times, (times, sensors, 3) in m."""
    return np.array([motion(when)[:, :3, 3] for when in times])


def _least(of: Callable[[float], float], most: float = 0.4) -> float:
    """Delay in s, at most `most` either way, at which a function is least."""
    delays = np.linspace(-most, most, 41)
    near = float(delays[int(np.argmin([of(delay) for delay in delays]))])
    step = delays[1] - delays[0]
    found: Any = minimize_scalar(of, bounds=(near - step, near + step), method="bounded", options={"xatol": 1e-5})
    return float(found.x)
