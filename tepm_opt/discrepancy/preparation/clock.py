"""Detection of a clock shift between positions and inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.fft import next_fast_len
from scipy.signal import lfilter

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.preparation.settings import DEFAULT, PreparationSettings


@dataclass(frozen=True, eq=False)
class TimeShift:
    """The shift in time that reduces a model's misfit most.

    Attributes:
        parts: (measured, modelled) over the noise and about their means, (rows, columns) each, of every run.
        steps: s between the samples of each run.
        settings: thresholds.
    """

    parts: tuple[tuple[np.ndarray, np.ndarray], ...]
    steps: tuple[float, ...]
    settings: PreparationSettings = DEFAULT

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"TimeShift({len(self.parts)} runs, {self.seconds:.2f} s explain {self.explained:.0%})"

    @cached_property
    def _costs(self) -> tuple[np.ndarray, np.ndarray]:
        """Shifts in s, and the squares that each leaves, less the noise's."""
        longest = min(min(self.settings.clock_max_shift, step * (len(y) // 2)) for (_, y), step in zip(self.parts, self.steps, strict=True))
        step = max(self.steps)
        most = int(longest / step + 1e-9)
        shifts, total = step * np.arange(-most, most + 1), np.zeros(2 * most + 1)
        for (measured, y), own in zip(self.parts, self.steps, strict=True):
            reach = int(longest / own + 1e-9)
            total += np.interp(shifts, own * np.arange(-reach, reach + 1), _squares_by_lag(measured, y, reach))
        return shifts, np.maximum(total - self.count, 0.0)

    @property
    def count(self) -> int:
        """Coordinates measured."""
        return sum(int(np.isfinite(measured).sum()) for measured, _ in self.parts)

    @property
    def seconds(self) -> float:
        """Time by which positions trail the model's at best; 0 where the squares have no minimum."""
        shifts, costs = self._costs
        best = int(np.argmin(costs))
        return float(shifts[best]) if 0 < best < len(costs) - 1 else 0.0

    @property
    def squares_before(self) -> float:
        """Squares beyond the noise's without a shift."""
        shifts, costs = self._costs
        return float(costs[len(shifts) // 2])

    @property
    def squares_after(self) -> float:
        """Squares beyond the noise's that the best shift leaves."""
        return float(self._costs[1].min())

    @property
    def explained(self) -> float:
        """Share of the structure that the best shift explains."""
        return 1 - self.squares_after / max(self.squares_before, 1e-12)

    def is_clock(self, least: float) -> bool:
        """Whether it explains at least this share, at times that no machine has, and no first-order lag explains nearly as much."""
        limits = self.settings
        if not self.parts or self.squares_before < limits.clock_min_structure * self.count or self.explained < least:
            return False
        if -limits.clock_max_lead <= self.seconds <= limits.clock_max_lag:
            return False
        if self.seconds < -limits.clock_max_lead:
            return True
        lags = np.geomspace(0.1, 10.0, 13)  # s, of a slow machine's time constant
        return min(self._lag_squares(lag) for lag in lags) >= limits.clock_min_lag_ratio * (self.squares_after + self.count)

    def _lag_squares(self, lag: float) -> float:
        """Squares that the model leaves behind a first-order lag with a time constant in s."""
        pairs = zip(self.parts, self.steps, strict=True)
        return float(sum(_squares_by_lag(measured, _apply_lag(y, lag / step), 0)[0] for (measured, y), step in pairs))


@dataclass(frozen=True)
class ClockShift:
    """A shift between the clocks of inputs and positions.

    Attributes:
        file: the run that is on another clock; empty where all runs are.
        seconds: by which positions trail the inputs; negative where they lead.
        explained: share of what is left that it explains.
    """

    file: str
    seconds: float
    explained: float

    @property
    def sentence(self) -> str:
        """The shift, for people."""
        late = f"trail the inputs by {self.seconds:.2f} s unchanged, as behind a delay and not as a slow machine does"
        how = f"lead the inputs by {-self.seconds:.2f} s" if self.seconds < 0 else late
        return (
            f"{self.file or 'all runs'}: shifted clock: positions {how}, which would explain {100 * self.explained:.0f} % of what is left"
        )


def find_time_shift(
    runs: Sequence[Run], points: Sequence[np.ndarray], noise: float | np.ndarray, settings: PreparationSettings = DEFAULT
) -> TimeShift:
    """Compare measured with modelled positions at all shifts in time, in the runs that move enough to tell.

    Args:
        runs: measured.
        points: modelled, (rows, points, axes) each.
        noise: of what is measured, 1 sigma per axis, or of each point, (points, 1).
        settings: thresholds.
    """
    parts, steps = [], []
    for run, modelled in zip(runs, points, strict=True):
        measured, y = (run.points / noise).reshape(run.rows, -1), (modelled / noise).reshape(run.rows, -1)
        ever = np.isfinite(measured).any(axis=0)
        if run.rows < 4 or run.start != "equilibrium" or not ever.any() or np.ptp(y[:, ever], axis=0).max() < settings.clock_min_motion:
            continue
        measured, y = measured[:, ever], y[:, ever]
        parts.append((measured - np.nanmean(measured, axis=0), y - y.mean(axis=0)))
        steps.append(float(np.median(np.diff(run.time))))
    return TimeShift(tuple(parts), tuple(steps), settings)


def check_clock(
    runs: Sequence[Run], recalibrated: Sequence[np.ndarray], corrected: Sequence[np.ndarray], noise: float | np.ndarray,
    settings: PreparationSettings = DEFAULT,
) -> ClockShift | None:  # fmt: skip
    """Find a shift between the clocks of inputs and positions; None where there is none, or where effects account for it.

    No machine leads its inputs. One that trails them may be slow, and no limit in seconds tells a slow machine from a clock. But a slow
    machine smears its commands, and a clock does not: a long shift counts only where no first-order lag explains nearly as much. The
    shift must explain most of what the effects leave, or most of what recalibration leaves and more than the effects do; effects that are
    such a shift themselves, as a delay of a second is, do not count.

    Args:
        runs: measured.
        recalibrated: points of the model without an effect, (rows, points, axes) each.
        corrected: those of the model with the effects found.
        noise: of what is measured, 1 sigma per axis, or of each point, (points, 1).
        settings: thresholds.
    """
    without, best = (find_time_shift(runs, points, noise, settings) for points in (recalibrated, corrected))
    if without.is_clock(settings.clock_min_explained):
        modelled = [replace(run, points=points) for run, points in zip(runs, corrected, strict=True)]
        delayed = find_time_shift(modelled, recalibrated, noise, settings)
        only_late = delayed.seconds > 0 and delayed.is_clock(settings.clock_min_explained)
        if without.squares_after < best.squares_before or only_late:
            return ClockShift("", without.seconds, without.explained)
    if best.is_clock(settings.clock_min_explained):
        return ClockShift("", best.seconds, best.explained)
    for run, points in zip(runs, corrected, strict=True):
        alone = find_time_shift([run], [points], noise, settings)
        if alone.is_clock(settings.clock_min_explained_alone):
            return ClockShift(run.file, alone.seconds, alone.explained)
    return None


def _apply_lag(series: np.ndarray, rows: float) -> np.ndarray:
    """Columns behind a first-order lag with a time constant in rows, at rest before, (rows, columns)."""
    decay = np.exp(-1 / rows)
    return np.asarray(lfilter([1 - decay], [1, -decay], series - series[0], axis=0)) + series[0]


def _squares_by_lag(measured: np.ndarray, modelled: np.ndarray, most: int) -> np.ndarray:
    """Squared differences, less their mean, for lags from -most to most rows, (2 · most + 1,).

    Sums over rows of products with a shifted series are correlations, all lags at once by the fast Fourier transform.

    Args:
        measured: (rows, columns) about 0, NaN where missing.
        modelled: (rows, columns) about 0; beyond its ends it stands still.
        most: rows.
    """
    seen = np.isfinite(measured)
    known = np.where(seen, measured, 0.0)
    held = np.pad(modelled, ((most, most), (0, 0)), mode="edge")
    length = next_fast_len(len(held), real=True)

    def correlate(series: np.ndarray, weight: np.ndarray) -> np.ndarray:
        spectrum = np.fft.rfft(series, length, axis=0) * np.conj(np.fft.rfft(weight, length, axis=0))
        return np.fft.irfft(spectrum, length, axis=0)[2 * most :: -1]

    count = np.maximum(seen.sum(axis=0), 1)
    present = seen.astype(float)
    mean = (known.sum(axis=0) - correlate(held, present)) / count
    squares = (known**2).sum(axis=0) - 2 * correlate(held, known) + correlate(held**2, present)
    return np.asarray((squares - count * mean**2).sum(axis=1))
