"""The arm beside obstacles: which of its points are watched, where they are, and how near they come.

Watched are the reference points and the centres of the other levels, so that no part of the arm's axis longer than a segment is left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from tepm_opt.control.collision.geometry import Obstacles
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.mechanics.statics import solve_statics

if TYPE_CHECKING:
    from tepm_opt.control.estimation.kalman_filter import StateEstimate
    from tepm_opt.solvers.linear.modal_model import ModalModel
    from tepm_opt.solvers.mechanics.statics import Equilibrium

DISTANCE, TRUE_DISTANCE, OBSTACLE, POINT = "distance_m", "true_distance_m", "nearest_obstacle", "nearest_point"  # columns of the log


@dataclass(frozen=True)
class Nearest:
    """The least distance of the arm to the obstacles.

    Attributes:
        distance: in m, negative inside.
        obstacle, point: names.
    """

    distance: float
    obstacle: str
    point: str


@dataclass(frozen=True, eq=False)
class CollisionModel:
    """Obstacles beside a model's arm.

    Attributes:
        model: of the arm.
        obstacles: in the tracker frame G.
    """

    model: CompiledModel
    obstacles: Obstacles

    @cached_property
    def _others(self) -> np.ndarray:
        """Numbers of the levels that are watched beside the reference points, (levels,)."""
        weights = self.model.layout.point_weights
        taken = {int(np.argmax(row)) for row in weights if row.max() > 1 - 1e-9}
        return np.array([level for level in range(1, weights.shape[1]) if level not in taken], dtype=int)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the watched points."""
        layout = self.model.layout
        return (*layout.point_names, *(f"level {level} of {layout.levels}" for level in self._others))

    @cached_property
    def _between(self) -> np.ndarray:
        """Interpolation of offsets from reference points to watched points, linear and 0 at the base, (watched, points)."""
        layout = self.model.layout
        heights = layout.point_weights @ np.arange(layout.levels + 1)
        own = [np.interp(self._others, [0.0, *heights], [0.0, *unit]) for unit in np.eye(layout.points)]
        return np.vstack([np.eye(layout.points), np.array(own).T.reshape(-1, layout.points)])

    def stack_watched_points(self, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Stack the watched points (…, watched, 3) of reference points (…, points, 3) and all nodes (…, n + 1, actuators, 3), in m in G."""
        return np.concatenate([points, nodes[..., self._others, :, :].mean(axis=-2)], axis=-2)

    def locate_watched_points(self, equilibria: Sequence[Equilibrium]) -> np.ndarray:
        """Locate the watched points of equilibria, (equilibria, watched, 3) in m in G."""
        mount = self.model.robot.mount
        nodes = np.array([at.nodes for at in equilibria]) @ mount.rotation.T + np.array(mount.base_position_m)
        return self.stack_watched_points(np.array([at.points for at in equilibria]), nodes)

    def observe(self, modal: ModalModel) -> np.ndarray:
        """Watched points in G by modal coordinates, (watched, 3, modes) in 1/√kg."""
        layout = self.model.layout
        shapes = modal.shapes.reshape(layout.levels, layout.actuators, 3, -1)[self._others - 1].mean(axis=1)
        turned = np.einsum("ij,ljm->lim", self.model.robot.mount.rotation, shapes)
        return np.concatenate([modal.observe.reshape(layout.points, 3, -1), turned])

    def estimate_watched_points(self, estimate: StateEstimate) -> np.ndarray:
        """Estimate the watched points by the filter, (watched, 3) in m in G."""
        modal = estimate.operating.model
        return (
            self.locate_watched_points([modal.equilibrium])[0]
            + self.observe(modal) @ estimate.motion[: len(modal.stiffness)]
            + self._between @ estimate.bias
        )

    def offsets(self, bias: np.ndarray) -> np.ndarray:
        """Offsets of the watched points for those of the reference points, (points, 3) in m."""
        return self._between @ bias

    def columns(self, estimate: StateEstimate) -> dict[str, float | str]:
        """Columns of the log: the least distance as the filter has it, in m, and between what."""
        least = self.nearest(self.estimate_watched_points(estimate))
        return {DISTANCE: least.distance, OBSTACLE: least.obstacle, POINT: least.point}

    def at_rest(self) -> str:
        """Sentence about an obstacle that the arm without inputs is inside of; empty where it is not, or does not stand."""
        rest = solve_statics(self.model, np.zeros(self.model.layout.inputs))
        if not rest.solved:
            return ""
        distances = self.obstacles.nearest(self.locate_watched_points([rest])[0])[0].min(axis=0)
        return tell_rest(dict(zip(self.obstacles.names, distances.tolist(), strict=True)))

    def nearest(self, watched: np.ndarray) -> Nearest:
        """The least distance of watched points (watched, 3) in m in G."""
        distances = self.obstacles.nearest(watched)[0]
        point, obstacle = np.unravel_index(int(np.argmin(distances)), distances.shape)
        return Nearest(float(distances[point, obstacle]), self.obstacles.names[obstacle], self.names[point])


def tell_rest(distances: Mapping[str, float]) -> str:
    """Sentence about an arm that is inside obstacles before anything moves; empty where it is inside of none.

    Args:
        distances: least distance of the arm at rest to each obstacle by name, in m.
    """
    name = min(distances, key=distances.__getitem__, default="")
    if not name or distances[name] >= 0:
        return ""
    return (
        f"the arm at rest is inside {name!r} by {-1e3 * distances[name]:.2g} mm, and real runs begin there; move it, or correct its place"
    )
