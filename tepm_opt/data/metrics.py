"""Distances between two robots' reference points: Eq. (5), per point and over time.

Where axes are missing, the distance is the one along those that were measured: in the plane of a camera, say. Nothing is made up for
the others, so such errors compare with each other and with `axes_measured` noises, not with those of points measured in all axes.
"""

from __future__ import annotations

import numpy as np


def point_errors(measured: np.ndarray, modelled: np.ndarray) -> np.ndarray:
    """ε_si of Eq. (5): distances of the reference points along the axes measured, (…, points) in m, from two arrays of (…, points, 3).

    NaN where no axis was measured.
    """
    squares = (np.asarray(measured) - np.asarray(modelled)) ** 2
    present = np.isfinite(squares)
    return np.sqrt(np.where(present.any(axis=-1), np.where(present, squares, 0.0).sum(axis=-1), np.nan))


def axes_measured(measured: np.ndarray) -> float:
    """Axes measured of a point that was, on average over (…, points, 3); all where none was: noise alone leaves its root times 1 sigma."""
    present = np.isfinite(measured)
    return float(present.sum() / max(present.any(axis=-1).sum(), 1)) or float(present.shape[-1])


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
