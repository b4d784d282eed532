"""Valves with orifices: flow that chokes (ISO 6358) on the way into a muscle, out of it, and through a leak."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from tepm_opt.data.documents import require_range
from tepm_opt.hw.simulation.imperfections.base import Imperfection, Numbers, PressureStage, of_actuators
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot

ATMOSPHERE = 101_325.0  # Pa
HALVINGS = 60  # of the interval in which a leak settles


def flow(upstream: np.ndarray, downstream: np.ndarray, critical_ratio: float) -> np.ndarray:
    """Flow through an orifice over its conductance, by absolute pressures (ISO 6358-1): an ellipse, choked below the critical ratio."""
    ratio = np.minimum(downstream / upstream, 1.0)
    return upstream * np.sqrt(1 - (np.maximum(ratio - critical_ratio, 0.0) / (1 - critical_ratio)) ** 2)


class Orifices:
    """Muscles filled from a supply and emptied to the atmosphere through a valve that opens in proportion to the error, then no further.

    Args:
        rate: conductance of the open valve over the muscle's volume in 1/s.
        supply: gauge pressure in Pa.
        band: error in Pa at which the valve is open.
        critical_ratio: of the valve.
    """

    def __init__(self, rate: float, supply: float, band: float, critical_ratio: float) -> None:
        self.rate, self.supply, self.band, self.critical_ratio = rate, supply, band, critical_ratio
        self.state = np.zeros(0)

    def settle(self, pressure: np.ndarray) -> np.ndarray:
        self.state = np.array(pressure)
        return self.state

    def step(self, pressure: np.ndarray, duration: float) -> np.ndarray:
        before, error = self.state, (pressure[0] + pressure[1]) / 2 - self.state
        inside = np.maximum(before, 0.0) + ATMOSPHERE
        source, sink = np.where(error > 0, self.supply + ATMOSPHERE, inside), np.where(error > 0, inside, ATMOSPHERE)
        open_for = self.rate * flow(source, sink, self.critical_ratio) * duration  # Pa, if the valve stayed open
        self.state = before + error * -np.expm1(-open_for / np.maximum(np.abs(error), self.band))
        return np.array([before, self.state])

    def numbers(self) -> Numbers:
        return Numbers("orifices", (self.rate, self.supply, self.band, self.critical_ratio), (self.state,))


class ChokedFilling(Imperfection):
    """Valves whose flow chokes: far from the set point pressure rises no faster than the open valve lets it.

    `rate_per_s` is the open valve's conductance over the muscle's volume: a choked supply fills by it times its absolute pressure.
    """

    of_one_actuator: ClassVar[bool] = True
    of_devices: ClassVar[bool] = True
    of_regulators: ClassVar[bool] = True
    rate_per_s: Annotated[float, require_range(0, 100, "1/s")] = 0.0
    supply_Pa: Annotated[float, require_range(1e5, 2e6, "Pa, gauge")] = 0.7e6
    band_Pa: Annotated[float, require_range(100, 1e6, "Pa of error that open the valve")] = 2e4
    critical_ratio: Annotated[float, require_range(0, 0.6, "")] = 0.3

    def pressure_stage(self, robot: Robot) -> PressureStage | None:
        return Orifices(self.rate_per_s, self.supply_Pa, self.band_Pa, self.critical_ratio) if self.rate_per_s else None


class Leak:
    """Muscles filled in proportion to the error, with a time constant (s), that lose through an orifice; those without a leak follow.

    The orifice's conductance is given over the valve's: a choked leak loses this share of the absolute pressure.
    """

    def __init__(self, share: np.ndarray, constant: float, critical_ratio: float) -> None:
        self.share, self.constant, self.critical_ratio = share, constant, critical_ratio
        self.state = np.zeros(0)

    def loss(self, pressure: np.ndarray) -> np.ndarray:
        """Pressure that the leak takes, in Pa of error of the regulator."""
        return self.share * flow(np.maximum(pressure, 0.0) + ATMOSPHERE, np.array(ATMOSPHERE), self.critical_ratio)

    def settle(self, pressure: np.ndarray) -> np.ndarray:
        low, high = np.zeros_like(pressure), np.array(pressure)
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            above = middle + self.loss(middle) > pressure
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        self.state = np.where(self.share > 0, low, pressure)
        return self.state

    def step(self, pressure: np.ndarray, duration: float) -> np.ndarray:
        before, goal = self.state, (pressure[0] + pressure[1]) / 2 - self.loss(self.state)
        after = goal + (before - goal) * np.exp(-duration / self.constant)
        leaks = self.share > 0
        self.state = np.where(leaks, np.maximum(after, 0.0), pressure[1])
        return np.array([np.where(leaks, before, pressure[0]), self.state])

    def numbers(self) -> Numbers:
        return Numbers("leak", (self.constant, self.critical_ratio), (self.share, self.state))


class RegulatorLeak(Imperfection):
    """Valves or muscles that leak, by actuator name: `share = { 12 = 0.05 }` of the absolute pressure is lost where the leak is choked."""

    of_regulators: ClassVar[bool] = True
    share: dict[str, Annotated[float, require_range(0, 0.5, "of the absolute pressure")]] = Field(default_factory=dict)
    time_s: Annotated[float, require_range(1e-3, 10, "s")] = 2e-3
    critical_ratio: Annotated[float, require_range(0, 0.6, "")] = 0.3

    def pressure_stage(self, robot: Robot) -> PressureStage | None:
        share = of_actuators(self.share, Layout.from_robot(robot), "regulator_leak: share")
        return Leak(share, self.time_s, self.critical_ratio) if share.any() else None
