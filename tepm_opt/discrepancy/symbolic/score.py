"""Scores of places: the share of the residuals in left-out runs that a smooth law there would predict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tepm_opt.discrepancy.problem.plant import as_network
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.cross_validation import Evidence
from tepm_opt.discrepancy.symbolic.places import Course, Place, find_places
from tepm_opt.discrepancy.symbolic.responses import Normal, normal_equations_by_place, simulate_courses
from tepm_opt.discrepancy.symbolic.settings import DEFAULT, SymbolicSettings
from tepm_opt.solvers.identification.identify import ParameterEstimate, Problem


@dataclass(frozen=True, eq=False)
class Scored:
    """A place with the smooth law that fits best there.

    Attributes:
        place: of the law.
        coefficients: of the law's shape, fitted to all runs, (size,) in the law's unit.
        covariance: of these, (size, size), for noise as large as the residuals of the law.
        closes: part of the structure left that the law predicts in left-out data, to first order.
        evidence: its predictions of left-out data, as of any hypothesis; it counts the coefficients that the prior leaves free.
    """

    place: Place
    coefficients: np.ndarray
    covariance: np.ndarray
    closes: float
    evidence: Evidence

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Scored({self.place.label}, closes {self.closes:.4f}, {self.evidence.parameters} free)"


def alternatives(estimate: ParameterEstimate, settings: SymbolicSettings = DEFAULT) -> list[Scored]:
    """Smooth laws at all places beside the effects of an estimate, the one that predicts most first: rivals of every named effect.

    They are fitted to first order together with the free parameters; their smoothness is the one that predicts left-out data best. A
    plant that is not a network has none.

    Raises:
        PredictionError: the model cannot do a run.
    """
    network = as_network(estimate.plant)
    if network is None:
        return []
    made = simulate_courses(network, estimate.problem.runs, settings)
    return score_places(estimate, made, find_places(made, settings), settings)


def score_places(
    estimate: ParameterEstimate, made: Sequence[Course], tried: Sequence[Place], settings: SymbolicSettings = DEFAULT
) -> list[Scored]:
    """Scores of some places, the one that predicts most first.

    Args:
        estimate: the fit whose residuals are explained.
        made: its runs as its model does them.
        tried: places with their shapes.
        settings: of the search.
    """
    problem = estimate.problem
    by_place = normal_equations_by_place(estimate, made, tried, settings)
    if not by_place:
        return []
    prior = prior_of(problem, estimate.values)
    free = len(problem.free)
    parts = [Normal(n.square[:, :free, :free], n.slope[:, :free], n.squares, n.counts) for n in by_place[0]]
    without = float(left_out_errors(parts, *prior)[0].sum())
    found = [_score_place(place, runs, prior, without, settings.smoothness) for place, runs in zip(tried, by_place, strict=True)]
    return sorted(found, key=lambda each: -each.closes)


def prior_of(problem: Problem, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Precision of the prior of the free parameters, and its slope at their values, (parameters,) each; those at a bound stay there."""
    spread = np.array([f.spread for f in problem.free])
    margin = 1e-6 * problem.scale
    bound = (values <= problem.low + margin) | (values >= problem.high - margin)
    middle = [
        f.prior_mean if np.isfinite(f.prior_std) else (f.low + f.high) / 2 if np.isfinite(f.high - f.low) else value
        for f, value in zip(problem.free, values, strict=True)
    ]
    precision = np.where(bound, (1e-6 * problem.scale) ** -2.0, spread**-2.0)
    return precision, np.where(bound, 0.0, (values - np.array(middle)) * precision) if len(values) else np.zeros(0)


def _folds(runs: Sequence[Normal]) -> list[tuple[int, slice]]:
    """Blocks of every fold: a run, or a quarter of one where there are fewer than three."""
    parts = 1 if len(runs) > 2 else SearchSettings().run_parts
    return [
        (k, slice(int(piece[0]), int(piece[-1]) + 1))
        for k, run in enumerate(runs)
        for piece in np.array_split(np.arange(len(run.counts)), parts)
        if len(piece)
    ]


def left_out_errors(
    runs: Sequence[Normal], precision: np.ndarray, pull: np.ndarray, extra: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Squares of the errors of every block, (blocks,), each predicted from the other folds, and the steps of the folds.

    Args:
        runs: normal equations of every run.
        precision: prior's of the free parameters.
        pull: its slope at their values.
        extra: precision matrix of the coefficients.
    """
    free, columns = len(precision), runs[0].slope.shape[1]
    known, slope_0 = np.zeros((columns, columns)), np.zeros(columns)
    known[:free, :free], slope_0[:free] = np.diag(precision), pull
    if extra is not None:
        known[free:, free:] = extra
    folds = _folds(runs)
    squares = np.array([runs[k].square[at].sum(axis=0) for k, at in folds])
    slopes = np.array([runs[k].slope[at].sum(axis=0) for k, at in folds])
    matrices = squares.sum(axis=0) - squares + known
    steps = -solve_scaled(matrices, slopes.sum(axis=0) - slopes + slope_0)
    errors = []
    for (k, at), step in zip(folds, steps, strict=True):
        run = runs[k]
        errors.append(run.squares[at] + 2 * run.slope[at] @ step + np.einsum("bij,i,j->b", run.square[at], step, step))
    return np.maximum(np.concatenate(errors), 0.0), steps


def solve_scaled(matrices: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Solve symmetric systems, scaled to a unit diagonal; unknowns without influence stay at 0."""
    size = np.sqrt(np.maximum(np.diagonal(matrices, axis1=-2, axis2=-1), 1e-300))
    scaled = matrices / size[..., :, None] / size[..., None, :] + 1e-10 * np.eye(matrices.shape[-1])
    return np.linalg.solve(scaled, (slopes / size)[..., None])[..., 0] / size


def _score_place(
    place: Place, runs: Sequence[Normal], prior: tuple[np.ndarray, np.ndarray], base: float, smoothness: Sequence[float]
) -> Scored:
    """A place with its smooth law; `base`: squares that the free parameters alone leave in left-out data."""
    precision, pull = prior
    free, total = len(precision), np.asarray(sum(run.square.sum(axis=0) for run in runs))
    slope = np.asarray(sum(run.slope.sum(axis=0) for run in runs))
    weight = float(np.trace(total[free:, free:])) / max(float(np.trace(place.penalty)), 1e-300)
    tried = [left_out_errors(runs, precision, pull, strength * weight * place.penalty) for strength in smoothness]
    best = int(np.argmin([errors.sum() for errors, _ in tried]))
    errors, steps = tried[best]
    counts = np.concatenate([run.counts for run in runs])
    known = np.zeros_like(total)
    known[:free, :free], known[free:, free:] = np.diag(precision), smoothness[best] * weight * place.penalty
    pulled = np.array(slope)
    pulled[:free] += pull
    step = -solve_scaled(total + known, pulled)
    kept = counts > 0
    spread = max(float(errors.sum()) / max(int(counts.sum()), 1), 1.0)
    inverse = np.linalg.pinv(total + known, hermitian=True)
    used = float(np.trace(inverse[free:] @ total[:, free:]))
    chance = 3 * np.sqrt(2 * float(counts.sum()))  # squares by which pure noise may exceed its own
    closes = (base - float(errors.sum())) / max(base - float(counts.sum()), chance)
    predicted = _predictive(runs, errors, steps, pulled, step)
    evidence = Evidence(predicted[kept], counts[kept], free + max(round(used), 1), np.zeros(free))
    return Scored(place, step[free:], spread * inverse[free:, free:], closes, evidence)


def _predictive(runs: Sequence[Normal], errors: np.ndarray, steps: np.ndarray, slope: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Squares of every block by the predictive distribution of the other folds, (blocks,), as in `cross_validation.leave_out`.

    Args:
        runs: normal equations of every run.
        errors: squares of every block with the values that the other folds give, (blocks,).
        steps: to these values, (folds, columns).
        slope: of all runs and the prior, (columns,).
        step: to the values that all runs give, (columns,).
    """
    first = np.cumsum([0, *(len(run.counts) for run in runs)])
    found = np.array(errors)
    for (k, at), own in zip(_folds(runs), steps, strict=True):
        blocks = slice(first[k] + at.start, first[k] + at.stop)
        added = float(runs[k].squares[at].sum()) + float(slope @ step) - float((slope - runs[k].slope[at].sum(axis=0)) @ own)
        found[blocks] *= np.clip(added / max(float(errors[blocks].sum()), 1e-300), 0.0, 1.0)
    return found
