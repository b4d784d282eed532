"""Imperfections of the muscle itself: forces along its vertical edges besides spring and damper."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, model_validator

from tepm_opt.data.documents import require_range
from tepm_opt.hw.simulation.imperfections.base import Body, EdgeStage, Imperfection, Numbers
from tepm_opt.hw.simulation.imperfections.lugre import LuGre

_LARGEST_STRAIN = 0.4  # of a muscle, for the choice of the tick; the paper's reach 0.35


class Bristles:
    """LuGre friction in all vertical edges: of one size, and in proportion to the pull of their springs.

    Args:
        friction: its state, (n, actuators).
        sliding: friction force while sliding that is always there, in N.
        share: what comes on top of it, by stretch, (n, actuators) in N/m.
        rest: rest lengths, (n, actuators) in m.
    """

    def __init__(self, friction: LuGre, sliding: float, share: np.ndarray, rest: np.ndarray) -> None:
        self.friction, self.sliding, self.share, self.rest = friction, sliding, share, rest

    def settle(self, length: np.ndarray) -> np.ndarray:
        return self.friction.settle()

    def step(self, length: np.ndarray, rate: np.ndarray, duration: float) -> np.ndarray:
        return -self.friction.step(rate, self.sliding + self.share * np.abs(length - self.rest), duration)

    def numbers(self) -> Numbers:
        return Numbers("bristles", (*self.friction.scalars, self.sliding), (self.share, self.rest, self.friction.bend))


class StructuralFriction(Imperfection):
    """Dry friction of the muscles on each other, on plates and on holders: LuGre with presliding in every vertical edge.

    A part of it is always there (`sliding_N`), a part grows with the elastic force that presses sheath, plates and holders together
    (`share` of it), so that it vanishes where the muscle is at rest.
    """

    of_one_actuator: ClassVar[bool] = True
    sliding_N: Annotated[float, require_range(0, 100, "N")] = 0.0
    share: Annotated[float, require_range(0, 0.9, "of the elastic force")] = 0.0
    breakaway_ratio: Annotated[float, require_range(1, 5, "of the sliding friction")] = 1.0
    stribeck_m_per_s: Annotated[float, require_range(1e-6, 1, "m/s")] = 1e-3
    bristle_stiffness_N_per_m: Annotated[float, require_range(10, 1e5, "N/m")] = 5000.0
    bristle_damping_N_s_per_m: Annotated[float, require_range(0, 10, "N s/m")] = 2.0

    def longest_tick(self, body: Body) -> float:
        return body.damping[:, body.verticals].min() / self.bristle_stiffness_N_per_m

    def edge_stage(self, body: Body) -> EdgeStage:
        shape = (body.layout.levels, body.layout.actuators)
        bristles = (self.bristle_stiffness_N_per_m, self.bristle_damping_N_s_per_m, self.breakaway_ratio, self.stribeck_m_per_s)
        vertical = body.verticals
        return Bristles(LuGre(shape, *bristles), self.sliding_N, self.share * body.stiffness[:, vertical], body.rest[:, vertical])


class Prony:
    """Maxwell branches beside the spring; each is advanced exactly for a constant rate.

    Attributes:
        force: pull of the branches, (branches, n, actuators) in N.
    """

    def __init__(self, stiffness: np.ndarray, constants: np.ndarray) -> None:
        self.stiffness, self.constants = stiffness, constants[:, None, None]
        self.force = np.zeros((len(constants), *stiffness.shape[1:]))

    def settle(self, length: np.ndarray) -> np.ndarray:
        self.force = np.zeros_like(self.force)
        return self.force.sum(axis=0)

    def step(self, length: np.ndarray, rate: np.ndarray, duration: float) -> np.ndarray:
        before, kept = self.force, np.exp(-duration / self.constants)
        self.force = before * kept + self.stiffness * self.constants * rate * (1 - kept)
        return -np.array([before.sum(axis=0), self.force.sum(axis=0)])

    def numbers(self) -> Numbers:
        return Numbers("prony", tuple(self.constants.ravel()), (self.stiffness[0], self.force), len(self.force))


class Creep(Imperfection):
    """Viscoelastic muscle: a Prony series whose branches, equally strong and spread over decades, creep nearly with the logarithm of time.

    At once a muscle is (1 + `fraction`) as stiff as in the long run.
    """

    of_one_actuator: ClassVar[bool] = True
    fraction: Annotated[float, require_range(0, 5, "of the stiffness")] = 0.0
    time_constants_s: Annotated[
        tuple[Annotated[float, require_range(1e-3, 1e4, "s")], ...], Field(min_length=1, max_length=8, description="1 … 8 time constants")
    ] = (0.4, 2.5, 15.0)

    def longest_tick(self, body: Body) -> float:
        return body.damping[:, body.verticals].min() / max(self.fraction * body.stiffness[:, body.verticals].max(), 1e-9)

    def edge_stage(self, body: Body) -> EdgeStage:
        share = self.fraction / len(self.time_constants_s)
        stiffness = np.repeat(share * body.stiffness[None, :, body.verticals], len(self.time_constants_s), axis=0)
        return Prony(stiffness, np.array(self.time_constants_s))


class Exponential:
    """Force that an exponential law adds to a linear spring when stretched: k ℓ_0 ((exp(b ε) − 1) / b − ε)."""

    def __init__(self, stiffness: np.ndarray, rest: np.ndarray, growth: float) -> None:
        self.stiffness, self.rest, self.growth = stiffness, rest, growth

    def settle(self, length: np.ndarray) -> np.ndarray:
        strain = np.maximum(length / self.rest - 1, 0.0)
        return -self.stiffness * self.rest * (np.expm1(self.growth * strain) / self.growth - strain)

    def step(self, length: np.ndarray, rate: np.ndarray, duration: float) -> np.ndarray:
        return self.settle(np.array([length, length + rate * duration]))

    def numbers(self) -> Numbers:
        return Numbers("exponential", (self.growth,), (self.stiffness, self.rest))


class StiffnessHardening(Imperfection):
    """Stiffness that grows as exp(growth · strain) with the stretch (Fung's law), not with compression."""

    of_one_actuator: ClassVar[bool] = True
    growth: Annotated[float, require_range(0, 20, "a unit of strain")] = 0.0

    @model_validator(mode="after")
    def _not_tiny(self) -> StiffnessHardening:
        if 0 < self.growth < 1e-6:
            raise ValueError("growth is too small to matter; valid: 0, or 1e-6 … 20")
        return self

    def longest_tick(self, body: Body) -> float:
        added = body.stiffness[:, body.verticals].max() * np.expm1(self.growth * _LARGEST_STRAIN)
        return body.damping[:, body.verticals].min() / added

    def edge_stage(self, body: Body) -> EdgeStage:
        return Exponential(body.stiffness[:, body.verticals], body.rest[:, body.verticals], self.growth)
