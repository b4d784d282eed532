"""White noise of the measurement, estimated from residuals after recalibration.

Third differences in time remove a smooth misfit and keep white noise (as von Neumann's first differences do, Annals of Mathematical
Statistics 12, 1941). Blocks in which the misfit is not smooth are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.preparation.settings import DEFAULT, PreparationSettings
from tepm_opt.solvers.identification.residuals import Residual
from tepm_opt.solvers.numerics.text import format_names, quantity


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """White noise shown by residuals, over the noise assumed.

    Attributes:
        levels: of each coordinate, (points, axes); NaN where too little was measured.
        error: standard error of their root mean square.
        by_spacing: root mean square of the levels for differences over 1, 2 and 3 samples; 1 where nothing tells. White noise is alike in
            all, a misfit shows most in the last.
        rough: the first of these with all blocks in it.
        moving: that in blocks of more motion over that in blocks of less.
        total: root mean square of the residuals themselves.
        settings: thresholds.
    """

    levels: np.ndarray
    error: float
    by_spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)
    rough: float = 1.0
    moving: float = 1.0
    total: float = 1.0
    settings: PreparationSettings = DEFAULT

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"NoiseEstimate({self.level:.3g} ± {self.error:.2g} times what was assumed, white {self.is_white}, even {self.is_even})"

    @property
    def level(self) -> float:
        """Noise over the assumed: the whole residual where that is as white as noise, else the level of third differences.

        Less noise than was assumed has to be seen in every block: tails that are heavy make few blocks loud.
        """
        level = self.by_spacing[0]
        if abs(self.total - level) < self.settings.noise_above_sigmas * self.error:
            return self.total
        return level if level > 1 else max(level, min(self.rough, 1.0))

    @property
    def differs(self) -> bool:
        """Whether it surely is another noise than was assumed."""
        sigmas = self.settings.noise_below_sigmas if self.level < 1 else self.settings.noise_above_sigmas
        return abs(self.level - 1) > max(self.settings.noise_min_change, sigmas * self.error)

    @property
    def is_white(self) -> bool:
        """Whether it is as much from sample to sample as over two and three: no filter smoothed it, nothing vibrates."""
        one, two, three = self.by_spacing
        allowed = max(self.settings.noise_white_tolerance, 5 * self.error / one)
        return abs(two / one - 1) < allowed and three / one - 1 > -allowed

    @property
    def is_even(self) -> bool:
        """Whether it is as much in motion as at rest; time that jitters and coarse resolution are not."""
        return bool(abs(np.log(self.moving)) < max(self.settings.noise_motion_tolerance, 10 * self.error / self.by_spacing[0]))

    @property
    def factor(self) -> float:
        """Number by which to multiply the noise assumed: 1 where that is right, or where not only white noise is seen or meant."""
        usable = self.differs and self.is_white and self.is_even and self.level > self.settings.noise_min_ratio
        return self.level if usable else 1.0


def estimate_noise(
    noise: float | np.ndarray, runs: Sequence[Run], residuals: Sequence[Residual], settings: PreparationSettings = DEFAULT
) -> tuple[float | np.ndarray, list[NoiseEstimate]]:
    """The noise as residuals show it, and the estimates: of all points together, or of each that has a noise of its own.

    Args:
        noise: assumed, 1 sigma per axis, or of each point, (points, 1).
        runs: motions that were measured.
        residuals: of a model in these runs.
        settings: thresholds.
    """
    left = [np.where(r.present, r.values, np.nan) for r in residuals]
    motion = np.concatenate([_block_motion(run.points / noise, settings.noise_block_rows) for run in runs])
    if not isinstance(noise, np.ndarray):
        together = _estimate(left, motion, settings)
        return noise * together.factor, [together]
    each = [_estimate([values[:, k : k + 1] for values in left], motion, settings) for k in range(len(noise))]
    return noise * np.array([[one.factor] for one in each]), each


def _estimate(left: Sequence[np.ndarray], motion: np.ndarray, settings: PreparationSettings) -> NoiseEstimate:
    """White noise in residuals.

    Args:
        left: residuals over the noise assumed, (rows, points, axes) of every run, NaN where a sample is missing.
        motion: in every block of rows of all runs.
        settings: thresholds.
    """
    parts = [[_difference_squares(values, spacing, settings) for values in left] for spacing in (1, 2, 3)]
    squares = [np.concatenate([found for found, _ in each]) for each in parts]  # (blocks, points, axes)
    if not np.any(np.isfinite(squares[0]).sum(axis=0) >= settings.noise_min_blocks):
        return NoiseEstimate(np.full(squares[0].shape[1:], np.nan), np.inf, settings=settings)

    def levels(blocks: np.ndarray) -> np.ndarray:
        return _levels(blocks, settings.noise_rough_block)

    own, much = levels(squares[0]), motion > np.median(motion)
    one, two, three = (_rms(levels(each)) for each in squares)
    overlap = 2.31  # neighbouring third differences say together as much as one in so many: 1 + 2 · Σ correlation²
    error = 0.5 * np.sqrt(2 * overlap / sum(count for _, count in parts[0])) * one  # of the root of a mean of so many squares
    rough = float(np.sqrt(np.nanmean(squares[0])))
    total = float(np.sqrt(sum(np.nansum(values**2) for values in left) / sum(np.isfinite(values).sum() for values in left)))
    moving = _rms(levels(squares[0][much])) / max(_rms(levels(squares[0][~much])), 1e-12)
    return NoiseEstimate(own, float(error), (one, two, three), rough, moving, total, settings)


def _cut_blocks(values: np.ndarray, rows: int) -> np.ndarray:
    """Values in blocks of rows, (blocks, rows, …); incomplete blocks at the end are left out."""
    count = len(values) // rows
    return values[: count * rows].reshape(count, rows, *values.shape[1:])


def _difference_squares(left: np.ndarray, spacing: int, settings: PreparationSettings) -> tuple[np.ndarray, int]:
    """Mean squares of third differences in every block, (blocks, points, axes), NaN where too few were measured; and their number."""
    third = np.array([-1.0, 3.0, -3.0, 1.0]) / np.sqrt(20)  # of white noise it leaves the variance as it is
    differences = np.full(left.shape, np.nan)
    count = max(len(left) - 3 * spacing, 0)
    differences[:count] = sum(part * left[k * spacing : k * spacing + count] for k, part in enumerate(third))
    blocks = _cut_blocks(differences, settings.noise_block_rows)
    present = np.isfinite(blocks)
    counts = present.sum(axis=1)
    means = (np.where(present, blocks, 0.0) ** 2).sum(axis=1) / np.maximum(counts, 1)
    enough = counts >= settings.noise_min_differences
    return np.where(enough, means, np.nan), int(counts[enough].sum())


def _levels(squares: np.ndarray, rough: float) -> np.ndarray:
    """Noise of each coordinate from mean squares of its blocks, (points, axes), without blocks above `rough` times their median."""
    found = np.full(squares.shape[1:], np.nan)
    seen = np.isfinite(squares).any(axis=0)
    known = squares[:, seen]
    found[seen] = np.nanmean(np.where(known <= rough * np.nanmedian(known, axis=0), known, np.nan), axis=0)
    return np.sqrt(found)


def _block_motion(points: np.ndarray, rows: int) -> np.ndarray:
    """Variance of the position in every block of rows, summed over coordinates, (blocks,)."""
    seen = np.isfinite(points)
    blocks, present = _cut_blocks(np.where(seen, points, 0.0), rows), _cut_blocks(seen, rows)
    counts = np.maximum(present.sum(axis=1), 1)
    mean = blocks.sum(axis=1) / counts
    return np.asarray((((blocks - mean[:, None]) ** 2 * present).sum(axis=1) / counts).sum(axis=(1, 2)))


def _rms(levels: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(levels**2))) if np.isfinite(levels).any() else 1.0


def describe_noise(estimates: Sequence[NoiseEstimate], noise: float | np.ndarray, signals: Signals) -> list[str]:
    """Remarks on the noise, a sentence each; none where it is as assumed.

    Args:
        estimates: see `estimate_noise`.
        noise: that was assumed.
        signals: names and unit of what is measured.
    """
    if np.ndim(noise) == 0:
        return [*_describe_difference(estimates[0], float(noise), signals.unit, ""), *_describe_loud_coordinates(estimates[0], signals)]
    units = signals.unit if len(set(np.ravel(noise))) == 1 else ""
    each = zip(estimates, np.ravel(noise), signals.points, strict=True)
    return [text for one, size, name in each for text in _describe_difference(one, float(size), units, name)]


def _describe_difference(found: NoiseEstimate, noise: float, unit: str, name: str) -> list[str]:
    """The difference between estimated and assumed noise in a sentence, if there is one."""
    large = abs(found.level - 1) > 0.25  # so that a person should look why
    if not found.differs or (found.factor == 1 and not large):
        return []
    of, part = f" of {name}" if name else "", 100 * abs(found.level - 1)
    compared = f"{found.level:.2g} times" if found.level > 2 else f"{part:.0f} % {'above' if found.level > 1 else 'below'}"
    seen = f"Noise{of}: samples scatter by {quantity(found.level * noise, unit)}, {compared} the {quantity(noise, unit)} assumed"
    if found.factor != 1:
        return [f"{seen}; fits are weighed by it.{' What is declared is wrong, or the tracker is another.' if large else ''}"]
    if found.is_white and found.is_even:
        return [f"{seen}; more than noise must be meant: what was assumed is kept."]
    why = "in motion than at rest" if found.is_white else "over several samples than from one to the next"
    return [f"{seen}; but it is another {why}, so that it is no white noise: what was assumed is kept."]


def _describe_loud_coordinates(found: NoiseEstimate, signals: Signals) -> list[str]:
    """The coordinates that scatter more than 1.5 times as much as is typical."""
    typical = float(np.nanmedian(found.levels)) if np.isfinite(found.levels).any() else np.inf
    columns = [f"{point} {axis}".strip() for point in signals.points for axis in signals.axes]
    more = [(level / typical, name) for level, name in zip(found.levels.ravel(), columns, strict=True) if level > 1.5 * typical]
    return (
        [f"Noise: {format_names([name for _, name in more])} scatter by up to {max(more)[0]:.2g} times as much as the others."]
        if more
        else []
    )
