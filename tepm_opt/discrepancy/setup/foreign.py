"""Runs from another set-up: one run that disagrees where all others agree, although they drive the machine alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.setup.settings import DEFAULT, SetupSettings


def misfit_by_run(runs: Sequence[Run], points: Sequence[np.ndarray], noise: float | np.ndarray) -> np.ndarray:
    """Mean square over the noise's of what a model misses in each run, (runs,); 0 where nothing was measured.

    Args:
        runs: measured.
        points: modelled, (rows, points, axes) of every run.
        noise: of the measurements, 1 sigma per axis, or of each point, (points, 1).
    """
    left = [((run.points - modelled) / noise) ** 2 for run, modelled in zip(runs, points, strict=True)]
    return np.array([np.nanmean(each) if np.isfinite(each).any() else 0.0 for each in left])


def odd_run(
    runs: Sequence[Run], points: Sequence[np.ndarray], noise: float | np.ndarray, settings: SetupSettings = DEFAULT
) -> tuple[int, float] | None:
    """Number of a run that a model misses far more than all others, and their largest misfit over its own; None if there is none.

    It counts where the run's inputs are within those of the others. What acts only at inputs, sums of inputs or changes of inputs
    that no other run has is physics rather than another set-up.

    Args:
        runs: measured.
        points: modelled, (rows, points, axes) of every run.
        noise: of the measurements, 1 sigma per axis, or of each point, (points, 1).
        settings: thresholds.
    """
    if len(runs) < settings.min_runs:
        return None
    misfit = misfit_by_run(runs, points, noise)
    worst = int(np.argmax(misfit))
    others = max(float(np.delete(misfit, worst).max()), 1.0)
    least = settings.foreign_ratio * others
    if misfit[worst] < least:
        return None
    drives = [_drive(run) for run in runs]
    most = np.max([drive.max(axis=0) for k, drive in enumerate(drives) if k != worst], axis=0)
    common = np.all(drives[worst] <= 1.05 * most, axis=1)
    left = (((runs[worst].points - points[worst]) / noise) ** 2)[common]
    return (worst, others / float(misfit[worst])) if np.isfinite(left).any() and np.nanmean(left) >= least else None


def is_outermost(runs: Sequence[Run], number: int) -> bool:
    """Whether a run is before or after all others of the session, so that what changes with its time is extrapolated to it."""
    began = [run.began for run in runs]
    others = began[:number] + began[number + 1 :]
    return not min(others, default=-np.inf) <= began[number] <= max(others, default=np.inf)


def _drive(run: Run, within: int = 10) -> np.ndarray:
    """Size of all inputs, of their changes within some rows, and their sum, (rows, 2 inputs + 1)."""
    size = np.abs(run.inputs)
    before = run.inputs[np.maximum(np.arange(run.rows) - within, 0)]
    return np.hstack([size, np.abs(run.inputs - before), size.sum(axis=1, keepdims=True)])
