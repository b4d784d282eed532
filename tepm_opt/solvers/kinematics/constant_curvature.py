"""Constant-curvature kinematics in closed form, both ways: actuator lengths and tip (Webster and Jones, IJRR 29, 2010).

A module is an arc of length s, curvature kappa and bending direction phi: it bends towards (cos phi, sin phi). It knows no
gravity and no elasticity: a seed, a check, and a way to see what the network adds. Base frame, m and rad.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np


def arc_from_lengths(
    lengths: Sequence[float] | np.ndarray, radius: float, angles: Sequence[float] | np.ndarray
) -> tuple[float, float, float]:
    """Arc (s, kappa, phi) of a module from its actuator lengths (actuators,).

    L_j = s (1 - kappa r cos(a_j - phi)); exact for three actuators, least squares for more.
    """
    angles = np.asarray(angles)
    columns = np.stack([np.ones_like(angles), np.cos(angles), np.sin(angles)], axis=1)
    mean, cosine, sine = np.linalg.lstsq(columns, np.asarray(lengths, dtype=float), rcond=None)[0]
    return float(mean), float(np.hypot(cosine, sine) / (mean * radius)), float(np.arctan2(-sine, -cosine))


def lengths_from_arc(arc: tuple[float, float, float], radius: float, angles: Sequence[float] | np.ndarray) -> np.ndarray:
    """Actuator lengths (actuators,) of an arc (s, kappa, phi): the inverse of `arc_from_lengths`."""
    s, kappa, phi = arc
    return s * (1 - kappa * radius * np.cos(np.asarray(angles) - phi))


def transform(arc: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and position (3,) of an arc's end in the frame of its start."""
    s, kappa, phi = arc
    bend = kappa * s
    direction = np.array([np.cos(phi), np.sin(phi), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    # sinc forms stay exact for the straight module
    position = s * (np.sinc(bend / np.pi) * up + bend / 2 * np.sinc(bend / (2 * np.pi)) ** 2 * direction)
    across = np.cross(up, direction)
    cosine, sine = np.cos(bend), np.sin(bend)
    skew = np.array([[0, -across[2], across[1]], [across[2], 0, -across[0]], [-across[1], across[0], 0]])
    rotation = cosine * np.eye(3) + sine * skew + (1 - cosine) * np.outer(across, across)
    return rotation, position


def tip_from_lengths(lengths: np.ndarray, radius: float, angles: Sequence[float] | np.ndarray) -> np.ndarray:
    """Tip (3,) of a chain of modules from its actuator lengths (modules, actuators)."""
    rotation, position = np.eye(3), np.zeros(3)
    for module in np.atleast_2d(lengths):
        turn, shift = transform(arc_from_lengths(module, radius, angles))
        position, rotation = position + rotation @ shift, rotation @ turn
    return position


def lengths_from_tip(tip: Sequence[float] | np.ndarray, modules: int, radius: float, angles: Sequence[float] | np.ndarray) -> np.ndarray:
    """Equal actuator lengths (modules, actuators) with which a chain of equal-curvature modules ends at `tip`.

    All modules together are one arc through base and tip, tangent to z at the base, hence unique.

    Args:
        tip: in the base frame, (3,) in m.
        modules: how many.
        radius: of the actuators' circle, m.
        angles: of the actuators on it, (actuators,) in rad.

    Raises:
        ValueError: the tip is not above the base plane's origin in any arc of less than a full turn (tip at the base).
    """
    x, y, z = map(float, tip)
    across, distance = math.hypot(x, y), math.hypot(x, y, z)
    if distance == 0 or (across == 0 and z < 0):
        raise ValueError(f"no arc from the base ends at {tip}")
    half_bend = math.atan2(across, z)  # the chord leaves the tangent by half the arc's angle
    length = distance * half_bend / math.sin(half_bend) if half_bend else distance
    arc = (length / modules, 2 * half_bend / length, math.atan2(y, x))
    return lengths_from_arc(arc, radius, angles)[None].repeat(modules, axis=0)
