"""Imperfections that go on in a session's time: what warms up, slips, drifts, shakes, and clocks that run apart."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from tepm_opt.data.documents import require_range
from tepm_opt.hw.simulation.imperfections.base import Body, EdgeStage, Imperfection, Numbers, Sighting, TensionStage, of_actuators
from tepm_opt.hw.simulation.imperfections.body import Vector
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot

SLIDES = 0.05  # s that a slip takes
FADE = 1.0  # s over which a robot at rest begins to feel that its base moves

Instant = Annotated[float, require_range(0, 1e7, "s of the session")]
Amplitude = Annotated[float, require_range(-0.05, 0.05, "m")]


class Warming:
    """Springs beside those of the vertical edges, whose stiffness goes from none to its end in proportion to time.

    Args:
        change: of stiffness at the end, (n, actuators) in N/m.
        rest: rest lengths, (n, actuators) in m.
        full: time in the session at the end, in s.

    Attributes:
        clock: time in the session in s.
    """

    def __init__(self, change: np.ndarray, rest: np.ndarray, full: float) -> None:
        self.change, self.rest, self.full, self.clock = change, rest, full, 0.0

    def _push(self, length: np.ndarray) -> np.ndarray:
        return -min(self.clock / self.full, 1.0) * self.change * (length - self.rest)

    def settle(self, length: np.ndarray) -> np.ndarray:
        return self._push(length)

    def step(self, length: np.ndarray, rate: np.ndarray, duration: float) -> np.ndarray:
        start = self._push(length)
        self.clock += duration
        return np.array([start, self._push(length + rate * duration)])

    def numbers(self) -> Numbers:
        return Numbers("warming", (self.clock, self.full), (self.change, self.rest))


class WarmUp(Imperfection):
    """Muscles that become softer or stiffer by a share in proportion to the session's time, until they are warm."""

    of_one_actuator: ClassVar[bool] = True
    change: Annotated[float, require_range(-0.5, 1, "of the stiffness")] = 0.0
    full_s: Annotated[float, require_range(1, 1e5, "s of the session")] = 120.0

    def longest_tick(self, body: Body) -> float:
        stiffest = abs(self.change) * body.stiffness[:, body.verticals].max()
        return body.damping[:, body.verticals].min() / max(stiffest, 1e-9)

    def edge_stage(self, body: Body) -> EdgeStage:
        return Warming(self.change * body.stiffness[:, body.verticals], body.rest[:, body.verticals], self.full_s)


class Slip:
    """Shares of tensions that are lost from an instant on, in proportion to time while it slides.

    Args:
        share: (modules · actuators,).
        instant: in s of the session.

    Attributes:
        clock: time in the session in s.
    """

    def __init__(self, share: np.ndarray, instant: float) -> None:
        self.share, self.instant, self.clock = share, instant, 0.0

    def _compute_kept_share(self) -> np.ndarray:
        return 1 - self.share * min(max((self.clock - self.instant) / SLIDES, 0.0), 1.0)

    def settle(self, tension: np.ndarray, length: np.ndarray) -> np.ndarray:
        return tension * self._compute_kept_share()

    def step(self, tension: np.ndarray, length: np.ndarray, rate: np.ndarray, duration: float) -> np.ndarray:
        start = tension[0] * self._compute_kept_share()
        self.clock += duration
        return np.array([start, tension[1] * self._compute_kept_share()])

    def numbers(self) -> Numbers:
        return Numbers("slip", (self.clock, self.instant, SLIDES), (self.share,))


class TendonSlip(Imperfection):
    """Tendons that slide in their clamps at an instant, within 50 ms, and keep what is left: `share = { 12 = 0.3 }`."""

    of_one_actuator: ClassVar[bool] = False
    share: dict[str, Annotated[float, require_range(-1, 1, "of the tension")]] = Field(default_factory=dict)
    instant_s: Instant = 0.0

    def tension_stage(self, robot: Robot) -> TensionStage:
        return Slip(of_actuators(self.share, Layout.from_robot(robot), "tendon_slip: share"), self.instant_s)


class TrackerDrift(Imperfection):
    """A tracker whose pose goes to and fro as a slow sine of the session's time, from where it is at its start."""

    rotation_deg: Vector = (0.0, 0.0, 0.0)
    shift_m: Vector = (0.0, 0.0, 0.0)
    period_s: Annotated[float, require_range(10, 1e6, "s")] = 1000.0

    def measure(self, measured: Sighting) -> np.ndarray:
        part = np.sin(2 * np.pi * measured.time / self.period_s)
        turn = Rotation.from_rotvec(part * np.deg2rad(self.rotation_deg)).as_matrix()
        return measured.points @ turn.T + part * np.array(self.shift_m)


class BaseVibration(Imperfection):
    """A base that moves to and fro with the session's time, its second harmonic a share of the first: seen, and felt by all masses.

    A run begins at rest: masses feel it increasingly within the first second. Where `felt` is false the tracker's stand moves instead.
    """

    amplitude_m: tuple[Amplitude, Amplitude, Amplitude] = (0.0, 0.0, 0.0)
    frequency_Hz: Annotated[float, require_range(0.1, 50, "Hz")] = 4.0
    phase_deg: Annotated[float, require_range(-360, 360, "degrees")] = 0.0
    harmonic: Annotated[float, require_range(0, 1, "of the first")] = 0.1
    felt: bool = True

    @property
    def _waves(self) -> tuple[tuple[float, float], ...]:
        """Angular frequency in 1/s and share of the amplitude of each harmonic."""
        turn = 2 * np.pi * self.frequency_Hz
        return (turn, 1.0), (2 * turn, self.harmonic)

    def measure(self, measured: Sighting) -> np.ndarray:
        phase = np.deg2rad(self.phase_deg)
        part = sum(share * np.sin(turn * measured.time + phase) for turn, share in self._waves)
        return measured.points + part * np.array(self.amplitude_m)

    def base_motion(self, body: Body) -> np.ndarray | None:
        turn = body.robot.mount.rotation
        accelerations = [-share * rate**2 * np.array(self.amplitude_m) @ turn for rate, share in self._waves]
        rows = [[rate, np.deg2rad(self.phase_deg), *part] for (rate, _), part in zip(self._waves, accelerations, strict=True)]
        return np.array(rows) if self.felt else None


class ClockSkew(Imperfection):
    """A tracker whose clock runs faster than the commands' by a share that grows in a run: frames are older than they say.

    A frame of time t in the run is of t (1 − rate) − bend t² / 2.
    """

    of_devices: ClassVar[bool] = True
    rate: Annotated[float, require_range(-0.05, 0.05, "1")] = 0.0
    bend_per_s: Annotated[float, require_range(-1e-3, 1e-3, "1/s")] = 0.0


class SampleJitter(Imperfection):
    """Frames that are older than they say by times drawn evenly up to this, each anew."""

    of_devices: ClassVar[bool] = True
    up_to_s: Annotated[float, require_range(0, 0.1, "s")] = 0.0


def evaluate_shaking(shaking: np.ndarray, time: float, passed: float) -> np.ndarray:
    """Evaluate the acceleration (3,) in m/s² of a base that moves by `Imperfection.base_motion`, as a robot feels it, in the base frame.

    Args:
        shaking: harmonics.
        time: in the session in s.
        passed: s since the run began at rest.
    """
    return min(passed / FADE, 1.0) ** 2 * np.sin(shaking[:, 0] * time + shaking[:, 1]) @ shaking[:, 2:]
