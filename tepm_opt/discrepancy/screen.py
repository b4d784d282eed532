"""Which effects are worth fitting: how much of the gap each could close to first order, with the free parameters free to follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.discrepancy.library import Candidate
from tepm_opt.solvers.identify import ParameterEstimate, Residual, free_parameters, normal_equations
from tepm_opt.solvers.least_squares import bounded_step
from tepm_opt.solvers.predict import PredictionError


@dataclass(frozen=True)
class Score:
    """What screening says of a candidate.

    Attributes:
        candidate: the effect.
        gain: part of the squared residuals beyond the noise that it could take away, to first order.
        start: values of its parameters and of the free ones by full name, from which to fit.
    """

    candidate: Candidate
    gain: float
    start: dict[str, float]

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Score({self.candidate.label}, gain {self.gain:.3g})"


def screen(estimate: ParameterEstimate, missing: Sequence[Candidate]) -> list[Score]:
    """Scores of candidates, largest gain first.

    Effects that are nearly linear in their parameters are judged by the outputs' derivatives at the null, others by a finite probe of
    which any multiple may act. Both are taken together with the parameters that are free already, so that what those could do as
    well does not count. Scores order, they do not decide: they are first order. A candidate whose probe the model cannot take is left out.
    """
    free = [parameter.name for parameter in estimate.problem.free]
    linear = [candidate for candidate in missing if not candidate.bends]
    names = [*free, *(name for candidate in linear for name in candidate.parameters)]
    at_null = estimate.problem.residuals(estimate.values, names)
    scores = []
    for candidate in linear:
        columns = [names.index(name) for name in (*free, *candidate.parameters)]
        own = free_parameters(estimate.problem.model, candidate.parameters)
        low, high = np.array([[f.low - f.start, f.high - f.start] for f in own]).T
        picked = [replace(r, by=r.by[:, columns]) for r in at_null]
        gain, step = _gain(estimate, picked, low, high, np.array([f.scale for f in own]))
        moved = dict(zip(free, (estimate.values + step[: len(free)]).tolist(), strict=True))
        scores.append(Score(candidate, gain, moved | {f.name: f.start + float(d) for f, d in zip(own, step[len(free) :], strict=True)}))
    for candidate in missing:
        if candidate.bends and (score := _probed(estimate, at_null, len(free), candidate)) is not None:
            scores.append(score)
    return sorted(scores, key=lambda score: -score.gain)


def _probed(estimate: ParameterEstimate, at_null: list[Residual], free: int, candidate: Candidate) -> Score | None:
    """Score of a candidate by its probe, as a direction."""
    moved = estimate.problem.with_values(estimate.values)
    theta = moved.theta.copy()
    for name, value in candidate.probe.items():
        theta[moved.network.parameter_names.index(name)] = value
    try:
        probed = replace(estimate.problem, model=moved.with_theta(theta)).residuals(estimate.values, [])
    except PredictionError:
        return None
    along = [(p.values - r.values).reshape(-1, 1) for p, r in zip(probed, at_null, strict=True)]
    picked = [replace(r, by=np.hstack([r.by[:, :free], d])) for r, d in zip(at_null, along, strict=True)]
    own = free_parameters(estimate.problem.model, candidate.parameters)
    change = {f.name: candidate.probe[f.name] - candidate.null[f.name] for f in own}
    room = [(f.high - candidate.null[f.name]) / change[f.name] for f in own if change[f.name]]
    gain, step = _gain(estimate, picked, np.zeros(1), np.array([min(room)]), np.ones(1))
    size = float(np.clip(step[-1], 0.1, min(room)))
    start = {f.name: candidate.null[f.name] + size * change[f.name] for f in own}
    return Score(candidate, gain, start)


def _gain(
    estimate: ParameterEstimate, residuals: list[Residual], low: np.ndarray, high: np.ndarray, scale: np.ndarray
) -> tuple[float, np.ndarray]:
    """Part of the excess that the last columns could take away, and the step of all parameters."""
    problem, values = estimate.problem, estimate.values
    square, slope = normal_equations(residuals)
    step, less = bounded_step(
        square,
        slope,
        np.concatenate([problem.low - values, low]),
        np.concatenate([problem.high - values, high]),
        np.concatenate([problem.scale, scale]),
    )
    return less / max(estimate.cost - estimate.count, 1e-9 * estimate.count), step
