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

from tepm_opt.control.estimation.kalman_filter import Operating
from tepm_opt.control.mpc.prediction import Horizon, Responses, Weights
from tepm_opt.control.references.reference import Reference
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

    def prepare(self, operating: Operating, reference: Reference, rows: np.ndarray) -> np.ndarray:
        """See `Forecast.prepare`; linearises along the last plan."""
        horizon, stages = self.horizon, self.horizon.stages
        horizon.prepare(operating, reference, rows)
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
        inputs = horizon.by_end.shape[1]
        forces = np.zeros((stages + 1, inputs, stages * inputs))
        forces[1:] = np.eye(stages * inputs).reshape(stages, inputs, -1)
        self._by, self._by_forces = self._responses(np.zeros((len(horizon.by_end), stages * inputs)), forces)
        return horizon.hessian(self._by)

    def about(self, motion: np.ndarray, bias: np.ndarray) -> None:
        """See `Forecast.about`."""
        self.horizon.about(motion, bias)

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

    def gradient(self, begin: np.ndarray) -> np.ndarray:
        """See `Forecast.gradient`."""
        horizon = self.horizon
        forces = np.zeros((horizon.stages + 1, len(begin), 1))
        forces[0, :, 0] = begin
        alone, self._free = self._responses(horizon.free[0][:, None], forces, True)
        return horizon.gradient(begin, self._by, alone.errors.ravel(), alone.last.ravel())

    def _responses(self, state: np.ndarray, forces: np.ndarray, driven: bool = False) -> tuple[Responses, np.ndarray]:
        """What forces (stages + 1, actuators, columns) in N make of the arm from states (2 · modes, columns) at stage 0.

        Args:
            state: at stage 0, in the modes there.
            forces: deviations from the reference's.
            driven: whether what drives the arm anyway and the errors' aim count, too.

        Returns:
            Errors and last state, and displacements of the points at stages 0 …, (stages + 1, 3 · points, columns) in m.
        """
        horizon, weights, modes = self.horizon, self.horizon.weights, len(state) // 2
        weighted, displaced, now, stage = [], [], self._operating, 0
        for stretch in self._stretches:
            then, model = stretch.operating, stretch.operating.model
            state, now = _turned(state, now, then), then
            scale = np.repeat([weights.shape, weights.tip], [len(model.observe) - 3, 3])[:, None]
            for pushed, after in zip(stretch.pushed[:-1], stretch.pushed[1:], strict=True):
                displaced.append(model.observe @ state[:modes])
                by_start, by_end = model.drive @ forces[stage], model.drive @ forces[stage + 1]
                if driven:
                    by_start[:, 0] += pushed
                    by_end[:, 0] += after
                state = then.A @ state + then.start @ by_start + then.end @ by_end
                error = model.observe @ state[:modes]
                if driven:
                    error[:, 0] -= model.observe @ model.static(horizon.rest_force)
                weighted.append(np.roll(error / scale, 3, axis=0))  # the tip first
                stage += 1
        displaced.append(now.model.observe @ state[:modes])
        last = _turned(state, now, self._operating)
        return Responses(np.concatenate(weighted[:-1]), last), np.array(displaced)

    def take(self, forces: np.ndarray | None) -> None:
        """Take note of the plan along which the next forecast is linearised; without one it is the reference."""
        self._displaced = None if forces is None else self._free[:, :, 0] + self._by_forces @ forces.ravel()


def _turned(state: np.ndarray, before: Operating, after: Operating) -> np.ndarray:
    """Deviations [e, e'] in columns, from the modes of one modal model to those of another."""
    turn, modes = after.seen_from(before)[0], len(state) // 2
    return np.concatenate([turn @ state[:modes], turn @ state[modes:]])
