"""Prediction with the network's nonlinearity: linearised along the last plan, not about the reference where the robot is now.

One step of sequential quadratic programming is taken in every control period, about the plan of the period before moved on in time: the
real-time iteration (Diehl, Bock, Schlöder, A real-time iteration scheme for nonlinear optimization in optimal feedback control, SIAM J.
Control Optim. 43, 2005), with the Gauss-Newton Hessian. The horizon is cut into stretches. In each the network is linearised about the
equilibrium at which its points are where the last plan has them; with e the deviation from the reference in the modes there,

    e'' + Δ e' + Ω e = B v + c − r'' − Δ r',      c = Ω e_0 − B δF,

where that equilibrium is e_0 from the reference's and takes axial forces that are δF from its.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tepm_opt.control.estimator import Operating
from tepm_opt.control.forecast import Horizon, Responses, Weights
from tepm_opt.control.reference import Reference
from tepm_opt.solvers.modal_model import modal_model
from tepm_opt.solvers.statics import Equilibrium, equilibrium

STRETCH = 3  # stages


@dataclass(frozen=True, eq=False)
class _Stretch:
    """Some stages: a modal model by stages, and modal forces that are there anyway at their ends, (stages + 1, modes)."""

    operating: Operating
    pushed: np.ndarray


class NonlinearForecast:
    """Prediction with a modal model for each stretch of the last plan.

    Attributes:
        horizon: the coming stages.
    """

    def __init__(self, weights: Weights, stages: int, damping: float = 1.0) -> None:
        """A forecast without a present.

        Args:
            weights: of the cost.
            stages: how many.
            damping: times the model's that is reckoned with.
        """
        self._damping = damping
        self.horizon = Horizon(weights, stages)
        self._displaced: np.ndarray | None = None  # of the points from the reference in the last plan, (stages + 1, 3 · points) in m

    def about(self, operating: Operating, reference: Reference, rows: np.ndarray, motion: np.ndarray, bias: np.ndarray) -> None:
        """See `Forecast.about`; linearises along the last plan."""
        horizon, stages = self.horizon, self.horizon.stages
        horizon.about(operating, reference, rows, motion, bias)
        self._operating, before = operating, operating.model
        self._stretches = []
        for first in range(0, stages, STRETCH):
            last = min(first + STRETCH, stages)
            middle = (first + last + 1) // 2
            at = reference.equilibria[rows[middle + 1]]
            there, change = self._planned(at, middle)
            before = model = modal_model(there, before).damped(self._damping)
            period, offset = horizon.stage.period, model.weights @ (model.levels - at.x[1:].ravel())
            path = reference.levels[rows[first : last + 3]] @ model.weights.T
            rate, bend = (path[2:] - path[:-2]) / (2 * period), (path[2:] - 2 * path[1:-1] + path[:-2]) / period**2
            pushed = model.stiffness * offset - model.drive @ change - bend - rate @ model.damping.T
            self._stretches.append(_Stretch(Operating.of(model, reference.forces[rows[middle + 1]] + change, period), pushed))

    def _planned(self, at: Equilibrium, stage: int) -> tuple[Equilibrium, np.ndarray]:
        """The equilibrium where the last plan has the points, and by what its axial forces differ from those of one on the reference."""
        holding, stages = self.horizon.holding, self.horizon.stages
        change = np.zeros(holding.shape[0])
        if self._displaced is None:
            return at, change
        moved = (self._displaced[stage] + self._displaced[min(stage + 1, stages)]) / 2  # half a stage later
        change = holding @ moved
        inputs = at.inputs + np.concatenate([np.maximum(change, 0.0) / at.model.values["A"], np.maximum(-change, 0.0)])
        found = equilibrium(at.model, inputs, at.loads, at, mapped=at.mapped, explain=False)
        return (found, change) if found.solved else (at, np.zeros(len(change)))

    def cost(self, begin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """H and f of the program; see `Forecast.cost`."""
        return self.horizon.cost(begin, self._responses(begin))

    def _responses(self, begin: np.ndarray) -> Responses:
        """What the forces at stages 1 … make of the arm, with `begin` at stage 0.

        Columns are what is without the forces at stages 1 …, then each of these.
        """
        horizon, weights, stages = self.horizon, self.horizon.weights, self.horizon.stages
        inputs, modes = len(begin), len(self._operating.model.stiffness)
        forces = np.zeros((stages + 1, inputs, 1 + stages * inputs))
        forces[0, :, 0] = begin
        forces[1:, :, 1:] = np.eye(stages * inputs).reshape(stages, inputs, -1)
        state = np.zeros((2 * modes, 1 + stages * inputs))
        state[:, 0] = horizon.free[0]
        weighted, displaced, now, stage = [], [], self._operating, 0
        for stretch in self._stretches:
            then, model = stretch.operating, stretch.operating.model
            state, now = _turned(state, now, then), then
            scale = np.repeat([weights.shape, weights.tip], [len(model.observe) - 3, 3])[:, None]
            rest = model.observe @ model.static(horizon.rest_force)
            for pushed, after in zip(stretch.pushed[:-1], stretch.pushed[1:], strict=True):
                displaced.append(model.observe @ state[:modes])
                by_start, by_end = model.drive @ forces[stage], model.drive @ forces[stage + 1]
                by_start[:, 0] += pushed
                by_end[:, 0] += after
                state = then.A @ state + then.start @ by_start + then.end @ by_end
                error = model.observe @ state[:modes]
                error[:, 0] -= rest
                weighted.append(np.roll(error / scale, 3, axis=0))  # the tip first
                stage += 1
        displaced.append(now.model.observe @ state[:modes])
        self._answers = np.array(displaced)
        seen, last = np.concatenate(weighted[:-1]), _turned(state, now, self._operating)
        return Responses(seen[:, 1:], seen[:, 0], last[:, 1:], last[:, 0])

    def take(self, forces: np.ndarray | None) -> None:
        """Take note of the plan along which the next forecast is linearised; without one it is the reference."""
        self._displaced = None if forces is None else self._answers @ np.append(1.0, forces.ravel())


def _turned(state: np.ndarray, before: Operating, after: Operating) -> np.ndarray:
    """Deviations [e, e'] in columns, from the modes of one modal model to those of another."""
    turn, modes = after.seen_from(before)[0], len(state) // 2
    return np.concatenate([turn @ state[:modes], turn @ state[modes:]])
