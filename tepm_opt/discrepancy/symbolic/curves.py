"""Shapes of laws without a formula: splines, banks of lags and of plays, polynomials in space."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Protocol

import numpy as np
from scipy.interpolate import BSpline


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
        """Contribution of each coefficient, (samples, …, size), at a variable's values, (samples, …), and times in s, (samples,)."""
        ...


@dataclass(frozen=True)
class Spline:
    """Quadratic B-splines between knots; straight lines outside.

    Attributes:
        knots: increasing, the ends of the visited range first and last.
    """

    knots: tuple[float, ...]

    @staticmethod
    def from_values(values: np.ndarray, pieces: int) -> Spline:
        """Knots over the values visited, half-way between even ones and quantiles: denser where data are dense."""
        parts = np.linspace(0, 1, pieces + 1)
        low, high = float(values.min()), float(values.max())
        knots = (np.quantile(values, parts) + low + parts * (high - low)) / 2
        return Spline(tuple(np.maximum.accumulate(knots + 1e-9 * (high - low) * np.arange(pieces + 1)).tolist()))

    @staticmethod
    def from_zero(values: np.ndarray, pieces: int) -> Spline:
        """Knots denser towards the lowest value visited, where thresholds and slack are: each piece is three times the one before."""
        low, high = float(values.min()), float(values.max())
        ends = np.append(0.0, np.cumsum(3.0 ** np.arange(pieces)))
        return Spline(tuple((low + (high - low) * ends / ends[-1]).tolist()))

    @property
    def size(self) -> int:
        return len(self.knots) + 1

    @property
    def penalty(self) -> np.ndarray:
        second = np.diff(np.eye(self.size), 2, axis=0)
        return second.T @ second + 1e-2 * np.eye(self.size)  # a little towards zero, where the data determine no level

    def columns(self, values: np.ndarray, time: np.ndarray) -> np.ndarray:
        low, high = self.knots[0], self.knots[-1]
        spline = BSpline(np.concatenate([[low] * 2, self.knots, [high] * 2]), np.eye(self.size), 2)
        inside = np.clip(values, low, high)
        return spline(inside) + (values - inside)[..., None] * spline(inside, 1)


@dataclass(frozen=True)
class Memory(ABC):
    """A bank of operators with memory: their outputs less the variable, per `unit` of it.

    Attributes:
        scales: of the operators.
        unit: of the variable, for which a coefficient stands.
    """

    scales: tuple[float, ...]
    unit: float

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return len(self.scales)

    @property
    def penalty(self) -> np.ndarray:
        """No preference but for small coefficients."""
        return np.eye(self.size)

    def columns(self, values: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Contribution of each coefficient, see `Shape`."""
        return np.stack([self.output(values, time, scale) - values for scale in self.scales], axis=-1) / self.unit

    @abstractmethod
    def output(self, values: np.ndarray, time: np.ndarray, scale: float) -> np.ndarray:
        """Output of the operator of one scale, (samples, …)."""


class Lags(Memory):
    """First-order lags; scales are time constants in s."""

    def output(self, values: np.ndarray, time: np.ndarray, scale: float) -> np.ndarray:
        """Exact lag of a variable that is linear between samples, from rest at the first."""
        found = np.array(values, dtype=float)
        for k, h in enumerate(np.diff(time), start=1):
            slope = (values[k] - values[k - 1]) / h
            found[k] = values[k] - scale * slope + (found[k - 1] - values[k - 1] + scale * slope) * np.exp(-h / scale)
        return found


class Plays(Memory):
    """Plays (Prandtl and Ishlinskii's hysteresis); scales are half-widths in the variable's unit."""

    def output(self, values: np.ndarray, time: np.ndarray, scale: float) -> np.ndarray:
        """Play operator, from its middle at the first sample."""
        found = np.array(values, dtype=float)
        for k in range(1, len(values)):
            found[k] = np.clip(found[k - 1], values[k] - scale, values[k] + scale)
        return found


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
    def from_values(values: np.ndarray, degree: int) -> Powers:
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
        return np.diag([4.0 ** len(term) for term in self.exponents]) * 1e-2  # half the standard deviation a degree

    def columns(self, values: np.ndarray, time: np.ndarray) -> np.ndarray:
        scaled = (values - np.array(self.centre)) / np.array(self.half)
        return np.stack([np.prod(scaled[..., list(term)], axis=-1) for term in self.exponents], axis=-1)
