"""Choices of rows in which a model may miss more than in others: runs, inputs in use, regimes of motion, times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.assessment.settings import DEFAULT, AssessmentSettings

ALONE = ", no other"  # after the name of an input that is the only one of its kind in use
Choice = tuple[str, str, np.ndarray]
"""By what, its name, and whether each row is in it, (rows of all runs,)."""


def list_choices(
    runs: Sequence[Run], points: Sequence[np.ndarray], signals: Signals, static: bool, settings: AssessmentSettings = DEFAULT
) -> Iterator[Choice]:
    """Every choice of rows that may hold more than the others.

    Args:
        runs: measured.
        points: modelled, of every run, (rows, points, axes).
        signals: names and ranges.
        static: whether rows are equilibria: there are no choices by time or motion.
        settings: thresholds.
    """
    lengths = [run.rows for run in runs]
    for k, run in enumerate(runs):
        yield "run", run.file, np.repeat(np.arange(len(runs)) == k, lengths)
    levels, recent, moved = _levels(runs, signals), settings.rows_recent, settings.rows_moved
    moves = [
        np.zeros_like(level, dtype=bool) if static else _way(run.time, level, recent) > moved
        for run, level in zip(runs, levels, strict=True)
    ]
    level, moving = np.concatenate(levels), np.concatenate(moves)
    used = (np.abs(level) > settings.rows_in_use) | moving
    yield from _input_choices(used, signals)
    yield from _regime_choices(level, used, _midway_points(runs, points), signals)
    if not static:
        yield from _time_choices(runs)
        least = _least_way(points, signals, settings)
        still = [
            _way(run.time, at.reshape(run.rows, -1) / least, recent).max(axis=1) <= 1
            for run, at in zip(runs, map(np.nan_to_num, points), strict=True)
        ]
        rest = ~moving.any(axis=1) & np.concatenate(still)
        reversed_ = np.concatenate([_has_reversed(run, level, settings) for run, level in zip(runs, levels, strict=True)])
        yield from (("regime", "at rest", rest), ("regime", "moving", ~rest), ("regime", "after a reversal", reversed_))


def _levels(runs: Sequence[Run], signals: Signals) -> list[np.ndarray]:
    """Inputs over their ranges, (rows, inputs) each; over their own maxima where ranges are unknown."""
    largest = np.abs(np.concatenate([run.inputs for run in runs])).max(axis=0, initial=0.0)
    ranges = np.where(np.isfinite(signals.ranges), signals.ranges, largest)
    return [run.inputs / np.where(ranges > 0, ranges, 1.0) for run in runs]


def _input_choices(used: np.ndarray, signals: Signals) -> Iterator[Choice]:
    """By parts of the inputs in use, and by those that are the only ones of their kind."""
    for part in signals.parts:
        own = used[:, part.columns].max(axis=1)
        yield part.by, part.name, own
        if part.alike:
            yield part.by, f"{part.name}{ALONE}", own & (used[:, part.alike].sum(axis=1) == len(part.columns))


def _midway_points(runs: Sequence[Run], points: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Midway between what is measured and what is modelled, where both are there, else modelled.

    To order errors by either of the two would show more of them at its ends without any cause (Bland and Altman, Lancet 1986).
    """
    return [np.where(np.isfinite(run.points), (run.points + modelled) / 2, modelled) for run, modelled in zip(runs, points, strict=True)]


def _regime_choices(level: np.ndarray, used: np.ndarray, points: Sequence[np.ndarray], signals: Signals) -> Iterator[Choice]:
    every = np.concatenate(points)
    low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    measured = ((every - low) / np.where(high > low, high - low, 1.0)).max(axis=-1)
    for regime in signals.regimes:
        values = (measured if regime.measured else np.abs(level))[:, regime.columns]
        inside = (values > regime.low) & (values < regime.high)
        yield "regime", regime.name, (inside & used[:, regime.columns] if regime.used else inside).max(axis=1)


def _time_choices(runs: Sequence[Run]) -> Iterator[Choice]:
    parts = [np.minimum(3 * (run.time - run.time[:1]) / max(run.duration, 1e-9), 2.0).astype(int) for run in runs]
    for k, name in enumerate(("early", "middle", "late")):
        yield "time", name, np.concatenate(parts) == k


def _way(time: np.ndarray, values: np.ndarray, recent: float) -> np.ndarray:
    """Way gone within a recent time in s by every column of (rows, columns)."""
    gone = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(np.abs(np.diff(values, axis=0)), axis=0)])
    return gone - gone[np.searchsorted(time, time - recent)]


def _least_way(points: Sequence[np.ndarray], signals: Signals, settings: AssessmentSettings) -> np.ndarray:
    """Recent way from which on each coordinate moves, (coordinates,): by the model, since that has no noise."""
    every = np.concatenate(points)
    if len(signals.axes) > 1:  # positions
        return np.full(every[0].size, settings.rows_point_moved)
    span = np.nanmax(every, axis=0) - np.nanmin(every, axis=0)
    return settings.rows_moved * np.where(span > 0, span, np.inf).ravel()


def _has_reversed(run: Run, level: np.ndarray, settings: AssessmentSettings) -> np.ndarray:
    """Whether some input has recently changed direction by more than jitter, (rows,)."""
    half = settings.rows_reversal / 2
    dragged = level.copy()  # follows with play, so that jitter does not move it
    for k in range(1, run.rows):
        dragged[k] = np.clip(dragged[k - 1], level[k] - half, level[k] + half)
    direction = np.sign(np.diff(dragged, axis=0, prepend=dragged[:1]))
    last = np.maximum.accumulate(np.where(direction != 0, np.arange(run.rows)[:, None], 0), axis=0)
    heading = np.take_along_axis(direction, last, axis=0)
    before = np.vstack([np.zeros((1, level.shape[1])), heading[:-1]])
    changed = np.cumsum((heading * before < 0).any(axis=1))
    return np.asarray(changed > np.append(0, changed)[np.searchsorted(run.time, run.time - settings.rows_recent)])
