"""Significance: whether the size of an effect differs from the size at which it vanishes."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2, norm

from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.solvers.identify import ParameterEstimate


def standard_deviations_from_null(estimate: ParameterEstimate, effect: Candidate) -> float:
    """Distance of an effect's strengths from their null values, in standard deviations.

    A single strength is compared with its own standard deviation; several by Wald's test (Transactions of the AMS 54, 1943), as the
    distance of one strength that is as improbable. Shapes say nothing of the size and are left out.

    Args:
        estimate: fit with the effect; its covariance allows for residuals that are not white.
        effect: with strengths that the fit has found.
    """
    at = [k for k, free in enumerate(estimate.problem.free) if free.name in effect.parameters and free.name not in effect.shapes]
    if not at:
        return np.inf
    scale = estimate.problem.scale[at]
    away = np.array([estimate.values[k] - effect.null[estimate.problem.free[k].name] for k in at]) / scale
    covariance = estimate.covariance[np.ix_(at, at)] / np.outer(scale, scale)
    squares = float(away @ np.linalg.pinv(covariance, hermitian=True) @ away)
    if len(at) == 1:
        return float(np.sqrt(squares)) if covariance[0, 0] > 0 else np.inf
    return float(-norm.ppf(max(chi2.sf(squares, len(at)) / 2, 1e-300)))


def is_significant(estimate: ParameterEstimate, effect: Candidate, settings: SearchSettings) -> bool:
    """Whether the size of an effect is at least `min_size_sigma` standard deviations from the size at which it vanishes."""
    return standard_deviations_from_null(estimate, effect) >= settings.min_size_sigma
