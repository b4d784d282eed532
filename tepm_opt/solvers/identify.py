"""Parameters of a model from measured runs: bounded Gauss-Newton on simulated sensitivities, with what the runs cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape

import numpy as np

from tepm_opt.data.run import Run, spaced
from tepm_opt.errors import InputError
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.least_squares import bounded_step
from tepm_opt.solvers.parallel import in_parallel
from tepm_opt.solvers.plant import START, Free, Plant, PredictionError
from tepm_opt.solvers.prior import JointPrior
from tepm_opt.solvers.residuals import BLOCK, Residual, normal_equations, weighted
from tepm_opt.solvers.start import begun, without_start
from tepm_opt.solvers.text import html_table, listed

ITERATIONS = 15
MAD = 1.4826  # of a normal distribution's median absolute deviation
HOPE = 2.0  # how many times what a step promises to first order a fit may still gain
OUT_OF_REACH = "a rival cannot be reached any more"
FACTOR = 4.0  # by which what is above 0 changes at most in a step: a time or a distance does not leap past its best
SHORTEST = 2.0**-12  # part of a step that is tried where the model cannot do the runs at its end


@dataclass(frozen=True, eq=False)
class Problem:
    """What to fit to what.

    Attributes:
        plant: a model of the machine; its values hold for all that is not free.
        runs: to fit to.
        free: the parameters to be found.
        noise: of a coordinate, 1 sigma in m, or of each point, (points, 1); of all runs alike or of each.
        robust: whether outliers are weighted down (Huber's loss at 4 robust standard deviations of the residuals).
        step: longest time step of the simulations in s.
        derivatives_apart: time in s between the samples at which derivatives are taken, with straight lines between them; 0 takes them at
            every sample. Derivatives of a motion are smooth: 0.04 s leaves errors of 0.2 % as a rule, of some % where inputs jump.
        block: time in s after which residuals count as independent.
        joint: prior of several parameters together, besides those that each has for itself; None for none.
    """

    plant: Plant
    runs: tuple[Run, ...]
    free: tuple[Free, ...]
    noise: float | np.ndarray | tuple[float | np.ndarray, ...]
    robust: bool = False
    step: float = np.inf
    derivatives_apart: float = 0.0
    block: float = BLOCK
    joint: JointPrior | None = None

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Problem({len(self.runs)} runs, free: {listed([free.name for free in self.free]) or 'nothing'})"

    def with_values(self, values: np.ndarray) -> Plant:
        """The model with these values of the free parameters."""
        return self.plant.with_values({free.name: float(value) for free, value in zip(self.free, values, strict=True)})

    @property
    def start(self) -> np.ndarray:
        """First values, (parameters,)."""
        return np.array([free.start for free in self.free])

    @property
    def low(self) -> np.ndarray:
        """Lower bounds, (parameters,)."""
        return np.array([free.low for free in self.free])

    @property
    def high(self) -> np.ndarray:
        """Upper bounds, (parameters,)."""
        return np.array([free.high for free in self.free])

    @property
    def scale(self) -> np.ndarray:
        """Small but visible changes, (parameters,)."""
        return np.array([free.scale for free in self.free])

    @property
    def prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean μ, (parameters,), and precision Λ, (parameters, parameters), of the normal priors: they cost (θ - μ)ᵀ Λ (θ - μ)."""
        mean = np.array([free.prior_mean for free in self.free])
        precision = np.diag(np.array([free.prior_std for free in self.free]) ** -2.0)
        if self.joint is None:
            return mean, precision
        shared, more = self.joint.terms(self.free)
        told = np.diag(more) > 0  # what earlier data tell includes what was known before them
        return np.where(told, shared, mean), np.where(np.outer(told, told), more, precision)

    @property
    def noises(self) -> tuple[float | np.ndarray, ...]:
        """Noise of each run."""
        return self.noise if isinstance(self.noise, tuple) else (self.noise,) * len(self.runs)

    def residuals(self, values: np.ndarray, names: Sequence[str] | None = None) -> list[Residual]:
        """Measured less modelled of every run, differentiated by `names` (the free ones where absent).

        Raises:
            PredictionError: the model cannot do a run with these values.
        """
        names = [free.name for free in self.free] if names is None else names
        plant = self.with_values(values)
        noise = self.noises
        if any(run.start != "equilibrium" for run in self.runs):
            return self._from_states(plant, names, noise)
        sparse = self.sparse if names else self
        work = [(self.step, run, names if sparse is self else ()) for run in self.runs]
        work += [(sparse.step, run, names) for run in sparse.runs if sparse is not self]
        found = in_parallel(
            lambda piece: plant.predict(piece[1], piece[2], piece[0]),
            work,
            lambda piece: piece[1].rows * (1 + len(piece[2])),
            plant.concurrent,
        )
        points, slopes = found[: len(self.runs)], found[-len(self.runs) :]
        return [
            Residual.of(run, modelled.points, change.by, sigma, at.time, self.block)
            for run, modelled, change, sigma, at in zip(self.runs, points, slopes, noise, sparse.runs, strict=True)
        ]

    def _from_states(self, plant: Plant, names: Sequence[str], noise: tuple[float | np.ndarray, ...]) -> list[Residual]:
        """Residuals of runs that begin with states of their own, each the best one for these parameters where it is free."""
        own = [START + name for name in plant.states]

        def left(measured: tuple[Run, float | np.ndarray]) -> Residual:
            run, sigma = begun(plant, *measured, self.step), measured[1]
            free = own if run.start == "free" else []
            found = plant.predict(run, [*names, *free], self.step)
            residual = Residual.of(run, found.points, found.by, sigma, block=self.block)
            return without_start(residual, len(free)) if free else residual

        return in_parallel(left, list(zip(self.runs, noise, strict=True)), lambda measured: measured[0].rows, plant.concurrent)

    @property
    def sparse(self) -> Problem:
        """The problem with only those samples at which derivatives are taken; this one where that is every one."""
        if self.plant.static or not self.derivatives_apart or any(run.start != "equilibrium" for run in self.runs):
            return self
        runs = tuple(spaced(run, self.derivatives_apart) for run in self.runs)
        return replace(self, runs=runs, step=self.derivatives_apart, derivatives_apart=0.0)


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
        """Which parameters ended at a bound, (parameters,)."""
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
        max_iterations: most steps.
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
    residuals = problem.residuals(values)
    weights = _weights(residuals, problem.robust)
    cost, damping, done, message = _cost(problem, values, residuals, weights), 1e-6, 0, "steps ended"
    converged, count, part = not problem.free, sum(r.count for r in residuals), 1.0
    while done < max_iterations and not converged:
        step, promised = _step(problem, values, residuals, weights, damping)
        if promised < 0.1 + tolerance * max(cost - count, 0.0):
            converged, message = True, "no step promises less"
            break
        if cost - HOPE * promised > reached:
            message = OUT_OF_REACH
            break
        done += 1
        tried, part, failure = _tried(problem, values, step, part, residuals if near else None)
        new = np.inf if tried is None else _cost(problem, values + part * step, tried, weights)
        if tried is not None and new < cost:
            gained = (cost - new) / (promised * part * (2 - part))
            values, residuals, part = values + part * step, tried, min(4 * part, 1.0)
            damping = damping / 10 if gained > 0.25 else damping * 3
            weights = _weights(residuals, problem.robust)
            cost = _cost(problem, values, residuals, weights)
        else:
            damping, part, message = max(10 * damping, 1e-3), 1.0, failure or message
            if damping > 1e6:
                converged, message = bool(np.isfinite(new)), failure or "no shorter step helps"
                break
        progress("fit", done, max_iterations)
    outcome = Outcome(Ending.SOLVED if converged else Ending.NOT_CONVERGED, message)
    square, _ = normal_equations(residuals)
    information = square * np.outer(problem.scale, problem.scale)
    return ParameterEstimate(problem, values, _covariance(problem, residuals, weights), residuals, cost, done, information, outcome)


def _tried(
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


def _step(
    problem: Problem, values: np.ndarray, residuals: list[Residual], weights: list[np.ndarray | None], damping: float
) -> tuple[np.ndarray, float]:
    square, slope = normal_equations(residuals, weights)
    mean, precision = problem.prior
    square, slope = square + precision, slope + precision @ (values - mean)
    low, high = problem.low, problem.high
    nearest, farthest = np.where(low > 0, np.maximum(low, values / FACTOR), low), np.where(low > 0, np.minimum(high, values * FACTOR), high)
    return bounded_step(square, slope, nearest - values, farthest - values, problem.scale, damping)


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
        values, by = weighted(r, w)
        rows = len(r.values)
        square += by.T @ by
        scores = np.stack([np.bincount(r.block, (slope * values).reshape(rows, -1).sum(axis=1)) for slope in by.T], axis=1)
        meat += scores.T @ scores
    square, meat = square * np.outer(scale, scale), meat * np.outer(scale, scale)
    inverse = np.linalg.pinv(square + known, hermitian=True)
    white = inverse  # what white noise alone leaves
    cov = inverse @ (meat + known_scores) @ inverse
    cov = np.where(np.eye(count, dtype=bool), np.maximum(np.diag(cov), np.diag(white)), cov)
    return cov * np.outer(scale, scale)
