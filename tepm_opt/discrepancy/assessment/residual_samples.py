"""Residuals of all runs in blocks of time, and the structure in parts of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.assessment.result import Place
from tepm_opt.discrepancy.assessment.settings import AssessmentSettings

Found = tuple[Place, bool]
"""A place, and whether it holds clearly more than elsewhere and not by chance."""


@dataclass(frozen=True, eq=False)
class ResidualSamples:
    """Residuals of all runs, one below the other.

    Attributes:
        excess: squared residual less the noise's square, (rows, points, 3) in m²; 0 where missing.
        present: whether there is a sample, (rows, points, 3).
        block: number of each row's block of time, (rows,).
        starts: first row of every run, and the number of rows, (runs + 1,).
        variance: of the noise in m².
        unit: of residuals; m unless what is measured has another.
        settings: thresholds.
    """

    excess: np.ndarray
    present: np.ndarray
    block: np.ndarray
    starts: np.ndarray
    variance: float
    unit: str
    settings: AssessmentSettings

    @cached_property
    def axes(self) -> float:
        """Coordinates measured of a point that was, on average."""
        return self.count / max(int(self.present.any(axis=2).sum()), 1)

    @cached_property
    def count(self) -> int:
        """Coordinates measured."""
        return int(self.present.sum())

    @cached_property
    def density(self) -> float:
        """Mean square beyond the noise's of a coordinate in m²."""
        return float(self.excess.sum()) / max(self.count, 1)

    @cached_property
    def blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """Excess and number of coordinates of every block, (blocks, points, 3) each."""
        starts = np.flatnonzero(np.diff(self.block, prepend=-1))
        return np.add.reduceat(self.excess, starts), np.add.reduceat(self.present.astype(float), starts)

    @cached_property
    def scale(self) -> float:
        """The density, or what noise can make of it where that is more: what ratios and shares refer to, in m²."""
        return max(self.density, self.variance * float(np.sqrt(2 / max(self.count, 1))), np.finfo(float).tiny)

    def make_place(self, by: str, name: str, excess: float, count: float, p: float, rms: float | None = None) -> Found:
        """A place, and whether it holds clearly more than elsewhere and not by chance.

        Args:
            by: kind of the place.
            name: of it.
            excess: sum of squares beyond the noise's in m².
            count: coordinates.
            p: chance of such an excess.
            rms: structure in m; from the density where None.
        """
        density = max(excess / count, 0.0)
        share = min(density * count / (self.scale * self.count), 1.0)
        rms = float(np.sqrt(self.axes * density)) if rms is None else rms
        ratio, limits = density / self.scale, self.settings
        least = {"band": (limits.location_min_ratio, limits.band_min_share), "moment": (limits.moment_min_ratio, limits.moment_min_share)}
        least_ratio, least_share = least.get(by, (limits.location_min_ratio, limits.location_min_share))
        tells = self.is_clear(density, count) and p <= limits.location_max_chance and ratio >= least_ratio and share >= least_share
        return Place(by, name, rms, share, ratio, p), tells

    def is_clear(self, density: float, count: float) -> bool:
        """Whether so much per coordinate, in m², is beyond what noise of the assumed size leaves."""
        least, sigmas = self.settings.location_min_excess, self.settings.location_min_sigmas
        return count > 0 and density > self.variance * max(least, sigmas * float(np.sqrt(2 / count)))


def collect_samples(
    runs: Sequence[Run], residuals: Sequence[np.ndarray], noise: float, block: float | None, unit: str, settings: AssessmentSettings
) -> ResidualSamples:
    """Residuals of all runs in blocks.

    Args:
        runs: measured.
        residuals: of every run, (rows, points, 3).
        noise: standard deviation.
        block: length of the blocks in s; None for a block each row.
        unit: of residuals.
        settings: thresholds.
    """
    every = np.concatenate(residuals)
    present = np.isfinite(every)
    excess = np.where(present, np.where(present, every, 0.0) ** 2 - noise**2, 0.0)
    blocks, first = [], 0
    for run in runs:
        number = np.arange(run.rows) if block is None else np.floor((run.time - run.time[:1]) / block + 1e-9).astype(int)
        number = np.unique(number, return_inverse=True)[1]
        blocks.append(first + number)
        first += int(number.max(initial=-1)) + 1
    starts = np.cumsum([0, *(run.rows for run in runs)])
    return ResidualSamples(excess, present, np.concatenate(blocks), starts, noise**2, unit, settings)
