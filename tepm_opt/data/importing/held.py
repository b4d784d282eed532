"""Samples of a slower sensor that a faster program wrote several times: only the new ones are samples."""

from __future__ import annotations

import numpy as np

LEAST = 20  # stretches of the same values, for a rhythm
RHYTHM = 0.95  # of the stretches that are as long as the others, to a row
SLOWER = 1.25  # rows a new value: below this samples repeat by chance
QUANTUM = 4.0  # steps of a column that counts: values that are held differ by many sizes


def new_rows(values: np.ndarray) -> np.ndarray | None:
    """Rows of columns in which a slower sensor's new samples begin; None where it is not slower.

    Stretches of equal values have to be equally long to a row, as no robot at rest and no coarse gauge makes them.

    Args:
        values: (columns, rows), NaN where samples are missing.
    """
    if values.shape[1] < 2 * LEAST:
        return None
    one, next_one = values[:, :-1], values[:, 1:]
    changed = np.any((one != next_one) & ~(np.isnan(one) & np.isnan(next_one)), axis=0)
    starts = np.r_[0, np.flatnonzero(changed) + 1]
    known = np.all(np.isfinite(values[:, starts]), axis=0)
    lengths = np.diff(starts)[1:]
    lengths = lengths[known[1:-1]]
    if len(lengths) < LEAST:
        return None
    middle = np.median(lengths)
    mean = float(lengths[np.less_equal(lengths, 2 * middle)].mean())
    if mean < SLOWER or np.mean((lengths == np.floor(mean)) | (lengths == np.ceil(mean))) < RHYTHM:
        return None
    steps = np.abs(np.diff(values[:, starts][:, known], axis=1)).max(axis=0)
    steps = steps[steps > 0]
    if not steps.size or steps.max() <= QUANTUM * steps.min():
        return None  # counts of a coarse sensor in even motion
    return starts
