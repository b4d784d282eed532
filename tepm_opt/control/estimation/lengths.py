"""Actuator lengths where nobody measures them: those of the nominal equilibrium that fits the tracked points best (SPEC section 2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.models.backends.interface import Status
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_actuated_statics


@dataclass(frozen=True)
class LengthEstimatorSettings:
    """Settings of the length estimator.

    Attributes:
        steps: most Gauss-Newton steps a sample.
        tolerance: change of every axial force in N below which no further step is taken.
        noise: standard deviation in m of a tracked coordinate; with `force_step` it weighs the sample against what was estimated before.
        force_step: standard deviation in N of an axial force's change from one sample to the next: what the points do not show stays.
        largest_step: largest change in N of an axial force in one Gauss-Newton step.
    """

    steps: int = 3
    tolerance: float = 0.02
    noise: float = 5.8e-4
    force_step: float = 1.0
    largest_step: float = 4.0


DEFAULT = LengthEstimatorSettings()


class LengthEstimator:
    """Axial forces, and so lengths, whose equilibrium fits the reference points; warm-started from sample to sample.

    Gauss-Newton on ‖(points − tracked) / noise‖² + ‖(F − F_before) / force_step‖² with the derivatives of the statics. Points that are
    missing (NaN) simply do not count; with all of them missing the estimate stays.

    Args:
        model: the nominal model, compiled.
        loads: known forces on the reference points in G, (points, 3) or on the tip (3,) in N.
        settings: of the estimator.

    Attributes:
        forces: estimated F_a, (modules · actuators,) in N.
        equilibrium: of these forces.
        residual: root mean square distance of the fitted from the tracked points in m; NaN before the first sample.
    """

    def __init__(self, model: CompiledModel, loads: np.ndarray | None = None, settings: LengthEstimatorSettings = DEFAULT) -> None:
        self.model, self.settings = model, settings
        self._loads = model.check_loads(loads)
        self._half, self._area = model.layout.inputs // 2, model.values["A"]
        self._coordinates = np.eye(3 * model.layout.points, 3 * model.layout.points + self._half)
        self.forces = np.zeros(self._half)
        self.equilibrium = self._solve_equilibrium(self.forces, None)
        self.residual = np.nan

    @property
    def lengths(self) -> np.ndarray:
        """Estimated lengths, (modules · actuators,) in m."""
        return self.equilibrium.lengths.ravel()

    def update(self, points: np.ndarray) -> np.ndarray:
        """Take a sample's points (points, 3) in m in G, NaN where missing; the lengths, (modules · actuators,) in m.

        Raises:
            InputError: another shape.
        """
        tracked = np.asarray(points, dtype=float)
        if tracked.shape != self.equilibrium.points.shape:
            raise InputError(f"points: shape {tracked.shape}; valid: {self.equilibrium.points.shape}")
        seen = np.isfinite(tracked).all(axis=1)
        if not seen.any():
            return self.lengths
        before = self.forces
        for _ in range(self.settings.steps):
            if not self._step(tracked, np.repeat(seen, 3), before):
                break
        missed = (self.equilibrium.points - tracked)[seen]
        self.residual = float(np.sqrt(np.mean((missed**2).sum(axis=1))))
        return self.lengths

    def _step(self, tracked: np.ndarray, used: np.ndarray, before: np.ndarray) -> bool:
        """One step; whether another one is worth it."""
        at, settings = self.equilibrium, self.settings
        status, by_u, _, _ = self.model.statics.sensitivity(at.x, at.load_case, self._coordinates, False)
        if status != Status.SOLVED:
            return False
        jacobian = by_u[used, : self._half] / self._area / settings.noise
        missed = (at.points - tracked).ravel()[used] / settings.noise
        normal = jacobian.T @ jacobian + np.eye(self._half) / settings.force_step**2
        step = -np.linalg.solve(normal, jacobian.T @ missed + (self.forces - before) / settings.force_step**2)
        step *= min(1.0, settings.largest_step / max(float(np.abs(step).max()), 1e-12))
        for _ in range(4):
            found = self._solve_equilibrium(self.forces + step, at)
            if found.solved:
                self.forces, self.equilibrium = self.forces + step, found
                return float(np.abs(step).max()) > settings.tolerance
            step /= 4
        return False

    def _solve_equilibrium(self, forces: np.ndarray, start: Equilibrium | None) -> Equilibrium:
        effective = np.concatenate([forces / self._area, np.zeros(self._half)])
        return solve_actuated_statics(self.model, effective, self._loads, start)
