"""Imperfections of the body at rest: masses, plates, gravity and constant loads."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from tepm_opt.data.documents import Number, require_range
from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.imperfections.base import Body, Imperfection
from tepm_opt.models.layout import DIAGONAL, Edge, Layout

Vector = Annotated[tuple[Number, Number, Number], Field(description="three numbers")]
Offset = Annotated[float, require_range(-1, 1, "m")]


class Payload(Imperfection):
    """A mass on the tip plate that can sit beside its centre.

    The tip nodes share it so that its centre of mass is right: with weights 1/m + (the smallest ones that give the moment).
    """

    mass_kg: Annotated[float, require_range(0, 10, "kg")] = 0.0
    eccentricity_m: tuple[Offset, Offset] = (0.0, 0.0)

    def change_body(self, body: Body) -> None:
        ring = body.layout.rest_positions(body.robot.parameters.r, body.robot.parameters.L_0)[0, :, :2]
        moments = np.vstack([np.ones(len(ring)), ring.T])
        shares = np.linalg.pinv(moments) @ np.array([1.0, *self.eccentricity_m])
        body.mass[-1] += self.mass_kg * shares
        if body.mass[-1].min() <= 0:
            raise InputError(f"payload: eccentricity_m = {list(self.eccentricity_m)} lies outside the tip plate")


class MassDistribution(Imperfection):
    """Part of each module's mass sits in its end plate and, of that, a share in the holders at half height.

    With one segment a module the base carries half of the first module's holders.
    """

    fraction: Annotated[float, require_range(0, 0.95, "of the module's mass")] = 0.0
    holder_share: Annotated[float, require_range(0, 1, "of the fraction")] = 0.0

    def change_body(self, body: Body) -> None:
        layout = body.layout
        moved = self.fraction * body.robot.parameters.m_d / layout.actuators
        body.mass *= 1 - self.fraction
        half, full = layout.point_weights[0::2, 1:], layout.point_weights[1::2, 1:]
        levels = moved * (self.holder_share * half + (1 - self.holder_share) * full).sum(axis=0)
        body.mass += levels[:, None]


class UnevenMass(Imperfection):
    """Nodes of unequal mass: heavier towards one side and, besides, scattered at random; the total mass stays."""

    fraction: Annotated[float, require_range(-0.9, 0.9, "of a node's mass")] = 0.0
    toward_deg: Annotated[float, require_range(-360, 360, "deg about z")] = 0.0
    scatter: Annotated[float, require_range(0, 0.3, "of a node's mass, 1 sigma")] = 0.0

    def change_body(self, body: Body) -> None:
        side = self.fraction * np.cos(body.robot.angles - np.deg2rad(self.toward_deg))
        drawn = self.scatter * np.clip(np.random.default_rng([body.seed, 17]).normal(size=body.mass.shape), -2.5, 2.5)
        factors = 1 + side + drawn
        if factors.min() <= 0.01:
            raise InputError("uneven_mass: a node would have no mass left; valid: fraction + 2.5 scatter below 0.99")
        body.mass *= factors * (body.mass.sum() / (body.mass * factors).sum())


class RigidPlates(Imperfection):
    """Plates and caps clamp a length of the muscle on each side; only what is left of the segment is elastic.

    A segment of height h with the clamped length d has h / (h − d) of its stiffness, in its vertical and diagonal edges.
    """

    clamped_length_m: Annotated[float, require_range(0, 1, "m")] = 0.0

    def change_body(self, body: Body) -> None:
        layout, height = body.layout, body.robot.parameters.L_0 / body.layout.segments
        clamps = np.zeros(layout.levels)
        clamps[0 :: layout.segments] += 1
        clamps[layout.segments - 1 :: layout.segments] += 1
        free = 1 - clamps * self.clamped_length_m / height
        if free.min() < 0.05:
            raise InputError(f"rigid_plates: clamped_length_m = {self.clamped_length_m:g} leaves nothing of a segment of {height:g} m")
        body.stiffness[:, body.upright] /= free[:, None]


class SoftPart(Imperfection):
    """Some segments are softer than the others, as a worn or a longer braid makes them: all their springs but the plates'.

    Segments count from 1 at the base; those from `first` to `last` lose a part of their stiffness.
    """

    loss: Annotated[float, require_range(-1, 0.9, "of the stiffness")] = 0.0
    first: Annotated[int, Field(strict=True, ge=1, description="1 … number of segments")] = 1
    last: Annotated[int, Field(strict=True, ge=1, description="1 … number of segments")] = 1

    def change_body(self, body: Body) -> None:
        if not self.first <= self.last <= body.layout.levels:
            raise InputError(f"soft_part: segments {self.first} … {self.last}; valid: 1 … {body.layout.levels}, rising")
        body.stiffness[self.first - 1 : self.last, body.upright] *= 1 - self.loss


class TwistedBody(Imperfection):
    """Muscles and braces wound round the body: diagonals of one hand are longer by a part of their length, those of the other shorter."""

    strain: Annotated[float, require_range(-0.2, 0.2, "of the diagonals' length")] = 0.0

    def change_body(self, body: Body) -> None:
        hand = [_hand(edge, body.layout) for edge in body.layout.edges]
        body.rest *= 1 + self.strain * np.array(hand)


def _hand(edge: Edge, layout: Layout) -> float:
    """Sense in which an edge winds round the axis on its way up: 1, −1, or 0 where it is no diagonal."""
    if edge.kind != DIAGONAL:
        return 0.0
    low, high = (layout.angles[node] for _, node in sorted((edge.a, edge.b)))
    return float(np.sign(np.sin(high - low)))


class BaseTilt(Imperfection):
    """The base stands oblique: gravity, seen from the base, is rotated. The tracker is mounted on the base and turns with it."""

    rotation_deg: Annotated[tuple[Number, Number], Field(description="two angles about x and y in deg")] = (0.0, 0.0)

    def change_body(self, body: Body) -> None:
        tilt = Rotation.from_rotvec(np.deg2rad([*self.rotation_deg, 0.0])).as_matrix()
        mount = body.robot.mount.rotation
        body.gravity = mount.T @ tilt.T @ mount @ body.gravity


class ExternalLoad(Imperfection):
    """A constant force on the tip that nobody commanded (hose drag)."""

    force_N: Vector = (0.0, 0.0, 0.0)

    def change_body(self, body: Body) -> None:
        body.load[-1] += self.force_N
