"""Uncertainty of identified parameters: directions without influence, profile intervals, fits from several starts."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import replace
from functools import partial

import numpy as np

from tepm_opt.errors import unknown_name
from tepm_opt.progress import Progress, silent, track
from tepm_opt.solvers.identification.identify import ITERATIONS, ParameterEstimate, Problem, identify
from tepm_opt.solvers.mechanics.plant import PredictionError
from tepm_opt.solvers.numerics.parallel import each_done


def unidentifiable(estimate: ParameterEstimate, max_relative_std: float = 0.5) -> list[str]:
    """Directions whose uncertainty exceeds `max_relative_std` of what was known before or of the parameters' size.

    It is that from the runs alone, or from these and a joint prior, which other runs have told.
    """
    free = estimate.problem.free
    if not free:
        return []
    size = np.array([min(f.spread, max(abs(value), f.scale)) for f, value in zip(free, estimate.values, strict=True)])
    information = estimate.information * np.outer(size, size) / np.outer(estimate.problem.scale, estimate.problem.scale)
    if estimate.problem.joint is not None:
        information = information + estimate.problem.joint.terms(free)[1] * np.outer(size, size)
    excess = max(estimate.cost / max(estimate.count, 1), 1.0)
    values, vectors = np.linalg.eigh(information)
    words = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value > 0 and np.sqrt(excess / value) <= max_relative_std:
            continue
        taking_part = [f.name for f, part in zip(free, vector, strict=True) if abs(part) > 0.3 * np.max(np.abs(vector))]
        if len(taking_part) == 1:
            words.append(f"{taking_part[0]} has hardly any influence in these runs")
        else:
            words.append(f"{' and '.join([', '.join(taking_part[:-1]), taking_part[-1]])} cannot be told apart in these runs")
    return words


def multi_start(
    problem: Problem, starts: int, seed: int, max_iterations: int = ITERATIONS, progress: Progress = silent,
    executor: Executor | None = None,
) -> ParameterEstimate:  # fmt: skip
    """The best of several fits: from the first values, then from random ones within the bounds (or three scales around).

    Args:
        problem: what to fit.
        starts: how many fits.
        seed: of the random values.
        max_iterations: most Gauss-Newton steps of each.
        progress: told of every step of every fit, or of every fit that an executor has done.
        executor: where fits run; here, one after the other, where None.

    Raises:
        InputError: no runs, no parameters or no measured sample.
        PredictionError: the model cannot do the runs with the first values.
    """
    random = np.random.default_rng(seed)
    tasks = [(1, problem)]
    for k in range(1, starts):
        low = np.maximum(problem.low, problem.start - 3 * problem.scale)
        high = np.minimum(problem.high, problem.start + 3 * problem.scale)
        values = random.uniform(low, high)
        free = tuple(replace(f, start=float(value)) for f, value in zip(problem.free, values, strict=True))
        tasks.append((k + 1, replace(problem, free=free)))
    if executor is None:
        fits = (_try_fit(max_iterations, task, _number_progress(progress, task[0], starts)) for task in tasks)
    else:
        done = dict(track(each_done(partial(_try_fit, max_iterations), tasks, executor), progress, "fits", starts))
        fits = (done[number] for number in sorted(done))
    best = None
    for found in fits:
        if found is not None and (best is None or found.cost < best.cost - 0.1):
            best = replace(found, problem=problem)
    assert best is not None
    return best


def _try_fit(max_iterations: int, task: tuple[int, Problem], progress: Progress = silent) -> ParameterEstimate | None:
    """Fit a problem; None where the model cannot do the runs with values that were drawn.

    Raises:
        PredictionError: it cannot with the first ones.
    """
    number, problem = task
    try:
        return identify(problem, max_iterations, progress)
    except PredictionError:
        if number == 1:
            raise
        return None


def _number_progress(progress: Progress, number: int, starts: int) -> Progress:
    """Progress of one fit of several."""
    return progress if starts == 1 else lambda stage, done, of: progress(f"{stage} {number} of {starts}", done, of)


def profile(estimate: ParameterEstimate, name: str, threshold: float = 3.841) -> tuple[float, float]:
    """Profile interval of a parameter: where the least cost, all others fitted anew, exceeds the best by a threshold.

    Costs are counted in units of what the residuals show, more than the noise where they are not white. An interval ends at a
    bound where that comes first.

    Args:
        estimate: the best fit.
        name: full name of one of its free parameters.
        threshold: quantile of chi-square with one degree of freedom (3.841: 95 %).

    Raises:
        InputError: no such free parameter.
    """
    problem, names = estimate.problem, [free.name for free in estimate.problem.free]
    if name not in names:
        raise unknown_name("free parameter", name, names)
    at = names.index(name)
    white = np.linalg.pinv(estimate.information, hermitian=True)[at, at] * problem.scale[at] ** 2
    unit = max(estimate.covariance[at, at] / max(white, 1e-300), 1.0)
    ends = []
    for side, bound in ((-1, problem.low[at]), (1, problem.high[at])):
        step, reached, end = max(estimate.std[at], 1e-9 * problem.scale[at]), estimate.values[at], bound
        inside = reached
        for _ in range(12):
            trial = inside + side * step
            if side * (trial - bound) >= 0:
                trial = bound
            rise = (_fit_with_fixed(estimate, at, trial) - estimate.cost) / unit
            if rise > threshold:
                end = trial
                break
            inside = trial
            if trial == bound:
                end = bound
                break
            step *= 1.5
        if end != bound or inside != bound:
            outside = end
            for _ in range(6):
                middle = (inside + outside) / 2
                rise = (_fit_with_fixed(estimate, at, middle) - estimate.cost) / unit
                inside, outside = (middle, outside) if rise <= threshold else (inside, middle)
            end = (inside + outside) / 2
        ends.append(float(end))
    return ends[0], ends[1]


def _fit_with_fixed(estimate: ParameterEstimate, at: int, value: float) -> float:
    """Least cost of a fit with one parameter fixed at a value."""
    problem = estimate.problem
    others = tuple(replace(f, start=float(v)) for k, (f, v) in enumerate(zip(problem.free, estimate.values, strict=True)) if k != at)
    held = replace(problem, free=(replace(problem.free[at], start=value),)).with_values(np.array([value]))
    try:
        return identify(replace(problem, plant=held, free=others), max_iterations=4).cost
    except PredictionError:
        return np.inf
