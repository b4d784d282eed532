"""The loops of kinematics.c in Python: the reference for the C ones, and what runs without a compiler."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from tepm_opt.models.backends.interface import (
    ALLOCATION_PRECISION,
    ALLOCATION_STEPS,
    LIMIT_SLACK,
    SEED_STEPS,
    SEED_TOLERANCE,
    Allotment,
    InverseNewton,
    InverseProblem,
    LoadCase,
    Pose,
    Status,
)
from tepm_opt.models.backends.statics import PythonStatics, move
from tepm_opt.models.robot import on_grid


class PythonKinematics(PythonStatics):
    """Reference backend, statics and inverse kinematics."""

    def inverse(
        self, x: np.ndarray, case: LoadCase, weights: np.ndarray, targets: np.ndarray, newton: InverseNewton
    ) -> tuple[Status, np.ndarray, np.ndarray, int]:
        """See `StaticsBackend.inverse`."""
        layout, theta, half = self.network.layout, case.theta, len(targets)
        a = np.concatenate([case.u[:half], np.zeros(half)])
        case = LoadCase(a, True, case.external, theta)  # which follows a
        for iteration in range(newton.max_iterations):
            _, P, level_0 = self.prepare(*case)
            x = np.concatenate([level_0[None], x[1:]])
            at = self.assemble(x, P, theta)
            try:
                factor = sla.cholesky_banded(at.band, lower=True)
            except np.linalg.LinAlgError:
                return Status.INDEFINITE, x, a[:half], iteration
            errors = weights @ self.observe(x, theta) - targets
            if np.abs(errors).max() < newton.target_tolerance and np.abs(at.force).max() < newton.tolerance:
                return Status.SOLVED, x, a[:half], iteration
            if not np.abs(errors).max() < 1e3:
                return Status.STALLED, x, a[:half], iteration
            by_a = self.sensitivity(x, case, weights, False)[1]
            settled = np.zeros_like(x)
            settled[1:] = sla.cho_solve_banded((factor, True), at.force.ravel()).reshape(at.force.shape)
            settling = np.array([self._directional(x, theta, weight, settled) for weight in weights])
            try:
                change = np.linalg.solve(by_a[:, :half], settling - errors)
            except np.linalg.LinAlgError:
                return Status.STALLED, x, a[:half], iteration
            a[:half] += change * min(1.0, newton.max_step / np.abs(change).max())
            force = self.assemble(x, self.prepare(*case)[1], theta).force
            step = np.zeros((layout.levels + 1, layout.block))
            step[1:] = -sla.cho_solve_banded((factor, True), force.ravel()).reshape(force.shape)
            x = move(x, step)
        return Status.EXHAUSTED, x, a[:half], newton.max_iterations

    def _directional(self, x: np.ndarray, theta: np.ndarray, weight: np.ndarray, direction: np.ndarray) -> float:
        """Change of a weighted sum of the observations when the levels move in a direction."""
        points = 3 * self.network.layout.points
        by_x = self._call("observe_adjoint", x.ravel(), theta, weight[:points], weight[points:])[0]
        return float(by_x.ravel() @ direction.ravel())

    def response(
        self, x: np.ndarray, case: LoadCase, weights: np.ndarray, tolerance: float, max_iterations: int
    ) -> tuple[Status, np.ndarray, np.ndarray, np.ndarray]:
        """See `StaticsBackend.response`."""
        found = self.statics(x, case, tolerance, max_iterations)
        if found.status != Status.SOLVED:
            return found.status, found.x, found.observed, np.zeros((len(weights), len(case.u)))
        status, by_a, _, _ = self.sensitivity(found.x, case, weights, False)
        return status, found.x, found.observed, by_a

    def allocate(self, forces: np.ndarray, allotment: Allotment, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """See `StaticsBackend.allocate`."""
        inputs, half = allotment.start.copy(), len(forces)
        self._correct(inputs, forces, allotment, theta, slice(0, half), 1 / allotment.area)
        if allotment.fine:
            inputs[:half] = on_grid(inputs, allotment.grid, allotment.limit)[:half]
            self._correct(inputs, forces, allotment, theta, slice(half, None), -1.0)
        rounded = on_grid(inputs, allotment.grid, allotment.limit)
        return inputs, rounded, float(np.abs(self._compute_missing_forces(inputs, forces, allotment, theta)).max())

    def _compute_missing_forces(self, inputs: np.ndarray, forces: np.ndarray, allotment: Allotment, theta: np.ndarray) -> np.ndarray:
        """Axial forces in N that the inputs do not make, (actuators,)."""
        effective, half = self.actuation(inputs, theta), len(forces)
        return forces - (allotment.area * effective[:half] - effective[half:])

    def _correct(self, inputs: np.ndarray, forces: np.ndarray, allotment: Allotment, theta: np.ndarray, part: slice, gain: float) -> None:
        """Change one part of the inputs in place, within limits, until the forces are met or nothing moves."""
        boost, before = np.ones(len(forces)), np.full(len(forces), np.inf)
        for _ in range(ALLOCATION_STEPS):
            missing = self._compute_missing_forces(inputs, forces, allotment, theta)
            if np.abs(missing).max() < ALLOCATION_PRECISION:
                return
            unanswered = (np.abs(missing) > 0.9 * np.abs(before)) & (np.sign(missing) == np.sign(before))  # what was overshot did answer
            boost = np.where(unanswered, 2 * boost, 1.0)
            before = missing
            changed = np.clip(inputs[part] + gain * boost * missing, 0.0, allotment.limit[part])
            moved = np.abs(changed - inputs[part]).max() / abs(gain)
            inputs[part] = changed
            if moved < ALLOCATION_PRECISION:
                return

    def configurations(
        self, problem: InverseProblem, targets: np.ndarray, x: np.ndarray, actuation: np.ndarray, cold: bool
    ) -> tuple[list[Pose], Status]:
        """See `StaticsBackend.configurations`; takes one a call."""
        half, area, case = len(problem.weights), problem.allotment.area, LoadCase(actuation, True, problem.external, problem.theta)
        if cold:
            seed = self.statics(x, case, SEED_TOLERANCE, SEED_STEPS)
            if seed.status != Status.SOLVED:
                return [], seed.status
            x = seed.x
        sums = np.concatenate([targets[0], np.zeros(half - 3)])
        newton = InverseNewton(problem.max_step / area, problem.tolerance, problem.force_tolerance, problem.max_iterations)
        status, x, pressures, steps = self.inverse(x, case, problem.weights, sums, newton)
        if status != Status.SOLVED:
            return [], status
        observed, forces = self.observe(x, problem.theta), area * pressures
        if observed[-half:].min() < problem.shortest:
            return [], Status.STALLED
        room = float((np.minimum(forces - problem.low, problem.high - forces) / (problem.high - problem.low)).min())
        if room < -LIMIT_SLACK:
            return [], Status.BEYOND
        effective = np.concatenate([pressures, actuation[half:]])
        force = self.assemble(x, self.prepare(*case._replace(u=effective))[1], problem.theta).force
        inputs, rounded, missed = self.allocate(forces, problem.allotment, problem.theta)
        return [Pose(x, effective, observed, inputs, rounded, steps, float(np.abs(force).max()), missed, room)], Status.SOLVED
