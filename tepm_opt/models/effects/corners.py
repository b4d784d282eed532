"""Corners of input maps, rounded and not."""

from __future__ import annotations

import casadi as ca

ROUNDING = 0.2  # half-width of a rounded corner over the threshold, where nothing else is known
SMALLEST_WIDTH = 1e-12  # keeps the corner's formula finite where the threshold vanishes
STRAIGHT = 1e-3  # of a corner's width: over less the mean is the value in the middle


def subtract_threshold(signal: ca.SX, threshold: ca.SX, rounding: ca.SX | float = ROUNDING) -> ca.SX:
    """max(signal - threshold, 0), its corner rounded by a parabola so that the gain is continuous.

    `rounding` is the half-width of the rounded corner over the threshold.
    """
    rest = signal - threshold
    width = rounding * threshold
    corner = (rest + width) ** 2 / (4 * ca.fmax(width, SMALLEST_WIDTH))
    return ca.if_else(rest >= width, rest, ca.if_else(rest <= -width, 0, corner))


def ramp(signal: ca.SX, width: ca.SX) -> tuple[ca.SX, ca.SX]:
    """max(signal, 0), its corner rounded by a parabola of this half-width, and its integral over the signal."""
    within = signal + width
    value = ca.if_else(signal >= width, signal, ca.if_else(signal <= -width, 0, within**2 / (4 * width)))
    integral = ca.if_else(signal >= width, (signal**2 + width**2 / 3) / 2, ca.if_else(signal <= -width, 0, within**3 / (12 * width)))
    return value, integral


def mean_ramp(signal: ca.SX, further: ca.SX, width: ca.SX) -> ca.SX:
    """Mean of `ramp` from the signal to one that is further."""
    straight = ca.fabs(further) < STRAIGHT * width
    over = ca.if_else(straight, STRAIGHT * width, further)
    mean = (ramp(signal + over, width)[1] - ramp(signal, width)[1]) / over
    return ca.if_else(straight, ramp(signal + further / 2, width)[0], mean)


def no_less_than_nothing(pressure: ca.SX, by: ca.SX, one_sided: ca.SX) -> ca.SX:
    """Pressures to which a constant is added later: as much more as the sum, where `one_sided` is 1, does not fall below 0."""
    return pressure + one_sided * ca.fmax(-(pressure + by), 0)
