"""How well hypotheses predict data they were not fitted to, and which of them is believed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tepm_opt.solvers.identify import ParameterEstimate
from tepm_opt.solvers.least_squares import bounded_step

DRAWS = 2000
FOLDS = 4  # parts a run is cut into where there are too few runs to leave one out


@dataclass(frozen=True, eq=False)
class Evidence:
    """Predictions of a hypothesis for data left out of its fit.

    Attributes:
        squares: sum of the squared errors over the noise of every block of time (about 1 s), (blocks,).
        counts: coordinates measured in every block, (blocks,).
        parameters: how many are free.
        scatter: jackknife standard deviation of the free parameters over the folds, (parameters,).
    """

    squares: np.ndarray
    counts: np.ndarray
    parameters: int
    scatter: np.ndarray

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Evidence({len(self.counts)} blocks, {self.parameters} parameters, excess {self.excess:.3g})"

    @property
    def count(self) -> int:
        """Coordinates measured."""
        return int(self.counts.sum())

    @property
    def excess(self) -> float:
        """Mean square of the errors beyond the noise, over the noise's: 0 where nothing but noise is left."""
        return max(float(self.squares.sum()) / max(self.count, 1) - 1.0, 0.0)

    @property
    def spread(self) -> float:
        """Mean square of the errors over the noise's, at least 1."""
        return max(float(self.squares.sum()) / max(self.count, 1), 1.0)


def leave_out(estimate: ParameterEstimate) -> Evidence:
    """Cross-validation: every run (with fewer than three, every quarter of a run) is predicted by a fit to the others.

    The refits are one Gauss-Newton step from the fit to all of them, within the bounds; predictions are linear in that step.
    """
    problem, residuals = estimate.problem, estimate.residuals
    count = len(problem.free)
    parts = []  # (values (rows, points · 3), by, block, counts) of every fold
    for r in residuals:
        rows = len(r.values)
        folds = 1 if len(residuals) > 2 else min(FOLDS, rows)
        pieces = [slice(piece[0], piece[-1] + 1) for piece in np.array_split(np.arange(rows), folds)]  # views, which cost no memory
        values, by = r.values.reshape(rows, -1), r.by.reshape(rows, r.values.size // rows, count)
        parts += [(values[piece], by[piece], r.block[piece], r.present.reshape(rows, -1)[piece].sum(axis=1)) for piece in pieces]
    squares = [by.reshape(values.size, count).T @ by.reshape(values.size, count) for values, by, _, _ in parts]
    slopes = [by.reshape(values.size, count).T @ values.ravel() for values, by, _, _ in parts]
    errors, counts, steps = [], [], []
    for k, (values, by, block, present) in enumerate(parts):
        left = values
        if count:
            others = sum(squares) - squares[k]
            low, high = problem.low - estimate.values, problem.high - estimate.values
            step, _ = bounded_step(others, sum(slopes) - slopes[k], low, high, problem.scale)
            left = values + by @ step
            steps.append(step)
        first = block - block.min()
        errors.append(np.bincount(first, (left**2).sum(axis=1)))
        counts.append(np.bincount(first, present))
    every = np.concatenate(counts)
    scatter = np.sqrt((len(parts) - 1) * np.var(steps, axis=0)) if count and len(parts) > 1 else np.zeros(count)
    return Evidence(np.concatenate(errors)[every > 0], every[every > 0], count, scatter)


def weights(evidence: Sequence[Evidence], seed: int, draws: int = DRAWS) -> np.ndarray:
    """Probabilities of hypotheses, one of which is taken to be the best, (hypotheses,).

    Pseudo-Bayesian model averaging with the Bayesian bootstrap over blocks of time (Yao, Vehtari, Simpson, Gelman, Bayesian
    Analysis 13, 2018): log densities of the left-out blocks, normal with the spread that each hypothesis shows; a parameter costs
    half the logarithm of the number of blocks (Schwarz, Annals of Statistics 6, 1978).
    """
    densities = np.stack([-0.5 * (e.counts * np.log(e.spread) + e.squares / e.spread) for e in evidence])
    blocks = densities.shape[1]
    densities -= 0.5 * np.array([[e.parameters] for e in evidence]) * np.log(max(blocks, 2)) / blocks
    random = np.random.default_rng(seed)
    shares = random.dirichlet(np.ones(blocks), size=draws) * blocks
    totals = densities @ shares.T
    totals -= totals.max(axis=0)
    each = np.exp(totals)
    return (each / each.sum(axis=0)).mean(axis=1)
