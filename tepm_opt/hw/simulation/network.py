"""Base of both engines' networks: nodes in the base frame, and what is seen of them."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from tepm_opt.hw.simulation.imperfections.base import Body


class Network(ABC):
    """A network that moves; base frame, SI.

    Args:
        body: the network in numbers.
        step: of RK4 in s.

    Attributes:
        rest: nodes at rest, (n + 1, actuators, 3) in m.
        count: of all modules' actuators.
        bound: the farthest in m that a node can be from its rest if the simulation has not diverged.
    """

    def __init__(self, body: Body, step: float) -> None:
        self.body, self.step, self.layout = body, step, body.layout
        self.rest = body.layout.rest_positions(body.robot.parameters.r, body.robot.parameters.L_0)
        self.count = self.layout.modules * self.layout.actuators
        self.bound = 100 * body.robot.parameters.L_0
        self.turn = body.robot.mount.rotation
        self.base = np.array(body.robot.mount.base_position_m, dtype=float)
        muscles = np.arange(self.count).reshape(self.layout.modules, 1, -1)
        self._muscle = np.repeat(muscles, self.layout.segments, axis=1).reshape(self.layout.levels, -1)

    @property
    @abstractmethod
    def nodes(self) -> np.ndarray:
        """All nodes, (n + 1, actuators, 3) in m."""

    @property
    @abstractmethod
    def velocities(self) -> np.ndarray:
        """Velocities of all nodes, (n + 1, actuators, 3) in m/s."""

    @abstractmethod
    def place(self, position: np.ndarray) -> None:
        """Put the free nodes where they stand still, (3 n actuators,) in m from rest."""

    @abstractmethod
    def load(self, forces: np.ndarray) -> None:
        """Set the forces on the reference points in G, (points, 3) in N; the body's constant load is added.

        The nodes of a point's levels share its force; the base takes what falls on level 0.
        """

    @abstractmethod
    def forces_at_rest(self, positions: np.ndarray, push: np.ndarray) -> np.ndarray:
        """Net forces on all free coordinates, (places, 3 n actuators) in N, where the network stands still.

        Args:
            positions: displacements from the rest geometry, (places, 3 n actuators) in m.
            push: of the motors along the vertical edges, (places, n, actuators) in N.
        """

    def push(self, axial: np.ndarray, edges: np.ndarray | None) -> np.ndarray:
        """Force of every motor, (…, n, actuators) in N.

        Args:
            axial: F_a of the actuators, (…, modules · actuators) in N.
            edges: forces that push the vertical edges apart besides, (…, n, actuators) in N.
        """
        push = axial[..., self._muscle]
        return push if edges is None else push + edges

    def lengths(self, positions: np.ndarray) -> np.ndarray:
        """Lengths of the vertical edges, (…, n, actuators) in m, at displacements (…, 3 n actuators) in m from the rest geometry."""
        return np.linalg.norm(np.diff(self.place_nodes(positions), axis=-3), axis=-1)

    def place_nodes(self, positions: np.ndarray) -> np.ndarray:
        """Place all nodes, (…, n + 1, actuators, 3) in m, at displacements (…, 3 n actuators) in m from the rest geometry."""
        nodes = np.broadcast_to(self.rest, (*positions.shape[:-1], *self.rest.shape)).copy()
        nodes[..., 1:, :, :] += positions.reshape(*positions.shape[:-1], self.layout.levels, -1, 3)
        return nodes

    def tip(self, nodes: np.ndarray) -> np.ndarray:
        """The tip in G, (…, 3) in m, of nodes (…, n + 1, actuators, 3)."""
        return self.in_tracker_frame(np.einsum("j,...jik->...k", self.layout.point_weights[-1] / self.layout.actuators, nodes))

    def at_tip(self, force: np.ndarray) -> np.ndarray:
        """Forces on all free coordinates, (…, 3 n actuators) in N, of a force on the tip in G, (…, 3)."""
        weights = np.repeat(self.layout.point_weights[-1, 1:] / self.layout.actuators, self.layout.actuators)
        return (weights[:, None] * (force @ self.turn)[..., None, :]).reshape(*force.shape[:-1], -1)

    def verticals(self) -> tuple[np.ndarray, np.ndarray]:
        """Lengths and rates of the vertical edges, (n, actuators) each in m and m/s."""
        span, motion = np.diff(self.nodes, axis=0), np.diff(self.velocities, axis=0)
        length = np.sqrt(np.einsum("jik,jik->ji", span, span))
        return length, np.einsum("jik,jik->ji", span, motion) / length

    def of_actuators(self, edges: np.ndarray) -> np.ndarray:
        """Sums over the vertical edges (…, n, actuators) of each actuator, (…, modules · actuators)."""
        layout = self.layout
        return edges.reshape(*edges.shape[:-2], layout.modules, layout.segments, -1).sum(axis=-2).reshape(*edges.shape[:-2], -1)

    def points(self, nodes: np.ndarray) -> np.ndarray:
        """Reference points in the frame G of nodes in the base frame, (points, 3) in m."""
        return self.in_tracker_frame(self.layout.point_weights @ nodes.mean(axis=1))

    def in_tracker_frame(self, positions: np.ndarray) -> np.ndarray:
        """Positions (…, 3) in m from the base frame to G."""
        return positions @ self.turn.T + self.base
