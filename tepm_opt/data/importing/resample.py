"""Samples at any times brought onto an even grid, with a filter against what the grid cannot carry."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import firwin, kaiserord, resample_poly

ATTENUATION = 60.0  # dB beyond half the new rate, and below 0.8 of that within as much of 1
PASS = 0.8  # of half the new rate
LIKE = 1.1  # times the new rate: up to here there is nothing to filter
GAP = 1.9  # steps without a sample that count as lost ones
CLOSE = 1e-3  # steps of the grid that a sample may be off and still be there: what stamps are rounded by


@dataclass(frozen=True, eq=False)
class Clock:
    """Times of samples.

    Attributes:
        time: in s, (rows,), increasing.
        known: rate in Hz where it is known, not measured.
        told: words about how the times were made.
    """

    time: np.ndarray
    known: float | None = None
    told: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Clock({len(self.time)} rows, {self.rate:.4g} Hz)"

    @cached_property
    def step(self) -> float:
        """Median time between samples in s; 0 where there is only one."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else 0.0

    @property
    def rate(self) -> float:
        """Samples a second, by the median step."""
        return 1 / self.step if self.step else 0.0

    @property
    def jitter(self) -> float:
        """Standard deviation of the steps that are no gaps, over the median step."""
        steps = np.diff(self.time)
        steps = steps[steps < GAP * self.step]
        return float(np.std(steps) / self.step) if len(steps) else 0.0

    @property
    def gaps(self) -> np.ndarray:
        """Steps in s in which samples are lost."""
        steps = np.diff(self.time)
        return steps[steps >= GAP * self.step]

    @property
    def own_rate(self) -> float:
        """A rate in Hz for a grid: the samples' own in as few digits as keep step with them, of irregular ones three digits."""
        if self.known is not None:
            return self.known
        if self.jitter > 0.01 or self.gaps.size:
            return float(f"{self.rate:.3g}")
        steps = len(self.time) - 1
        exact = steps / float(self.time[-1] - self.time[0])
        rounded = (float(f"{exact:.{digits}g}") for digits in range(3, 17))
        return next(rate for rate in rounded if abs(rate / exact - 1) * steps < CLOSE)


def grid_of(start: float, end: float, rate: float) -> np.ndarray:
    """Even times in s from `start` that do not pass `end`, (rows,)."""
    return start + np.arange(int(np.floor((end - start) * rate + CLOSE)) + 1) / rate


def reduction(clock: Clock, rate: float) -> int:
    """Count the steps of the fine grid, on which samples are filtered, that make one of the new; 1: no filter."""
    return 1 if clock.rate <= LIKE * rate else int(np.ceil(clock.rate / rate - 1e-6))


@lru_cache
def taps(steps: int) -> np.ndarray:
    """Finite impulse response of the filter for a fine grid of `steps` steps to one of the new: linear phase, sum 1."""
    count, beta = kaiserord(ATTENUATION, (1 - PASS) / steps)
    return np.asarray(firwin(count | 1, (1 + PASS) / 2 / steps, window=("kaiser", beta)))  # type: ignore[arg-type]


def resample_measured(clock: Clock, values: np.ndarray, grid: np.ndarray, rate: float) -> np.ndarray:
    """Bring one measured column onto a grid: a cubic spline through the samples, on a fine grid through a filter without delay.

    Below 0.8 of half the new rate 0.999 … 1.001 passes, above half the new rate 0.001 at most. No sample is made up where there was
    none for 1.9 steps of the samples and, where they are filtered, a step of the grid.

    Args:
        clock: times of the samples.
        values: the samples, (rows,); NaN where one is missing.
        grid: even times in s at this rate, (new rows,).
        rate: of the grid in Hz.

    Returns:
        (new rows,), NaN where samples are missing.
    """
    steps = reduction(clock, rate)
    found = np.full(len(grid), np.nan)
    known = np.isfinite(values)
    longest = max(GAP * clock.step, 1 / rate if steps > 1 else 0.0) * (1 + 1e-9)
    for time, part in _stretches(clock.time[known], values[known], longest):
        slack = CLOSE / rate
        first, last = np.searchsorted(grid, [time[0] - slack, time[-1] + slack])
        if first == last:
            continue
        first, last = int(first), int(last)
        rows = slice(first, last)
        if len(time) == 1:
            found[rows] = part[0]
        elif steps == 1:
            found[rows] = _curve(time, part, grid[rows])
        else:
            # the stretch may go on before the first of its rows and behind the last: the filter takes that along
            before = int(np.floor((grid[first] - time[0]) * rate * steps + CLOSE))
            behind = int(np.floor((time[-1] - grid[last - 1]) * rate * steps + CLOSE))
            fine = grid[first] + np.arange(-before, (last - first - 1) * steps + behind + 1) / (rate * steps)
            found[rows] = _decimate(_curve(time, part, fine), steps, before)[: last - first]
    return found


def _decimate(fine: np.ndarray, steps: int, first: int) -> np.ndarray:
    """Filter a fine grid and take every so many steps, from the row `first` on; ends go on mirrored through their last values."""
    beyond = steps * -(-(len(taps(steps)) // 2) // steps)
    beyond += -(first + beyond) % steps
    whole = np.pad(fine, beyond, mode="reflect", reflect_type="odd")
    return resample_poly(whole, 1, steps, window=taps(steps))[(first + beyond) // steps :]


def _stretches(time: np.ndarray, values: np.ndarray, longest: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Parts of a column between gaps that are longer than `longest` s."""
    cuts = np.flatnonzero(np.diff(time) > longest) + 1
    for rows in np.split(np.arange(len(time)), cuts):
        if len(rows):
            yield time[rows], values[rows]


def _curve(time: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    at = np.clip(at, time[0], time[-1])
    return np.interp(at, time, values) if len(time) < 4 else CubicSpline(time, values)(at)


def resample_commanded(clock: Clock, values: np.ndarray, grid: np.ndarray, hold: bool) -> np.ndarray:
    """Bring one column that is put in onto a grid, never filtered.

    Args:
        clock: times of the samples.
        values: the samples, (rows,); where `hold`, NaN keeps the value before.
        grid: even times in s, (new rows,).
        hold: whether a value holds until the next one; else straight lines go between them.
    """
    if not hold:
        return np.interp(grid, clock.time, values)
    known = np.isfinite(values)
    place = np.searchsorted(clock.time[known], grid + 1e-9, side="right") - 1
    return np.where(place < 0, np.nan, values[known][np.maximum(place, 0)]) if known.any() else np.full(len(grid), np.nan)
