"""Nodes and their joints: the geometry of the network (SPEC section 2), numbers only."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from tepm_opt.models.robot import Robot

VERTICAL, HORIZONTAL, DIAGONAL = "vertical", "horizontal", "diagonal"


@dataclass(frozen=True)
class Edge:
    """One edge of a segment between node `a` and node `b`; 0 is the segment's lower level, 1 its upper one."""

    kind: str
    a: tuple[int, int]  # (level 0 or 1, node)
    b: tuple[int, int]


@dataclass(frozen=True)
class Layout:
    """The network as a chain of equal segments between levels 0 (fixed) … n."""

    modules: int
    actuators: int
    segments: int  # per module, n_e
    angles: tuple[float, ...]  # rad
    crossed: bool
    guided: bool = False  # plates slide on rails along the base axis

    @staticmethod
    def from_robot(robot: Robot) -> Layout:
        """The layout of a robot."""
        geometry = robot.geometry
        crossed = geometry.bracing == "crossed"
        return Layout(robot.modules, robot.actuators, geometry.segments_per_module, tuple(robot.angles), crossed, geometry.guide)

    @property
    def levels(self) -> int:
        """Number of free levels n."""
        return self.modules * self.segments

    @property
    def block(self) -> int:
        """Coordinates per level, the size of a block of the stiffness matrix."""
        return 3 * self.actuators

    @property
    def inputs(self) -> int:
        """Length of u: all pressures, then all tensions, module-major."""
        return 2 * self.modules * self.actuators

    @property
    def points(self) -> int:
        """Number of reference points s_1 … : two a module, the last one is the tip."""
        return 2 * self.modules

    @cached_property
    def edges(self) -> tuple[Edge, ...]:
        """The edges of one segment: verticals (actuators, in order), horizontals of its upper level, diagonals of its faces.

        Three actuators make a ring; with more, every pair of nodes of a level is joined (a bare ring can lozenge).
        """
        count = self.actuators
        around = [int(k) for k in np.argsort(np.mod(self.angles, 2 * np.pi))]
        faces = list(zip(around, around[1:] + around[:1], strict=True))
        vertical = [Edge(VERTICAL, (0, i), (1, i)) for i in range(count)]
        horizontal = [Edge(HORIZONTAL, (1, i), (1, j)) for i, j in combinations(range(count), 2)]
        diagonal = [Edge(DIAGONAL, (0, i), (1, j)) for i, j in faces]
        if self.crossed:
            diagonal += [Edge(DIAGONAL, (0, j), (1, i)) for i, j in faces]
        return tuple(vertical + horizontal + diagonal)

    @cached_property
    def point_weights(self) -> np.ndarray:
        """Weights (points, n + 1) of the levels' centroids in each reference point, at half and full height of each module.

        For odd n_e the half height lies between two levels and takes half of each.
        """
        weights = np.zeros((self.points, self.levels + 1))
        for point in range(self.points):
            height = (point + 1) * self.segments / 2
            weights[point, int(np.floor(height))] += 0.5
            weights[point, int(np.ceil(height))] += 0.5
        return weights

    @cached_property
    def actuator_names(self) -> tuple[str, ...]:
        """`hj` of every actuator, module-major: "11", "12", … ; with two-digit numbers separated by an underscore."""
        separator = "_" if max(self.modules, self.actuators) > 9 else ""
        return tuple(f"{h + 1}{separator}{j + 1}" for h in range(self.modules) for j in range(self.actuators))

    @cached_property
    def point_names(self) -> tuple[str, ...]:
        """Names of the reference points: "s1", "s2", …"""
        return tuple(f"s{i + 1}" for i in range(self.points))

    def details(self, kind: str | None) -> tuple[str, ...]:
        """Names that the detail of an effect can have: actuators, points, or nothing where the effect has no detail.

        Args:
            kind: "actuator", "point" or None, as `Effect.detail` has it.
        """
        return {"actuator": self.actuator_names, "point": self.point_names, None: ()}[kind]

    def rest_positions(self, radius: float, length: float) -> np.ndarray:
        """Nodes at rest in the base frame, shape (n + 1, actuators, 3) in m, for a radius and a module length in m."""
        angles, heights = np.array(self.angles), np.arange(self.levels + 1) * length / self.segments
        ring = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.zeros_like(angles)], axis=-1)
        return ring[None] + heights[:, None, None] * np.array([0.0, 0.0, 1.0])

    def run_through(self, levels: np.ndarray) -> np.ndarray:
        """Whether plates on a guide have run through the base or through each other, (…,).

        An edge knows its length only, so that a network pulls on beyond that as if it were a mirror.

        Args:
            levels: levels 0 … n in the base frame, (…, n + 1, block) in m.
        """
        if not self.guided:
            return np.zeros(levels.shape[:-2], dtype=bool)
        return np.asarray((np.diff(levels[..., 2::3], axis=-2) <= 0).any(axis=(-2, -1)))
