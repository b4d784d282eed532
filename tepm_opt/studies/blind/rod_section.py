"""A cross-section of a Cosserat rod that stands for the network: its strain energy, of which the network's unit cell decides.

A unit cell is a segment between two rings. Its energy is that of a long network of uniform strain, whose rings deform as they like.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement, permutations, product
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from tepm_opt.hw.simulation.imperfections.base import Body

STRETCHES = 1.1 + 0.25 * np.cos(np.pi * (np.arange(9) + 0.5) / 9)  # at which the law is fitted: Chebyshev's nodes
DEGREE = 4  # of its polynomials, which err by less than 1e-4
STEPS = np.array([0.01] * 3 + [0.1] * 3)  # of numerical derivatives: shear, stretch, and curvatures in 1/m
WIDE = np.array([0.02] * 3 + [0.3] * 3)  # of third ones
ITERATIONS = 12  # of Newton's method for a ring, of which three or four are needed
SMALLEST = 1e-15  # m, step of Newton's method that ends it
AT_REST = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
"""Strain of the straight network: two shears, the stretch ratio, two bending curvatures and the twist in 1/m."""


class SectionLaw(NamedTuple):
    """Elastic law of a section in arrays, as compiled code takes them.

    Attributes:
        stiffness: polynomials in the elongation (stretch - 1), highest power first, (4, powers): shear and secant axial stiffness in N,
            bending and torsional stiffness in N m².
        third: third derivatives of the energy per length by strains, (6, 6, 6); N and m.
    """

    stiffness: np.ndarray
    third: np.ndarray


@dataclass(frozen=True, eq=False)
class UnitCell:
    """A segment of the network.

    Attributes:
        height: of the segment at rest in m.
        ring: nodes of a ring at rest around its centre, (nodes, 3) in m.
        starts, ends: level (0 or 1) and node of the edges, (edges, 2).
        stiffness, rest: of the edges, (edges,) in N/m and m.
    """

    height: float
    ring: np.ndarray
    starts: np.ndarray
    ends: np.ndarray
    stiffness: np.ndarray
    rest: np.ndarray

    @staticmethod
    def from_body(body: Body) -> UnitCell:
        """Take the second segment of a network in numbers, which no imperfection of its ends changes."""
        layout, value = body.layout, body.robot.parameters
        starts, ends = (np.array([getattr(edge, end) for edge in layout.edges]) for end in ("a", "b"))
        ring = layout.rest_positions(value.r, value.L_0)[0]
        return UnitCell(value.L_0 / layout.segments, ring, starts, ends, body.stiffness[1], body.rest[1])

    def find_energy(self, strain: np.ndarray) -> float:
        """Energy per length at rest in J/m of a strain (6,), see `AT_REST`, with relaxed rings."""
        turn, shift = _relate_rings(self.height, strain)
        modes = _strain_modes(self.ring)
        nodes, moves = (
            np.stack([ring, ring @ turn.T + more]) for ring, more in ((self.ring, shift), (np.moveaxis(modes, 0, 1), np.zeros(3)))
        )
        spans, ways = (of[tuple(self.ends.T)] - of[tuple(self.starts.T)] for of in (nodes, moves))
        amounts = np.zeros(len(modes))
        for _ in range(ITERATIONS):
            along = spans + np.einsum("eqi,q->ei", ways, amounts)
            length = np.linalg.norm(along, axis=1)
            unit, pull = along / length[:, None], self.stiffness * (length - self.rest)
            rates = np.einsum("ei,eqi->eq", unit, ways)
            across = np.einsum("e,eqi,eri->qr", pull / length, ways, ways) - np.einsum("e,eq,er->qr", pull / length, rates, rates)
            step = np.linalg.solve(np.einsum("e,eq,er->qr", self.stiffness, rates, rates) + across, -pull @ rates)
            amounts += step
            if np.abs(step).max() < SMALLEST:
                break
        length = np.linalg.norm(spans + np.einsum("eqi,q->ei", ways, amounts), axis=1)
        return 0.5 * float(self.stiffness @ (length - self.rest) ** 2) / self.height

    def fit_law(self) -> SectionLaw:
        """Elastic law of the section: second derivatives of the energy at all stretches, third ones at rest."""
        found = []
        for stretch in STRETCHES:
            strain = np.array([0.0, 0.0, stretch, 0.0, 0.0, 0.0])
            here = self.find_energy(strain)
            shear, bending, torsion = (2 * (self.find_energy(strain + step) - here) / step.sum() ** 2 for step in np.diag(STEPS)[[0, 3, 5]])
            more, less = (self.find_energy(strain * scale) for scale in (1 + 1e-4, 1 - 1e-4))
            found.append((shear, (more - less) / (2e-4 * stretch * (stretch - 1)), bending, torsion))
        stiffness = np.polyfit(STRETCHES - 1, np.array(found), DEGREE).T
        return SectionLaw(np.ascontiguousarray(stiffness), self._third_derivatives())

    def _third_derivatives(self) -> np.ndarray:
        """Third derivatives of the energy per length at rest, (6, 6, 6)."""
        third, signs = np.zeros((6, 6, 6)), list(product((1, -1), repeat=3))
        for axes in combinations_with_replacement(range(6), 3):
            steps = np.diag(WIDE)[list(axes)]
            total = sum(np.prod(sign) * self.find_energy(AT_REST + sign @ steps) for sign in signs)
            for each in permutations(axes):
                third[each] = total / (8 * np.prod(WIDE[list(axes)]))
        return third


def _relate_rings(height: float, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and place (3,) in m of the next ring in the frame of the one below, for a uniform strain (6,)."""
    screw, (about_x, about_y, about_z) = np.zeros((4, 4)), strain[3:]
    screw[:3, :3] = [[0.0, -about_z, about_y], [about_z, 0.0, -about_x], [-about_y, about_x, 0.0]]
    screw[:3, 3] = strain[:3]
    pose = expm(height * screw)
    return pose[:3, :3], pose[:3, 3]


def _strain_modes(ring: np.ndarray) -> np.ndarray:
    """Orthonormal displacements of a ring's nodes that no rigid motion has, (modes, nodes, 3)."""
    shifts = [np.tile(axis, (len(ring), 1)).ravel() for axis in np.eye(3)]
    turns = [np.cross(axis, ring).ravel() for axis in np.eye(3)]
    return np.linalg.svd(np.array([*shifts, *turns]))[2][6:].reshape(-1, *ring.shape)
