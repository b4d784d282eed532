"""Significance: whether the size of an effect differs from the size at which it vanishes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2, norm

from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.solvers.identification.identify import ParameterEstimate
from tepm_opt.solvers.mechanics.plant import PredictionError


def is_significant(estimate: ParameterEstimate, effect: Candidate, settings: SearchSettings) -> bool:
    """Whether the size of an effect is at least `min_size_sigma` standard deviations from the size at which it vanishes.

    Shapes that act by themselves are not held, as they may be all that acts: a regulator whose rate is limited chokes without a lag.
    """
    if standard_deviations_from_null(estimate, effect) < settings.min_size_sigma:
        return False
    alone = [free.name for free in estimate.problem.free if free.name in effect.shapes and not effect.null[free.name]]
    if not alone or not _acts_without_strengths(estimate, effect, settings):
        return True
    return standard_deviations_from_null(estimate, effect, alone) >= settings.min_size_sigma


def standard_deviations_from_null(estimate: ParameterEstimate, effect: Candidate, following: Sequence[str] = ()) -> float:
    """Distance of an effect's strengths from their null values, in standard deviations.

    A single strength is compared with its own standard deviation; several by Wald's test (Transactions of the AMS 54, 1943), as the
    distance of one strength that is as improbable. Shapes have no meaning where the effect vanishes, so they are held at their values
    (Davies, Biometrika 64, 1977): a stiffness that changes by more, later, is no less surely there.

    Args:
        estimate: fit with the effect; its covariance allows for residuals that are not white.
        effect: with strengths that the fit has found.
        following: full names of shapes that are not held.
    """
    names = [free.name for free in estimate.problem.free]
    strengths = [k for k, name in enumerate(names) if name in effect.parameters and name not in effect.shapes]
    shapes = [k for k, name in enumerate(names) if name in effect.shapes and name not in following]
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


def _acts_without_strengths(estimate: ParameterEstimate, effect: Candidate, settings: SearchSettings) -> bool:
    """Whether outputs change visibly by an effect with its strengths at their null values and its shapes as fitted."""
    strengths = {name: value for name, value in effect.null.items() if name not in effect.shapes}
    fitted = estimate.plant
    try:
        with_shapes, without = (
            replace(estimate.problem, plant=fitted.with_values(values), free=()).residuals(np.zeros(0))
            for values in (strengths, effect.null)
        )
    except PredictionError:
        return False
    changed = sum(float(np.sum((a.values - b.values) ** 2)) for a, b in zip(with_shapes, without, strict=True))
    return changed > settings.min_excess_removed * estimate.count
