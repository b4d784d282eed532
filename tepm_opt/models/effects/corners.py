"""Corners of input maps, rounded and not."""

from __future__ import annotations

import casadi as ca

ROUNDING = 0.2  # half-width of a rounded corner over the threshold, where nothing else is known
SMALLEST_WIDTH = 1e-9  # keeps the corner's formula finite where the threshold vanishes


def above(signal: ca.SX, threshold: ca.SX, rounding: ca.SX | float = ROUNDING) -> ca.SX:
    """max(signal - threshold, 0), its corner rounded by a parabola so that the gain is continuous.

    `rounding` is the half-width of the rounded corner over the threshold.
    """
    rest = signal - threshold
    width = rounding * threshold
    corner = (rest + width) ** 2 / (4 * ca.fmax(width, SMALLEST_WIDTH))
    return ca.if_else(rest >= width, rest, ca.if_else(rest <= -width, 0, corner))


def offset(pressure: ca.SX, by: ca.SX, one_sided: ca.SX) -> ca.SX:
    """Pressures with a constant more; where `one_sided` is 1 they do not fall below 0, where it is 0 they do, without a corner."""
    shifted = pressure + by
    return shifted - one_sided * ca.fmin(shifted, 0)
