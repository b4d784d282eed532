"""Keeping all points of the arm out of obstacles: soft rows of the predictive controller's program.

In every control step the distances are linearised about where the last plan has the points at the coming stages, which gives for
each a half space that contains no part of a convex obstacle (cf. Schulman et al., Motion planning with sequential convex optimization
and convex collision checking, IJRR 33, 2014); the `ROWS` least distances become rows n·p ≥ n·p_0 − d + margin.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tepm_opt.control.collision.model import CollisionModel

if TYPE_CHECKING:
    from tepm_opt.control.mpc.prediction import CondensedOcp
    from tepm_opt.control.references.reference import Reference
    from tepm_opt.solvers.linear.modal_model import ModalModel

ROWS = 40  # of the program: the least distances over stages, points and obstacles
PRESSED = 1e-3  # m within a margin, as it is foreseen, from which the pressures take their whole part in the feedback
WEIGHT = 10.0  # how much more a millimetre within the margin matters than a millimetre of the tip's error


class CollisionConstraints:
    """The soft rows of the program in the deviations of the forces at stages 1 …; always as many.

    Args:
        keep_out: what of.
        reference: about which the program predicts.
        stages: of the program.

    Attributes:
        count: of the rows.
    """

    def __init__(self, keep_out: CollisionModel, reference: Reference, stages: int) -> None:
        self.keep_out, self._reference = keep_out, keep_out.locate_watched_points(reference.equilibria)
        self.count = min(ROWS, (stages - 1) * len(keep_out.names) * len(keep_out.obstacles.names))

    def linearise(
        self, horizon: CondensedOcp, modal: ModalModel, rows: np.ndarray, bias: np.ndarray, begin: np.ndarray, plan: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Linearise the least distances: R and r of R v ≥ r, (rows, stages · actuators) and (rows,) in m.

        Args:
            horizon: the coming stages.
            modal: the modal model at stage 0.
            rows: of the reference at stages 1 … stages − 1.
            bias: of the reference points, (points, 3) in m.
            begin: deviation of the forces at stage 0, (actuators,) in N.
            plan: about which distances are linearised: deviations at stages 1 …, (stages, actuators) in N; None where there is none.
        """
        first, pulses = horizon.pulses()
        modes, count = len(modal.stiffness), len(rows)
        observe = self.keep_out.observe(modal)
        free = horizon.free[1 : count + 1, :modes] + first[:count, :modes] @ begin
        lags = np.arange(count)[:, None] - np.arange(horizon.stages)
        later = np.where((lags >= 0)[:, :, None, None], pulses[np.maximum(lags, 0), :modes], 0.0)  # (stage, of stage, modes, inputs)
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
