"""Do positions and inputs tell the same time?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import next_fast_len
from scipy.signal import lfilter

from tepm_opt.data.run import Run

LONGEST = 5.0  # s, searched
EARLY, LATE = -0.03, 0.6  # s: what positions lead by at most; what they may trail by, whatever the way in which they do
EXPLAINS = 0.6  # of the squared error that a shift must take away to be called one, in most runs
ALONE = 0.9  # in a run whose clock is off while others' are right: a model that is far off fits some run better at another time
CLEARLY = 2.0  # times the squares that a shift leaves, left by every lag: then it is no lag
MOVES = 25.0  # times the noise that a run must move by to tell
LAGS = np.geomspace(0.1, 10.0, 13)  # s


def shifts(runs: Sequence[Run], points: Sequence[np.ndarray], noise: float | np.ndarray) -> dict[str, float]:
    """Seconds by which the positions of each run trail a model's, where a shift in time explains most of their difference.

    No machine leads its inputs. One that trails them may be slow, which no limit in seconds tells from a clock: a slow machine smears what
    it is told, and a clock does not. So a long shift only counts where no first-order lag would explain nearly as much.

    Args:
        runs: measured.
        points: the modelled positions, (rows, points, 3) in m each.
        noise: of what is measured, 1 sigma per axis, or of each point, (points, 1).

    Returns:
        Runs by file name with shifts that are not a slow machine's.
    """
    every = {run.file: _shift(run, run.points / noise, modelled / noise) for run, modelled in zip(runs, points, strict=True)}
    shifted = {file: found for file, found in every.items() if found[1] > EXPLAINS and not EARLY <= found[0] <= LATE}
    most = 2 * len(shifted) > len(every)
    return {file: shift for file, (shift, explained) in shifted.items() if most or explained > ALONE}


def _shift(run: Run, points: np.ndarray, modelled: np.ndarray) -> tuple[float, float]:
    """The shift in s that fits best, and the part of the squared error it takes away; none where a lag does it, too."""
    if run.rows < 2:
        return 0.0, 0.0
    step = float(np.median(np.diff(run.time)))
    most = min(int(LONGEST / step), run.rows // 2)
    measured, y = points.reshape(run.rows, -1), modelled.reshape(run.rows, -1)
    if np.ptp(y, axis=0).max() < MOVES or not np.isfinite(measured).any():
        return 0.0, 0.0
    ever = np.isfinite(measured).any(axis=0)
    measured, y = measured[:, ever], y[:, ever]
    measured, y = measured - np.nanmean(measured, axis=0), y - y.mean(axis=0)
    costs = _costs(measured, y, most)
    best = int(np.argmin(costs))
    if best in (0, 2 * most):  # no minimum: the difference is no shift
        return 0.0, 0.0
    if (best - most) * step > LATE and min(_costs(measured, _lagged(y, lag / step), 0)[0] for lag in LAGS) < CLEARLY * costs[best]:
        return 0.0, 0.0
    return (best - most) * step, 1 - costs[best] / max(costs[most], 1e-30)


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
