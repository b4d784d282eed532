"""The point within the limits that is nearest to a target out of reach."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.optimize import minimize

from tepm_opt.outcome import SOLVED, Ending, Outcome
from tepm_opt.solvers.ik_problem import Balance, IkProblem
from tepm_opt.solvers.statics import Equilibrium


def nearest(problem: IkProblem, target: np.ndarray) -> tuple[Balance, Outcome]:
    """The configuration within the limits whose tip is nearest to the target.

    The distance has local minima (a target below the base seen by the straight robot), so the search starts from the middle of
    the forces and from bends towards the target and to its sides, and the best end counts.
    """
    robot = problem.model.robot
    local = problem.local(target)
    middle, half_range = (problem.low + problem.high) / 2, (problem.high - problem.low) / 2
    towards = np.arctan2(local[1], local[0]) + np.array([0.0, 1.0, -1.0]) * np.pi / robot.actuators
    bends = [middle - 0.9 * half_range * np.tile(np.cos(robot.angles - angle), robot.modules) for angle in towards]
    ends = [_constrained(problem, target, forces) for forces in (middle, *bends)]
    found = min((end for end in ends if end), key=lambda end: float(np.linalg.norm(end[0].equilibrium.tip - target)), default=None)
    if found and found[1].solved and problem.redundant:
        return _constrained(problem, target, found[0].forces, least_norm=True) or found
    if found:
        return found
    message = "no stable equal-curvature configuration within the limits was found"
    if not problem.at(np.zeros(problem.half), None).solved:
        message += "; without inputs the robot is not stable either (it buckles under its weight or load)"
    return Balance(middle, problem.at(middle, None)), Outcome(Ending.FAILED, message)


def _constrained(problem: IkProblem, target: np.ndarray, forces: np.ndarray, least_norm: bool = False) -> tuple[Balance, Outcome] | None:
    """Within the limits and with equal curvature: the nearest tip, or, with `least_norm`, the smallest forces at the target."""
    scale, span = 1e-2, problem.high - problem.low  # errors in cm, forces in parts of their range
    held = 0 if least_norm else 3  # first of the errors that are constraints
    start = np.clip((forces - problem.low) / span, 0.0, 1.0)
    last = problem.at(problem.low + start * span, None)

    @lru_cache(maxsize=4)  # SLSQP asks for value and derivatives at the same point, one after the other
    def evaluate(part: bytes) -> tuple[Equilibrium, np.ndarray, np.ndarray]:
        nonlocal last
        last = problem.at(problem.low + np.frombuffer(part) * span, last)
        return last, problem.errors(last, target) / scale, problem.jacobian(last) * span / scale

    def errors(part: np.ndarray) -> np.ndarray:
        return evaluate(part.tobytes())[1]

    def jacobian(part: np.ndarray) -> np.ndarray:
        return evaluate(part.tobytes())[2]

    def objective(part: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = (problem.low / span + part, np.eye(len(part))) if least_norm else (errors(part)[:3], jacobian(part)[:3])
        return 0.5 * float(value @ value), slope.T @ value

    try:
        result = minimize(
            objective,
            start,
            jac=True,
            bounds=[(0.0, 1.0)] * len(forces),
            constraints={"type": "eq", "fun": lambda part: errors(part)[held:], "jac": lambda part: jacobian(part)[held:]},
            method="SLSQP",
            options={"maxiter": 200, "ftol": 1e-12},
        )
        part = np.clip(result.x, 0.0, 1.0)
        at, missed, _ = evaluate(part.tobytes())
    except np.linalg.LinAlgError:
        return None
    if not at.solved or scale * np.abs(missed[3:]).max(initial=0.0) > 1e-7:
        return None
    there = scale * np.abs(missed[:3]).max() < 100 * problem.settings.tolerance
    return Balance(problem.low + part * span, at, int(result.nit)), SOLVED if there else Outcome(Ending.OUT_OF_REACH)
