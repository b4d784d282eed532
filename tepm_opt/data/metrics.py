"""Distances between two robots' reference points: Eq. (5), per point and over time."""

from __future__ import annotations

import numpy as np


def point_errors(measured: np.ndarray, modelled: np.ndarray) -> np.ndarray:
    """ε_si of Eq. (5): distances of the reference points, (…, points) in m, from two arrays of (…, points, 3)."""
    return np.linalg.norm(np.asarray(measured) - np.asarray(modelled), axis=-1)


def shape_error(measured: np.ndarray, modelled: np.ndarray) -> np.ndarray:
    """E of Eq. (5) at every instant, (…) in m: root mean square over the points that are present; NaN where none is."""
    squares = point_errors(measured, modelled) ** 2
    present = np.isfinite(squares)
    count = present.sum(axis=-1)
    total = np.where(present, squares, 0.0).sum(axis=-1)
    return np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def error_over_time(measured: np.ndarray, modelled: np.ndarray) -> float:
    """Root mean square of Eq. (5) over the instants (instants, points, 3) in m; points that are missing do not count."""
    squares = point_errors(measured, modelled) ** 2
    return float(np.sqrt(np.nanmean(squares))) if np.isfinite(squares).any() else float("nan")
