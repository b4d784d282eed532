"""Do positions and inputs tell the same time?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import next_fast_len
from scipy.signal import lfilter

from tepm_opt.data.run import Run

LONGEST = 5.0  # s, searched
EARLY, LATE = -0.03, 0.25  # s: what positions lead by at most; what they may trail by, whatever the way in which they do
EXPLAINS = 0.6  # of the structure of all runs that a shift must take away to be called one
ALONE = 0.9  # in a run whose clock is off while others' are right: a model that is far off fits some run better at another time
CLEARLY = 2.0  # times the squares that a shift leaves, left by every lag: then it is no lag
MATERIAL = 0.25  # structure over the noise's squares below which nothing is asked
MOVES = 25.0  # times the noise that a run must move by to tell
LAGS = np.geomspace(0.1, 10.0, 13)  # s


@dataclass(frozen=True, eq=False)
class Shifted:
    """What shifts in time make of a model's misfit in some runs.

    Attributes:
        parts: (measured, modelled) over the noise and about their means, (rows, columns) each, of every run.
        steps: s between the samples of each run.
    """

    parts: tuple[tuple[np.ndarray, np.ndarray], ...]
    steps: tuple[float, ...]

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Shifted({len(self.parts)} runs, {self.seconds:.2f} s explain {self.explains:.0%})"

    @cached_property
    def _costs(self) -> tuple[np.ndarray, np.ndarray]:
        """Shifts in s, and the squares that each leaves, less the noise's."""
        longest = min(min(LONGEST, step * (len(y) // 2)) for (_, y), step in zip(self.parts, self.steps, strict=True))
        step = max(self.steps)
        most = int(longest / step + 1e-9)
        shifts, total = step * np.arange(-most, most + 1), np.zeros(2 * most + 1)
        for (measured, y), own in zip(self.parts, self.steps, strict=True):
            reach = int(longest / own + 1e-9)
            total += np.interp(shifts, own * np.arange(-reach, reach + 1), _costs(measured, y, reach))
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
    def before(self) -> float:
        """Squares beyond the noise's that there are as it is."""
        shifts, costs = self._costs
        return float(costs[len(shifts) // 2])

    @property
    def after(self) -> float:
        """Squares beyond the noise's that the best shift leaves."""
        return float(self._costs[1].min())

    @property
    def explains(self) -> float:
        """Part of the structure that the best shift takes away."""
        return 1 - self.after / max(self.before, 1e-12)

    def is_clock(self, least: float) -> bool:
        """Whether it takes away so much at times that are no machine's, and no first-order lag nearly as much."""
        if not self.parts or self.before < MATERIAL * self.count or self.explains < least or EARLY <= self.seconds <= LATE:
            return False
        if self.seconds < EARLY:
            return True
        return min(self._lagging(lag) for lag in LAGS) >= CLEARLY * (self.after + self.count)

    def _lagging(self, lag: float) -> float:
        """Squares that the model leaves behind a lag."""
        return float(sum(_costs(seen, _lagged(y, lag / step), 0)[0] for (seen, y), step in zip(self.parts, self.steps, strict=True)))


def shifted(runs: Sequence[Run], points: Sequence[np.ndarray], noise: float | np.ndarray) -> Shifted:
    """Shifts in time of what was measured against a model; of runs that tell.

    Args:
        runs: measured.
        points: modelled, (rows, points, axes) each.
        noise: of what is measured, 1 sigma per axis, or of each point, (points, 1).
    """
    parts, steps = [], []
    for run, modelled in zip(runs, points, strict=True):
        measured, y = (run.points / noise).reshape(run.rows, -1), (modelled / noise).reshape(run.rows, -1)
        ever = np.isfinite(measured).any(axis=0)
        if run.rows < 4 or run.start != "equilibrium" or not ever.any() or np.ptp(y[:, ever], axis=0).max() < MOVES:
            continue
        measured, y = measured[:, ever], y[:, ever]
        parts.append((measured - np.nanmean(measured, axis=0), y - y.mean(axis=0)))
        steps.append(float(np.median(np.diff(run.time))))
    return Shifted(tuple(parts), tuple(steps))


def doubt(runs: Sequence[Run], recalibrated: Sequence[np.ndarray], corrected: Sequence[np.ndarray], noise: float | np.ndarray) -> str:
    """Why inputs and positions seem to tell different times; nothing where they do not, or where effects account for it.

    No machine leads its inputs. One that trails them may be slow, which no limit in seconds tells from a clock: a slow machine smears what
    it is told, and a clock does not. So a long shift only counts where no first-order lag would explain nearly as much. A shift is in doubt
    where it explains most of what the effects leave, or most of what recalibration leaves and more than the effects do.

    Args:
        runs: measured.
        recalibrated: points of the model without an effect, (rows, points, axes) each.
        corrected: those of the model with the effects found.
        noise: of what is measured, 1 sigma per axis, or of each point, (points, 1).
    """
    without, best = shifted(runs, recalibrated, noise), shifted(runs, corrected, noise)
    if without.is_clock(EXPLAINS) and without.after < best.before:
        return _said(without, "all runs")
    if best.is_clock(EXPLAINS):
        return _said(best, "all runs")
    for run, points in zip(runs, corrected, strict=True):
        alone = shifted([run], [points], noise)
        if alone.is_clock(ALONE):
            return _said(alone, run.file)
    return ""


def _said(found: Shifted, where: str) -> str:
    late = f"trail the inputs by {found.seconds:.2f} s unchanged, as behind a delay and not as a slow machine does"
    how = f"lead the inputs by {-found.seconds:.2f} s" if found.seconds < 0 else late
    return f"{where}: shifted clock: positions {how}, which would explain {100 * found.explains:.0f} % of what is left"


def _lagged(series: np.ndarray, rows: float) -> np.ndarray:
    """Columns behind a first-order lag with a time constant in rows, at rest before, (rows, columns)."""
    decay = np.exp(-1 / rows)
    return np.asarray(lfilter([1 - decay], [1, -decay], series - series[0], axis=0)) + series[0]


def _costs(measured: np.ndarray, modelled: np.ndarray, most: int) -> np.ndarray:
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

    def shifted(series: np.ndarray, weight: np.ndarray) -> np.ndarray:
        spectrum = np.fft.rfft(series, length, axis=0) * np.conj(np.fft.rfft(weight, length, axis=0))
        return np.fft.irfft(spectrum, length, axis=0)[2 * most :: -1]

    count = np.maximum(seen.sum(axis=0), 1)
    present = seen.astype(float)
    mean = (known.sum(axis=0) - shifted(held, present)) / count
    squares = (known**2).sum(axis=0) - 2 * shifted(held, known) + shifted(held**2, present)
    return np.asarray((squares - count * mean**2).sum(axis=1))
