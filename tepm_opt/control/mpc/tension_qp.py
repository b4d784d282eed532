"""The controller's quadratic program in the tensions of the coming stages."""

from __future__ import annotations

import numpy as np

from tepm_opt.control.collision.constraints import WEIGHT
from tepm_opt.control.mpc.prediction import Forecast
from tepm_opt.control.mpc.qp import QpResult, QpSolver
from tepm_opt.control.mpc.settings import MpcSettings, Use

Rows = tuple[np.ndarray, np.ndarray]
"""R and r of soft rows R v ≥ r in the deviations v of the forces, (rows, stages · actuators) and (rows,)."""


class TensionProgram:
    """Tensions λ of the coming stages, of which the axial forces' deviations are v = offset − factor λ.

    Tensions have a range and a rate; a corridor about the reference and what the arm shall keep out of are soft.

    Args:
        settings: of the controller.
        tension_max: of the motors, (actuators,) in N.
        most: change of a tension from stage to stage, in N.
        kept: how many soft rows there are beside those of the corridor.
    """

    def __init__(self, settings: MpcSettings, tension_max: np.ndarray, most: float, kept: int) -> None:
        self._settings, self._tension_max, self._most = settings, tension_max, most
        variables = settings.stages * len(tension_max)
        self._rates = np.eye(variables) - np.eye(variables, k=-len(tension_max))
        kept += 3 * (settings.stages - 1) if np.isfinite(settings.corridor) else 0
        soft = np.append(np.full(variables, np.inf), np.full(kept, (WEIGHT / settings.weights.tip) ** 2)) if kept else None
        self._soft = kept > 0
        self._solver = QpSolver(np.vstack([self._rates, np.zeros((kept, variables))]), soft)

    def prepare(self, hessian: np.ndarray, factor: np.ndarray) -> None:
        """Take H in the deviations of the forces, (stages · actuators, stages · actuators), and the factors, (stages, actuators)."""
        self._hessian, self._scale = hessian, -factor.ravel()
        self._own = hessian * self._scale[:, None] * self._scale
        if not self._soft:
            self._solver.take(self._own)

    def solve(
        self, forecast: Forecast, begin: np.ndarray, offset: np.ndarray, tension: np.ndarray, enabled: np.ndarray, kept: Rows | None
    ) -> QpResult:
        """Solve it for what has been seen.

        Args:
            forecast: of the arm.
            begin: v at stage 0, (actuators,) in N.
            offset: (stages, actuators) in N.
            tension: now, (actuators,) in N.
            enabled: which motors are on, (actuators,) of bool.
            kept: soft rows in v, as many as were announced, see `KeepOutRows`.
        """
        settings, scale = self._settings, self._scale
        f = scale * (forecast.gradient(begin) + self._hessian @ offset.ravel())
        low, high = np.zeros(len(f)), np.tile(self._tension_max * enabled, settings.stages)
        if settings.use is Use.PRESSURE:
            high = np.tile(self._tension_max, settings.stages)
            low = -high  # what pressure shall make
        rate_low, rate_high = np.full(len(f), -self._most), np.full(len(f), self._most)
        first = np.clip(tension, 0.0, self._tension_max)  # a gauge may say what no motor does
        first = first * enabled if settings.use is not Use.PRESSURE else first
        rate_low[: len(first)] += first
        rate_high[: len(first)] += first
        if not self._soft:
            return self._solver.solve(None, f, low, high, rate_low, rate_high)
        horizon, width = forecast.horizon, settings.corridor
        soft = [(horizon.tip_answer, -width - horizon.tip_free, width - horizon.tip_free)] if np.isfinite(width) else []
        soft += [] if kept is None else [(*kept, np.full(len(kept[1]), np.inf))]
        by, least, most = (np.concatenate(parts) for parts in zip(*soft, strict=True))
        known = by @ offset.ravel()
        rows = np.vstack([self._rates, by * scale])
        return self._solver.solve(self._own, f, low, high, np.append(rate_low, least - known), np.append(rate_high, most - known), rows)
