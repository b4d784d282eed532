"""Shapes that a law may have before anybody knows its formula: splines, banks of lags and of plays, polynomials in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Protocol

import numpy as np
from scipy.interpolate import BSpline

RIDGE = 1e-2  # of the smoothness prior: pulls to zero what is smooth anyway
DEGREE = 2


class Shape(Protocol):
    """A family of functions of a variable's history, linear in coefficients that have the law's unit."""

    @property
    def size(self) -> int:
        """Number of coefficients."""
        ...

    @property
    def penalty(self) -> np.ndarray:
        """Precision of the smoothness prior, up to its strength, (size, size)."""
        ...

    def columns(self, values: np.ndarray, time: np.ndarray) -> np.ndarray:
        """What each coefficient contributes, (samples, …, size), for a variable's values, (samples, …), at times in s, (samples,)."""
        ...


@dataclass(frozen=True)
class Spline:
    """Quadratic B-splines between knots; straight on outside, as nobody knows better there.

    Attributes:
        knots: increasing, the ends of the visited range first and last.
    """

    knots: tuple[float, ...]

    @staticmethod
    def over(values: np.ndarray, pieces: int) -> Spline:
        """Knots over the values visited: half-way between even ones and quantiles, so that a bend is found where data are dense."""
        parts = np.linspace(0, 1, pieces + 1)
        low, high = float(values.min()), float(values.max())
        knots = (np.quantile(values, parts) + low + parts * (high - low)) / 2
        return Spline(tuple(np.maximum.accumulate(knots + 1e-9 * (high - low) * np.arange(pieces + 1)).tolist()))

    @staticmethod
    def from_zero(values: np.ndarray, pieces: int) -> Spline:
        """Knots denser towards the lowest value visited, where thresholds and slack show: each piece is three times the one before."""
        low, high = float(values.min()), float(values.max())
        ends = np.append(0.0, np.cumsum(3.0 ** np.arange(pieces)))
        return Spline(tuple((low + (high - low) * ends / ends[-1]).tolist()))

    @property
    def size(self) -> int:
        return len(self.knots) - 1 + DEGREE

    @property
    def penalty(self) -> np.ndarray:
        second = np.diff(np.eye(self.size), 2, axis=0)
        return second.T @ second + RIDGE * np.eye(self.size)

    def columns(self, values: np.ndarray, time: np.ndarray) -> np.ndarray:
        low, high = self.knots[0], self.knots[-1]
        spline = BSpline(np.concatenate([[low] * DEGREE, self.knots, [high] * DEGREE]), np.eye(self.size), DEGREE)
        inside = np.clip(values, low, high)
        return spline(inside) + (values - inside)[..., None] * spline(inside, 1)


@dataclass(frozen=True)
class Lags:
    """How far first-order lags of some time constants are behind the variable, per `unit` of it.

    Attributes:
        times: time constants in s.
        unit: of the variable, for which a coefficient stands.
    """

    times: tuple[float, ...]
    unit: float

    @property
    def size(self) -> int:
        return len(self.times)

    @property
    def penalty(self) -> np.ndarray:
        return np.eye(self.size)

    def columns(self, values: np.ndarray, time: np.ndarray) -> np.ndarray:
        return np.stack([late(values, time, constant) - values for constant in self.times], axis=-1) / self.unit


@dataclass(frozen=True)
class Plays:
    """How far plays of some widths are behind the variable, per `unit` of it (Prandtl and Ishlinskii's hysteresis).

    Attributes:
        radii: half-widths, in the variable's unit.
        unit: of the variable, for which a coefficient stands.
    """

    radii: tuple[float, ...]
    unit: float

    @property
    def size(self) -> int:
        return len(self.radii)

    @property
    def penalty(self) -> np.ndarray:
        return np.eye(self.size)

    def columns(self, values: np.ndarray, time: np.ndarray) -> np.ndarray:
        return np.stack([play(values, radius) - values for radius in self.radii], axis=-1) / self.unit


@dataclass(frozen=True)
class Powers:
    """Products of up to `degree` coordinates, scaled to -1 … 1 over what was visited.

    Attributes:
        centre, half: of the visited range of every coordinate.
        degree: largest.
    """

    centre: tuple[float, ...]
    half: tuple[float, ...]
    degree: int

    @staticmethod
    def over(values: np.ndarray, degree: int) -> Powers:
        """Powers over the visited values, (samples, coordinates)."""
        low, high = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
        return Powers(tuple(((low + high) / 2).tolist()), tuple(np.maximum((high - low) / 2, 1e-9).tolist()), degree)

    @property
    def exponents(self) -> list[tuple[int, ...]]:
        """Coordinates multiplied in each term."""
        return [term for degree in range(self.degree + 1) for term in combinations_with_replacement(range(len(self.centre)), degree)]

    @property
    def size(self) -> int:
        return len(self.exponents)

    @property
    def penalty(self) -> np.ndarray:
        return np.diag([4.0 ** len(term) for term in self.exponents]) * RIDGE

    def columns(self, values: np.ndarray, time: np.ndarray) -> np.ndarray:
        scaled = (values - np.array(self.centre)) / np.array(self.half)
        return np.stack([np.prod(scaled[..., list(term)], axis=-1) for term in self.exponents], axis=-1)


def late(values: np.ndarray, time: np.ndarray, constant: float) -> np.ndarray:
    """A first-order lag of what is linear between samples, from rest at the first: exact."""
    found = np.array(values, dtype=float)
    for k, h in enumerate(np.diff(time), start=1):
        slope = (values[k] - values[k - 1]) / h
        found[k] = values[k] - constant * slope + (found[k - 1] - values[k - 1] + constant * slope) * np.exp(-h / constant)
    return found


def play(values: np.ndarray, radius: float) -> np.ndarray:
    """What a play of this half-width drags along, from its middle at the first sample."""
    found = np.array(values, dtype=float)
    for k in range(1, len(values)):
        found[k] = np.clip(found[k - 1], values[k] - radius, values[k] + radius)
    return found


def straight(penalties: Sequence[np.ndarray]) -> np.ndarray:
    """Penalties of several coefficients' groups together."""
    size = sum(len(each) for each in penalties)
    whole, at = np.zeros((size, size)), 0
    for each in penalties:
        whole[at : at + len(each), at : at + len(each)] = each
        at += len(each)
    return whole
