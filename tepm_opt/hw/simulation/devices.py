"""Regulators, tendon motors, their sensors and the tracker as a rig file describes them; the defaults are perfect devices."""

from __future__ import annotations

from typing import Annotated
from zlib import crc32

import numpy as np
from pydantic import Field

from tepm_opt.data.documents import Section, require_range
from tepm_opt.models.robot import Robot

_ROOT_3 = np.sqrt(3)
Switch = Annotated[bool, Field(strict=True, description="true or false")]


def generator(seed: int, device: str, noise: int = 0) -> np.random.Generator:
    """The random numbers of one device: they do not depend on which other devices are on. Each `noise` is another run of the same rig."""
    return np.random.default_rng([seed, crc32(device.encode()), noise] if noise else [seed, crc32(device.encode())])


def on_grid(values: np.ndarray, step: float) -> np.ndarray:
    """Values rounded to multiples of a step; unchanged where the step is 0."""
    return np.round(values / step) * step if step > 0 else values


class Regulator(Section):
    """Pressure regulators; their lag is the imperfection `regulator_lag`."""

    quantised: Switch = False

    def step_of(self, robot: Robot) -> float:
        """Grid of the set points in Pa, 0 where continuous."""
        return robot.actuation.pressure_step if self.quantised else 0.0


class Stepper(Section):
    """Tendon motors: tension on a grid, changing at most at a rate (0: at once); a disabled one lets its tendon follow without tension."""

    quantised: Switch = False
    rate_limit_N_per_s: Annotated[float, require_range(0, 1e5, "N/s")] = 0.0

    def step_of(self, robot: Robot) -> float:
        """Grid of the set points in N, 0 where continuous."""
        return robot.actuation.tension_step if self.quantised else 0.0


class PressureMonitor(Section):
    """The regulators' monitor output: pressure in the muscle behind the lag."""

    fitted: Switch = False
    noise_rms_Pa: Annotated[float, require_range(0, 1e5, "Pa")] = 0.0
    offset_Pa: Annotated[float, require_range(-1e5, 1e5, "Pa")] = 0.0


class Dynamometer(Section):
    """Tension at the motor, before slack and friction."""

    fitted: Switch = False
    noise_rms_N: Annotated[float, require_range(0, 10, "N")] = 0.0
    offset_N: Annotated[float, require_range(-10, 10, "N")] = 0.0


class TrackerDevice(Section):
    """Position tracker.

    `noise_rms_m` is the RMS of the distance (3-D), so a coordinate has it over √3. A point is lost with `dropout_probability` a frame and
    stays lost for `dropout_frames`.
    """

    rate_hz: Annotated[float, require_range(0.1, 4000, "Hz")] = 100.0
    latency_s: Annotated[float, require_range(0, 1, "s")] = 0.0
    noise_rms_m: Annotated[float, require_range(0, 0.1, "m")] = 0.0
    dropout_probability: Annotated[float, require_range(0, 1, "a point and frame")] = 0.0
    dropout_frames: Annotated[int, Field(strict=True, ge=1, le=10000, description="1 … 10000")] = 1


class Lens:
    """The tracker at work: noise and dropouts of one rig.

    Args:
        settings: of the tracker.
        points: how many it sees.
        seed: of the rig.
        noise: number of the run; each has noise of its own.

    Attributes:
        lost: frames for which each point stays lost, (points,).
    """

    def __init__(self, settings: TrackerDevice, points: int, seed: int, noise: int = 0) -> None:
        self.settings = settings
        self.random = generator(seed, "tracker", noise)
        self.lost = np.zeros(points, dtype=int)

    def look(self, points: np.ndarray) -> np.ndarray:
        """A frame: points (points, 3) in m with noise, NaN where lost."""
        settings = self.settings
        seen = points + self.random.standard_normal(points.shape) * settings.noise_rms_m / _ROOT_3
        drawn = self.random.random(len(points))
        if settings.dropout_probability == 0:
            return seen
        dropped = drawn < settings.dropout_probability
        self.lost = np.where(dropped & (self.lost == 0), settings.dropout_frames, self.lost)
        seen[self.lost > 0] = np.nan
        self.lost = np.maximum(self.lost - 1, 0)
        return seen
