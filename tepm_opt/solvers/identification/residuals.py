"""Measured less modelled positions with their derivatives, and the normal equations they make."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.solvers.numerics.text import shorten

BLOCK = 1.0  # s; residuals further apart than this count as independent


@dataclass(frozen=True, eq=False)
class Residual:
    """Measured less modelled positions of a run over the noise, 0 where a sample is missing.

    Attributes:
        file: the run.
        values: (rows, points, 3).
        present: whether a coordinate was measured, (rows, points, 3).
        by: change with the parameters, (rows · points · 3, parameters) per unit.
        block: number of the block of time each row belongs to, (rows,).
    """

    file: str
    values: np.ndarray
    present: np.ndarray
    by: np.ndarray
    block: np.ndarray

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Residual({shorten(self.file, 40)}, {self.count} coordinates, mean square {self.squares / max(self.count, 1):.3g})"

    @staticmethod
    def from_prediction(
        run: Run, points: np.ndarray, by: np.ndarray, noise: float | np.ndarray, at: np.ndarray | None = None, block: float = BLOCK
    ) -> Residual:
        """Form residuals from a run and its prediction.

        Args:
            run: what was measured.
            points: predicted reference points in G, (rows, points, 3) in m.
            by: their change with each parameter, (parameters, rows, points, 3) in m per its unit.
            noise: of a coordinate, 1 sigma in m; or of each point, (points, 1).
            at: time in s of the rows of `by` where these are fewer; straight lines between them.
            block: length of a block in s.
        """
        present = np.isfinite(run.points)
        values = np.where(present, run.points - points, 0.0) / noise
        time = np.arange(run.rows) if np.isnan(run.time).any() else (run.time - run.time[0]) // block
        bare = Residual(run.file, values, present, np.empty((values.size, 0)), time.astype(int))
        return bare.with_derivatives(run, by, noise, at)

    def with_derivatives(self, run: Run, by: np.ndarray, noise: float | np.ndarray, at: np.ndarray | None = None) -> Residual:
        """The residuals with derivatives.

        Args:
            run: measured.
            by: derivatives of the modelled points, (parameters, rows or samples of `at`, points, axes).
            noise: 1 sigma per axis in m, or of each point, (points, 1).
            at: times in s of the derivatives, with straight lines between them; None for all rows.
        """
        present = self.present
        slopes = np.empty((len(by), present.size))
        between = None if at is None or len(at) == run.rows else _make_interpolator(run.time, at)
        for slope, change in zip(slopes, by, strict=True):  # one by one: all of them at once take several times the memory
            whole = change if between is None else between(change)
            np.divide(np.where(present, whole, 0.0), -noise, out=slope.reshape(present.shape))
        return replace(self, by=slopes.T)

    @property
    def bare(self) -> Residual:
        """The residuals without derivatives, which take most of the memory."""
        return replace(self, by=np.empty((self.values.size, 0)))

    @property
    def count(self) -> int:
        """Coordinates measured."""
        return int(self.present.sum())

    @property
    def squares(self) -> float:
        """Sum of the squared values: about `count` where only noise is left."""
        return float(np.sum(self.values**2))


def independent_after(residuals: Sequence[Residual], runs: Sequence[Run]) -> float:
    """Time in s after which residuals forget: their integrated autocorrelation, at most a quarter of the longest run.

    Summed up to the first lag at which it is no more than 0.05 (Sokal, Monte Carlo methods in statistical mechanics, 1997, section 3).
    """
    rows = max(len(r.values) for r in residuals)
    products, step = np.zeros(rows), max(float(np.median(np.diff(run.time))) if run.rows > 1 else 0.0 for run in runs)
    for r in residuals:
        for column in r.values.reshape(len(r.values), -1).T:
            spectrum = np.abs(np.fft.rfft(column, 2 * len(column))) ** 2
            products[: len(column)] += np.fft.irfft(spectrum)[: len(column)]
    if not products[0] > 0 or not step > 0:
        return BLOCK
    correlation = products / products[0]
    ends = np.flatnonzero(correlation < 0.05)
    first = int(ends[0]) if ends.size else rows
    return float(step * np.clip(2 * correlation[:first].sum() - 1, 1.0, max(rows / 4, 1.0)))


def _make_interpolator(time: np.ndarray, at: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Make a linear interpolation from values at some times, (times, …), to all times, (rows, …)."""
    left = np.clip(np.searchsorted(at, time, side="right") - 1, 0, len(at) - 2)
    part = ((time - at[left]) / (at[left + 1] - at[left]))[:, None, None]
    return lambda values: values[left] * (1 - part) + values[left + 1] * part


def apply_weights(residual: Residual, weights: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Scale values (coordinates,) and derivatives (coordinates, parameters) by square roots of weights; None for all 1."""
    values = residual.values.ravel()
    return (values, residual.by) if weights is None else (values * weights.ravel(), residual.by * weights.reshape(-1, 1))


def normal_equations(residuals: Sequence[Residual], weights: Sequence[np.ndarray | None] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """JᵀJ (parameters, parameters) and Jᵀr (parameters,) of several runs together."""
    count = residuals[0].by.shape[1] if residuals else 0
    square, slope = np.zeros((count, count)), np.zeros(count)
    for r, w in zip(residuals, weights or [None] * len(residuals), strict=True):
        values, by = apply_weights(r, w)
        square += by.T @ by
        slope += by.T @ values
    return square, slope
