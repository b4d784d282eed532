"""Beginnings of runs whose misfit comes from a past that no file holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tepm_opt.data.run import Run, RunSet
from tepm_opt.discrepancy.preparation.settings import DEFAULT, PreparationSettings


def remove_beginnings(
    dataset: RunSet, points: Sequence[np.ndarray], noise: float | np.ndarray, settings: PreparationSettings = DEFAULT
) -> tuple[RunSet, list[str]]:
    """Remove beginnings of runs that a model misses far more than the rest; the remarks name them.

    Only runs to fit to that do not begin at rest are shortened. The machine must do no more at the beginning than later, as a free decay
    is largest there and misses most.

    Args:
        dataset: measured.
        points: modelled, (rows, points, axes) of every run.
        noise: of what is measured, 1 sigma per axis, or of each point, (points, 1).
        settings: thresholds.
    """
    squares = {
        k: _block_squares(run, (modelled - run.points) / noise, settings.beginning_block)
        for k, (run, modelled) in enumerate(zip(dataset.runs, points, strict=True))
        if run.role == "fit" and run.rows > 1
    }
    blocks = np.concatenate([np.zeros(0), *(found for _, found in squares.values())])
    if not len(blocks):
        return dataset, []
    most, runs, remarks = settings.beginning_min_misfit * float(np.median(blocks)), list(dataset.runs), []
    for k, (numbers, found) in squares.items():
        run = runs[k]
        worse = np.flatnonzero(found[: int(settings.beginning_max_share * len(found))] > most)
        if run.start == "equilibrium" or not len(worse):
            continue
        first = int(np.searchsorted(numbers, worse[-1] + 1))
        own = (run.points - np.nanmean(run.points, axis=0)) / noise
        if np.nanmean(own[:first] ** 2) > settings.beginning_max_motion * np.nanmean(own**2):
            continue
        runs[k] = _crop_run(run, first)
        seconds = run.time[first] - run.time[0]
        remarks.append(f"The first {seconds:.2g} s of {run.file} are left out: what was before them counts there, and no file holds it.")
    return dataset.with_runs(runs), remarks


def _block_squares(run: Run, residual: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Number of each row's block of a length in s, (rows,), and mean square of what is measured in each block, (blocks,)."""
    numbers = np.floor((run.time - run.time[0]) / length + 1e-9).astype(int)
    rows = residual.reshape(run.rows, -1)
    total, count = np.bincount(numbers, np.nansum(rows**2, axis=1)), np.bincount(numbers, np.isfinite(rows).sum(axis=1))
    return numbers, total / np.maximum(count, 1)


def _crop_run(run: Run, first: int) -> Run:
    """A run from a row on, whose initial state is to be found anew."""
    extra = {name: values[first:] for name, values in run.extra.items()}
    return replace(
        run, time=run.time[first:], inputs=run.inputs[first:], tip_force=run.tip_force[first:], points=run.points[first:], extra=extra,
        lines=run.lines[first:], state=None,
    )  # fmt: skip
