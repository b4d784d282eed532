"""Do positions and inputs tell the same time?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

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
    seen = np.isfinite(measured)
    costs = np.empty(2 * most + 1)
    for k, lag in enumerate(range(-most, most + 1)):
        moved = y[np.clip(np.arange(run.rows) - lag, 0, run.rows - 1)]
        error = np.where(seen, measured - moved, np.nan)
        costs[k] = np.nansum((error - np.nanmean(error, axis=0)) ** 2)
    best = int(np.argmin(costs))
    if best in (0, 2 * most):  # no minimum: the difference is no shift
        return 0.0, 0.0
    return (best - most) * step, 1 - costs[best] / max(costs[most], 1e-30)
