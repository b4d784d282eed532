"""How much what is measured scatters by itself: white noise in what recalibration leaves, beside the noise that was assumed.

Third differences in time take a model's misfit away, which is smooth, and leave white noise (as von Neumann's first differences do,
Annals of Mathematical Statistics 12, 1941); blocks in which the misfit is not smooth are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.solvers.residuals import Residual
from tepm_opt.solvers.text import listed, quantity

THIRD = np.array([-1.0, 3.0, -3.0, 1.0]) / np.sqrt(20)  # of white noise it leaves the variance as it is
OVERLAP = 2.31  # neighbouring differences say together as much as one in so many: 1 + 2 · Σ correlation²
ROWS = 50  # of a block
FEWEST, ENOUGH = 8, 10  # blocks that tell, and differences in each
APART = (1, 2, 3)  # samples between those of a difference: white noise is alike in all, a misfit shows most in the last
WHITE = 0.1  # part by which they may differ
EVEN = 0.2  # part by which noise may differ between blocks of more motion and of less
ROUGH = 2.5  # times the median of blocks' squares, above which there is more than noise in a block
SURE = 2.0, 3.0  # standard errors that make noise another, and less than was assumed: that makes structure of what was none
LEAST = 0.005  # departure from what was assumed below which nothing is changed
LARGE = 0.25  # … from which on a person should look why
SMALLEST = 0.4  # of what was assumed that is taken for it: who declares far more than what scatters means more than white noise
LOUDER = 1.5  # times the typical noise of a coordinate from which on one is named


@dataclass(frozen=True, eq=False)
class Scatter:
    """White noise that residuals show.

    Attributes:
        levels: over the noise assumed, of each coordinate, (points, axes); NaN where too little was measured.
        error: standard error of their root mean square.
        apart: their root mean square, and those of differences over more samples, see `APART`; 1 where nothing tells.
        rough: the first of these with all blocks in it.
        moving: that where more moves over that where less does.
        total: root mean square of the residuals themselves.
    """

    levels: np.ndarray
    error: float
    apart: tuple[float, ...]
    rough: float
    moving: float
    total: float

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Scatter({self.level:.3g} ± {self.error:.2g} times what was assumed, white {self.white}, even {self.even})"

    @property
    def level(self) -> float:
        """Noise over what was assumed: all that is left where that is as white as noise, else what third differences show of it.

        Less noise than was assumed has to be seen in every block: tails that are heavy make few blocks loud.
        """
        if abs(self.total - self.apart[0]) < SURE[0] * self.error:
            return self.total
        return self.apart[0] if self.apart[0] > 1 else max(self.apart[0], min(self.rough, 1.0))

    @property
    def departs(self) -> bool:
        """Whether it surely is another noise than was assumed."""
        return abs(self.level - 1) > max(LEAST, SURE[self.level < 1] * self.error)

    @property
    def white(self) -> bool:
        """Whether it is as much from sample to sample as over two and three: no filter smoothed it, nothing vibrates."""
        one, two, three = self.apart
        allowed = max(WHITE, 5 * self.error / one)
        return abs(two / one - 1) < allowed and three / one - 1 > -allowed

    @property
    def even(self) -> bool:
        """Whether it is as much in motion as at rest, as no time that jitters and no resolution makes it."""
        return bool(abs(np.log(self.moving)) < max(EVEN, 10 * self.error / self.apart[0]))

    @property
    def factor(self) -> float:
        """Number by which to multiply the noise assumed: 1 where that is right, or where not only white noise is seen or meant."""
        return self.level if self.departs and self.white and self.even and self.level > SMALLEST else 1.0


def fitted(noise: float | np.ndarray, runs: Sequence[Run], residuals: Sequence[Residual]) -> tuple[float | np.ndarray, list[Scatter]]:
    """The noise as residuals over it show it, and how they scatter: of all points together, or of each that has a noise of its own.

    Args:
        noise: assumed, 1 sigma per axis, or of each point, (points, 1).
        runs: motions that were measured.
        residuals: what a model leaves of them.
    """
    left = [np.where(r.present, r.values, np.nan) for r in residuals]
    moves = np.concatenate([_moves(run.points / noise) for run in runs])
    if not isinstance(noise, np.ndarray):
        together = scatter(left, moves)
        return noise * together.factor, [together]
    each = [scatter([values[:, k : k + 1] for values in left], moves) for k in range(len(noise))]
    return noise * np.array([[one.factor] for one in each]), each


def scatter(left: Sequence[np.ndarray], moves: np.ndarray) -> Scatter:
    """White noise in what a model leaves of runs.

    Args:
        left: over the noise assumed, (rows, points, axes) of every run, NaN where a sample is missing.
        moves: motion in every block of rows of all runs.
    """
    parts = [[_squares(values, apart) for values in left] for apart in APART]
    squares = [np.concatenate([found for found, _ in each]) for each in parts]  # (blocks, points, axes)
    known = np.isfinite(squares[0])
    if not np.any(known.sum(axis=0) >= FEWEST):
        return Scatter(np.full(squares[0].shape[1:], np.nan), np.inf, (1.0,) * len(APART), 1.0, 1.0, 1.0)
    levels, much = _levels(squares[0]), moves > np.median(moves)
    size = _rms(levels)
    error = 0.5 * np.sqrt(2 * OVERLAP / sum(count for _, count in parts[0])) * size  # of the root of a mean of so many squares
    rough = float(np.sqrt(np.nanmean(squares[0])))
    total = float(np.sqrt(sum(np.nansum(values**2) for values in left) / sum(np.isfinite(values).sum() for values in left)))
    moving = _rms(_levels(squares[0][much])) / max(_rms(_levels(squares[0][~much])), 1e-12)
    return Scatter(levels, float(error), (size, *(_rms(_levels(each)) for each in squares[1:])), rough, moving, total)


def _cut(values: np.ndarray) -> np.ndarray:
    """Rows in blocks, (blocks, rows of one, …); what is left at the end is left out."""
    count = len(values) // ROWS
    return values[: count * ROWS].reshape(count, ROWS, *values.shape[1:])


def _squares(left: np.ndarray, apart: int) -> tuple[np.ndarray, int]:
    """Mean squares of third differences in every block, (blocks, points, axes), NaN where too few were measured; and how many were."""
    differences = np.full(left.shape, np.nan)
    count = max(len(left) - 3 * apart, 0)
    differences[:count] = sum(part * left[k * apart : k * apart + count] for k, part in enumerate(THIRD))
    blocks = _cut(differences)
    present = np.isfinite(blocks)
    counts = present.sum(axis=1)
    means = (np.where(present, blocks, 0.0) ** 2).sum(axis=1) / np.maximum(counts, 1)
    return np.where(counts >= ENOUGH, means, np.nan), int(counts[counts >= ENOUGH].sum())


def _levels(squares: np.ndarray) -> np.ndarray:
    """Noise of each coordinate from mean squares of its blocks, (points, axes), without blocks far above their median."""
    found = np.full(squares.shape[1:], np.nan)
    seen = np.isfinite(squares).any(axis=0)
    known = squares[:, seen]
    found[seen] = np.nanmean(np.where(known <= ROUGH * np.nanmedian(known, axis=0), known, np.nan), axis=0)
    return np.sqrt(found)


def _moves(points: np.ndarray) -> np.ndarray:
    """How much moves in every block, (blocks,)."""
    seen = np.isfinite(points)
    blocks, present = _cut(np.where(seen, points, 0.0)), _cut(seen)
    counts = np.maximum(present.sum(axis=1), 1)
    mean = blocks.sum(axis=1) / counts
    return np.asarray((((blocks - mean[:, None]) ** 2 * present).sum(axis=1) / counts).sum(axis=(1, 2)))


def _rms(levels: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(levels**2))) if np.isfinite(levels).any() else 1.0


def told(scatters: Sequence[Scatter], noise: float | np.ndarray, signals: Signals) -> list[str]:
    """What a reader should know of the noise, in sentences.

    Args:
        scatters: found, see `fitted`.
        noise: that was assumed.
        signals: names and unit of what is measured.
    """
    if np.ndim(noise) == 0:
        return [*_told(scatters[0], float(noise), signals.unit, ""), *_louder(scatters[0], signals)]
    units = signals.unit if len(set(np.ravel(noise))) == 1 else ""
    each = zip(scatters, np.ravel(noise), signals.points, strict=True)
    return [text for one, size, name in each for text in _told(one, float(size), units, name)]


def _told(found: Scatter, noise: float, unit: str, name: str) -> list[str]:
    """How the noise differs from what was assumed, if it does."""
    large = abs(found.level - 1) > LARGE
    if not found.departs or (found.factor == 1 and not large):
        return []
    of, sigma = f" of {name}" if name else "", quantity(noise, unit)
    seen = f"Noise{of}: samples scatter by {quantity(found.level * noise, unit)}, {_compared(found.level)} the {sigma} assumed"
    if found.factor != 1:
        return [f"{seen}; fits are weighed by it.{' What is declared is wrong, or the tracker is another.' if large else ''}"]
    why = "in motion than at rest" if found.white else "over several samples than from one to the next"
    if found.white and found.even:
        return [f"{seen}; more than noise must be meant: what was assumed is kept."]
    return [f"{seen}; but it is another {why}, so that it is no white noise: what was assumed is kept."]


def _compared(level: float) -> str:
    part = 100 * abs(level - 1)
    return f"{level:.2g} times" if level > 2 else f"{part:.0f} % {'above' if level > 1 else 'below'}"


def _louder(found: Scatter, signals: Signals) -> list[str]:
    """Coordinates that scatter more than the others."""
    typical = float(np.nanmedian(found.levels)) if np.isfinite(found.levels).any() else np.inf
    columns = [f"{point} {axis}".strip() for point in signals.points for axis in signals.axes]
    more = [(level / typical, name) for level, name in zip(found.levels.ravel(), columns, strict=True) if level > LOUDER * typical]
    return [f"Noise: {listed([name for _, name in more])} scatter by up to {max(more)[0]:.2g} times as much as the others."] if more else []
