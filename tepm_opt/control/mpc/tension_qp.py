"""The controller's quadratic program in the tensions of the coming stages."""

from __future__ import annotations

import numpy as np

from tepm_opt.control.collision.constraints import WEIGHT
from tepm_opt.control.mpc.qp import QpResult, QpSolver
from tepm_opt.control.mpc.settings import MpcSettings, Use

Rows = tuple[np.ndarray, np.ndarray]
"""R and r of soft rows R v ≥ r in the deviations v of the forces, (rows, stages · actuators) and (rows,)."""


class TensionQp:
    """Tensions λ of the coming stages, of which the axial forces' deviations are v = offset − factor λ, within their range and rate.

    Args:
        settings: of the controller.
        tension_max: of the motors, (actuators,) in N.
        most: change of a tension from stage to stage, in N.
        kept: how many soft rows there are, for what the arm shall keep out of.
    """

    def __init__(self, settings: MpcSettings, tension_max: np.ndarray, most: float, kept: int) -> None:
        variables = settings.stages * len(tension_max)
        self._tension_max, self._most, self._soft = tension_max, most, kept > 0
        self._high = np.tile(tension_max, settings.stages)
        self._low = -self._high if settings.use is Use.PRESSURE else np.zeros(variables)  # what pressure shall make
        self._rates = np.eye(variables) - np.eye(variables, k=-len(tension_max))
        soft = np.append(np.full(variables, np.inf), np.full(kept, (WEIGHT / settings.weights.tip) ** 2)) if kept else None
        self._solver = QpSolver(np.vstack([self._rates, np.zeros((kept, variables))]), soft)

    def prepare(self, hessian: np.ndarray, factor: np.ndarray) -> None:
        """Take H in the deviations of the forces, (stages · actuators, stages · actuators), and the factors, (stages, actuators)."""
        self._hessian, self._scale = hessian, -factor.ravel()
        self._own = hessian * self._scale[:, None] * self._scale
        if not self._soft:
            self._solver.take(self._own)

    def solve(self, gradient: np.ndarray, offset: np.ndarray, tension: np.ndarray, kept: Rows | None) -> QpResult:
        """Solve it for what has been seen.

        Args:
            gradient: f in the deviations of the forces, (stages · actuators,).
            offset: (stages, actuators) in N.
            tension: now, (actuators,) in N.
            kept: soft rows in v, as many as were announced, see `CollisionConstraints`.
        """
        scale, solver = self._scale, self._solver
        f = scale * (gradient + self._hessian @ offset.ravel())
        rate_low, rate_high = np.full(len(f), -self._most), np.full(len(f), self._most)
        first = np.clip(tension, 0.0, self._tension_max)  # a gauge may say what no motor does
        rate_low[: len(first)] += first
        rate_high[: len(first)] += first
        if kept is None:
            return solver.solve(None, f, self._low, self._high, rate_low, rate_high)
        by, least = kept
        rows, free = np.vstack([self._rates, by * scale]), np.full(len(least), np.inf)
        rate_low = np.append(rate_low, least - by @ offset.ravel())
        return solver.solve(self._own, f, self._low, self._high, rate_low, np.append(rate_high, free), rows)
