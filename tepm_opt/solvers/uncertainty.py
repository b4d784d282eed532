"""What runs can and cannot tell about parameters: directions without influence, profile intervals, fits from several starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tepm_opt.errors import unknown_name
from tepm_opt.solvers.identify import ITERATIONS, ParameterEstimate, Problem, Progress, identify
from tepm_opt.solvers.predict import PredictionError


def unidentifiable(estimate: ParameterEstimate, most: float = 0.5) -> list[str]:
    """Directions whose uncertainty, from the runs alone, exceeds `most` of what was known before or of the parameters' size."""
    free = estimate.problem.free
    if not free:
        return []
    size = np.array([min(f.spread, max(abs(value), f.scale)) for f, value in zip(free, estimate.values, strict=True)])
    information = estimate.information * np.outer(size, size) / np.outer(estimate.problem.scale, estimate.problem.scale)
    excess = max(estimate.cost / max(estimate.count, 1), 1.0)
    values, vectors = np.linalg.eigh(information)
    words = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value > 0 and np.sqrt(excess / value) <= most:
            continue
        taking_part = [f.name for f, part in zip(free, vector, strict=True) if abs(part) > 0.3 * np.max(np.abs(vector))]
        if len(taking_part) == 1:
            words.append(f"{taking_part[0]} has hardly any influence in these runs")
        else:
            words.append(f"{' and '.join([', '.join(taking_part[:-1]), taking_part[-1]])} cannot be told apart in these runs")
    return words


def multi_start(
    problem: Problem, starts: int, seed: int, iterations: int = ITERATIONS, progress: Progress = lambda text: None
) -> ParameterEstimate:
    """The best of several fits: from the first values, then from random ones within the bounds (or three scales around)."""
    random = np.random.default_rng(seed)
    best = identify(problem, iterations, progress)
    for k in range(1, starts):
        low = np.maximum(problem.low, problem.start - 3 * problem.scale)
        high = np.minimum(problem.high, problem.start + 3 * problem.scale)
        values = random.uniform(low, high)
        free = tuple(replace(f, start=float(value)) for f, value in zip(problem.free, values, strict=True))
        progress(f"start {k + 1} of {starts}")
        try:
            found = identify(replace(problem, free=free), iterations, progress)
        except PredictionError:
            continue
        if found.cost < best.cost - 0.1:
            best = replace(found, problem=problem)
    return best


def profile(estimate: ParameterEstimate, name: str, level: float = 3.841) -> tuple[float, float]:
    """Profile interval of a parameter: where the least cost, all others fitted anew, exceeds the best by `level` (3.841: 95 %).

    Costs are counted in units of what the residuals show, more than the noise where they are not white. An interval ends at a
    bound where that comes first.

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
            rise = (_held(estimate, at, trial) - estimate.cost) / unit
            if rise > level:
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
                rise = (_held(estimate, at, middle) - estimate.cost) / unit
                inside, outside = (middle, outside) if rise <= level else (inside, middle)
            end = (inside + outside) / 2
        ends.append(float(end))
    return ends[0], ends[1]


def _held(estimate: ParameterEstimate, at: int, value: float) -> float:
    """Least cost with one parameter held."""
    problem = estimate.problem
    others = tuple(replace(f, start=float(v)) for k, (f, v) in enumerate(zip(problem.free, estimate.values, strict=True)) if k != at)
    held = replace(problem, free=(replace(problem.free[at], start=value),)).with_values(np.array([value]))
    try:
        return identify(replace(problem, model=held, free=others), iterations=4).cost
    except PredictionError:
        return np.inf
