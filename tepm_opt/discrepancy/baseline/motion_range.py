"""Kinds of motion that recordings have: their inputs and what these were shortly before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.baseline.settings import DEFAULT, BaselineSettings


@dataclass(frozen=True, eq=False)
class MotionRange:
    """Distribution of inputs and their past averages in a recording.

    A sample lies outside where its Mahalanobis distance from the mean exceeds that of every sample of the recording.

    Attributes:
        seconds: windows over which the past is averaged, 0 for the present.
        mean, spread: of each feature, (features,).
        precision: inverse correlation of the features, (features, features).
        farthest: largest squared distance in the recording.
    """

    seconds: tuple[float, ...]
    mean: np.ndarray
    spread: np.ndarray
    precision: np.ndarray
    farthest: float

    @staticmethod
    def from_runs(runs: Sequence[Run], lasts: float, settings: BaselineSettings = DEFAULT) -> MotionRange:
        """Range of motions of some runs.

        Args:
            runs: with inputs.
            lasts: time in s for which the model's error lasts; 0 for equilibria, which have no past.
            settings: thresholds.
        """
        seconds = tuple(each * lasts for each in settings.windows) if lasts > 0 else (0.0,)
        values = np.concatenate([_features(run, seconds) for run in runs])
        least = settings.min_input_spread * np.abs(values).max(axis=0, initial=0.0)
        spread = np.maximum(values.std(axis=0), np.where(least > 0, least, 1e-12))
        scaled = (values - values.mean(axis=0)) / spread
        correlation = scaled.T @ scaled / max(len(scaled), 1) + settings.min_input_spread * np.eye(scaled.shape[1])
        found = MotionRange(seconds, values.mean(axis=0), spread, np.linalg.inv(correlation), 0.0)
        return MotionRange(seconds, found.mean, spread, found.precision, float(found._distances(values).max(initial=0.0)))

    def share_outside(self, runs: Sequence[Run]) -> float:
        """Share of the samples of some runs that lie outside, 0 … 1."""
        values = np.concatenate([_features(run, self.seconds) for run in runs])
        return float(np.mean(self._distances(values) > self.farthest)) if len(values) else 0.0

    def _distances(self, values: np.ndarray) -> np.ndarray:
        """Squared Mahalanobis distances, (rows,)."""
        scaled = (values - self.mean) / self.spread
        return np.asarray(np.einsum("ij,jk,ik->i", scaled, self.precision, scaled))


def share_unlike(one: Sequence[Run], other: Sequence[Run], lasts: float, settings: BaselineSettings = DEFAULT) -> float:
    """Share of the samples of one recording with motions that the other has nowhere, 0 … 1; of both recordings the larger share.

    Both ways count: where one has fast and slow motions and the other slow ones only, the mean error of a model differs, too.

    Args:
        one, other: runs of the recordings.
        lasts: time in s for which the model's error lasts; 0 for equilibria.
        settings: thresholds.
    """
    shares = [MotionRange.from_runs(a, lasts, settings).share_outside(b) for a, b in ((one, other), (other, one))]
    return max(shares)


def _features(run: Run, seconds: Sequence[float]) -> np.ndarray:
    """Inputs averaged over windows of the past, (rows, windows · inputs)."""
    if len(seconds) == 1 or run.rows < 2:
        return np.tile(run.inputs, (1, len(seconds)))
    steps = np.diff(run.time, prepend=run.time[0])
    total = np.cumsum(run.inputs * steps[:, None], axis=0)
    found = []
    for window in seconds:
        first = np.searchsorted(run.time, run.time - window - 1e-9)
        span = (run.time - run.time[first])[:, None]
        mean = (total - total[first]) / np.where(span > 0, span, 1.0)
        found.append(np.where(span > 0, mean, run.inputs))
    return np.concatenate(found, axis=1)
