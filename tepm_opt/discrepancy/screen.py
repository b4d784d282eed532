"""Which effects are worth fitting: how much of the gap each could close to first order, with the free parameters free to follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.discrepancy.library import Candidate
from tepm_opt.solvers.identify import ParameterEstimate, free_parameters
from tepm_opt.solvers.least_squares import bounded_step
from tepm_opt.solvers.parallel import in_parallel
from tepm_opt.solvers.predict import PredictionError
from tepm_opt.solvers.residuals import Residual, normal_equations

MEMORY = 60_000_000  # B, of the derivatives taken in one pass


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

    Effects that are nearly linear in their parameters are judged by the outputs' derivatives at the null, all from one pass through the
    runs, others by a finite probe of which any multiple may act. Both are taken together with the parameters that are free already, so
    that what those could do as well does not count. Scores order, they do not decide: they are first order. A candidate whose probe the
    model cannot take is left out.
    """
    free, scores = [parameter.name for parameter in estimate.problem.free], []
    at_null: list[Residual] = []
    for block in _blocks(estimate, [candidate for candidate in missing if not candidate.bends]):
        names = [*free, *(name for candidate in block for name in candidate.parameters)]
        residuals = estimate.problem.residuals(estimate.values, names)
        square, slope = normal_equations(residuals)
        for candidate in block:
            at = [names.index(name) for name in (*free, *candidate.parameters)]
            scores.append(_by_slopes(estimate, candidate, square[np.ix_(at, at)], slope[at]))
        at_null = [replace(r, by=r.by[:, : len(free)].copy(order="K")) for r in residuals]
    bent = [candidate for candidate in missing if candidate.bends]
    changes = in_parallel(lambda candidate: _change(estimate, at_null, candidate), bent, threads=estimate.problem.model.is_c)
    scores += [_by_change(estimate, at_null, c, change) for c, change in zip(bent, changes, strict=True) if change is not None]
    return sorted(scores, key=lambda score: -score.gain)


def _blocks(estimate: ParameterEstimate, candidates: Sequence[Candidate]) -> list[list[Candidate]]:
    """Candidates whose derivatives are taken in one pass: all of them unless they would take too much memory."""
    free, each = len(estimate.problem.free), 8 * max(sum(r.values.size for r in estimate.residuals), 1)
    room = max(MEMORY // each - free, 1)
    blocks: list[list[Candidate]] = [[]]
    taken = 0
    for candidate in candidates:
        if blocks[-1] and taken + len(candidate.parameters) > room:
            blocks.append([])
            taken = 0
        blocks[-1].append(candidate)
        taken += len(candidate.parameters)
    return blocks


def _by_slopes(estimate: ParameterEstimate, candidate: Candidate, square: np.ndarray, slope: np.ndarray) -> Score:
    """Score of a candidate from the normal equations of the free parameters and its own."""
    own = free_parameters(estimate.problem.model, candidate.parameters)
    low, high = np.array([[f.low - f.start, f.high - f.start] for f in own]).T
    gain, step = _gain(estimate, square, slope, low, high, np.array([f.scale for f in own]))
    start = {f.name: f.start + float(d) for f, d in zip(own, step[-len(own) :], strict=True)}
    moved = {f.name: float(value + d) for f, value, d in zip(estimate.problem.free, estimate.values, step, strict=False)}
    return Score(candidate, gain, moved | start)


def _change(estimate: ParameterEstimate, at_null: Sequence[Residual], candidate: Candidate) -> list[np.ndarray] | None:
    """How a candidate's probe changes the residuals of every run, (coordinates,) each; None where the model cannot take it."""
    moved = estimate.model
    theta = moved.theta.copy()
    for name, value in candidate.probe.items():
        theta[moved.network.parameter_names.index(name)] = value
    try:
        probed = replace(estimate.problem, model=moved.with_theta(theta)).residuals(estimate.values, [])
    except PredictionError:
        return None
    return [(p.values - r.values).ravel() for p, r in zip(probed, at_null, strict=True)]


def _by_change(estimate: ParameterEstimate, at_null: Sequence[Residual], candidate: Candidate, change: Sequence[np.ndarray]) -> Score:
    """Score of a candidate by its probe, as a direction."""
    picked = [replace(r, by=np.vstack([r.by.T, d]).T) for r, d in zip(at_null, change, strict=True)]
    own = free_parameters(estimate.problem.model, candidate.parameters)
    moved = {f.name: candidate.probe[f.name] - candidate.null[f.name] for f in own}
    room = min((f.high - candidate.null[f.name]) / moved[f.name] for f in own if moved[f.name])
    gain, step = _gain(estimate, *normal_equations(picked), np.zeros(1), np.array([room]), np.ones(1))
    size = float(np.clip(step[-1], 0.1, room))
    return Score(candidate, gain, {f.name: candidate.null[f.name] + size * moved[f.name] for f in own})


def _gain(
    estimate: ParameterEstimate, square: np.ndarray, slope: np.ndarray, low: np.ndarray, high: np.ndarray, scale: np.ndarray
) -> tuple[float, np.ndarray]:
    """Part of the excess that the last parameters could take away, and the step of all.

    Args:
        estimate: with the parameters that are free already.
        square, slope: normal equations, its parameters first.
        low, high: bounds of the others' steps.
        scale: of the others.
    """
    problem, values = estimate.problem, estimate.values
    step, less = bounded_step(
        square,
        slope,
        np.concatenate([problem.low - values, low]),
        np.concatenate([problem.high - values, high]),
        np.concatenate([problem.scale, scale]),
    )
    return less / max(estimate.cost - estimate.count, 1e-9 * estimate.count), step
