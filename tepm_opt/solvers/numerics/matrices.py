"""Banded storage of symmetric matrices, and independent columns of any."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla


def upper_from_band(band: np.ndarray) -> np.ndarray:
    """Upper half of a symmetric matrix (n, n) in lower banded storage (SciPy's `solveh_banded` layout)."""
    n = band.shape[1]
    width = min(len(band), n + 1)
    half = np.zeros((n, n + 1))
    half[:, :width] = band[:width].T  # row i begins at column i where rows have n elements
    return half.reshape(-1)[: n * n].reshape(n, n)


def expand_band(band: np.ndarray) -> np.ndarray:
    """Expand a symmetric matrix (n, n) from its lower banded storage."""
    half = upper_from_band(band)
    return half + half.T - np.diag(band[0])


def choose_independent_columns(rows: np.ndarray, count: int) -> np.ndarray:
    """Choose columns of a matrix that are independent of each other, the clearest first, (count,)."""
    pivots = np.asarray(sla.qr(rows, mode="r", pivoting=True)[-1]) if count else np.zeros(0)
    return pivots[:count].astype(int)
