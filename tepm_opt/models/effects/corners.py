"""Rounded corners of input maps."""

from __future__ import annotations

import casadi as ca

ROUNDING = 0.2  # half-width of the rounded corner over the threshold
SMALLEST_WIDTH = 1e-9  # keeps the corner's formula finite where the threshold vanishes


def above(signal: ca.SX, threshold: ca.SX) -> ca.SX:
    """max(signal - threshold, 0), its corner rounded by a parabola so that the gain is continuous."""
    rest = signal - threshold
    width = ROUNDING * threshold
    corner = (rest + width) ** 2 / (4 * ca.fmax(width, SMALLEST_WIDTH))
    return ca.if_else(rest >= width, rest, ca.if_else(rest <= -width, 0, corner))
