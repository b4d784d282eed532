"""Which effects are worth fitting: how much of the gap each could close to first order, with the free parameters free to follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.discrepancy.plant import Candidate
from tepm_opt.solvers.identify import ParameterEstimate
from tepm_opt.solvers.least_squares import bounded_step
from tepm_opt.solvers.parallel import beside, in_parallel
from tepm_opt.solvers.plant import PredictionError
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
    estimate = _sparse(estimate)
    problem, threads = estimate.problem, estimate.problem.plant.concurrent
    free = [parameter.name for parameter in problem.free]
    smooth, bent = [c for c in missing if c.smooth], [c for c in missing if not c.smooth]

    def slopes() -> tuple[list[Score], list[Residual]]:
        """Scores by derivatives, and the residuals as simulated here with their derivatives by the free parameters."""
        scores, residuals = [], []
        for block in _blocks(estimate, smooth):
            names = [*free, *(name for candidate in block for name in candidate.parameters)]
            residuals = problem.residuals(estimate.values, names)
            square, slope = normal_equations([replace(r, by=s.by) for r, s in zip(estimate.residuals, residuals, strict=True)])
            for candidate in block:
                at = [names.index(name) for name in (*free, *candidate.parameters)]
                scores.append(_by_slopes(estimate, candidate, square[np.ix_(at, at)], slope[at]))
            residuals = [replace(r, by=r.by[:, : len(free)].copy(order="K")) for r in residuals]
        return scores, residuals

    (scores, simulated), probed = beside(slopes, lambda: in_parallel(lambda c: _probed(estimate, c), bent, threads=threads), threads)
    at_null = [replace(r, by=s.by) for r, s in zip(estimate.residuals, simulated, strict=True)]
    for candidate, residuals in zip(bent, probed, strict=True):
        if residuals is not None:
            change = [(p.values - s.values).ravel() for p, s in zip(residuals, simulated, strict=True)]
            scores.append(_by_change(estimate, at_null, candidate, change))
    return sorted(scores, key=lambda score: -score.gain)


def _sparse(estimate: ParameterEstimate) -> ParameterEstimate:
    """The estimate with only those samples at which derivatives are taken: first-order gains need no more."""
    problem, whole = estimate.problem.sparse, estimate.problem
    if problem is whole:
        return estimate
    rows = [np.searchsorted(run.time, at.time) for run, at in zip(whole.runs, problem.runs, strict=True)]
    residuals = [
        replace(r, values=r.values[k], present=r.present[k], by=np.empty((r.values[k].size, 0)), block=r.block[k])
        for r, k in zip(estimate.residuals, rows, strict=True)
    ]
    return replace(estimate, problem=problem, residuals=residuals, cost=sum(r.squares for r in residuals))


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
    own = estimate.problem.plant.free(candidate.parameters)
    low, high = np.array([[f.low - f.start, f.high - f.start] for f in own]).T
    gain, step = _gain(estimate, square, slope, low, high, np.array([f.scale for f in own]))
    start = {f.name: f.start + float(d) for f, d in zip(own, step[-len(own) :], strict=True)}
    moved = {f.name: float(value + d) for f, value, d in zip(estimate.problem.free, estimate.values, step, strict=False)}
    return Score(candidate, gain, moved | start)


def _probed(estimate: ParameterEstimate, candidate: Candidate) -> list[Residual] | None:
    """Residuals of every run with a candidate's probe; None where the model cannot take it."""
    try:
        return replace(estimate.problem, plant=estimate.plant.with_values(candidate.probes[0])).residuals(estimate.values, [])
    except PredictionError:
        return None


def _by_change(estimate: ParameterEstimate, at_null: Sequence[Residual], candidate: Candidate, change: Sequence[np.ndarray]) -> Score:
    """Score of a candidate by how its probe changes the residuals of every run, (coordinates,) each: a direction."""
    picked = [replace(r, by=np.vstack([r.by.T, d]).T) for r, d in zip(at_null, change, strict=True)]
    own = estimate.problem.plant.free(candidate.parameters)
    moved = {f.name: candidate.probes[0][f.name] - candidate.null[f.name] for f in own}
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
