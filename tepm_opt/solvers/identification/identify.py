"""Parameters of a model from measured runs: bounded Gauss-Newton on simulated sensitivities, with what the runs cannot tell."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.identification.problem import Problem
from tepm_opt.solvers.identification.residuals import Residual, apply_weights, normal_equations
from tepm_opt.solvers.mechanics.plant import Plant, PredictionError
from tepm_opt.solvers.numerics.least_squares import bounded_step
from tepm_opt.solvers.numerics.text import html_table

ITERATIONS = 15
MAD = 1.4826  # of a normal distribution's median absolute deviation
TRIES = 3  # steps tried, with those that leave more, for each one allowed
HOPE = 2.0  # how many times what a step promises to first order a fit may still gain
OUT_OF_REACH = "a rival cannot be reached any more"
FACTOR = 4.0  # by which what is above 0 changes at most in a step: a time or a distance does not leap past its best
INSIDE = 0.5  # of its scale by which a parameter is moved off a bound near which it changes nothing
SHORTEST = 2.0**-12  # part of a step that is tried where the model cannot do the runs at its end


@dataclass(frozen=True, eq=False)
class ParameterEstimate:
    """Parameters found.

    Attributes:
        problem: what was fitted.
        values: (parameters,), SI.
        covariance: (parameters, parameters), including the priors; robust against residuals that are not white.
        residuals: measured less modelled of every run at the values, with their derivatives by the parameters.
        cost: sum of the (weighted) squares over the noise.
        iterations: Gauss-Newton steps.
        information: Fisher information of the runs alone, (parameters, parameters), in the parameters' scales.
        outcome: SOLVED where the steps ended by themselves, else NOT_CONVERGED; its message says how they ended.
    """

    problem: Problem
    values: np.ndarray
    covariance: np.ndarray
    residuals: list[Residual]
    cost: float
    iterations: int
    information: np.ndarray
    outcome: Outcome

    def __repr__(self) -> str:
        """The outcome and the main numbers, in a line."""
        ratio = np.sqrt(self.cost / max(self.count, 1))
        return f"ParameterEstimate({self.outcome.ending}, {len(self.values)} parameters, residuals {ratio:.3g} times the noise)"

    def _repr_html_(self) -> str:
        """The parameters with their standard deviations, as a table."""
        rows = [
            (free.name, f"{value:.6g}", f"{std:.2g}", free.unit, "at its bound" if bound else "")
            for free, value, std, bound in zip(self.problem.free, self.values, self.std, self.at_bound, strict=True)
        ]
        return f"<p>{escape(str(self.outcome))}</p>" + html_table(("parameter", "value", "standard deviation", "unit", ""), rows)

    @property
    def solved(self) -> bool:
        """Whether the steps ended by themselves."""
        return self.outcome.solved

    @property
    def out_of_reach(self) -> bool:
        """Whether the steps ended because a rival could not be reached any more."""
        return self.outcome.message == OUT_OF_REACH

    @property
    def std(self) -> np.ndarray:
        """Standard deviations, (parameters,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def named(self) -> dict[str, float]:
        """Values by full name."""
        return {free.name: float(value) for free, value in zip(self.problem.free, self.values, strict=True)}

    @property
    def plant(self) -> Plant:
        """The model with the values found."""
        return self.problem.with_values(self.values)

    @property
    def at_bound(self) -> np.ndarray:
        """Whether each parameter ended at a bound, (parameters,)."""
        problem, margin = self.problem, 1e-6 * self.problem.scale
        return (self.values <= problem.low + margin) | (self.values >= problem.high - margin)

    @property
    def count(self) -> int:
        """Coordinates measured."""
        return sum(residual.count for residual in self.residuals)


def identify(
    problem: Problem, max_iterations: int = ITERATIONS, progress: Progress = silent, tolerance: float = 1e-5, reached: float = np.inf,
    near: bool = False,
) -> ParameterEstimate:  # fmt: skip
    """Least squares by Gauss-Newton steps within the bounds, damped where they fail (Levenberg-Marquardt; Nocedal and Wright 2006, ch. 10).

    A step to values at which the model cannot do the runs (they are unstable, or have no equilibrium) is shortened until it can; the steps
    after it grow again.

    Args:
        problem: what to fit.
        max_iterations: most steps. One that leaves more does not count where it is simulated without derivatives; `TRIES` times as many
            are tried at most.
        progress: told of every step.
        tolerance: part of the squared residuals beyond the noise for which no further step is made.
        reached: cost that a rival has: no further step is made where `HOPE` times what it promises would leave more.
        near: whether the first values are so good that derivatives there serve for all steps and for the estimate.

    Raises:
        InputError: no runs, no parameters or no measured sample.
        PredictionError: the model cannot do the runs with the first values.
    """
    if not problem.runs or not sum(np.isfinite(run.points).sum() for run in problem.runs):
        raise InputError("nothing to fit to: no run with a measured sample")
    values = np.clip(problem.start, problem.low, problem.high)
    at = _Iterate(problem, values, problem.residuals(values), near, near or problem.sparse is not problem)
    damping, done, tried_steps, message, converged = 1e-6, 0, 0, "steps ended", not problem.free
    count, part = sum(r.count for r in at.residuals), 1.0
    while done < max_iterations and tried_steps < TRIES * max_iterations and not converged:
        step, promised = at.compute_step(damping)
        if promised < 0.1 + tolerance * max(at.cost - count, 0.0):
            converged, message = True, "no step promises less"
            break
        if at.cost - HOPE * promised > reached:
            message = OUT_OF_REACH
            break
        tried_steps += 1
        tried, part, failure = _try_step(problem, at.values, step, part, at.residuals if at.keeps else None)
        new = np.inf if tried is None else _cost(problem, at.values + part * step, tried, at.weights)
        if tried is not None and new < at.cost:
            done += 1
            gained = (at.cost - new) / (promised * part * (2 - part))
            at, part = at.advance(part * step, tried), min(4 * part, 1.0)
            damping = damping / 10 if gained > 0.25 else damping * 3
        else:
            damping, part, message = max(10 * damping, 1e-3), 1.0, failure or message
            done += 0 if at.keeps else 1  # without derivatives it cost little
            if damping > 1e6:
                converged, message = bool(np.isfinite(new)), failure or "no shorter step helps"
                break
        progress("fit", done, max_iterations)
    return at.estimate(done, Outcome(Ending.SOLVED if converged else Ending.NOT_CONVERGED, message))


def compute_cost(problem: Problem, values: np.ndarray) -> float:
    """Sum of the (weighted) squares over the noise, with the priors', of values, (parameters,), simulated without derivatives.

    Raises:
        PredictionError: the model cannot do a run with these values.
    """
    residuals = problem.residuals(values, ())
    return _cost(problem, values, residuals, _weights(residuals, problem.robust))


@dataclass(frozen=True, eq=False)
class _Iterate:
    """Values on the way of a fit.

    Attributes:
        problem: what is fitted.
        values: of the free parameters, (parameters,).
        residuals: at the values, with derivatives.
        near: whether the first derivatives serve for all steps.
        keeps: whether residuals are simulated without derivatives at first.
    """

    problem: Problem
    values: np.ndarray
    residuals: list[Residual]
    near: bool
    keeps: bool

    @cached_property
    def weights(self) -> list[np.ndarray | None]:
        """Square roots of Huber's weights, of the residuals' shape; None for all 1."""
        return _weights(self.residuals, self.problem.robust)

    @cached_property
    def cost(self) -> float:
        """Sum of the weighted squares over the noise, with the priors'."""
        return _cost(self.problem, self.values, self.residuals, self.weights)

    def compute_step(self, damping: float) -> tuple[np.ndarray, float]:
        """Damped Gauss-Newton step, (parameters,), and the squares that it promises to remove."""
        problem, values = self.problem, self.values
        square, slope = normal_equations(self.residuals, self.weights)
        mean, precision = problem.prior
        square, slope = square + precision, slope + precision @ (values - mean)
        low, high = problem.low, problem.high
        nearest, farthest = (
            np.where(low > 0, np.maximum(low, values / FACTOR), low),
            np.where(low > 0, np.minimum(high, values * FACTOR), high),
        )
        return bounded_step(square, slope, nearest - values, farthest - values, problem.scale, damping)

    def advance(self, step: np.ndarray, tried: list[Residual]) -> _Iterate:
        """The next one, behind a step; residuals tried without derivatives get them now."""
        values = self.values + step
        return replace(self, values=values, residuals=self.problem.differentiate(values, tried) if self.keeps and not self.near else tried)

    def estimate(self, steps: int, outcome: Outcome) -> ParameterEstimate:
        """The result, after so many steps."""
        problem = self.problem
        residuals = _differentiate_inside(problem, self.values, self.residuals)
        square, _ = normal_equations(residuals)
        information, covariance = square * np.outer(problem.scale, problem.scale), _covariance(problem, residuals, self.weights)
        return ParameterEstimate(problem, self.values, covariance, residuals, self.cost, steps, information, outcome)


def _differentiate_inside(problem: Problem, values: np.ndarray, residuals: list[Residual]) -> list[Residual]:
    """Residuals with derivatives a little inside a bound by what changes nothing at it, where a parameter has been moved to that bound.

    A tendon that has lost its whole tension pulls no less by losing more, but would by losing less. Where the model cannot be simulated
    there, derivatives stay as they are.
    """
    means, count, margin = np.array([free.prior_mean for free in problem.free]), len(problem.free), INSIDE * problem.scale
    blind = sum((np.sum(r.by**2, axis=0) for r in residuals), start=np.zeros(count)) * problem.scale**2 < 1
    inside = np.clip(values, problem.low + margin, problem.high - margin)
    moved = blind & (inside != values) & (np.abs(values - means) > margin)
    if not moved.any():
        return residuals
    with suppress(PredictionError):
        there = problem.residuals(np.where(moved, inside, values))
        return [replace(r, by=np.where(blind, other.by, r.by)) for r, other in zip(residuals, there, strict=True)]
    return residuals


def _try_step(
    problem: Problem, values: np.ndarray, step: np.ndarray, part: float, known: list[Residual] | None
) -> tuple[list[Residual] | None, float, str]:
    """Residuals at the end of a step, or of the longest half, quarter, … of it that the model can do.

    Args:
        problem: what is fitted.
        values: of the parameters where the step begins, (parameters,).
        step: their change, (parameters,).
        part: of it to try first.
        known: residuals whose derivatives serve instead of new ones; None for none.

    Returns:
        Residuals (None where the model can do no part of the step), the part, and why a longer one could not be done.
    """
    failure = ""
    while part >= SHORTEST:
        try:
            tried = problem.residuals(values + part * step, None if known is None else [])
        except PredictionError as error:
            part, failure = part / 2, str(error)
        else:
            return ([replace(after, by=r.by) for after, r in zip(tried, known, strict=True)] if known is not None else tried), part, failure
    return None, part, failure


def _weights(residuals: list[Residual], robust: bool) -> list[np.ndarray | None]:
    """Square roots of Huber's weights, of the residuals' shape; None for all 1."""
    if not robust:
        return [None] * len(residuals)
    sizes = np.concatenate([np.abs(r.values[r.present]) for r in residuals])
    limit = 4 * max(MAD * float(np.median(sizes)), 1.0)
    return [np.sqrt(limit / np.maximum(np.abs(r.values), limit)) for r in residuals]


def _cost(problem: Problem, values: np.ndarray, residuals: list[Residual], weights: list[np.ndarray | None]) -> float:
    mean, precision = problem.prior
    return float((values - mean) @ precision @ (values - mean)) + float(
        sum(np.sum((r.values if w is None else r.values * w) ** 2) for r, w in zip(residuals, weights, strict=True))
    )


def _covariance(problem: Problem, residuals: list[Residual], weights: list[np.ndarray | None]) -> np.ndarray:
    """Sandwich: curvature and priors outside, scores summed over blocks of time inside (White, Econometrica 50, 1982)."""
    scale, count = problem.scale, len(problem.free)
    if not count:
        return np.zeros((0, 0))
    known = np.diag((scale / np.array([free.spread for free in problem.free])) ** 2)
    known_scores = known
    if problem.joint is not None:
        shared = problem.joint.terms(problem.free)[1] * np.outer(scale, scale)
        told = np.outer(np.diag(shared) > 0, np.diag(shared) > 0)
        known, known_scores = np.where(told, shared, known), np.where(told, problem.joint.weight * shared, known)
    square, meat = np.zeros((count, count)), np.zeros((count, count))
    for r, w in zip(residuals, weights, strict=True):
        values, by = apply_weights(r, w)
        rows = len(r.values)
        square += by.T @ by
        scores = np.stack([np.bincount(r.block, (slope * values).reshape(rows, -1).sum(axis=1)) for slope in by.T], axis=1)
        meat += scores.T @ scores
    square, meat = square * np.outer(scale, scale), meat * np.outer(scale, scale)
    inverse = np.linalg.pinv(square + known, hermitian=True)
    return _at_least(inverse @ (meat + known_scores) @ inverse, inverse) * np.outer(scale, scale)


def _at_least(covariance: np.ndarray, least: np.ndarray) -> np.ndarray:
    """A covariance that in no direction is smaller than another one, here than what white noise alone leaves."""
    size, axes = np.linalg.eigh(least)
    root = axes * np.sqrt(np.maximum(size, 0.0))  # root @ root.T is `least`
    whitened = np.linalg.pinv(root)
    ratio, directions = np.linalg.eigh(whitened @ covariance @ whitened.T)
    root = root @ directions
    return (root * np.maximum(ratio, 1.0)) @ root.T
