"""From axial forces over the coming stages to what they cost: prediction about a reference, with the cost beyond the last stage."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import scipy.linalg as sla

from tepm_opt.control.estimation.kalman_filter import Operating
from tepm_opt.control.references.reference import Reference
from tepm_opt.solvers.modal_model import ModalModel

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


def holding(model: ModalModel) -> np.ndarray:
    """Forces that hold the points where they are displaced to, (actuators, 3 · points) in N/m."""
    answer = model.observe @ (model.drive / model.stiffness[:, None])  # of the points at rest
    return np.linalg.solve(answer.T @ answer + RIDGE**2 * np.eye(answer.shape[1]), answer.T)


def against(model: ModalModel, bias: np.ndarray) -> np.ndarray:
    """Smallest forces that take a displacement of the tip back at rest, (actuators, …) in N for (3, …) in m."""
    by_tip = model.gain[-3:]
    return -by_tip.T @ np.linalg.solve(by_tip @ by_tip.T + NOTHING**2 * np.eye(3), bias)


@dataclass(frozen=True, eq=False)
class Responses:
    """What forces at the coming stages make of the arm: everything is linear in them.

    Attributes:
        errors: weighted errors at stages 1 … stages − 1 by the forces at stages 1 …, (errors, stages · actuators) in 1/N; the tip's are
            the first three of each stage.
        last: the state at the last stage by these forces, (states, stages · actuators).
    """

    errors: np.ndarray
    last: np.ndarray


@dataclass(frozen=True, eq=False)
class Pulses:
    """States at stages 1 … after a pulse of the forces at one stage, (stages, 2 · modes, actuators) in 1/N.

    Attributes:
        first: of a pulse at stage 0.
        later: of a pulse at a later stage: what it is that many stages and one after the stage before.
    """

    first: np.ndarray
    later: np.ndarray


class Horizon:
    """The reference over the coming stages, the arm's free motion beside it, and the cost of forces with what lies beyond the last stage.

    Attributes:
        is_blind: whether the tip is lost; set before `prepare`.
        forces: axial forces of the reference at stages 0 …, (stages and preview, actuators) in N.
        dynamic: forces that accelerate the arm along the reference at stages 1 …, (preview, actuators) in N.
        speed: speed of the reference's tip over the stages in m/s.
        rest_force: deviation of the forces that brings the tip to its target at rest, with the bias it has, (actuators,) in N.
        holding: forces that hold the points where they are displaced to, (actuators, 3 · points) in N/m.
        stage: the modal model at stage 0 over one stage.
        by_start, by_end: what deviations of the forces at start and end of a stage add to [e, e'], (2 · modes, actuators) in 1/N.
        free: deviation [e, e'] without forces at stages 0 …, (stages + 1, 2 · modes).
        rest: deviation [e, e'] at rest under `rest_force`, (2 · modes,).
        value: cost beyond the last stage by its state and forces, (2 · modes + actuators, 2 · modes + actuators).
        tip_answer: tip's error at stages 1 … stages − 1 by the forces at stages 1 …, (3 · (stages − 1), stages · actuators) in m/N; as of
            the last `hessian`.
        tip_free: tip's error there without these forces, (3 · (stages − 1),) in m; as of the last `gradient`.
    """

    def __init__(self, weights: Weights, stages: int) -> None:
        """A horizon without a present.

        Args:
            weights: of the cost.
            stages: how many.
        """
        self._weights, self.stages, self.is_blind = weights, stages, False
        self.value = np.zeros(0)
        self._before: Operating | None = None

    @property
    def weights(self) -> Weights:
        """Weights of the cost while the tip is seen, or while it is lost."""
        return replace(self._weights, tip=self._weights.blind_tip) if self.is_blind else self._weights

    def prepare(self, operating: Operating, reference: Reference, rows: np.ndarray) -> None:
        """Take a new present, of which no sample has been seen yet.

        Args:
            operating: modal model at stage 0, by control periods.
            reference: what is followed.
            rows: rows of the reference at stages −1, 0, 1, …, (stages + 3,) or more.
        """
        model, two = operating.model, operating.doubled()
        path = (reference.levels[rows] - model.levels) @ model.weights.T
        rate = (path[2:] - path[:-2]) / (2 * two.period)
        way = np.diff(reference.tips[rows[1 : self.stages + 2]], axis=0)
        self.speed = float(np.sqrt((way**2).sum(axis=1)).mean() / two.period)
        bend = (path[2:] - 2 * path[1:-1] + path[:-2]) / two.period**2
        drift = -bend - rate @ model.damping.T
        self.forces = reference.forces[rows[1:-1]]
        self._tip, self._others = model.observe[-3:], model.observe[:-3]
        self.holding = holding(model)
        self.dynamic = (-drift[1:] / model.stiffness) @ (self.holding @ model.observe).T
        self._model, self._rate = model, rate[0]
        self._pushed = two.start @ drift[: self.stages].T + two.end @ drift[1 : self.stages + 1].T
        self.stage, self.by_start, self.by_end = two, two.start @ model.drive, two.end @ model.drive
        self._turn(operating)

    def about(self, motion: np.ndarray, bias: np.ndarray) -> None:
        """Take what was seen.

        Args:
            motion: [q, q'] about the operating point at stage 0, (2 · modes,).
            bias: what the tip's position is off by in m, (3,).
        """
        count = len(self._rate)
        self.rest_force = against(self._model, bias)
        self.rest = np.concatenate([self._model.static(self.rest_force), np.zeros(count)])
        self.free = np.empty((self.stages + 1, 2 * count))
        self.free[0] = motion
        self.free[0, count:] -= self._rate
        for k in range(self.stages):
            self.free[k + 1] = self.stage.A @ self.free[k] + self._pushed[:, k]

    def _turn(self, operating: Operating) -> None:
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

    def pulses(self) -> Pulses:
        """States after pulses of the forces, with the modal model at stage 0."""
        states, inputs = self.by_start.shape
        first, later = np.empty((self.stages, states, inputs)), np.empty((self.stages, states, inputs))
        first[0], later[0] = self.by_start, self.by_end
        for k in range(1, self.stages):
            first[k], later[k] = self.stage.A @ first[k - 1], self.stage.A @ later[k - 1]
            if k == 1:
                later[k] += self.by_start
        return Pulses(first, later)

    def tip_errors(self, forces: np.ndarray | None) -> np.ndarray:
        """Distances of the tip from its targets at stages 1 … stages − 1 in m, as of the last `cost`.

        Args:
            forces: deviations at stages 1 …, (stages, actuators) in N; none where None.
        """
        error = self.tip_free if forces is None else self.tip_free + self.tip_answer @ forces.ravel()
        return np.linalg.norm(error.reshape(-1, 3), axis=1)

    def rows(self) -> np.ndarray:
        """Weighted errors of the points by modal deviations, (3 · points, modes), the tip's first."""
        return np.vstack([self._tip / self.weights.tip, self._others / self.weights.shape])

    def hessian(self, by: Responses) -> np.ndarray:
        """H of ½ vᵀ H v + fᵀ v for the deviations v of the forces at stages 1 …, (stages · actuators,), in N, which make `by`."""
        weights, inputs, size = self.weights, self.by_end.shape[1], by.errors.shape[1]
        tips = by.errors.reshape(self.stages - 1, -1, size)[:, :3].reshape(3 * self.stages - 3, size)
        self.tip_answer, end = weights.tip * tips, self._at_end(by)
        H = by.errors.T @ by.errors + end.T @ (self.value @ end)
        change, force = 1 / weights.change**2, 1 / weights.force**2
        diagonal = np.full(size, 2 * change + force)
        diagonal[-inputs:] = change  # the last one is in the cost beyond
        H[np.diag_indices(size)] += diagonal
        off = np.arange(size - inputs)
        H[off, off + inputs] -= change
        H[off + inputs, off] -= change
        return H

    def gradient(self, begin: np.ndarray, by: Responses, errors: np.ndarray, last: np.ndarray) -> np.ndarray:
        """f of the same program.

        Args:
            begin: the deviation at stage 0, (actuators,) in N.
            by: what the deviations make of the arm.
            errors, last: weighted errors and last state without the deviations at stages 1 …, as those of `by`.
        """
        weights, inputs = self.weights, len(begin)
        size = self.stages * inputs
        self.tip_free = weights.tip * errors.reshape(self.stages - 1, -1)[:, :3].ravel()
        at_end = np.concatenate([last - self.rest, -self.rest_force])
        f = by.errors.T @ errors + self._at_end(by).T @ (self.value @ at_end)
        f[:inputs] -= begin / weights.change**2
        f[: size - inputs] -= np.tile(self.rest_force, self.stages - 1) / weights.force**2
        return f

    def _at_end(self, by: Responses) -> np.ndarray:
        """State and deviation of the forces at the last stage by the deviations, (states + actuators, stages · actuators)."""
        states, inputs = self.by_end.shape
        end = np.zeros((states + inputs, by.last.shape[1]))
        end[:states], end[states:, -inputs:] = by.last, np.eye(inputs)
        return end


class Forecast(Protocol):
    """Prediction of the arm over the coming stages; what it stands on is its `horizon`."""

    @property
    def horizon(self) -> Horizon:
        """The coming stages."""
        ...

    def prepare(self, operating: Operating, reference: Reference, rows: np.ndarray) -> np.ndarray:
        """Take a new present, of which no sample has been seen yet; H of the program in the deviations of the forces.

        Args:
            operating: modal model at stage 0, by control periods.
            reference: what is followed.
            rows: rows of the reference at stages −1, 0, 1, …, (stages + 3,) or more.
        """
        ...

    def about(self, motion: np.ndarray, bias: np.ndarray) -> None:
        """Take what was seen.

        Args:
            motion: [q, q'] about the operating point at stage 0, (2 · modes,).
            bias: what the tip's position is off by in m, (3,).
        """
        ...

    def gradient(self, begin: np.ndarray) -> np.ndarray:
        """f of the program in the deviations of the forces, which are `begin`, (actuators,) in N, at stage 0; see `Horizon.gradient`."""
        ...

    def take(self, forces: np.ndarray | None) -> None:
        """Take note of a plan: deviations of the forces at stages 1 …, (stages, actuators) in N; None where there is none."""
        ...


class LinearForecast:
    """Prediction with one modal model, about the reference at stage 0.

    Attributes:
        horizon: the coming stages.
    """

    def __init__(self, weights: Weights, stages: int) -> None:
        """A forecast without a present.

        Args:
            weights: of the cost.
            stages: how many.
        """
        self.horizon = Horizon(weights, stages)
        behind = np.arange(stages - 1)[:, None] - np.arange(stages)  # of stages 1 … stages − 1 behind the forces of stages 1 …
        self._lags, self._later = np.maximum(behind, 0), behind >= 0

    def prepare(self, operating: Operating, reference: Reference, rows: np.ndarray) -> np.ndarray:
        """See `Forecast.prepare`."""
        self.horizon.prepare(operating, reference, rows)
        self._by = self._responses()
        return self.horizon.hessian(self._by)

    def about(self, motion: np.ndarray, bias: np.ndarray) -> None:
        """See `Forecast.about`."""
        self.horizon.about(motion, bias)

    def gradient(self, begin: np.ndarray) -> np.ndarray:
        """See `Forecast.gradient`."""
        horizon, modes = self.horizon, len(self.horizon.rest) // 2
        free = horizon.free[1:] + self._first @ begin
        error = (free[:-1, :modes] - horizon.rest[:modes]) @ horizon.rows().T
        return horizon.gradient(begin, self._by, error.ravel(), free[-1])

    def take(self, forces: np.ndarray | None) -> None:
        """Ignore the plan: this forecast is always about the reference."""

    def _responses(self) -> Responses:
        """What the forces at stages 1 … make of the arm."""
        horizon = self.horizon
        stages = horizon.stages
        states, inputs = horizon.by_start.shape
        pulses = horizon.pulses()
        first, later = pulses.first, pulses.later
        rows, modes = horizon.rows(), states // 2
        answer = rows @ later[: stages - 1, :modes]
        seen = np.where(self._later[:, :, None, None], answer[self._lags], 0.0)  # (stage, of stage, outputs, inputs)
        seen = seen.transpose(0, 2, 1, 3).reshape(-1, stages * inputs)
        self._first = first
        return Responses(seen, later[::-1].transpose(1, 0, 2).reshape(states, -1))
