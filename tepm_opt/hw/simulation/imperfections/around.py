"""Surroundings that the tip meets (foreign to SPEC section 5): a wall, a hose tied to it, drag. Places and forces are in the frame G."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from tepm_opt.data.documents import Number, require_range
from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.imperfections.base import Imperfection, Numbers, TipStage
from tepm_opt.hw.simulation.imperfections.body import Vector
from tepm_opt.models.robot import Robot

Place = Annotated[tuple[Number, Number, Number], Field(description="three numbers in m")]


class Wall:
    """A plane that pushes along its normal what is behind it: a spring, and a damper that does not pull.

    Args:
        place: of the plane, (3,) in m.
        normal: to the free side, of length 1, (3,).
        stiffness: in N/m.
        damping: in N s/m.
    """

    def __init__(self, place: np.ndarray, normal: np.ndarray, stiffness: float, damping: float) -> None:
        self.place, self.normal, self.stiffness, self.damping = place, normal, stiffness, damping

    def force(self, place: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        depth = -((place - self.place) @ self.normal)
        push = np.maximum(self.stiffness * depth - self.damping * (velocity @ self.normal), 0.0) * (depth > 0)
        return push[..., None] * self.normal

    def numbers(self) -> Numbers:
        return Numbers("wall", (*self.place, *self.normal, self.stiffness, self.damping))


class TipWall(Imperfection):
    """The tip cannot go far beyond a plane through `place_m`; `normal` points to the free side."""

    stiffness_N_per_m: Annotated[float, require_range(0, 2000, "N/m")] = 0.0
    damping_N_s_per_m: Annotated[float, require_range(0, 10, "N s/m")] = 1.0
    place_m: Place = (0.1, 0.0, 0.3)
    normal: Vector = (-1.0, 0.0, 0.0)

    def tip_stage(self, robot: Robot) -> TipStage:
        normal = np.array(self.normal)
        size = float(np.linalg.norm(normal))
        if size == 0:
            raise InputError("tip_wall: normal = [0, 0, 0]; valid: a direction")
        return Wall(np.array(self.place_m), normal / size, self.stiffness_N_per_m, self.damping_N_s_per_m)


class Tether:
    """A spring to a place, without a length of its own."""

    def __init__(self, place: np.ndarray, stiffness: float) -> None:
        self.place, self.stiffness = place, stiffness

    def force(self, place: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        return self.stiffness * (self.place - place)

    def numbers(self) -> Numbers:
        return Numbers("tether", (*self.place, self.stiffness))


class TetheredTip(Imperfection):
    """A hose that pulls the tip to where it is tied, like a spring."""

    stiffness_N_per_m: Annotated[float, require_range(0, 200, "N/m")] = 0.0
    place_m: Place = (0.0, 0.0, 0.35)

    def tip_stage(self, robot: Robot) -> TipStage:
        return Tether(np.array(self.place_m), self.stiffness_N_per_m)


class Drag:
    """A force against the velocity, with its square."""

    def __init__(self, size: float) -> None:
        self.size = size

    def force(self, place: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        return -self.size * np.linalg.norm(velocity, axis=-1, keepdims=True) * velocity

    def numbers(self) -> Numbers:
        return Numbers("drag", (self.size,))


class TipDrag(Imperfection):
    """A tool at the tip that is dragged through air or water."""

    size_N_s2_per_m2: Annotated[float, require_range(0, 20, "N s²/m²")] = 0.0

    def tip_stage(self, robot: Robot) -> TipStage:
        return Drag(self.size_N_s2_per_m2)
