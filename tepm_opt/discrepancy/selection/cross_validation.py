"""Cross-validation of hypotheses, and their probabilities from the predictions of left-out data."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2, norm

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.solvers.identification.identify import ParameterEstimate
from tepm_opt.solvers.identification.residuals import Residual, independent_after
from tepm_opt.solvers.mechanics.plant import PredictionError
from tepm_opt.solvers.numerics.least_squares import bounded_step
from tepm_opt.solvers.numerics.parallel import in_parallel


@dataclass(frozen=True, eq=False)
class Evidence:
    """Predictions of a hypothesis for data left out of its fit.

    Attributes:
        squares: sum of the squared errors over the noise of every block of time (about 1 s), (blocks,).
        counts: coordinates measured in every block, (blocks,).
        parameters: how many are free and matter.
        scatter: jackknife standard deviation of the free parameters over the folds, (parameters,).
        worth: how many independent measurements a coordinate is worth, at most 1: neighbours in time say nearly the same.
        held_out: whether the data were left out of the fits that predict them.
        chance: excess that counts as chance, because the noise is a model's error whose size is known from other data only.
        prior_excess: excess of the misfit between the parameters and what other data tell of them; it has a block of its own in `squares`.
    """

    squares: np.ndarray
    counts: np.ndarray
    parameters: int
    scatter: np.ndarray
    worth: float = 1.0
    held_out: bool = True
    chance: float = 0.0
    prior_excess: float = 0.0

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Evidence({len(self.counts)} blocks, {self.parameters} parameters, excess {self.excess:.3g})"

    @property
    def count(self) -> int:
        """Coordinates measured."""
        return int(self.counts.sum())

    @property
    def without_prior(self) -> Evidence:
        """The evidence of measurements alone, without that of a prior."""
        return replace(self, squares=self.squares[self.counts > 0], counts=self.counts[self.counts > 0], prior_excess=0.0)

    @property
    def excess(self) -> float:
        """Mean square of the errors beyond noise and chance, over the noise's: 0 where nothing but noise is left."""
        measured = float(self.squares[self.counts > 0].sum()) / max(self.count, 1)
        return max(measured - 1.0 - self.chance, 0.0) + self.prior_excess

    @property
    def spread(self) -> float:
        """Mean square of the errors over the noise's, at least 1."""
        return max(float(self.squares.sum()) / max(self.count, 1), 1.0)


def leave_out(estimate: ParameterEstimate, settings: SearchSettings, partly: Collection[str] = ()) -> Evidence:
    """Cross-validate a fit: every run (with fewer than three, every quarter of a run) is predicted by a fit to the others.

    A refit is one Gauss-Newton step from the fit to all runs, within the bounds; predictions are linear in that step. Parameters at a
    bound stay there, and so do refinements of a form: often a single run tells them. The squares are those of the predictive distribution:
    for linear models what the run adds to the squares of the others (Vehtari and Ojanen, Statistics Surveys 6, 2012). With
    `settings.refit_folds` see `leave_out_by_refits`.

    Args:
        estimate: the fit.
        settings: of the search.
        partly: parameters of effects that act in some runs only; a run that alone tells of one of them is cut into quarters, too.
    """
    problem, residuals = estimate.problem, estimate.residuals
    if settings.refit_folds:
        return _with_joint_prior(leave_out_by_refits(estimate, settings), estimate, settings)
    count = len(problem.free)
    parts = []  # (values (rows, points · 3), by, block, counts) of every fold
    for r, cut in zip(residuals, _runs_to_cut(estimate, partly, settings), strict=True):
        rows, first = len(r.values), int(r.block.min())
        blocks = np.array_split(np.arange(first, int(r.block.max()) + 1), settings.run_parts if cut else 1)
        edges = [np.searchsorted(r.block, (part[0], part[-1] + 1)) for part in blocks if len(part)]
        pieces = [slice(*edge) for edge in edges if edge[0] < edge[1]]  # views, which cost no memory
        values, by = r.values.reshape(rows, -1), r.by.reshape(rows, r.values.size // rows, count)
        parts += [(values[piece], by[piece], r.block[piece], r.present.reshape(rows, -1)[piece].sum(axis=1)) for piece in pieces]
    squares = [by.reshape(values.size, count).T @ by.reshape(values.size, count) for values, by, _, _ in parts]
    slopes = [by.reshape(values.size, count).T @ values.ravel() for values, by, _, _ in parts]
    mean, precision = problem.prior
    errors, counts, steps = [], [], []
    for k, (values, by, block, present) in enumerate(parts):
        left, part = values, 1.0
        if count:
            others = sum(squares) - squares[k]
            stays = estimate.at_bound | [free.refines for free in problem.free]
            low, high = (np.where(stays, 0.0, bound - estimate.values) for bound in (problem.low, problem.high))
            slope = sum(slopes) - slopes[k] + precision @ (estimate.values - mean)
            step, less = bounded_step(others + precision, slope, low, high, problem.scale)
            left = values + by @ step
            part = min((float(np.sum(values**2)) + max(less, 0.0)) / max(float(np.sum(left**2)), 1e-300), 1.0)
            steps.append(step)
        first = block - block.min()
        errors.append(part * np.bincount(first, (left**2).sum(axis=1)))
        counts.append(np.bincount(first, present))
    every = np.concatenate(counts)
    scatter = np.sqrt((len(parts) - 1) * np.var(steps, axis=0)) if count and len(parts) > 1 else np.zeros(count)
    worth = 1.0 if problem.plant.static else min(problem.block / independent_after(residuals, problem.runs), 1.0)
    found = Evidence(np.concatenate(errors)[every > 0], every[every > 0], count, scatter, worth)
    return _with_joint_prior(found, estimate, settings)


def _with_joint_prior(evidence: Evidence, estimate: ParameterEstimate, settings: SearchSettings) -> Evidence:
    """Evidence with the parameters' distance from a joint prior as one more block; as it is without such a prior.

    The squared distance of parameters that did not change follows a chi-square distribution; what exceeds it beyond chance is structure.
    """
    joint, free = estimate.problem.joint, estimate.problem.free
    if joint is None:
        return evidence
    mean, precision = joint.terms(free)
    squares, told = float((estimate.values - mean) @ precision @ (estimate.values - mean)), int((np.diag(precision) > 0).sum())
    likely = joint.weight * float(chi2.isf(norm.sf(settings.chance_sigmas), max(told, 1)))
    return replace(
        evidence,
        squares=np.append(evidence.squares, squares),
        counts=np.append(evidence.counts, 0),
        worth=1 / joint.weight,
        chance=settings.chance_excess,
        prior_excess=max(squares - likely, 0.0) / max(evidence.count, 1),
    )


def _runs_to_cut(estimate: ParameterEstimate, names: Collection[str], settings: SearchSettings) -> np.ndarray:
    """Mask of the runs that alone tell one of some parameters, (runs,); all runs where there are fewer than three."""
    residuals, own = estimate.residuals, [free.name in names for free in estimate.problem.free]
    if len(residuals) < 3:
        return np.ones(len(residuals), dtype=bool)
    told = np.array([np.square(r.by[:, own]).sum(axis=0) for r in residuals])  # (runs, parameters)
    return (told > settings.alone_share * np.maximum(told.sum(axis=0), 1e-300)).any(axis=1)


def in_sample(estimate: ParameterEstimate, evidence: Evidence) -> Evidence:
    """Evidence from the data that a hypothesis was fitted to, without scatter of its parameters."""
    errors, counts = [], []
    for r in estimate.residuals:
        rows, first = len(r.values), r.block - r.block.min()
        errors.append(np.bincount(first, (r.values.reshape(rows, -1) ** 2).sum(axis=1)))
        counts.append(np.bincount(first, r.present.reshape(rows, -1).sum(axis=1)))
    every = np.concatenate(counts)
    scatter = np.zeros_like(evidence.scatter)
    return Evidence(np.concatenate(errors)[every > 0], every[every > 0], evidence.parameters, scatter, held_out=False)


def leave_out_by_refits(estimate: ParameterEstimate, settings: SearchSettings) -> Evidence:
    """Cross-validate a fit by simulated refits, each without one fold of the data.

    A fold is every sixth run, or every sixth part of the runs where there are few. States that a run begins with belong to the run, so
    that all it measured tells them. Refits keep the derivatives of the fit to all data and start from it. A fit that ended early is not
    refitted: it leaves too much as it is.
    """
    problem = estimate.problem
    folds = _number_folds(problem.runs, settings)
    own = sorted({int(k) for numbers in folds for k in np.unique(numbers)})
    refits = in_parallel(
        lambda fold: _refit(estimate, [numbers != fold for numbers in folds], settings.refit_steps), own, threads=problem.plant.concurrent
    )
    errors, counts, measured = [], [], 0
    for k, numbers in enumerate(folds):
        rows = numbers[:, None] == np.array(own)
        square = sum(_sum_by_row(left[k].values ** 2) * rows[:, j] for j, (_, left) in enumerate(refits))
        present, block = _sum_by_row(estimate.residuals[k].present), estimate.residuals[k].block
        errors.append(np.bincount(block - block.min(), square))
        counts.append(np.bincount(block - block.min(), present))
        measured += int((present > 0).sum())
    every = np.concatenate(counts)
    values = np.array([found for found, _ in refits])
    scatter = np.sqrt((len(own) - 1) * np.var(values, axis=0)) if len(own) > 1 else np.zeros(len(problem.free))
    worth = min((every > 0).sum() / max(measured, 1), 1.0)
    squares = np.concatenate(errors)[every > 0]
    return Evidence(squares, every[every > 0], len(problem.free), scatter, worth, held_out=not estimate.out_of_reach)


def _sum_by_row(values: np.ndarray) -> np.ndarray:
    """Sum over everything measured at one time, (rows,)."""
    return values.reshape(len(values), -1).sum(axis=1) if values.size else np.zeros(len(values))


def _refit(estimate: ParameterEstimate, kept: Sequence[np.ndarray], steps: int) -> tuple[np.ndarray, list[Residual]]:
    """Parameters fitted to some rows of every run, and the residuals of all rows with them.

    Args:
        estimate: the fit to all rows.
        kept: mask of the rows to fit to, (rows,) of every run.
        steps: most Gauss-Newton steps.
    """
    problem, values, left = estimate.problem, estimate.values, estimate.residuals
    if not len(values) or estimate.out_of_reach:
        return values, left
    masks = [np.broadcast_to(rows[:, None, None], r.values.shape) for rows, r in zip(kept, left, strict=True)]
    slopes = [r.by * mask.reshape(-1, 1) for mask, r in zip(masks, left, strict=True)]
    square = np.asarray(sum(by.T @ by for by in slopes))
    mean, precision = problem.prior

    def cost(residuals: Sequence[Residual], at: np.ndarray) -> float:
        return float(
            sum(np.sum(r.values[mask] ** 2) for r, mask in zip(residuals, masks, strict=True)) + (at - mean) @ precision @ (at - mean)
        )

    for _ in range(steps):
        slope = sum(by.T @ r.values.ravel() for by, r in zip(slopes, left, strict=True)) + precision @ (values - mean)
        step, promised = bounded_step(square + precision, slope, problem.low - values, problem.high - values, problem.scale)
        before = cost(left, values)
        if promised < 1e-3 + 1e-6 * before:
            break
        for part in (1.0, 0.25):
            try:
                tried = problem.residuals(values + part * step, [])
            except PredictionError:
                continue
            if cost(tried, values + part * step) < before:
                values, left = values + part * step, tried
                break
        else:
            break
    return values, left


def _number_folds(runs: Sequence[Run], settings: SearchSettings) -> list[np.ndarray]:
    """Number of the fold of every row of every run, (rows,) each."""
    count = settings.fold_count
    if len(runs) >= count:
        return [np.full(run.rows, k % count) for k, run in enumerate(runs)]
    most = -(-count * settings.fold_parts // len(runs))
    folds, first = [], 0
    for run in runs:
        parts = min(most, run.rows)
        folds.append((first + np.arange(run.rows) * parts // run.rows) % count)
        first += parts
    return folds


def weights(evidence: Sequence[Evidence], seed: int, draws: int = 2000) -> np.ndarray:
    """Probabilities of hypotheses, (hypotheses,), from `draws` of a Bayesian bootstrap.

    Pseudo-Bayesian model averaging with the Bayesian bootstrap over blocks of time (Yao, Vehtari, Simpson, Gelman, Bayesian
    Analysis 13, 2018): log densities of the left-out blocks, normal with the spread that each hypothesis shows; a parameter costs
    half the logarithm of the number of blocks (Schwarz, Annals of Statistics 6, 1978). What neighbours in time say alike counts as
    often as the one that leaves least shows.
    """
    densities = np.stack([-0.5 * (e.counts * np.log(e.spread) + e.squares / e.spread) for e in evidence])
    blocks = densities.shape[1]
    densities *= min(evidence, key=lambda each: each.excess).worth
    densities -= 0.5 * np.array([[e.parameters] for e in evidence]) * np.log(max(blocks, 2)) / blocks
    random = np.random.default_rng(seed)
    shares = random.dirichlet(np.ones(blocks), size=draws) * blocks
    totals = densities @ shares.T
    totals -= totals.max(axis=0)
    each = np.exp(totals)
    return (each / each.sum(axis=0)).mean(axis=1)
