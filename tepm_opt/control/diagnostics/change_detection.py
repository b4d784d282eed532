"""A change at an unknown time in known directions: generalised likelihood ratios over a regression whose noise is known in form.

Measurements are y = X θ + noise, where X is known and θ is what sets a machine apart from its model, unknown within a prior. A change at
a time s adds the column c of X times a size from then on. Its evidence over no change, with θ estimated from all measurements beside it,
is that of a linear model and needs nothing but sums over time (Willsky and Jones, A generalized likelihood ratio approach to the
detection and estimation of jumps in linear systems, IEEE Trans. Autom. Control 21, 1976; Quandt's test with a prior).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np


class PrewhiteningFilter:
    """Whitening of measurements whose noise is white noise, slow disturbances (Gauss-Markov) and what belongs to a place and is the same
    whenever it is come to: by a Kalman filter that goes over measurements and regressors alike (generalised least squares; Harvey,
    Forecasting, structural time series models, 1989, section 3.4).

    Args:
        spreads: of the slow disturbances at rest, (states,).
        times: over which they fade in s, (states,).
        outputs: number of measurements in a row.
        columns: number of columns that go through.
        period: from row to row in s.
    """

    def __init__(self, spreads: np.ndarray, times: np.ndarray, outputs: int, columns: int, period: float) -> None:
        self._kept = np.concatenate([np.ones(outputs), np.exp(-period / times)])
        self._covariance = np.diag(np.concatenate([np.zeros(outputs), spreads**2]))
        self._added = self._covariance * (1 - self._kept**2)
        self._state = np.zeros((len(self._kept), columns))
        self._place, self._own = -1, slice(0, outputs)
        self._known: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def whiten(self, rows: np.ndarray, seen: np.ndarray, white: np.ndarray, place: int, prior: np.ndarray, again: np.ndarray) -> np.ndarray:
        """Whiten rows of measurements and regressors: independent rows of unit variance.

        Args:
            rows: (outputs, columns).
            seen: of the slow disturbances, (outputs, states).
            white: covariance of the white noise, (outputs, outputs).
            place: number of the place, 0 and above.
            prior: covariance of what belongs to it, before anything is known of it, (outputs, outputs).
            again: covariance of what differs from visit to visit, (outputs, outputs).
        """
        state, covariance, own = (
            self._kept[:, None] * self._state,
            self._kept[:, None] * self._covariance * self._kept + self._added,
            self._own,
        )
        if place != self._place:
            self._known[self._place] = self._state[own], self._covariance[own, own]
            state[own], known = self._known.get(place, (0.0, prior))
            covariance[own], covariance[:, own] = 0.0, 0.0
            covariance[own, own], self._place = known + again, place
        seen = np.hstack([np.eye(len(rows)), seen])
        crossed = seen @ covariance
        innovations = rows - seen @ state
        root = np.linalg.cholesky(crossed @ seen.T + white)
        halves = np.linalg.solve(root, np.hstack([innovations, crossed]))
        done, gain = halves[:, : rows.shape[1]], halves[:, rows.shape[1] :]
        self._state = state + gain.T @ done
        self._covariance = covariance - gain.T @ gain
        return done


@dataclass(frozen=True, eq=False)
class GlrStatistics:
    """Score and information of a change by its time, per column, after removal of what θ explains.

    Attributes:
        score: (times, …, columns).
        information: (times, …, columns, columns).
        theta: estimate of θ from all measurements, (…, columns).
        noise: over what is assumed (variances), (machines,).
    """

    score: np.ndarray
    information: np.ndarray
    theta: np.ndarray
    noise: np.ndarray


class Sums:
    """Sums over time of one or several regressions of the same columns, with marks at which a change may begin.

    Args:
        spreads: of θ before anything was measured, (columns,).
        machines: number of regressions beside each other.
        marks: how many are kept.
        least: noise that is left at least, over what is assumed (variances).
    """

    def __init__(self, spreads: np.ndarray, machines: int, marks: int, least: float) -> None:
        self._prior, self._least = np.diag(spreads**-2.0), least
        count = len(spreads) + 1
        self._sum, self._rows = np.zeros((machines, count, count)), 0
        self._marks: deque[tuple[np.ndarray, int]] = deque(maxlen=marks)

    def add(self, rows: np.ndarray) -> None:
        """Take rows of unit variance, the measurement in the first column, (machines, rows, 1 + columns)."""
        self._sum = self._sum + np.swapaxes(rows, -1, -2) @ rows
        self._rows += rows.shape[1]

    def mark(self) -> None:
        """Let a change be possible from the next row on."""
        self._marks.append((self._sum, self._rows))

    def score_changes(self) -> GlrStatistics:
        """Score and information of a change at each mark, the oldest first; the noise is the residual before the first mark.

        Without a row before it the noise is not known, and nothing tells of a change.
        """
        begun, rows = self._marks[0]
        left = begun[:, 0, 0] - self._sum_explained_squares(begun)
        noise = np.maximum(left / rows, self._least) if rows else np.full(len(left), np.inf)
        whole = self._sum
        inverse = np.linalg.inv(whole[:, 1:, 1:] + self._prior)
        theta = (inverse @ whole[:, 1:, :1])[..., 0]
        since = whole - np.array([sums for sums, _ in self._marks])
        part = since[..., 1:, 1:]
        score = (since[..., 1:, 0] - (part @ theta[..., None])[..., 0]) / noise[:, None]
        return GlrStatistics(score, (part - part @ inverse @ part) / noise[:, None, None], theta, noise)

    def measure_misfit(self, mark: int, machine: int, evidence: float, noise: np.ndarray) -> tuple[int, float]:
        """Rows since a mark, and the sum of squares over the noise that a change leaves of them.

        Args:
            mark: number of the mark, 0 for the oldest that is kept.
            machine: number of the regression.
            evidence: of the change, half of what it takes off the sum of squares over the noise.
            noise: over what is assumed (variances), (machines,).
        """
        sums, rows = self._marks[mark]
        since = self._sum[machine, 0, 0] - self._sum_explained_squares(self._sum)[machine]
        since -= sums[machine, 0, 0] - self._sum_explained_squares(sums)[machine]
        return self._rows - rows, float(since / noise[machine]) - 2 * evidence

    def _sum_explained_squares(self, sums: np.ndarray) -> np.ndarray:
        by = sums[:, 1:, :1]
        return (by * np.linalg.solve(sums[:, 1:, 1:] + self._prior, by)).sum(axis=(1, 2))
