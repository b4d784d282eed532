"""Imperfections between the tendon's motor and the tendon's end."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np

from tepm_opt.data.documents import require_range
from tepm_opt.hw.simulation.imperfections.base import Body, Imperfection, Numbers, TensionStage
from tepm_opt.hw.simulation.imperfections.lugre import LuGre
from tepm_opt.models.robot import Robot


class TakeUp:
    """λ − k · (slack left), where lengthening of the actuator takes the slack up; never below zero."""

    def __init__(self, slack: float, stiffness: float, rest: float) -> None:
        self.slack, self.stiffness, self.rest = slack, stiffness, rest

    def settle(self, tension: np.ndarray, length: np.ndarray) -> np.ndarray:
        left = np.maximum(self.slack - (length - self.rest), 0.0)
        return np.maximum(tension - self.stiffness * left, 0.0)

    def step(self, tension: np.ndarray, length: np.ndarray, rate: np.ndarray, duration: float) -> np.ndarray:
        return self.settle(tension, np.array([length, length + rate * duration]))

    def numbers(self) -> Numbers:
        return Numbers("take_up", (self.slack, self.stiffness, self.rest))


class TendonSlack(Imperfection):
    """A tendon too long by `length_m` at the actuator's rest length, wound up by a motor that measures behind a spring.

    The motor's elastic stroke (tension over `winding_stiffness_N_per_m`) first takes up the slack that the actuator's lengthening leaves.
    """

    of_one_actuator: ClassVar[bool] = True
    length_m: Annotated[float, require_range(0, 0.5, "m")] = 0.0
    winding_stiffness_N_per_m: Annotated[float, require_range(1, 1e5, "N/m")] = 250.0

    def longest_tick(self, body: Body) -> float:
        return body.robot.parameters.c_a / self.winding_stiffness_N_per_m

    def tension_stage(self, robot: Robot) -> TensionStage:
        return TakeUp(self.length_m, self.winding_stiffness_N_per_m, robot.parameters.L_0)


class Sheath:
    """LuGre friction along the tendon: more tension at its end while the muscle draws it out, less while it is wound in.

    Args:
        count: number of actuators.
        constant: friction at any tension in N.
        share: friction over tension.
        bristles: stiffness of the bristles in N/m.
    """

    def __init__(self, count: int, constant: float, share: float, bristles: float) -> None:
        self.constant, self.share = constant, share
        self.friction = LuGre((count,), bristles)

    def settle(self, tension: np.ndarray, length: np.ndarray) -> np.ndarray:
        self.friction.settle()
        return tension

    def step(self, tension: np.ndarray, length: np.ndarray, rate: np.ndarray, duration: float) -> np.ndarray:
        drag = self.friction.step(rate, self.constant + self.share * tension[1], duration)
        return np.maximum(tension + drag, 0.0)

    def numbers(self) -> Numbers:
        return Numbers("sheath", (self.constant, self.share, *self.friction.scalars), (self.friction.bend,))


class TendonFriction(Imperfection):
    """Gasket (constant) and guides (in proportion to the tension) between motor and end; a tendon cannot push."""

    of_one_actuator: ClassVar[bool] = True
    constant_N: Annotated[float, require_range(0, 100, "N")] = 0.0
    share: Annotated[float, require_range(0, 0.9, "of the tension")] = 0.0
    bristle_stiffness_N_per_m: Annotated[float, require_range(10, 1e5, "N/m")] = 1500.0

    def longest_tick(self, body: Body) -> float:
        return body.robot.parameters.c_a / self.bristle_stiffness_N_per_m

    def tension_stage(self, robot: Robot) -> TensionStage:
        return Sheath(robot.modules * robot.actuators, self.constant_N, self.share, self.bristle_stiffness_N_per_m)
