"""Beginnings of runs that a model misses for what happened before them: a machine at work has a past that no file holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tepm_opt.data.run import Run, RunSet

BLOCK = 1.0  # s
WORSE = 10.0  # times the median block's mean square in the runs fitted to, from which a block at a beginning is left out
LIVELIER = 3.0  # times the run's mean square about its mean, up to which a beginning is no more lively than the rest
LONGEST = 0.15  # part of a run that may be left out


def without_beginnings(dataset: RunSet, points: Sequence[np.ndarray], noise: float | np.ndarray) -> tuple[RunSet, list[str]]:
    """The data set without beginnings that a model misses far more than the rest, and what a reader should know of them.

    Only runs to fit to that do not begin at rest are shortened, and only where the machine does no more at the beginning than later: a
    free decay is largest there, and misses most.

    Args:
        dataset: measured.
        points: modelled, (rows, points, axes) of every run.
        noise: of what is measured, 1 sigma per axis, or of each point, (points, 1).
    """
    squares = {
        k: _squares(run, (modelled - run.points) / noise)
        for k, (run, modelled) in enumerate(zip(dataset.runs, points, strict=True))
        if run.role == "fit" and run.rows > 1
    }
    blocks = np.concatenate([np.zeros(0), *(found for _, found in squares.values())])
    if not len(blocks):
        return dataset, []
    most, runs, remarks = WORSE * float(np.median(blocks)), list(dataset.runs), []
    for k, (numbers, found) in squares.items():
        run = runs[k]
        worse = np.flatnonzero(found[: int(LONGEST * len(found))] > most)
        if run.start == "equilibrium" or not len(worse):
            continue
        first = int(np.searchsorted(numbers, worse[-1] + 1))
        own = (run.points - np.nanmean(run.points, axis=0)) / noise
        if np.nanmean(own[:first] ** 2) > LIVELIER * np.nanmean(own**2):
            continue
        runs[k] = _crop_run(run, first)
        seconds = run.time[first] - run.time[0]
        remarks.append(f"The first {seconds:.2g} s of {run.file} are left out: what was before them counts there, and no file holds it.")
    return dataset.with_runs(runs), remarks


def _squares(run: Run, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number of the block of every row, (rows,), and mean square of what is measured in each block, (blocks,)."""
    numbers = np.floor((run.time - run.time[0]) / BLOCK + 1e-9).astype(int)
    rows = left.reshape(run.rows, -1)
    total, count = np.bincount(numbers, np.nansum(rows**2, axis=1)), np.bincount(numbers, np.isfinite(rows).sum(axis=1))
    return numbers, total / np.maximum(count, 1)


def _crop_run(run: Run, first: int) -> Run:
    """A run from a row on, whose state is to be found anew."""
    extra = {name: values[first:] for name, values in run.extra.items()}
    return replace(
        run, time=run.time[first:], inputs=run.inputs[first:], tip_force=run.tip_force[first:], points=run.points[first:], extra=extra,
        lines=run.lines[first:], state=None,
    )  # fmt: skip
