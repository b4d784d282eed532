"""Linear least squares within bounds, from the normal equations."""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear


def bounded_step(
    square: np.ndarray, slope: np.ndarray, low: np.ndarray, high: np.ndarray, scale: np.ndarray, damping: float = 0.0
) -> tuple[np.ndarray, float]:
    """Minimiser d of dᵀ square d + 2 slopeᵀ d (+ damping) within low ≤ d ≤ high, and by how much it falls short of 0.

    Directions without any influence are left where they are.

    Args:
        square: JᵀJ, (parameters, parameters).
        slope: Jᵀr, (parameters,).
        low, high: bounds of d, (parameters,) each; low ≤ 0 ≤ high.
        scale: of d, (parameters,).
        damping: Levenberg-Marquardt's, relative to the diagonal of the scaled JᵀJ.
    """
    H, g = square * np.outer(scale, scale), slope * scale
    size = np.maximum(np.diag(H), 1e-12 * max(float(np.max(np.diag(H), initial=0.0)), 1e-30))
    root = np.sqrt(size)
    scaled = H / np.outer(root, root)
    try:
        factor = np.linalg.cholesky(scaled + (damping + 1e-10) * np.eye(len(g))).T
    except np.linalg.LinAlgError:  # differences of nearly equal sums are not positive to the last digits
        below = max(-float(np.linalg.eigvalsh(scaled)[0]), 0.0)
        factor = np.linalg.cholesky(scaled + (damping + 2 * below + 1e-10) * np.eye(len(g))).T
    target = -np.linalg.solve(factor.T, g / root)
    limits = [np.minimum(low / scale * root, -0.0), np.maximum(high / scale * root, 0.0)]
    limits[1] = np.maximum(limits[1], limits[0] + 1e-12)
    y = lsq_linear(factor, target, bounds=(limits[0], limits[1]), method="bvls", tol=1e-12).x
    d = np.clip(y / root * scale, np.minimum(low, 0), np.maximum(high, 0))
    return d, float(-(d @ square @ d + 2 * slope @ d))
