"""Screening: share of the gap that each candidate could close to first order while the free parameters follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.discrepancy.problem.plant import (
    Candidate,
    collect_free_parameters,
    free_candidate_parameters,
    restrict_effects_to_runs,
)
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.linearised import Linearised, scale_from_null, simulate_probe
from tepm_opt.solvers.identification.identify import ParameterEstimate, identify
from tepm_opt.solvers.identification.residuals import normal_equations
from tepm_opt.solvers.mechanics.plant import PredictionError
from tepm_opt.solvers.numerics.least_squares import bounded_step
from tepm_opt.solvers.numerics.parallel import in_parallel


@dataclass(frozen=True, eq=False)
class Score:
    """Screening result of a candidate.

    Attributes:
        candidate: the effect.
        gain: share of the squared residuals beyond the noise that it could remove, to first order.
        start: values of its parameters and of the free ones by full name, from which to fit.
        also: such values of other probes that promise nearly as much.
    """

    candidate: Candidate
    gain: float
    start: dict[str, float]
    also: tuple[dict[str, float], ...] = ()

    @property
    def starts(self) -> tuple[dict[str, float], ...]:
        """All values from which to fit, the most promising first."""
        return (self.start, *self.also)

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Score({self.candidate.label}, gain {self.gain:.3g})"


def screen(linear: Linearised, settings: SearchSettings, nonsmooth: Sequence[Candidate] = ()) -> list[Score]:
    """Scores of candidates, largest gain first; they order candidates and decide nothing.

    Candidates and free parameters are linearised together, so that what the free parameters could do as well does not count.

    Args:
        linear: a fit to first order in the candidates.
        settings: of the search.
        nonsmooth: further candidates, not smooth, that are screened by fits (`screen_by_fits`).
    """
    scores = [Score(c, *linear.gain((*linear.effects, c))) for c in linear.able]
    scores += [Score(next(a for a in linear.able if a == c), *linear.gain((*linear.effects, c))) for c in linear.far_probed]
    return _rank([*scores, *screen_by_fits(linear.estimate, nonsmooth, settings)], settings)


def _rank(scores: Sequence[Score], settings: SearchSettings) -> list[Score]:
    """The best score of every candidate, with the values of others that promise nearly as much; largest gain first."""
    found: dict[Candidate, list[Score]] = {}
    for score in sorted(scores, key=lambda score: -score.gain):
        found.setdefault(score.candidate, []).append(score)
    return [
        replace(first, also=(*first.also, *(score.start for score in others if score.gain >= settings.min_start_gain * first.gain)))
        for first, *others in found.values()
    ]


def screen_by_fits(estimate: ParameterEstimate, candidates: Sequence[Candidate], settings: SearchSettings) -> list[Score]:
    """Scores from short fits on some of the runs: a few steps from every probe, and more from the best of each candidate.

    A fit begins where the free parameters undo to first order what the probe changes: a spring with memory is a spring, too.

    Args:
        estimate: fit without the candidates.
        candidates: all in all runs, or each in some.
        settings: of the search.
    """
    probes = [(candidate, probe) for candidate in candidates for probe in candidate.probes]
    if not probes:
        return []
    count = len(estimate.problem.runs)
    stride = 1 if any(candidate.runs for candidate in candidates) else settings.probe_run_stride
    some = sorted({round(k) for k in np.linspace(0, count - 1, -(-count // stride))})
    problem = replace(
        estimate.problem,
        runs=tuple(estimate.problem.runs[k] for k in some),
        noise=tuple(estimate.problem.noises[k] for k in some),
    )
    names, values = [f.name for f in problem.free], estimate.values
    null = problem.residuals(values, names)
    square = normal_equations(null)[0]
    if problem.joint is not None:
        square = square + problem.joint.terms(problem.free)[1]
    squares, coordinates = sum(r.squares for r in null), sum(r.count for r in null)
    beyond = max(estimate.cost - estimate.count, 1e-9 * estimate.count) * coordinates / max(estimate.count, 1)
    excess = max(squares - coordinates, beyond)  # in these runs, of which a few may hold most of it, or hardly any

    def fit_from_probe(probe: tuple[Candidate, Mapping[str, float]]) -> Score | None:
        candidate, at = probe
        added = tuple(replace(f, start=at[f.name]) for f in free_candidate_parameters(problem.plant, candidate))
        own = replace(problem, plant=restrict_effects_to_runs(problem.plant, [candidate]))
        try:
            changed = replace(own, plant=own.plant.with_values(at)).residuals(values, [])
            slope = sum(r.by.T @ (c.values - r.values).ravel() for r, c in zip(null, changed, strict=True))
            step, _ = bounded_step(square, np.asarray(slope), problem.low - values, problem.high - values, problem.scale)
            free = tuple(replace(f, start=float(v)) for f, v in zip(problem.free, values + step, strict=True))
            return score_fit(candidate, identify(replace(own, free=(*free, *added)), settings.probe_steps))
        except PredictionError:
            return None

    def score_fit(candidate: Candidate, found: ParameterEstimate) -> Score:
        return Score(candidate, (squares - sum(r.squares for r in found.residuals)) / excess, found.named)

    def continue_fit(score: Score) -> Score:
        free = collect_free_parameters(problem.free, problem.plant, [score.candidate])
        plant = restrict_effects_to_runs(problem.plant, [score.candidate])
        begin = replace(problem, plant=plant, free=tuple(replace(f, start=score.start[f.name]) for f in free))
        return replace(score_fit(score.candidate, identify(begin, settings.best_probe_steps)), also=score.also)

    threads = problem.plant.concurrent
    first = [score for score in in_parallel(fit_from_probe, probes, threads=threads) if score is not None]
    return in_parallel(continue_fit, _rank(first, settings), threads=threads)


def screen_pairs(
    estimate: ParameterEstimate, scores: Sequence[Score], most: int
) -> list[tuple[tuple[Candidate, Candidate], float, dict[str, float]]]:
    """Pairs of candidates with their common gain, largest first: (pair, gain, values to fit from).

    Each acts along the line from its null values to the start of its own score, in any multiple of it.

    Args:
        estimate: with the parameters that are free already.
        scores: of single candidates, largest gain first.
        most: how many of them are paired.
    """
    picked = scores[:most]
    free = [parameter.name for parameter in estimate.problem.free]
    simulated = estimate.problem.residuals(estimate.values, free)
    own = {score: {name: score.start[name] for name in score.candidate.parameters} for score in picked}
    changes = in_parallel(lambda score: simulate_probe(estimate, own[score]), picked, threads=estimate.problem.plant.concurrent)
    able = [(score, change) for score, change in zip(picked, changes, strict=True) if change is not None]
    columns = [np.stack([(change[k].values - r.values).ravel() for _, change in able], axis=1) for k, r in enumerate(simulated)]
    whole = [replace(r, by=np.hstack([s.by, c])) for r, s, c in zip(estimate.residuals, simulated, columns, strict=True)]
    square, slope = normal_equations(whole)
    found = []
    for i, (one, _) in enumerate(able):
        for j, (other, _) in enumerate(able[:i]):
            at = [*range(len(free)), len(free) + i, len(free) + j]
            gain, step = _gain(estimate, square[np.ix_(at, at)], slope[at], np.full(2, 100.0))  # any multiple that makes sense
            start: dict[str, float] = {}
            for score, size in ((one, step[-2]), (other, step[-1])):
                start |= scale_from_null(score.candidate, own[score], float(size))
            found.append(((one.candidate, other.candidate), gain, start))
    return sorted(found, key=lambda pair: -pair[1])


def _gain(estimate: ParameterEstimate, square: np.ndarray, slope: np.ndarray, reach: np.ndarray) -> tuple[float, np.ndarray]:
    """Share of the excess that the last parameters could remove, and the step of all parameters.

    Args:
        estimate: with the parameters that are free already.
        square, slope: normal equations, its parameters first.
        reach: largest steps of the last parameters either way, in multiples.
    """
    problem, values = estimate.problem, estimate.values
    step, less = bounded_step(
        square,
        slope,
        np.concatenate([problem.low - values, -reach]),
        np.concatenate([problem.high - values, reach]),
        np.concatenate([problem.scale, np.ones_like(reach)]),
    )
    return less / max(estimate.cost - estimate.count, 1e-9 * estimate.count), step
