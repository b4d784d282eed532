"""Black-box model of residuals: a bound on the gap that any cause could explain, never a cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.assessment.settings import DEFAULT, AssessmentSettings

RANGES = (1e-2, 1.0, 1e2), (1e-1, 1.0, 1e2), (1e-5, 0.1, 1e1)
"""Lowest, first and highest variance, length (in the inputs' sizes) and noise variance; outputs have a mean square of 1."""


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
    memory = 0.0 if static else settings.black_box_memory
    x, y = np.concatenate([_features(run, scale, memory) for run in fit]), np.concatenate([rows.reshape(len(rows), -1) for rows in left])
    whole = np.isfinite(y).any(axis=1)
    x, y = x[whole], y[whole]
    mean = np.nan_to_num(np.nanmean(np.where(np.isfinite(y).any(axis=0), y, 0.0), axis=0))
    y = np.where(np.isfinite(y), y, mean)
    picked = np.unique(np.linspace(0, len(x) - 1, min(settings.black_box_samples, len(x))).astype(int))
    size = float(np.std(y)) or 1.0
    process = GaussianProcess.fit(x[picked], (y[picked] - mean) / size)
    found, piece = [], 2000  # rows predicted at a time, each of which takes as many numbers as there are samples
    for run in other:
        pieces = np.split(_features(run, scale, memory), range(piece, run.rows, piece))
        predicted = np.concatenate([process.predict(each) for each in pieces]).reshape(run.rows, -1)
        found.append((mean + size * predicted).reshape(run.points.shape))
    return found


@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """Mean of a Gaussian process without a mean of its own, with a squared-exponential kernel.

    Attributes:
        x: where it was learnt, (samples, features).
        weights: of the kernel at these places, (samples, outputs).
        variance, length: of the kernel.
    """

    x: np.ndarray
    weights: np.ndarray
    variance: float
    length: float

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"GaussianProcess({len(self.x)} samples, variance {self.variance:.3g}, length {self.length:.3g})"

    @staticmethod
    def fit(x: np.ndarray, y: np.ndarray) -> GaussianProcess:
        """The process with the kernel and noise of the largest marginal likelihood (Rasmussen and Williams 2006, eq. 5.9).

        Args:
            x: places, (samples, features).
            y: values there, (samples, outputs); all outputs share the kernel.
        """
        squares = _squared_distances(x, x)

        def loss(logarithms: np.ndarray) -> tuple[float, np.ndarray]:
            variance, length, noise = np.exp(logarithms)
            kernel = variance * np.exp(-squares / (2 * length**2))
            factor = cho_factor(kernel + noise * np.eye(len(x)), lower=True)
            weights, inverse = cho_solve(factor, y), cho_solve(factor, np.eye(len(x)))
            outer = y.shape[1] * inverse - weights @ weights.T
            by = [np.vdot(outer, kernel), np.vdot(outer, kernel * squares) / length**2, noise * np.trace(outer)]
            return 0.5 * np.vdot(y, weights) + y.shape[1] * np.log(np.diag(factor[0])).sum(), 0.5 * np.array(by)

        found = minimize(loss, np.log(RANGES)[:, 1], jac=True, bounds=np.log(RANGES)[:, [0, 2]])
        variance, length, noise = np.exp(found.x)
        kernel = variance * np.exp(-squares / (2 * length**2)) + noise * np.eye(len(x))
        return GaussianProcess(x, cho_solve(cho_factor(kernel, lower=True), y), float(variance), float(length))

    def predict(self, x: np.ndarray) -> np.ndarray:
        """Means at some places (rows, features), (rows, outputs)."""
        return self.variance * np.exp(-_squared_distances(x, self.x) / (2 * self.length**2)) @ self.weights


def _squared_distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Squared distances between all rows of two arrays, (rows, rows)."""
    return np.maximum((a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T, 0.0)


def _features(run: Run, scale: np.ndarray, memory: float) -> np.ndarray:
    """Inputs over their size, the same low-passed with a memory in s where there is one, and the tip force in N, (rows, features)."""
    from scipy.signal import lfilter  # as above

    inputs = run.inputs / scale
    if not memory:
        return np.hstack([inputs, run.tip_force])
    pole = np.exp(-float(np.median(np.diff(run.time))) / memory) if run.rows > 1 else 0.0
    past = inputs[0] + lfilter([1 - pole], [1, -pole], inputs - inputs[0], axis=0)
    return np.hstack([inputs, past, run.tip_force])
