"""Imperfections between the pressure set point and the force of the muscle."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from tepm_opt.data.documents import require_range
from tepm_opt.hw.simulation.imperfections.base import Imperfection, Numbers, PressureStage, StaticMap, of_actuators
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot


class UnequalLag:
    """First-order lag that fills and exhausts with different time constants (s); exact for set points linear in the tick."""

    def __init__(self, fill: float, exhaust: float) -> None:
        self.fill, self.exhaust = max(fill, 1e-9), max(exhaust, 1e-9)
        self.state = np.zeros(0)

    def settle(self, pressure: np.ndarray) -> np.ndarray:
        self.state = np.array(pressure)
        return self.state

    def step(self, pressure: np.ndarray, duration: float) -> np.ndarray:
        before = self.state
        constant = np.where(pressure[0] + pressure[1] > 2 * before, self.fill, self.exhaust)
        behind = (pressure[1] - pressure[0]) / duration * constant
        self.state = pressure[1] - behind + (before - pressure[0] + behind) * np.exp(-duration / constant)
        return np.array([before, self.state])

    def numbers(self) -> Numbers:
        return Numbers("unequal_lag", (self.fill, self.exhaust), (self.state,))


class RegulatorLag(Imperfection):
    """The regulator fills and empties the muscle with time constants of their own."""

    of_one_actuator: ClassVar[bool] = True
    of_devices: ClassVar[bool] = True
    of_regulators: ClassVar[bool] = True
    fill_s: Annotated[float, require_range(0, 30, "s")] = 0.0
    exhaust_s: Annotated[float, require_range(0, 30, "s")] = 0.0

    def pressure_stage(self, robot: Robot) -> PressureStage:
        return UnequalLag(self.fill_s, self.exhaust_s)


class PressureDeadZone(Imperfection):
    """Softplus: p_eff = s ln(1 + exp((p − p_0) / s)), shifted to be zero at zero pressure; the bladder has to be pressed on."""

    of_one_actuator: ClassVar[bool] = True
    threshold_Pa: Annotated[float, require_range(0, 1e6, "Pa")] = 0.0
    softness_Pa: Annotated[float, require_range(1, 1e6, "Pa")] = 3e3

    def pressure_stage(self, robot: Robot) -> PressureStage:
        def soft(pressure: np.ndarray | float) -> np.ndarray:
            return self.softness_Pa * np.logaddexp(0.0, (pressure - self.threshold_Pa) / self.softness_Pa)

        return StaticMap(lambda pressure: soft(pressure) - soft(0.0), Numbers("soft_zone", (self.threshold_Pa, self.softness_Pa)))


class PlayStack:
    """Prandtl–Ishlinskii: the mean of play operators of rising radius; settles as if filled from zero.

    Attributes:
        below, above: how far the operators stay below a rising and above a falling pressure, (operators, 1) in Pa each.
        state: of the operators, (operators, modules · actuators) in Pa.
    """

    def __init__(self, below: np.ndarray, above: np.ndarray) -> None:
        self.below, self.above = below[:, None], above[:, None]
        self.state = np.zeros((len(below), 0))

    def settle(self, pressure: np.ndarray) -> np.ndarray:
        self.state = np.maximum(pressure - self.below, 0.0)
        return self.state.mean(axis=0)

    def step(self, pressure: np.ndarray, duration: float) -> np.ndarray:
        out = []
        for value in pressure:
            self.state = np.minimum(np.maximum(self.state, value - self.below), value + self.above)
            out.append(self.state.mean(axis=0))
        return np.array(out)

    def numbers(self) -> Numbers:
        return Numbers("play_stack", (*self.below[:, 0], *self.above[:, 0]), (self.state,), len(self.below))


class PressureHysteresis(Imperfection):
    """Stacked play operators; `width_Pa` is the full width of a large loop along the pressure axis.

    With an `asymmetry` above 0 more of it lies on the way up: force stays further below a rising than above a falling pressure.
    """

    of_one_actuator: ClassVar[bool] = True
    width_Pa: Annotated[float, require_range(0, 1e6, "Pa")] = 0.0
    asymmetry: Annotated[float, require_range(-1, 1, "")] = 0.0
    operators: Annotated[int, Field(strict=True, ge=1, le=20, description="1 … 20")] = 4

    def pressure_stage(self, robot: Robot) -> PressureStage:
        steps = np.arange(1, self.operators + 1)
        radii = self.width_Pa / 2 * steps / steps.mean()
        return PlayStack((1 + self.asymmetry) * radii, (1 - self.asymmetry) * radii)


class PressureCrosstalk(Imperfection):
    """A muscle is squeezed by the two beside it, more than in proportion to their pressure.

    p_i gains share · p_max · Σ (p_j / p_max) ** exponent over the neighbours j in the ring of its module.
    """

    share: Annotated[float, require_range(-0.5, 0.5, "of the neighbour's pressure")] = 0.0
    exponent: Annotated[float, require_range(0.5, 3, "")] = 1.2

    def pressure_stage(self, robot: Robot) -> PressureStage:
        largest, order = robot.actuation.pressure_max_Pa, np.argsort(np.mod(robot.angles, 2 * np.pi))
        ring = np.zeros((robot.actuators, robot.actuators))
        for here, beside in zip(order, np.roll(order, 1), strict=True):
            ring[here, beside] = ring[beside, here] = 1.0
        mixing = np.kron(np.eye(robot.modules), ring)

        def squeeze(pressure: np.ndarray) -> np.ndarray:
            return pressure + self.share * largest * (np.maximum(pressure, 0) / largest) ** self.exponent @ mixing

        return StaticMap(squeeze, Numbers("squeeze", (self.share, largest, self.exponent), (mixing,)))


class ActuatorGain(Imperfection):
    """Muscles of smaller (loss above zero) or larger area than the others, by actuator name: `loss = { 13 = 0.06 }`."""

    loss: dict[str, Annotated[float, require_range(-1, 1, "of the pressure's force")]] = Field(default_factory=dict)

    def pressure_stage(self, robot: Robot) -> PressureStage:
        factor = 1 - of_actuators(self.loss, Layout.from_robot(robot), "actuator_gain: loss")
        return StaticMap(lambda pressure: pressure * factor, Numbers("gain", channels=(factor,)))
