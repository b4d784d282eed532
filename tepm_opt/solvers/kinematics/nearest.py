"""The configuration within the limits whose tip is nearest to a target out of reach.

Sequential quadratic programming on the axial forces (Nocedal and Wright, Numerical Optimization, 2006, ch. 18): exact derivatives of
statics, the Gauss-Newton matrix of all errors as the first Hessian, damped BFGS updates of it, an l1 penalty, programs solved by DAQP.
Gauss-Newton alone would crawl: what is left of the distance at the nearest point bends the objective as much as the tip's motion does.
"""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_int
from dataclasses import dataclass, replace

import daqp
import numpy as np

from tepm_opt.models.backends.interface import LoadCase, Status
from tepm_opt.outcome import SOLVED, Ending, Outcome
from tepm_opt.solvers.kinematics.ik_problem import Balance, IkProblem
from tepm_opt.solvers.mechanics.statics import tell_weight

UNIT = 1e-2  # m, of errors; forces are in parts of their range: both programs and penalties are then of order 1
STEPS = 60  # of a search
NEWTON_STEPS = 40  # of statics on the way: what takes more has left its branch
HALVINGS = 12  # of a step, in which a shorter one has to lower the penalised objective
RADIUS = 0.5  # largest change of a force in a step, at first; later ones are at most twice as long as what the last one could take
RESTORATIONS = 10  # steps to where the constraints hold
STILL = 1e-8  # largest change of a force in a step at which a search ends
SAME = 0.05  # difference of forces below which a search ends where another has ended
EQUAL = 1e-7  # m, largest difference of lengths of an end
EXACT = 5  # DAQP's mark of a row that is an equality


def nearest(problem: IkProblem, target: np.ndarray) -> tuple[Balance, Outcome]:
    """The configuration within the limits whose tip is nearest to the target, SOLVED where it is there, OUT_OF_REACH or FAILED.

    The distance has local minima (a target below the base seen by the straight robot), so the search starts from several places,
    and the best end counts.
    """
    search, ends = _Search(problem, target), []
    for series in _starts(problem, target):
        x = problem.model.rest
        for part in series:
            if (start := search.evaluate(part, x)) is None:
                continue
            x = start.x
            if (end := search.run(start, ends)) is not None:
                ends.append(end)
    found = min(ends, key=lambda end: end.distance, default=None)
    if found is None:
        message = "no stable equal-curvature configuration within the limits was found"
        if not problem.idle.solved:
            message += f"; without inputs the robot is not stable either (it buckles under its weight or load){tell_weight(problem.model)}"
        return Balance(problem.middle, problem.balanced), Outcome(Ending.FAILED, message)
    there = found.distance < 100 * problem.settings.tolerance
    if there and problem.redundant:
        found = _Search(problem, target, least_norm=True).run(found, ()) or found
    return search.balance(found), SOLVED if there else Outcome(Ending.OUT_OF_REACH)


def _starts(problem: IkProblem, target: np.ndarray) -> list[list[np.ndarray]]:
    """Forces to start from, in parts of their ranges, in series whose statics start from rest and then from the one before.

    They are bends towards the target and to its sides, and the middle. A robot that does not stand with equal forces has stable
    configurations in regions of their own: it gets bends all around, and from each it is let go in steps.
    """
    robot, local, middle = problem.model.robot, problem.local(target), np.full(problem.half, 0.5)
    stands = problem.balanced.solved
    sizes, turns = ((0.45,), (0, 1, -1)) if stands else ((0.45, 0.3, 0.15, 0.0), (0, 1, -1, 2, -2, 3))
    angles = np.arctan2(local[1], local[0]) + np.array(turns) * np.pi / robot.actuators
    series = [[middle - size * np.tile(np.cos(robot.angles - angle), robot.modules) for size in sizes] for angle in angles]
    return [*series, [middle]] if stands else series


@dataclass(frozen=True, eq=False)
class _Point:
    """Forces in parts of their ranges, levels, errors in UNIT, their derivatives by the parts, and steps taken to it."""

    part: np.ndarray
    x: np.ndarray
    errors: np.ndarray
    jacobian: np.ndarray
    steps: int = 0

    @property
    def distance(self) -> float:
        """From the target in m."""
        return UNIT * float(np.linalg.norm(self.errors[:3]))


class _Search:
    """The nearest tip of equal curvature or, with `least_norm`, the smallest forces that have the tip at the target."""

    def __init__(self, problem: IkProblem, target: np.ndarray, least_norm: bool = False) -> None:
        self.problem, self.target, self.least_norm = problem, target, least_norm
        self.span, self.held = problem.high - problem.low, slice(0 if least_norm else 3, None)  # the errors that are constraints
        self.sense = np.zeros(problem.half + len(problem.weights[self.held]), dtype=c_int)
        self.sense[problem.half :] = EXACT

    def evaluate(self, part: np.ndarray, x: np.ndarray) -> _Point | None:
        """Evaluate the point of forces, its statics from levels x; None where they lead to no stable equilibrium."""
        problem, shared = self.problem, self.problem.shared
        case = LoadCase(problem.actuation(problem.low + part * self.span), True, shared.external, shared.theta)
        status, levels, observed, by_a = problem.model.statics.response(x, case, shared.weights, shared.force_tolerance, NEWTON_STEPS)
        if status != Status.SOLVED or observed[-problem.half :].min() < shared.shortest:
            return None
        errors = shared.weights @ observed
        errors[:3] -= self.target
        return _Point(part, levels, errors / UNIT, by_a[:, : problem.half] * (self.span / (problem.area * UNIT)))

    def objective(self, at: _Point) -> tuple[float, np.ndarray]:
        """Value and gradient of what is minimised."""
        if self.least_norm:
            forces = self.problem.low / self.span + at.part
            return 0.5 * float(forces @ forces), forces
        missed = at.errors[:3]
        return 0.5 * float(missed @ missed), at.jacobian[:3].T @ missed

    def run(self, at: _Point, ends: Sequence[_Point]) -> _Point | None:
        """The end of a search from a point; None where there is none or it comes to one of the `ends`."""
        penalty, radius, steps, kept = 1.0, RADIUS, 0, None
        hessian = np.eye(len(at.part)) if self.least_norm else at.jacobian.T @ at.jacobian
        hessian.flat[:: len(at.part) + 1] += 1e-6 * hessian.trace()
        for _ in range(STEPS):
            value, gradient = self.objective(at)
            missed, slopes = at.errors[self.held], np.ascontiguousarray(at.jacobian[self.held])
            step, multipliers, met = self._program(hessian, gradient, missed, slopes, at.part, radius)
            wrong, longest = float(np.abs(missed).sum()), float(np.abs(step).max())
            penalty = max(penalty, 1.5 * float(np.abs(multipliers).max(initial=0.0)))
            slope = float(gradient @ step) - penalty * met * wrong
            if longest < STILL or slope > -1e-14 * (1 + value):
                break
            merit, t = value + penalty * wrong, 1.0
            for _ in range(HALVINGS):
                trial = self.evaluate(np.minimum(np.maximum(at.part + t * step, 0.0), 1.0), at.x)
                if trial is not None:
                    there = self.objective(trial)
                    if there[0] + penalty * float(np.abs(trial.errors[self.held]).sum()) <= merit + 1e-4 * t * slope:
                        break
                t /= 2
            else:
                break
            moved = trial.part - at.part
            turned = there[1] - gradient + (trial.jacobian[self.held] - slopes).T @ multipliers
            if UNIT * np.abs(missed).max(initial=0.0) < EQUAL:
                kept = at
            at, steps, radius = trial, steps + 1, min(RADIUS, 2 * (t * longest if t < 1 else radius))
            _update(hessian, moved, turned)
            if any(np.abs(at.part - end.part).max() < SAME for end in ends):
                return None
        end = self._restore_constraints(at) or kept
        return None if end is None else replace(end, steps=steps)

    def _restore_constraints(self, at: _Point) -> _Point | None:
        """Move a point to one nearby that meets the constraints, or None: where the stable branch ends, a search ends before it does."""
        for _ in range(RESTORATIONS):
            missed, slopes = at.errors[self.held], np.ascontiguousarray(at.jacobian[self.held])
            wrong = np.abs(missed).max(initial=0.0)
            if UNIT * wrong < EQUAL:
                return at
            step, _, _ = self._program(np.eye(len(at.part)), np.zeros(len(at.part)), missed, slopes, at.part, RADIUS)
            for part in 0.5 ** np.arange(HALVINGS):
                trial = self.evaluate(np.minimum(np.maximum(at.part + part * step, 0.0), 1.0), at.x)
                if trial is not None and np.abs(trial.errors[self.held]).max() < wrong:
                    break
            else:
                return None
            at = trial
        return None

    def _program(
        self, hessian: np.ndarray, gradient: np.ndarray, missed: np.ndarray, slopes: np.ndarray, part: np.ndarray, radius: float
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Step, multipliers of the constraints, and the part of the constraints' errors that it takes away."""
        low, high = np.maximum(-part, -radius), np.minimum(1.0 - part, radius)
        for met in (1.0, 0.5, 0.1, 0.0):
            upper, lower = np.concatenate([high, -met * missed]), np.concatenate([low, -met * missed])
            step, _, flag, info = daqp.solve(hessian, gradient, slopes, upper, lower, self.sense, primal_tol=1e-9)
            if flag == 1:
                return step, info["lam"][len(part) :], met
        return np.zeros(len(part)), np.zeros(len(missed)), 0.0

    def balance(self, at: _Point) -> Balance:
        """A point with its equilibrium."""
        forces = self.problem.low + at.part * self.span
        return Balance(forces, self.problem.solve_equilibrium(forces, replace(self.problem.idle, x=at.x)), at.steps)


def _update(hessian: np.ndarray, moved: np.ndarray, turned: np.ndarray) -> None:
    """Damped BFGS update in place (Powell 1978): positive definite whatever the curvature along `moved`."""
    pulled = hessian @ moved
    along, met = float(moved @ pulled), float(moved @ turned)
    if met < 0.2 * along:
        turned = pulled + 0.8 * along / (along - met) * (turned - pulled)
        met = 0.2 * along
    hessian += turned[:, None] * turned / met - pulled[:, None] * pulled / along
