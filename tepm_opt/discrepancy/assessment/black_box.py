"""Black-box model of residuals: a bound on the gap that any cause could explain, never a cause."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.assessment.settings import DEFAULT, AssessmentSettings


def predict_residuals(
    fit: Sequence[Run], left: Sequence[np.ndarray], scale: np.ndarray, other: Sequence[Run], static: bool,
    settings: AssessmentSettings = DEFAULT,
) -> list[np.ndarray]:  # fmt: skip
    """Residuals predicted by a Gaussian process on inputs, their past and the tip force (Rasmussen and Williams 2006, ch. 2).

    Args:
        fit: runs to learn from.
        left: measured less modelled positions of these runs, (rows, points, 3) in m each; NaN where missing.
        scale: size of the inputs, (inputs,).
        other: runs to predict the residuals of.
        static: whether rows are equilibria, so that there is no past.
        settings: samples and memory.

    Returns:
        Residuals of the other runs, (rows, points, 3) in m each.
    """
    from sklearn.exceptions import ConvergenceWarning  # half a second to import, needed when the search is over
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    memory = 0.0 if static else settings.black_box_memory
    x, y = np.concatenate([_features(run, scale, memory) for run in fit]), np.concatenate([rows.reshape(len(rows), -1) for rows in left])
    whole = np.isfinite(y).any(axis=1)
    x, y = x[whole], y[whole]
    mean = np.nan_to_num(np.nanmean(np.where(np.isfinite(y).any(axis=0), y, 0.0), axis=0))
    y = np.where(np.isfinite(y), y, mean)
    picked = np.unique(np.linspace(0, len(x) - 1, min(settings.black_box_samples, len(x))).astype(int))
    size = float(np.std(y)) or 1.0
    kernel = ConstantKernel(1.0, (1e-2, 1e2)) * RBF(1.0, (1e-1, 1e2)) + WhiteKernel(0.1, (1e-5, 1e1))
    process = GaussianProcessRegressor(kernel)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        process.fit(x[picked], (y[picked] - mean) / size)
    found, piece = [], 2000  # rows predicted at a time, each of which takes as many numbers as there are samples
    for run in other:
        pieces = np.split(_features(run, scale, memory), range(piece, run.rows, piece))
        predicted = np.concatenate([process.predict(each) for each in pieces]).reshape(run.rows, -1)
        found.append((mean + size * predicted).reshape(run.points.shape))
    return found


def _features(run: Run, scale: np.ndarray, memory: float) -> np.ndarray:
    """Inputs over their size, the same low-passed with a memory in s where there is one, and the tip force in N, (rows, features)."""
    from scipy.signal import lfilter  # as above

    inputs = run.inputs / scale
    if not memory:
        return np.hstack([inputs, run.tip_force])
    pole = np.exp(-float(np.median(np.diff(run.time))) / memory) if run.rows > 1 else 0.0
    past = inputs[0] + lfilter([1 - pole], [1, -pole], inputs - inputs[0], axis=0)
    return np.hstack([inputs, past, run.tip_force])
