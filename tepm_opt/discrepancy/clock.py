"""Do positions and inputs tell the same time?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import next_fast_len

from tepm_opt.data.run import Run

LONGEST = 5.0  # s, searched
EARLY, LATE = -0.03, 0.6  # s: positions that lead by more, or trail by more, are not a machine's doing
EXPLAINS = 0.6  # of the squared error that a shift must take away to be called one
MOVES = 5e-3  # m, that a run must move by to tell


def shifts(runs: Sequence[Run], points: Sequence[np.ndarray]) -> dict[str, float]:
    """Seconds by which the positions of each run trail a model's, where a shift in time explains most of their difference.

    Args:
        runs: measured.
        points: the modelled positions, (rows, points, 3) in m each.

    Returns:
        Runs by file name whose shift no machine could cause: positions that lead the inputs, or that trail them by far too much.
    """
    found = {}
    for run, modelled in zip(runs, points, strict=True):
        shift, explained = _shift(run, modelled)
        if explained > EXPLAINS and not EARLY <= shift <= LATE:
            found[run.file] = shift
    return found


def _shift(run: Run, modelled: np.ndarray) -> tuple[float, float]:
    """The shift in s that fits best, and the part of the squared error it takes away."""
    step = float(np.median(np.diff(run.time)))
    most = min(int(LONGEST / step), run.rows // 2)
    measured, y = run.points.reshape(run.rows, -1), modelled.reshape(run.rows, -1)
    if np.ptp(y, axis=0).max() < MOVES or not np.isfinite(measured).any():
        return 0.0, 0.0
    ever = np.isfinite(measured).any(axis=0)
    measured, y = measured[:, ever], y[:, ever]
    costs = _costs(measured - np.nanmean(measured, axis=0), y - y.mean(axis=0), most)
    best = int(np.argmin(costs))
    if best in (0, 2 * most):  # no minimum: the difference is no shift
        return 0.0, 0.0
    return (best - most) * step, 1 - costs[best] / max(costs[most], 1e-30)


def _costs(measured: np.ndarray, modelled: np.ndarray, most: int) -> np.ndarray:
    """Squared differences, less their mean, for lags from -most to most rows, (2 · most + 1,).

    Sums over rows of products with a shifted series are correlations, all lags at once by the fast Fourier transform.

    Args:
        measured: (rows, columns) in m, about 0, NaN where missing.
        modelled: (rows, columns) in m, about 0; beyond its ends it stands still.
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
