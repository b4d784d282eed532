"""From axial forces over the coming stages to what they cost: prediction about a reference, with the cost beyond the last stage."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla

from tepm_opt.control.estimation.kalman_filter import DiscreteModalModel
from tepm_opt.control.references.reference import Reference
from tepm_opt.solvers.linear.modal_model import ModalModel

RIDGE = 2e-3  # m/N: directions of the forces that move the points less are not used to accelerate them
NOTHING = 1e-6  # m/N: what moves the tip less does not move it (a tip on a guide)


@dataclass(frozen=True)
class Weights:
    """Weights of the terms in the cost, as the sizes at which they cost the same.

    Attributes:
        tip: error of the tip in m.
        blind_tip: the same while the tip is lost, whose estimate is noisier and later then.
        shape: error of the other reference points in m.
        force: deviation of an axial force from the reference's in N.
        change: of that deviation from stage to stage in N.
    """

    tip: float = 1e-3
    blind_tip: float = 3e-3
    shape: float = 2e-2
    force: float = 2.0
    change: float = 0.18


def compute_holding_forces(model: ModalModel) -> np.ndarray:
    """Forces that hold the points where they are displaced to, (actuators, 3 · points) in N/m."""
    answer = model.observe @ (model.drive / model.stiffness[:, None])  # of the points at rest
    return np.linalg.solve(answer.T @ answer + RIDGE**2 * np.eye(answer.shape[1]), answer.T)


def compensate_tip_bias(model: ModalModel, bias: np.ndarray) -> np.ndarray:
    """Smallest forces that take a displacement of the tip back at rest, (actuators, …) in N for (3, …) in m."""
    by_tip = model.gain[-3:]
    return -by_tip.T @ np.linalg.solve(by_tip @ by_tip.T + NOTHING**2 * np.eye(3), bias)


class CondensedOcp:
    """Reference over the coming stages, the arm's free motion beside it, and the terminal cost.

    Attributes:
        is_blind: whether the tip is lost; set before `prepare`.
        forces: axial forces of the reference at stages 0 …, (stages and preview, actuators) in N.
        dynamic: forces that accelerate the arm along the reference at stages 1 …, (preview, actuators) in N.
        speed: speed of the reference's tip over the stages in m/s.
        rest_force: deviation of the forces that brings the tip to its target at rest, with the bias it has, (actuators,) in N.
        stage: the modal model at stage 0 over one stage.
        by_start, by_end: what deviations of the forces at start and end of a stage add to [e, e'], (2 · modes, actuators) in 1/N.
        free: deviation [e, e'] without forces at stages 0 …, (stages + 1, 2 · modes).
        rest: deviation [e, e'] at rest under `rest_force`, (2 · modes,).
        value: cost beyond the last stage by its state and forces, (2 · modes + actuators, 2 · modes + actuators).
    """

    def __init__(self, weights: Weights, stages: int) -> None:
        """A horizon without a present.

        Args:
            weights: of the cost.
            stages: how many.
        """
        self._weights, self.stages, self.is_blind = weights, stages, False
        self.value = np.zeros(0)
        self._before: DiscreteModalModel | None = None

    @property
    def weights(self) -> Weights:
        """Weights of the cost while the tip is seen, or while it is lost."""
        return replace(self._weights, tip=self._weights.blind_tip) if self.is_blind else self._weights

    def prepare(self, operating: DiscreteModalModel, reference: Reference, rows: np.ndarray) -> None:
        """Take a new present, of which no sample has been seen yet.

        Args:
            operating: modal model at stage 0, by control periods.
            reference: what is followed.
            rows: rows of the reference at stages −1, 0, 1, …, (stages + 3,) or more.
        """
        model, two = operating.model, operating.double_period()
        path = (reference.levels[rows] - model.levels) @ model.weights.T
        rate = (path[2:] - path[:-2]) / (2 * two.period)
        way = np.diff(reference.tips[rows[1 : self.stages + 2]], axis=0)
        self.speed = float(np.sqrt((way**2).sum(axis=1)).mean() / two.period)
        bend = (path[2:] - 2 * path[1:-1] + path[:-2]) / two.period**2
        drift = -bend - rate @ model.damping.T
        self.forces = reference.forces[rows[1:-1]]
        self.dynamic = (-drift[1:] / model.stiffness) @ (compute_holding_forces(model) @ model.observe).T
        self._rate = rate[0]
        self._pushed = two.start @ drift[: self.stages].T + two.end @ drift[1 : self.stages + 1].T
        self.stage, self.by_start, self.by_end = two, two.start @ model.drive, two.end @ model.drive
        self._turn(operating)

    def set_initial_state(self, motion: np.ndarray, bias: np.ndarray) -> None:
        """Set the state at stage 0, and predict the free motion and the state at rest from it.

        Args:
            motion: [q, q'] about the operating point at stage 0, (2 · modes,).
            bias: what the tip's position is off by in m, (3,).
        """
        count = len(self._rate)
        self.rest_force = compensate_tip_bias(self.stage.model, bias)
        self.rest = np.concatenate([self.stage.model.static(self.rest_force), np.zeros(count)])
        self.free = np.empty((self.stages + 1, 2 * count))
        self.free[0] = motion
        self.free[0, count:] -= self._rate
        for k in range(self.stages):
            self.free[k + 1] = self.stage.A @ self.free[k] + self._pushed[:, k]

    def _turn(self, operating: DiscreteModalModel) -> None:
        """The cost beyond the last stage, one step of the Riccati recursion on, about the new operating point."""
        A, start, end, weights = self.stage.A, self.by_start, self.by_end, self.weights
        states, inputs = start.shape
        full = np.zeros((states + inputs, states + inputs))
        full[:states, :states], full[:states, states:] = A, start + end
        full[states:, states:] = np.eye(inputs)
        by, modes = np.vstack([end, np.eye(inputs)]), states // 2
        cost = np.zeros_like(full)
        rows = self.rows()
        cost[:modes, :modes] = rows.T @ rows
        cost[states:, states:] = np.eye(inputs) / weights.force**2
        change = np.eye(inputs) / weights.change**2
        value = self.value
        if self._before is None:
            value = sla.solve_discrete_are(full, by, cost, change)
        elif operating is not self._before:
            turn, _ = operating.seen_from(self._before)
            both = np.eye(states + inputs)
            both[:modes, :modes] = both[modes:states, modes:states] = turn
            value = both @ value @ both.T
        forward = value @ full
        gain = np.linalg.solve(change + by.T @ value @ by, by.T @ forward)
        value = cost + full.T @ (forward - value @ by @ gain)
        self.value, self._before = (value + value.T) / 2, operating

    def pulses(self) -> tuple[np.ndarray, np.ndarray]:
        """States at stages 1 … after a pulse of the forces, (stages, 2 · modes, actuators) in 1/N: of one at stage 0, and of one at a later
        stage, counted from the stage before it."""
        states, inputs = self.by_start.shape
        first, later = np.empty((self.stages, states, inputs)), np.empty((self.stages, states, inputs))
        first[0], later[0] = self.by_start, self.by_end
        for k in range(1, self.stages):
            first[k], later[k] = self.stage.A @ first[k - 1], self.stage.A @ later[k - 1]
            if k == 1:
                later[k] += self.by_start
        return first, later

    def rows(self) -> np.ndarray:
        """Weighted errors of the points by modal deviations, (3 · points, modes), the tip's first."""
        observe = self.stage.model.observe
        return np.vstack([observe[-3:] / self.weights.tip, observe[:-3] / self.weights.shape])


class PredictionModel:
    """Cost of the forces at the coming stages, as a program in their deviations from the reference's: ½ vᵀ H v + fᵀ v.

    Attributes:
        horizon: the coming stages.
        tip_answer: tip's error at stages 1 … stages − 1 by the forces at stages 1 …, (3 · (stages − 1), stages · actuators) in m/N.
        tip_free: tip's error there without these forces, (3 · (stages − 1),) in m; as of the last `gradient`.
    """

    def __init__(self, weights: Weights, stages: int) -> None:
        """A forecast without a present.

        Args:
            weights: of the cost.
            stages: how many.
        """
        self.horizon = CondensedOcp(weights, stages)
        behind = np.arange(stages - 1)[:, None] - np.arange(stages)  # of stages 1 … stages − 1 behind the forces of stages 1 …
        self._lags, self._later = np.maximum(behind, 0), behind >= 0

    def prepare(self, operating: DiscreteModalModel, reference: Reference, rows: np.ndarray) -> np.ndarray:
        """Take a new present, see `CondensedOcp.prepare`; H, (stages · actuators, stages · actuators)."""
        horizon = self.horizon
        horizon.prepare(operating, reference, rows)
        self._respond()
        weights, stages, inputs, size = horizon.weights, horizon.stages, horizon.by_end.shape[1], self._errors.shape[1]
        tips = self._errors.reshape(stages - 1, -1, size)[:, :3].reshape(3 * stages - 3, size)
        self.tip_answer, end = weights.tip * tips, self._end
        H = self._errors.T @ self._errors + end.T @ (horizon.value @ end)
        change, force = 1 / weights.change**2, 1 / weights.force**2
        diagonal = np.full(size, 2 * change + force)
        diagonal[-inputs:] = change  # the last one is in the cost beyond
        H[np.diag_indices(size)] += diagonal
        off = np.arange(size - inputs)
        H[off, off + inputs] -= change
        H[off + inputs, off] -= change
        return H

    def gradient(self, begin: np.ndarray) -> np.ndarray:
        """f, (stages · actuators,), for a deviation of the forces at stage 0, (actuators,) in N, after `CondensedOcp.set_initial_state`."""
        horizon, inputs = self.horizon, len(begin)
        weights, modes, size = horizon.weights, len(horizon.rest) // 2, horizon.stages * inputs
        free = horizon.free[1:] + self._first @ begin
        errors = ((free[:-1, :modes] - horizon.rest[:modes]) @ horizon.rows().T).ravel()
        self.tip_free = weights.tip * errors.reshape(horizon.stages - 1, -1)[:, :3].ravel()
        at_end = np.concatenate([free[-1] - horizon.rest, -horizon.rest_force])
        f = self._errors.T @ errors + self._end.T @ (horizon.value @ at_end)
        f[:inputs] -= begin / weights.change**2
        f[: size - inputs] -= np.tile(horizon.rest_force, horizon.stages - 1) / weights.force**2
        return f

    def tip_errors(self, forces: np.ndarray | None) -> np.ndarray:
        """Distances of the tip from its targets at stages 1 … stages − 1 in m, as of the last `gradient`.

        Args:
            forces: deviations at stages 1 …, (stages, actuators) in N; none where None.
        """
        error = self.tip_free if forces is None else self.tip_free + self.tip_answer @ forces.ravel()
        return np.linalg.norm(error.reshape(-1, 3), axis=1)

    def _respond(self) -> None:
        """Weighted errors, and state and deviation of the forces at the last stage, by the deviations at stages 1 …"""
        horizon = self.horizon
        stages, (states, inputs) = horizon.stages, horizon.by_start.shape
        self._first, later = horizon.pulses()
        answer = horizon.rows() @ later[: stages - 1, : states // 2]
        seen = np.where(self._later[:, :, None, None], answer[self._lags], 0.0)  # (stage, of stage, outputs, inputs)
        self._errors = seen.transpose(0, 2, 1, 3).reshape(-1, stages * inputs)
        self._end = np.zeros((states + inputs, stages * inputs))
        self._end[:states] = later[::-1].transpose(1, 0, 2).reshape(states, -1)
        self._end[states:, -inputs:] = np.eye(inputs)
