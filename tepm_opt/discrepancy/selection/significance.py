"""Significance: whether the size of an effect differs from the size at which it vanishes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2, norm

from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.solvers.identification.identify import ParameterEstimate
from tepm_opt.solvers.mechanics.plant import PredictionError


def is_significant(estimate: ParameterEstimate, effect: Candidate, settings: SearchSettings) -> bool:
    """Whether the size of an effect is at least `min_size_sigma` standard deviations from the size at which it vanishes.

    A shape that is 0 where the effect vanishes counts as a strength where it acts alone, too, as a choke without a lag does. An effect that
    is complete, as the loss of a tendon's whole tension, has no derivative there: it is significant where it changes outputs visibly.
    """
    if standard_deviations_from_null(estimate, effect) >= settings.min_size_sigma:
        return True
    if _is_complete(estimate, effect):
        return _changes_outputs(estimate, {}, effect, settings)
    also = [free.name for free in estimate.problem.free if free.name in effect.shapes and not effect.null[free.name]]
    strengths = {name: value for name, value in effect.null.items() if name not in effect.shapes}
    if not also or not _changes_outputs(estimate, strengths, effect, settings):
        return False
    return standard_deviations_from_null(estimate, effect, also) >= settings.min_size_sigma


def standard_deviations_from_null(estimate: ParameterEstimate, effect: Candidate, also: Sequence[str] = ()) -> float:
    """Distance of an effect's strengths from their null values, in standard deviations.

    A single strength is compared with its own standard deviation; several by Wald's test (Transactions of the AMS 54, 1943), as the
    distance of one strength that is as improbable. Shapes have no meaning where the effect vanishes, so they are held at their values
    (Davies, Biometrika 64, 1977): a stiffness that changes by more, later, is no less surely there.

    Args:
        estimate: fit with the effect; its covariance allows for residuals that are not white.
        effect: with strengths that the fit has found.
        also: full names of shapes that count as strengths.
    """
    names = [free.name for free in estimate.problem.free]
    strengths = [k for k, name in enumerate(names) if name in effect.parameters and (name not in effect.shapes or name in also)]
    shapes = [k for k, name in enumerate(names) if name in effect.shapes and name not in also]
    if not strengths:
        return np.inf
    away = np.array([estimate.values[k] - effect.null[names[k]] for k in strengths]) / estimate.problem.scale[strengths]
    covariance = _hold(estimate.covariance / np.outer(estimate.problem.scale, estimate.problem.scale), strengths, shapes)
    squares = float(away @ np.linalg.pinv(covariance, hermitian=True) @ away)
    if len(strengths) == 1:
        return float(np.sqrt(squares)) if covariance[0, 0] > 0 else np.inf
    return float(-norm.ppf(max(chi2.sf(squares, len(strengths)) / 2, 1e-300)))


def _hold(covariance: np.ndarray, of: Sequence[int], held: Sequence[int]) -> np.ndarray:
    """Covariance of some parameters where others are held at their values, (of, of): the Schur complement."""
    across = covariance[np.ix_(of, held)]
    return covariance[np.ix_(of, of)] - across @ np.linalg.pinv(covariance[np.ix_(held, held)], hermitian=True) @ across.T


def _is_complete(estimate: ParameterEstimate, effect: Candidate) -> bool:
    """Whether all strengths of an effect ended at their bounds, where a change of them by their whole scale changes nothing visible."""
    names = [free.name for free in estimate.problem.free]
    strengths = [k for k, name in enumerate(names) if name in effect.parameters and name not in effect.shapes]
    return bool(strengths) and all(estimate.at_bound[k] and estimate.information[k, k] < 1 for k in strengths)


def _changes_outputs(estimate: ParameterEstimate, changed: Mapping[str, float], effect: Candidate, settings: SearchSettings) -> bool:
    """Whether outputs with some values of a fit changed differ visibly from those without the effect."""
    fitted = estimate.plant
    try:
        acting, without = (
            replace(estimate.problem, plant=fitted.with_values(values), free=()).residuals(np.zeros(0)) for values in (changed, effect.null)
        )
    except PredictionError:
        return False
    squares = sum(float(np.sum((a.values - b.values) ** 2)) for a, b in zip(acting, without, strict=True))
    return squares > settings.min_excess_removed * estimate.count
