"""A residual learnt without physics: a bound on what any cause could explain, never a cause."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from tepm_opt.data.run import Run

SAMPLES = 400  # a Gaussian process costs their cube
PIECE = 2000  # rows predicted at a time, each of which takes as many numbers as there are samples
MEMORY = 0.3  # s, of the low-passed inputs that stand for the past
START = (1.0, 1.0, 0.1)  # variance of the function, its length, variance of the noise; inputs and residuals are over their sizes
BOUNDS = ((1e-2, 1e2), (1e-1, 1e2), (1e-5, 1e1))


def black_box(fit: Sequence[Run], left: Sequence[np.ndarray], scale: np.ndarray, other: Sequence[Run], static: bool) -> list[np.ndarray]:
    """What a Gaussian process on inputs, their past and the tip force predicts of residuals (Rasmussen and Williams 2006, ch. 2).

    Args:
        fit: runs to learn from.
        left: measured less modelled positions of these runs, (rows, points, 3) in m each; NaN where missing.
        scale: size of the inputs, (inputs,).
        other: runs to predict the residuals of.
        static: whether rows are equilibria, so that there is no past.

    Returns:
        Residuals of the other runs, (rows, points, 3) in m each.
    """
    features = [_features(run, scale, static) for run in fit]
    x, y = np.concatenate(features), np.concatenate([values.reshape(len(values), -1) for values in left])
    whole = np.isfinite(y).any(axis=1)
    x, y = x[whole], y[whole]
    mean = np.nan_to_num(np.nanmean(np.where(np.isfinite(y).any(axis=0), y, 0.0), axis=0))
    y = np.where(np.isfinite(y), y, mean)
    picked = np.unique(np.linspace(0, len(x) - 1, min(SAMPLES, len(x))).astype(int))
    size = float(np.std(y)) or 1.0
    x, y = x[picked], (y[picked] - mean) / size
    kernel, weights = _learnt(x, y)
    found = []
    for run in other:
        pieces = np.split(_features(run, scale, static), range(PIECE, run.rows, PIECE))
        predicted = np.concatenate([_covariance(_squares(piece, x), *kernel) @ weights for piece in pieces])
        found.append((mean + size * predicted).reshape(run.points.shape))
    return found


def _learnt(x: np.ndarray, y: np.ndarray) -> tuple[tuple[float, float], np.ndarray]:
    """Variance and length of the most likely squared exponential kernel, and what the samples (samples, outputs) weigh in predictions."""
    squares, unit, outputs = _squares(x, x), np.eye(len(x)), y.shape[1]

    def unlikelihood(logarithms: np.ndarray) -> tuple[float, np.ndarray]:
        """Negative logarithm of the marginal likelihood, and its gradient (the same, Eqs. 5.8 and 5.9)."""
        variance, length, noise = np.exp(logarithms)
        smooth = _covariance(squares, variance, length)
        factor = cho_factor(smooth + noise * unit, lower=True)
        inverse = cho_solve(factor, unit)
        weights = inverse @ y
        by = outputs * inverse - weights @ weights.T
        value = 0.5 * np.sum(y * weights) + outputs * np.sum(np.log(np.diag(factor[0])))
        along = by * smooth
        return value, 0.5 * np.array([np.sum(along), np.sum(along * squares) / length**2, noise * np.trace(by)])

    found = minimize(unlikelihood, np.log(START), method="L-BFGS-B", jac=True, bounds=np.log(BOUNDS)).x
    variance, length, noise = np.exp(found)
    return (variance, length), cho_solve(cho_factor(_covariance(squares, variance, length) + noise * unit), y)


def _covariance(squares: np.ndarray, variance: float, length: float) -> np.ndarray:
    return np.asarray(variance * np.exp(-0.5 / length**2 * squares))


def _squares(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Squared distances of features, (rows of one, rows of the other)."""
    return np.maximum((one**2).sum(axis=1)[:, None] - 2 * one @ other.T + (other**2).sum(axis=1), 0.0)


def _features(run: Run, scale: np.ndarray, static: bool) -> np.ndarray:
    """Inputs over their size, the same low-passed, and the tip force in N, (rows, features)."""
    inputs = run.inputs / scale
    if static:
        return np.hstack([inputs, run.tip_force])
    keeps = np.exp(-float(np.median(np.diff(run.time))) / MEMORY)
    past = inputs.copy()
    for before, now in pairwise(past):
        now += keeps * (before - now)
    return np.hstack([inputs, past, run.tip_force])
