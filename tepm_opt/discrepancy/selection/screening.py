"""Which effects are worth fitting: how much of the gap each could close to first order, with the free parameters free to follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.discrepancy.problem.plant import Candidate, freed, ranged
from tepm_opt.discrepancy.selection.linearised import Linearised, probed
from tepm_opt.solvers.identify import ParameterEstimate, identify
from tepm_opt.solvers.least_squares import bounded_step
from tepm_opt.solvers.parallel import in_parallel
from tepm_opt.solvers.plant import PredictionError
from tepm_opt.solvers.residuals import normal_equations

FURTHER = 100.0  # times the values that a candidate's own score found
SHARED = 4  # of the runs of a quick plant one in so many tells what a probe is worth
SOME_STEPS, MORE_STEPS = 3, 8  # from every probe, and on from the best of each candidate
ALSO = 0.5  # part of the best probe's gain from which another is worth a fit


@dataclass(frozen=True, eq=False)
class Score:
    """What screening says of a candidate.

    Attributes:
        candidate: the effect.
        gain: part of the squared residuals beyond the noise that it could take away, to first order.
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


def screen(linear: Linearised, bent: Sequence[Candidate] = ()) -> list[Score]:
    """Scores of candidates, largest gain first.

    Both what they do and what the free parameters do are taken to first order together, so that what those could do as well does not
    count. Scores order, they do not decide. Where the plant is quick, a few steps are made from each probe instead.

    Args:
        linear: a fit to first order in the candidates.
        bent: further candidates of a quick plant, that are not smooth: probed by fits.
    """
    scores = [Score(c, *linear.gain((*linear.effects, c))) for c in linear.able]
    scores += [Score(next(a for a in linear.able if a == c), *linear.gain((*linear.effects, c))) for c in linear.afar]
    probes = [(candidate, probe) for candidate in bent for probe in candidate.probes]
    return _ordered([*scores, *(_fitted(linear.estimate, probes) if probes else [])])


def _ordered(scores: Sequence[Score]) -> list[Score]:
    """One score of every candidate, its best, with the values of others that promise nearly as much; largest gain first."""
    found: dict[Candidate, list[Score]] = {}
    for score in sorted(scores, key=lambda score: -score.gain):
        found.setdefault(score.candidate, []).append(score)
    return [
        replace(first, also=(*first.also, *(score.start for score in others if score.gain >= ALSO * first.gain)))
        for first, *others in found.values()
    ]


def _fitted(estimate: ParameterEstimate, probes: Sequence[tuple[Candidate, Mapping[str, float]]]) -> list[Score]:
    """Scores by what a few steps from each probe, and some more from the best, gain on some of the runs, the free parameters beside it.

    They begin where the free parameters undo to first order what the probe changes: a spring that remembers is a spring, too.
    """
    count = len(estimate.problem.runs)
    some = sorted({round(k) for k in np.linspace(0, count - 1, -(-count // SHARED))})
    problem = replace(
        estimate.problem,
        runs=tuple(estimate.problem.runs[k] for k in some),
        noise=tuple(estimate.problem.noises[k] for k in some),
    )
    names, values = [f.name for f in problem.free], estimate.values
    null = problem.residuals(values, names)
    square = normal_equations(null)[0]
    squares, coordinates = sum(r.squares for r in null), sum(r.count for r in null)

    def tried(probe: tuple[Candidate, Mapping[str, float]]) -> Score | None:
        candidate, at = probe
        added = tuple(replace(f, start=at[f.name]) for f in ranged(problem.plant, candidate))
        try:
            changed = replace(problem, plant=problem.plant.with_values(at)).residuals(values, [])
            slope = sum(r.by.T @ (c.values - r.values).ravel() for r, c in zip(null, changed, strict=True))
            step, _ = bounded_step(square, np.asarray(slope), problem.low - values, problem.high - values, problem.scale)
            free = tuple(replace(f, start=float(v)) for f, v in zip(problem.free, values + step, strict=True))
            return scored(candidate, identify(replace(problem, free=(*free, *added)), SOME_STEPS))
        except PredictionError:
            return None

    def scored(candidate: Candidate, found: ParameterEstimate) -> Score:
        gain = (squares - sum(r.squares for r in found.residuals)) / max(squares - coordinates, 1e-9 * coordinates)
        return Score(candidate, gain, found.named)

    def further(score: Score) -> Score:
        free = tuple(replace(f, start=score.start[f.name]) for f in freed(problem.free, problem.plant, [score.candidate]))
        return replace(scored(score.candidate, identify(replace(problem, free=free), MORE_STEPS)), also=score.also)

    threads = problem.plant.concurrent
    first = [score for score in in_parallel(tried, probes, threads=threads) if score is not None]
    return in_parallel(further, _ordered(first), threads=threads)


def screen_pairs(
    estimate: ParameterEstimate, scores: Sequence[Score], most: int
) -> list[tuple[tuple[Candidate, Candidate], float, dict[str, float]]]:
    """Pairs of candidates by what the two could take away together, largest first: (pair, gain, values to fit from).

    Only the direction from null to start of each is looked at, as its own score found it; any multiple of it may act.

    Args:
        estimate: with the parameters that are free already.
        scores: of single candidates, largest gain first.
        most: how many of them are paired.
    """
    picked = scores[:most]
    free = [parameter.name for parameter in estimate.problem.free]
    simulated = estimate.problem.residuals(estimate.values, free)
    own = {score: {name: score.start[name] for name in score.candidate.parameters} for score in picked}
    changes = in_parallel(lambda score: probed(estimate, own[score]), picked, threads=estimate.problem.plant.concurrent)
    able = [(score, change) for score, change in zip(picked, changes, strict=True) if change is not None]
    columns = [np.stack([(change[k].values - r.values).ravel() for _, change in able], axis=1) for k, r in enumerate(simulated)]
    whole = [replace(r, by=np.hstack([s.by, c])) for r, s, c in zip(estimate.residuals, simulated, columns, strict=True)]
    square, slope = normal_equations(whole)
    found = []
    for i, (one, _) in enumerate(able):
        for j, (other, _) in enumerate(able[:i]):
            at = [*range(len(free)), len(free) + i, len(free) + j]
            gain, step = _gain(estimate, square[np.ix_(at, at)], slope[at], -np.ones(2) * FURTHER, np.ones(2) * FURTHER, np.ones(2))
            start = {}
            for score, size in ((one, step[-2]), (other, step[-1])):
                null = score.candidate.null
                start |= {
                    name: value if name in score.candidate.shapes else null[name] + float(size) * (value - null[name])
                    for name, value in own[score].items()
                }
            found.append(((one.candidate, other.candidate), gain, start))
    return sorted(found, key=lambda pair: -pair[1])


def _gain(
    estimate: ParameterEstimate, square: np.ndarray, slope: np.ndarray, low: np.ndarray, high: np.ndarray, scale: np.ndarray
) -> tuple[float, np.ndarray]:
    """Part of the excess that the last parameters could take away, and the step of all.

    Args:
        estimate: with the parameters that are free already.
        square, slope: normal equations, its parameters first.
        low, high: bounds of the others' steps.
        scale: of the others.
    """
    problem, values = estimate.problem, estimate.values
    step, less = bounded_step(
        square,
        slope,
        np.concatenate([problem.low - values, low]),
        np.concatenate([problem.high - values, high]),
        np.concatenate([problem.scale, scale]),
    )
    return less / max(estimate.cost - estimate.count, 1e-9 * estimate.count), step
