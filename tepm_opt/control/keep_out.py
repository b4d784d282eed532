"""Keeping all points of the arm out of obstacles: soft rows of the predictive controller's program, and how near the arm is.

Watched are the reference points and the centres of the other levels, so that no part of the arm's axis longer than a segment is left
out. In every control step the distances are linearised about where the last plan has the points at the coming stages, which gives for
each a half space that contains no part of a convex obstacle (cf. Schulman et al., Motion planning with sequential convex optimization
and convex collision checking, IJRR 33, 2014); the `ROWS` least distances become rows n·p ≥ n·p_0 − d + margin.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from tepm_opt.control.obstacles import Obstacles
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.statics import solve_statics

if TYPE_CHECKING:
    from tepm_opt.control.estimator import StateEstimate
    from tepm_opt.control.forecast import Horizon
    from tepm_opt.control.reference import Reference
    from tepm_opt.solvers.modal_model import ModalModel
    from tepm_opt.solvers.statics import Equilibrium

ROWS = 40  # of the program: the least distances over stages, points and obstacles
DISTANCE, TRUE_DISTANCE, OBSTACLE, POINT = "distance_m", "true_distance_m", "nearest_obstacle", "nearest_point"  # columns of the log
PRESSED = 1e-3  # m within a margin, as it is foreseen, from which the pressures take their whole part in the feedback
WEIGHT = 10.0  # how much more a millimetre within the margin matters than a millimetre of the tip's error


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
class KeepOut:
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
        """What offsets of the reference points are at the watched points, linear between them and 0 at the base, (watched, points)."""
        layout = self.model.layout
        heights = layout.point_weights @ np.arange(layout.levels + 1)
        own = [np.interp(self._others, [0.0, *heights], [0.0, *unit]) for unit in np.eye(layout.points)]
        return np.vstack([np.eye(layout.points), np.array(own).T.reshape(-1, layout.points)])

    def watched(self, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Watched points (…, watched, 3) of reference points (…, points, 3) and all nodes (…, n + 1, actuators, 3), in m in G."""
        return np.concatenate([points, nodes[..., self._others, :, :].mean(axis=-2)], axis=-2)

    def along(self, equilibria: Sequence[Equilibrium]) -> np.ndarray:
        """Watched points of equilibria, (equilibria, watched, 3) in m in G."""
        mount = self.model.robot.mount
        nodes = np.array([at.nodes for at in equilibria]) @ mount.rotation.T + np.array(mount.base_position_m)
        return self.watched(np.array([at.points for at in equilibria]), nodes)

    def observe(self, modal: ModalModel) -> np.ndarray:
        """Watched points in G by modal coordinates, (watched, 3, modes) in 1/√kg."""
        layout = self.model.layout
        shapes = modal.shapes.reshape(layout.levels, layout.actuators, 3, -1)[self._others - 1].mean(axis=1)
        turned = np.einsum("ij,ljm->lim", self.model.robot.mount.rotation, shapes)
        return np.concatenate([modal.observe.reshape(layout.points, 3, -1), turned])

    def estimated(self, estimate: StateEstimate) -> np.ndarray:
        """Watched points where the filter has them, (watched, 3) in m in G."""
        modal = estimate.operating.model
        return (
            self.along([modal.equilibrium])[0]
            + self.observe(modal) @ estimate.motion[: len(modal.stiffness)]
            + self._between @ estimate.bias
        )

    def offsets(self, bias: np.ndarray) -> np.ndarray:
        """Offsets of the watched points for those of the reference points, (points, 3) in m."""
        return self._between @ bias

    def columns(self, estimate: StateEstimate) -> dict[str, float | str]:
        """Columns of the log: the least distance as the filter has it, in m, and between what."""
        least = self.nearest(self.estimated(estimate))
        return {DISTANCE: least.distance, OBSTACLE: least.obstacle, POINT: least.point}

    def at_rest(self) -> str:
        """Sentence about an obstacle that the arm without inputs is inside of; empty where it is not, or does not stand."""
        rest = solve_statics(self.model, np.zeros(self.model.layout.inputs))
        if not rest.solved:
            return ""
        distances = self.obstacles.nearest(self.along([rest])[0])[0].min(axis=0)
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


class KeepOutRows:
    """The soft rows of the program in the deviations of the forces at stages 1 …; always as many.

    Args:
        keep_out: what of.
        reference: about which the program predicts.
        stages: of the program.

    Attributes:
        count: of the rows.
    """

    def __init__(self, keep_out: KeepOut, reference: Reference, stages: int) -> None:
        self.keep_out, self._reference = keep_out, keep_out.along(reference.equilibria)
        self.count = min(ROWS, (stages - 1) * len(keep_out.names) * len(keep_out.obstacles.names))

    def about(
        self, horizon: Horizon, modal: ModalModel, rows: np.ndarray, bias: np.ndarray, begin: np.ndarray, plan: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """R and r of R v ≥ r, (rows, stages · actuators) and (rows,) in m.

        Args:
            horizon: the coming stages.
            modal: the modal model at stage 0.
            rows: of the reference at stages 1 … stages − 1.
            bias: of the reference points, (points, 3) in m.
            begin: deviation of the forces at stage 0, (actuators,) in N.
            plan: about which distances are linearised: deviations at stages 1 …, (stages, actuators) in N; None where there is none.
        """
        pulses = horizon.pulses()
        modes, count = len(modal.stiffness), len(rows)
        observe = self.keep_out.observe(modal)
        free = horizon.free[1 : count + 1, :modes] + pulses.first[:count, :modes] @ begin
        lags = np.arange(count)[:, None] - np.arange(horizon.stages)
        later = np.where((lags >= 0)[:, :, None, None], pulses.later[np.maximum(lags, 0), :modes], 0.0)  # (stage, of stage, modes, inputs)
        moved = free if plan is None else free + np.einsum("ksmi,si->km", later, plan)
        places = self._reference[rows] + self.keep_out.offsets(bias) + np.einsum("pxm,km->kpx", observe, moved)
        distances, normals = self.keep_out.obstacles.nearest(places.reshape(-1, 3))
        room = (distances - self.keep_out.obstacles.margins).ravel()
        least = np.argpartition(room, self.count - 1)[: self.count]
        at, point, obstacle = np.unravel_index(least, (*places.shape[:2], distances.shape[1]))
        normal = normals.reshape(*places.shape[:2], -1, 3)[at, point, obstacle]
        by_modes = np.einsum("rx,rxm->rm", normal, observe[point])
        answer = np.einsum("rm,rsmi->rsi", by_modes, later[at]).reshape(self.count, -1)
        return answer, np.einsum("rm,rm->r", by_modes, (moved - free)[at]) - room[least]
