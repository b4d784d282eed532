"""The nominal backbone (IV.B): a curve through the base's centre and the reference points."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator


def backbone(base: np.ndarray, points: np.ndarray, count: int = 41) -> np.ndarray:
    """PCHIP (Fritsch and Carlson 1980) over the number of the point, (…, count, 3) in m.

    Args:
        base: the base plate's centre, (3,) in m.
        points: reference points in the same frame, (…, points, 3) in m, all finite.
        count: of points on the curve, evenly spread over the numbers of the knots.
    """
    points = np.asarray(points, dtype=float)
    knots = np.concatenate([np.broadcast_to(base, (*points.shape[:-2], 1, 3)), points], axis=-2)
    number = np.arange(knots.shape[-2])
    return PchipInterpolator(number, knots, axis=-2)(np.linspace(0, number[-1], count))


def backbone_error(base: np.ndarray, measured: np.ndarray, modelled: np.ndarray, count: int = 41) -> np.ndarray:
    """Distance of two backbones at the same parameters, (…, count) in m.

    Args:
        base: the base plate's centre, (3,) in m.
        measured, modelled: reference points in the same frame, (…, points, 3) in m.
        count: of points on the curves.
    """
    return np.linalg.norm(backbone(base, measured, count) - backbone(base, modelled, count), axis=-1)
