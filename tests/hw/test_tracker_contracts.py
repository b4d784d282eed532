"""Built-in trackers keep the contract of trackers, each against a stand-in for its server."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from tepm_opt.models.hardware import TrackerLink
from tepm_opt.testing import TrackerContract
from tepm_opt.testing.trackers import Motion
from tests.hw.igtl import DEVICES, PlusServer

LATENCY, NOISE, RATE = 0.03, 3e-4, 100.0


class Sensors:
    """Four moving sensors as a server knows them: late, noisy, lost and frozen as it is told.

    Attributes:
        latency_s, noise_m, rotations: see `tepm_opt.testing.StandIn`.
    """

    latency_s, noise_m, rotations = LATENCY, NOISE, True

    def __init__(self) -> None:
        self._random, self._lock = np.random.default_rng(1), threading.Lock()
        self._lost, self._kept = frozenset[int](), None
        self._frozen, self._motion = False, None

    def lose(self, devices: frozenset[int]) -> None:
        """See `StandIn`."""
        self._lost = devices

    def freeze(self, frozen: bool) -> None:
        """See `StandIn`."""
        self._frozen = frozen

    def poses(self) -> list[np.ndarray | None]:
        """What the sensors told last, in m; None where one is lost."""
        with self._lock:
            if not self._frozen or self._kept is None:
                self._kept = self._motion(time.monotonic() - self.latency_s)
                self._kept[:, :3, 3] += self.noise_m * self._random.normal(size=(4, 3))
            return [None if k in self._lost else self._kept[k] for k in range(4)]


class PlusStandIn(Sensors):
    """PlusServer: OpenIGTLink over TCP, mm, with its validity in metadata."""

    def __init__(self) -> None:
        super().__init__()
        self._server = PlusServer(RATE, self._sent, shift=1000.0)
        self._server.start()
        self._server.stop()  # has a port of its own from now on
        self.link = TrackerLink(devices=DEVICES, port=self._server.port, rate_hz=RATE, latency_s=0.0)

    def _sent(self, _: float) -> np.ndarray:
        poses = [np.eye(4) if pose is None else pose @ np.diag([1, 1, 1, 1.0]) for pose in self.poses()]
        sent = np.array(poses)
        sent[:, :3, 3] *= 1e3
        return sent

    def start(self, motion: Motion) -> None:
        """See `StandIn`."""
        self._motion = motion
        self._server.start()

    def stop(self) -> None:
        """See `StandIn`."""
        self._server.stop()


@pytest.mark.slow
class TestOpenIGTLink(TrackerContract):
    """Poses of a PlusServer."""

    def stand_in(self) -> PlusStandIn:
        """Not started yet."""
        return PlusStandIn()
