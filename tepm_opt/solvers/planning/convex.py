"""Solves the program of a plan as a sequence of quadratic ones: each linearised about the motion of the last, in a region of trust.

Rows may be broken at a price, as in Fletcher's S l1 QP (Practical Methods of Optimization, 1987, section 14.4): every program has a
solution, and price and effort together tell a better motion from a worse one. The Hessian is Gauss and Newton's. DAQP solves the programs
(Arnström, Bemporad, Axehill, IEEE TAC 67(8), 2022, p. 4362), each from the active set of the last.
"""

from __future__ import annotations

import time
from ctypes import c_int
from dataclasses import dataclass, replace

import daqp
import numpy as np

from tepm_opt.outcome import Ending, Outcome
from tepm_opt.solvers.planning.linearised import Program, Rows
from tepm_opt.solvers.planning.program import PlannedMotion, PlanTask

LONGEST, SHORTEST = 60.0, 0.05  # s
SPACING = 0.02  # s, between instants at which rows are kept
PRICE = 0.1  # of a broken row by one unit of it, beside an objective of about 1
DEARER, DEAREST = 10.0, 100.0  # while rows stay broken it is raised by this factor, up to this
SOFT = 8  # DAQP's mark of such a row
FIRST, LONGER, WRONG = 0.15, 1.4, 8.0  # s: shortest guess of a duration, made longer until no row is broken by more
TRUST, SMALLEST_TRUST = 1.0, 1e-5  # of the lengths in their box
STRETCH = 0.5  # of the duration's logarithm, beside the same of the lengths
SURE, DOUBTFUL = 0.7, 0.2  # parts of the foreseen gain from which the region grows, and up to which it shrinks
CLOSE = 5e-6  # foreseen gain, as a part of what there is, at which a motion is the best
KEPT = 2e-3  # by which rows may be broken
CURVED = 1e-7  # least curvature of the programs, beside the largest


@dataclass(frozen=True, eq=False)
class _Iterate:
    """Unknowns of the program, (unknowns,), and the program linearised about them."""

    x: np.ndarray
    rows: Rows


@dataclass(frozen=True, eq=False)
class _Merit:
    """Merit to be minimised: duration or none, effort with its weight, and broken rows with their price."""

    program: Program
    weight: float
    price: float

    def evaluate(self, at: _Iterate) -> float:
        """Merit of an iterate."""
        least = float(np.exp(at.x[0])) if self.program.task.duration is None else 0.0
        beyond, residuals = at.rows.beyond, at.rows.residuals
        return least + self.weight / 2 * float(residuals @ residuals) + self.price * float(beyond.sum()) + float(beyond @ beyond) / 2


def solve(task: PlanTask, bulge: np.ndarray | None = None) -> PlannedMotion:
    """The fastest motion from rest to rest or, with a duration, the one of least effort.

    Args:
        task: what about.
        bulge: of the first guess to one side, (3,) in y.
    """
    began = time.perf_counter()
    duration = task.duration or _first(task, bulge)
    program = Program(task, duration / SPACING)
    x = program.guess(duration, bulge)
    at = _Iterate(x, program.linearise(x))
    trust, count, multipliers = TRUST, 0, None
    weight = 2 * task.effort_weight if task.duration is None else 2 / max(float(at.rows.residuals @ at.rows.residuals), 1e-3)
    merit = _Merit(program, weight, PRICE)
    why = ""
    while count < task.max_iterations:
        count += 1
        step, gain, multipliers = _find_step(merit, at, trust, multipliers)
        if step is None:
            why = "a quadratic program failed"
            break
        if gain < CLOSE * merit.evaluate(at) or trust < SMALLEST_TRUST:
            if float(at.rows.beyond.max()) <= KEPT or merit.price >= DEAREST:
                break
            # breaking rows was cheaper than keeping them (Nocedal and Wright, section 18.5)
            merit, trust = replace(merit, price=DEARER * merit.price), TRUST
            continue
        there, real = _take_step(merit, at, step)
        if real < SURE * gain:  # the rows are curved: once more with what they missed (Fletcher's second-order correction)
            rows, tried = at.rows, there.rows
            bent = replace(rows, values=tried.values - rows.slopes @ step, residuals=tried.residuals - rows.residual_slopes @ step)
            again, _, _ = _find_step(merit, _Iterate(at.x, bent), trust, multipliers)
            if again is not None:
                second = _take_step(merit, at, again)
                if second[1] > real:
                    step, (there, real) = again, second
        if real > DOUBTFUL * gain:
            if real > SURE * gain:
                trust = min(2 * trust, TRUST)
        else:
            trust = min(trust, max(float(np.abs(step[1 : 1 + program.places]).max()), 1e-3)) / 4
        if real > 0:
            at = there
    else:
        why = f"{count} quadratic programs were not enough"
    if not why and (beyond := float(at.rows.beyond.max())) > KEPT:
        why = f"limits stay broken by {beyond:.2g} of their unit"
    duration, place, air = program.splines(at.x)
    outcome = Outcome(Ending.NOT_CONVERGED, why) if why else Outcome()
    return PlannedMotion(duration, place, task.route, air, outcome, count, time.perf_counter() - began)


def _first(task: PlanTask, bulge: np.ndarray | None) -> float:
    """A first guess of the duration in s, rather too short: from there it goes quickest."""
    plain, duration = Program(replace(task, limits=replace(task.limits, frequencies=()))), FIRST
    while duration < LONGEST / LONGER and float(plain.linearise(plain.guess(duration, bulge)).beyond.max()) > WRONG:
        duration *= LONGER
    if task.limits.frequencies and float((full := Program(task)).linearise(full.guess(duration, bulge)).beyond.max()) > WRONG:
        return max(duration, *(2 * np.pi / frequency for frequency in task.limits.frequencies))
    return duration


def _take_step(merit: _Merit, at: _Iterate, step: np.ndarray) -> tuple[_Iterate, float]:
    """End of a step, and its gain."""
    there = _Iterate(at.x + step, merit.program.linearise(at.x + step))
    return there, merit.evaluate(at) - merit.evaluate(there)


def _find_step(
    merit: _Merit, at: _Iterate, trust: float, multipliers: np.ndarray | None
) -> tuple[np.ndarray | None, float, np.ndarray | None]:
    """Step of the program linearised, the gain it foresees, and its multipliers; None where the solver failed.

    Args:
        merit: of the program.
        at: from where.
        trust: of the lengths.
        multipliers: of the program before.
    """
    program, weight, x, rows = merit.program, merit.weight, at.x, at.rows
    task, inner = program.task, slice(1, 1 + program.places)
    hessian = weight * rows.residual_slopes.T @ rows.residual_slopes
    gradient = weight * rows.residual_slopes.T @ rows.residuals
    low, high = np.full(len(x), -1e3), np.full(len(x), 1e3)
    bound = 1.0 if task.route is None else np.inf
    low[inner], high[inner] = np.maximum(-bound - x[inner], -trust), np.minimum(bound - x[inner], trust)
    if task.duration is None:
        duration = float(np.exp(x[0]))
        gradient[0] += duration
        hessian[0, 0] += duration
        low[0], high[0] = max(np.log(SHORTEST) - x[0], -STRETCH * trust), min(np.log(LONGEST) - x[0], STRETCH * trust)
    else:
        low[0] = high[0] = 0.0
    hessian[np.diag_indices(len(x))] += CURVED * max(float(hessian.diagonal().max()), 1e-3)
    sense = np.concatenate([np.zeros(len(x)), np.full(len(rows.values), SOFT)]).astype(c_int)
    upper, lower = np.concatenate([high, rows.high - rows.values]), np.concatenate([low, rows.low - rows.values])
    upper, lower = np.minimum(upper, 1e30), np.maximum(lower, -1e30)
    solver = daqp.Model()
    if solver.setup(hessian, gradient, rows.slopes, upper, lower, sense, dual_start=multipliers)[0] < 0:
        return None, 0.0, None
    ones = np.ones(len(sense))
    solver.soft_weights(rho_l=ones, rho_u=ones, w_l=merit.price * ones, w_u=merit.price * ones)
    step, _, flag, info = solver.solve()
    if flag < 1 or not np.isfinite(step).all():
        return None, 0.0, None
    step = np.clip(step, low, high)
    moved = replace(rows, values=rows.values + rows.slopes @ step, residuals=rows.residuals + rows.residual_slopes @ step)
    part = 1 + step[0] + step[0] ** 2 / 2 - np.exp(step[0])  # of the duration, that the quadratic program does not see
    unseen = float(np.exp(x[0]) * part) if task.duration is None else 0.0
    gain = merit.evaluate(at) - merit.evaluate(_Iterate(x + step, moved)) - unseen
    return step, gain, info["lam"]
