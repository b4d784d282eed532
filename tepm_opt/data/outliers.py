"""Samples that no machine makes, but what measures it: they jump away from their neighbours and back, or stand still in noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy.ndimage import maximum_filter1d, percentile_filter, uniform_filter1d
from scipy.stats import chi2

from tepm_opt.data.run import RunSet

FEW = 0.05  # part of the samples up to which strays are exceptions
CHANCE = 5e-8  # that noise makes a sample a stray
WIDE = 10  # usual steps within which a sample's four neighbours lie
AROUND = 17  # samples that tell how smooth the motion is there
PART, SMALL = 35, 2.2  # percentile of them that two strays leave as it is, and the standard deviation over it
MAD = 1.4826  # standard deviation over median absolute deviation of a normal distribution
ROUGH = 2.0  # times what the model itself is off the cubics, that a motion may be
ROUNDS = 5  # in which strays are found that others hide
MOST = 2  # strays among five samples in a row; more of them are a motion
LONG, USUAL = 10, 0.5  # samples that are all the same where something is stuck; part of them up to which that is not usual
Data = TypeVar("Data", bound=RunSet)


def strays(time: np.ndarray, points: np.ndarray, modelled: np.ndarray | None = None, noise: float | np.ndarray = 0.0) -> np.ndarray:
    """Find samples of each point that stray: off the cubic through their neighbours, which are on theirs, (rows, points) of bool.

    What a model says is taken away first. No stray is what is as rough as the model's own motion or as the samples around it, nor three
    samples in a row: a motion may be so.

    Args:
        time: (rows,) in s.
        points: measured, (rows, points, axes), NaN where missing.
        modelled: of the same shape; None for none.
        noise: assumed, 1 sigma, or of each point, (points, 1); half of it is the least that counts as noise.
    """
    found = np.zeros(points.shape[:2], dtype=bool)
    least = np.broadcast_to(0.5 * np.asarray(noise), points.shape[1:])
    for k in range(points.shape[1]):
        rows = np.flatnonzero(np.isfinite(points[:, k]).all(axis=1))
        if len(rows) >= AROUND:
            still = np.zeros((len(rows), points.shape[2]))
            found[rows, k] = _strays(time[rows], points[rows, k], still if modelled is None else modelled[rows, k], least[k])
    return found


def far(time: np.ndarray) -> np.ndarray:
    """Find samples with neighbours beyond a gap, which tell nothing, (rows,) of bool."""
    apart = np.zeros(len(time), dtype=bool)
    apart[2:-2] = time[4:] - time[:-4] > WIDE * np.median(np.diff(time))
    return apart


def _strays(time: np.ndarray, measured: np.ndarray, modelled: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Strays of one point, (rows,).

    Args:
        time: (rows,) in s.
        measured, modelled: (rows, axes) each.
        least: noise of each axis that counts as such, (axes,).
    """
    weights, alone = _weights(time), far(time)
    left, limit = measured - modelled, float(np.sqrt(chi2.isf(CHANCE, measured.shape[1])))
    rough = ROUGH * maximum_filter1d(np.abs(_subtract_cubic(weights, modelled)), 5, axis=0)
    noise = np.maximum(
        MAD * np.median(np.abs(_subtract_cubic(weights, left)), axis=0), np.maximum(least, 1e-9 * np.ptp(left, axis=0) + 1e-300)
    )
    found = _first_two(left, limit * noise) | _first_two(left[::-1], limit * noise)[::-1]
    for _ in range(ROUNDS):
        off = np.abs(_subtract_cubic(weights, _interpolate_strays(time, left, found)))
        smooth = SMALL * percentile_filter(off, PART, size=(AROUND, 1), mode="nearest")
        size = np.linalg.norm(np.where(off > rough, off, 0.0) / np.maximum(noise, smooth), axis=1)
        size[alone] = 0.0
        new = (size > limit) & (size == maximum_filter1d(size, 5)) & ~found
        if not new.any():
            break
        found |= new
    found &= np.linalg.norm((left - _interpolate_strays(time, left, found)) / noise, axis=1) > limit  # some were only beside strays
    crowded = maximum_filter1d(uniform_filter1d(found.astype(float), 5), 5) > (MOST + 0.5) / 5
    return np.asarray(found & ~crowded)


def stuck(points: np.ndarray) -> np.ndarray:
    """Find samples of each point that equal those before them for long, in all axes, where noise forbids it, (rows, points) of bool.

    Args:
        points: measured, (rows, points, axes); of one axis alone nobody can say so, it may rest within its resolution.
    """
    found = np.zeros(points.shape[:2], dtype=bool)
    if len(points) < LONG or points.shape[2] < 2:
        return found
    same = np.all(points[1:] == points[:-1], axis=2)
    for k in np.flatnonzero(same.mean(axis=0) < USUAL):
        edges = np.flatnonzero(np.diff(same[:, k], prepend=False, append=False))
        for first, end in zip(edges[::2], edges[1::2], strict=True):
            found[first + 1 : end + 1, k] = end - first >= LONG
    return found


def _interpolate_strays(time: np.ndarray, left: np.ndarray, strayed: np.ndarray) -> np.ndarray:
    """Put strays onto straight lines between the samples beside them, (rows, axes)."""
    if not strayed.any():
        return left
    return np.stack([np.interp(time, time[~strayed], column[~strayed]) for column in left.T], axis=1)


def _first_two(left: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    """Strays among the first two rows, which have no neighbours before them: far off the six after them, (rows,).

    Args:
        left: measured less modelled, (rows, axes).
        allowed: by noise, (axes,).
    """
    found, after = np.zeros(len(left), dtype=bool), np.sort(left[2:8], axis=0)
    most = 1.5 * allowed + 8 * (after[4] - after[1])  # all but the outermost, so that one of them may stray, too
    found[:2] = np.any(np.abs(left[:2] - np.median(after, axis=0)) > most, axis=1)
    return found


def _weights(time: np.ndarray) -> np.ndarray:
    """Numbers that make a sample less the cubic through the four beside it, as noisy as a sample is, (5, rows − 4)."""
    beside = np.stack([time[k : len(time) - 4 + k] - time[2:-2] for k in (0, 1, 3, 4)])
    lagrange = [np.prod([-other / (own - other) for other in np.delete(beside, k, axis=0)], axis=0) for k, own in enumerate(beside)]
    weights = -np.stack([*lagrange[:2], -np.ones(len(time) - 4), *lagrange[2:]])
    return weights / np.linalg.norm(weights, axis=0)


def _subtract_cubic(weights: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Subtract from samples the cubic through the two before and the two after; 0 where there are none, (rows, axes)."""
    off = np.zeros_like(values)
    off[2:-2] = sum(weight[:, None] * values[k : len(values) - 4 + k] for k, weight in enumerate(weights))
    return off


def without_strays(dataset: Data, modelled: Sequence[np.ndarray], noise: float | np.ndarray) -> tuple[Data, list[str]]:
    """The data without strays and stuck samples, and sentences about them where there are any.

    Args:
        dataset: motions.
        modelled: points of every run, (rows, points, axes) each.
        noise: assumed, 1 sigma per axis, or of each point, (points, 1).
    """
    held = [stuck(run.points) for run in dataset.runs]
    found = [
        strays(run.time, np.where(still[:, :, None], np.nan, run.points), points, noise)
        for run, points, still in zip(dataset.runs, modelled, held, strict=True)
    ]
    every = sum(int(np.isfinite(run.points).any(axis=2).sum()) for run in dataset.runs)
    said = _summarize_removal("Outliers", found, every, "jump away from their neighbours and back", dataset)
    said += _summarize_removal("Frozen", held, every, "are exactly those before them", dataset)
    if not said:
        return dataset, []
    lost = [one | other for one, other in zip(found, held, strict=True)]
    runs = [replace(run, points=np.where(gone[:, :, None], np.nan, run.points)) for run, gone in zip(dataset.runs, lost, strict=True)]
    return dataset.with_runs(runs), said


def _summarize_removal(kind: str, found: Sequence[np.ndarray], every: int, how: str, dataset: RunSet) -> list[str]:
    """Say how many samples are left out and why, in a sentence; none where there are none."""
    counts = [int(lost.sum()) for lost in found]
    if not any(counts):
        return []
    most, share = dataset.runs[int(np.argmax(counts))].file, sum(counts) / every
    many = f" That is more than {100 * FEW:.0f} %: look at what measures." if share > FEW else ""
    return [f"{kind}: {sum(counts)} of {every} samples ({100 * share:.2g} %) {how}, most in {most}; they are left out.{many}"]
