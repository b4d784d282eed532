"""Actuators that are not alike: rest lengths, zeros and gains of single ones or of all."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from tepm_opt.data.documents import require_range
from tepm_opt.hw.simulation.imperfections.base import Body, Imperfection, Numbers, PressureStage, StaticMap, TensionStage, of_actuators
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot


def lengthen(body: Body, lengths: np.ndarray) -> None:
    """Add lengths (modules · actuators,) in m to the rest lengths of the muscles, in place."""
    layout = body.layout
    each = lengths.reshape(layout.modules, layout.actuators) / layout.segments
    body.rest[:, body.verticals] += np.repeat(each, layout.segments, axis=0)


class ActuatorOffset(Imperfection):
    """Muscles whose rest length or whose regulator's zero is off, by actuator name: `length_m = { 13 = 0.003 }`."""

    of_regulators: ClassVar[bool] = True
    length_m: dict[str, Annotated[float, require_range(-0.05, 0.05, "m")]] = Field(default_factory=dict)
    zero_Pa: dict[str, Annotated[float, require_range(-1e5, 1e5, "Pa")]] = Field(default_factory=dict)

    def change_body(self, body: Body) -> None:
        lengthen(body, of_actuators(self.length_m, body.layout, "actuator_offset: length_m"))

    def pressure_stage(self, robot: Robot) -> PressureStage | None:
        return shift_zeros(of_actuators(self.zero_Pa, Layout.from_robot(robot), "actuator_offset: zero_Pa")) if self.zero_Pa else None


def shift_zeros(zero: np.ndarray) -> StaticMap:
    """Make a map that adds zeros (modules · actuators,) in Pa to pressures."""
    return StaticMap(lambda pressure: pressure + zero, Numbers("shift", channels=(zero,)))


class ActuatorScatter(Imperfection):
    """Muscles of areas and rest lengths drawn at random, normal with these spreads; `draw` says which ones."""

    area_spread: Annotated[float, require_range(0, 0.5, "of the area")] = 0.0
    length_spread_m: Annotated[float, require_range(0, 0.05, "m")] = 0.0
    draw: Annotated[int, Field(strict=True, ge=0)] = 0

    def draw_scatter(self, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
        """Draw areas over the nominal one and lengths in m more, (modules · actuators,) each."""
        random = np.random.default_rng([self.draw, 2])
        area, length = random.standard_normal((2, layout.modules * layout.actuators))
        return 1 + self.area_spread * area, self.length_spread_m * length

    def change_body(self, body: Body) -> None:
        lengthen(body, self.draw_scatter(body.layout)[1])

    def pressure_stage(self, robot: Robot) -> PressureStage | None:
        area, _ = self.draw_scatter(Layout.from_robot(robot))
        return StaticMap(lambda pressure: pressure * area, Numbers("gain", channels=(area,))) if self.area_spread else None


class LoadCell:
    """Tension kept by a motor that believes a bent and shifted scale: λ (1 − loss) + bend λ (1 − λ / largest) + zero, never below 0.

    Args:
        loss: of the tendons, (modules · actuators,); those without one have a scale that does not bend.
        zero: of the tendons, (modules · actuators,) in N.
        bend: of the scale.
        largest: tension in N at which the scale is right again.
    """

    def __init__(self, loss: np.ndarray, zero: np.ndarray, bend: float, largest: float) -> None:
        self.loss, self.zero, self.bend, self.largest = loss, zero, bend, largest

    def settle(self, tension: np.ndarray, length: np.ndarray) -> np.ndarray:
        bent = self.bend * tension * (1 - tension / self.largest) * (self.loss != 0)
        return np.maximum(tension * (1 - self.loss) + bent + self.zero, 0.0)

    def step(self, tension: np.ndarray, length: np.ndarray, rate: np.ndarray, duration: float) -> np.ndarray:
        return self.settle(tension, length)

    def numbers(self) -> Numbers:
        return Numbers("load_cell", (self.bend, self.largest), (self.loss, self.zero))


class TensionGain(Imperfection):
    """Dynamometers of single tendons that show too much (loss above zero) or too little, by actuator name, on a scale that bends."""

    loss: dict[str, Annotated[float, require_range(-1, 1, "of the tension")]] = Field(default_factory=dict)
    zero_N: dict[str, Annotated[float, require_range(-5, 5, "N")]] = Field(default_factory=dict)
    bend: Annotated[float, require_range(-0.2, 0.2, "of the tension")] = 0.0

    def tension_stage(self, robot: Robot) -> TensionStage:
        layout, largest = Layout.from_robot(robot), float(robot.actuation.tension_max_N)
        loss, zero = of_actuators(self.loss, layout, "tension_gain: loss"), of_actuators(self.zero_N, layout, "tension_gain: zero_N")
        return LoadCell(loss, zero, self.bend, largest)
