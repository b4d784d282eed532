"""Which effects explain the data: screen, fit, judge on held-out data; forward until nothing improves, then backward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.discrepancy.evidence import weights
from tepm_opt.discrepancy.fits import Fits, Hypothesis, SearchSettings, labels
from tepm_opt.discrepancy.plant import Candidate
from tepm_opt.discrepancy.screen import Score, screen_pairs
from tepm_opt.solvers.identify import Problem
from tepm_opt.solvers.plant import PredictionError
from tepm_opt.solvers.text import shortened

# part of the squared output of the other effects that their forms may be wrong by (5 % of the size); an effect that takes away less
# beside them may only mend their forms
FORM_ERROR_RATIO = 0.0025
PAIRED = 10  # candidates, those that promise most alone, that are tried in pairs where none of them helps alone
ABREAST = 1.5  # times the excess of the best set of effects that another may leave to be followed, too
PLAIN = 0.9  # part of a form's gain from which a plainer form of the same is fitted in its place
MIN_GAIN_RATIO = 0.25  # part of the best candidate's first-order gain below which others are not worth a fit
Shares = dict[Candidate, float]
Groups = dict[Candidate, list[tuple[Hypothesis, float]]]


@dataclass(frozen=True, eq=False)
class Explanation:
    """What the search found.

    Attributes:
        without: the known parameters recalibrated, no effect added.
        best: effects that stand out, all fitted together with the parameters; none where nothing does.
        widest: the most that was tried along.
        tried: every hypothesis fitted, in order.
        scores: first-order gains of all candidates against `without`.
        shares: for each effect of `best`: how many times the structure left only this effect takes away.
        groups: for each effect of `best`: hypotheses that have another one in its place, `best` first, and their probabilities.
    """

    without: Hypothesis
    best: Hypothesis
    widest: Hypothesis
    tried: list[Hypothesis]
    scores: list[Score]
    shares: Shares
    groups: Groups

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Explanation({shortened(labels(self.best), 60)}, closes {self.closes(self.best):.0%}, {len(self.tried)} fits)"

    def closes(self, hypothesis: Hypothesis) -> float:
        """Part of the structure left by recalibration that a hypothesis takes away."""
        return 1 - hypothesis.excess / max(self.without.excess, 1e-12)


def explain(fits: Fits, missing: Sequence[Candidate], seed: int) -> Explanation:
    """Search the effects that explain what recalibration leaves.

    Raises:
        PredictionError: the model cannot do the runs even without an effect.
    """
    settings = fits.settings
    without = fits.fit((), {})
    if without is None:
        fits.problem.residuals(fits.problem.start)
        raise PredictionError("the model cannot do the runs")
    best, front = without, [without]
    while front and not best.only_noise(settings):
        grown = {h.effects: h for base in front for h in _grown(fits, base, missing, seed)}
        front = _most_probable(list(grown.values()), seed, settings.beam)
        front = [h for h in front if h.excess <= ABREAST * front[0].excess]
        best = _most_probable([best, *front], seed, 1)[0] if settings.beam > 1 else next(iter(front), best)
    widest = best
    best, shares, groups = _settled(fits, best, missing, seed)
    for _ in range(settings.max_effects):
        weakest = min(groups.values(), key=lambda group: group[0][1], default=[(best, 1.0)])
        better, weight = max(weakest, key=lambda pair: pair[1])
        if better is best or weight < 0.5:
            break
        best, shares, groups = _settled(fits, fits.finished(better), missing, seed)
    if best.excess > settings.max_unexplained_ratio**2 * _motion(fits.problem):
        best, shares, groups = without, {}, {}
    return Explanation(without, best, widest, list(fits.done.values()), fits.screen(without, missing), shares, groups)


def _settled(fits: Fits, best: Hypothesis, missing: Sequence[Candidate], seed: int) -> tuple[Hypothesis, Shares, Groups]:
    """What is left of a hypothesis after the way back, with the shares of its effects and their rivals.

    Where that is nothing, because several stood in for one, the single effect that stands out and leaves least.
    """
    several = len(best.effects) > 1
    best, shares = _backward(fits, best)
    if several and not best.effects:
        alone = [_backward(fits, fits.finished(h)) for h in list(fits.done.values()) if len(h.effects) == 1]
        best, shares = min(alone, key=lambda end: end[0].excess, default=(best, shares))
    return best, shares, {effect: _alternatives(fits, best, effect, missing, seed) for effect in best.effects}


def _motion(problem: Problem) -> float:
    """Mean square of the measured motion about each run's mean position, or the equilibria's about that of all, over the noise's."""
    parts = [(run.points / sigma).reshape(run.rows, -1) for run, sigma in zip(problem.runs, problem.noises, strict=True)]
    total, count = 0.0, 0
    for part in [np.concatenate(parts)] if problem.plant.static else parts:
        for column in part.T:
            seen = column[np.isfinite(column)]
            total, count = total + float(np.var(seen) if seen.size else 0.0) * seen.size, count + seen.size
    return total / max(count, 1)


def _grown(fits: Fits, base: Hypothesis, missing: Sequence[Candidate], seed: int) -> list[Hypothesis]:
    """The most probable of what surely explains more than `base` with one effect more, or with a first pair where no single one does."""
    settings = fits.settings
    if len(base.effects) >= settings.max_effects:
        return []
    for trials in (_round, _pairs):
        first = _most_probable([base, *trials(fits, base, missing)], seed, settings.beam)
        better = [fits.finished(trial) for trial in first if trial is not base]
        if better := [h for h in better if h.excess <= (1 - settings.min_share_closed) * base.excess and _beats(h, base, seed, settings)]:
            return better
    return []


def _round(fits: Fits, base: Hypothesis, missing: Sequence[Candidate], rival: Hypothesis | None = None) -> list[Hypothesis]:
    """Fits of the candidates that promise most beside those of `base`; what competes with a rival, or with the first, may end early."""
    settings = fits.settings
    scores = fits.screen(base, missing)
    if not scores:
        return []
    most = settings.fits_later_rounds if base.effects else settings.fits_first_round
    least = settings.min_share_closed / 2 if base.effects and settings.beam > 1 else 0.0
    promising = plainest([score for score in scores if score.gain >= max(MIN_GAIN_RATIO * scores[0].gain, least)])[:most]
    asked = [
        [((*base.effects, score.candidate), {**base.estimate.named, **start}) for start in score.starts[: settings.starts]]
        for score in promising
    ]
    trials = fits.fit_all(asked[0], bound=_bound(fits, base))[:1] if asked and not rival else []
    trials += fits.fit_all([each for one in asked[len(trials) :] for each in one], rival or next(iter(trials), None), _bound(fits, base))
    return list(dict.fromkeys(trial for trial in trials if trial is not None))


def _bound(fits: Fits, base: Hypothesis) -> float:
    """Squares below which one more effect must come to be worth its fit's end; no bound where fits take few steps anyway."""
    if fits.settings.beam == 1:
        return np.inf
    estimate = base.estimate
    return estimate.count + (1 - fits.settings.min_share_closed) * max(estimate.cost - estimate.count, 0.0)


def plainest(scores: Sequence[Score]) -> list[Score]:
    """Scores without other forms of what a form with fewer parameters promises nearly as well."""
    return [
        score
        for score in scores
        if not any(
            other.candidate.form_of == score.candidate.form_of
            and len(other.candidate.parameters) < len(score.candidate.parameters)
            and other.gain >= PLAIN * score.gain
            for other in scores
        )
    ]


def _pairs(fits: Fits, base: Hypothesis, missing: Sequence[Candidate]) -> list[Hypothesis]:
    """Fits of the pairs that promise most together where there is no effect yet: each may hide the other."""
    scores = fits.screen(base, missing)
    if len(scores) < 2 or base.effects or fits.settings.max_effects < 2:
        return []
    pairs = [
        (pair, start) for pair, _, start in screen_pairs(base.estimate, plainest(scores), PAIRED) if pair[0].form_of != pair[1].form_of
    ]
    asked = [((*base.effects, *pair), {**base.estimate.named, **start}) for pair, start in pairs[: fits.settings.fits_first_round]]
    return [trial for trial in fits.fit_all(asked) if trial is not None]


def _most_probable(hypotheses: Sequence[Hypothesis], seed: int, most: int) -> list[Hypothesis]:
    """So many of some hypotheses, the most probable first."""
    order = np.argsort(-weights([h.evidence for h in hypotheses], seed), kind="stable") if hypotheses else []
    return [hypotheses[k] for k in order[:most]]


def _beats(one: Hypothesis, other: Hypothesis, seed: int, settings: SearchSettings) -> bool:
    return bool(weights([one.evidence, other.evidence], seed)[0] > settings.min_probability)


def _backward(fits: Fits, best: Hypothesis) -> tuple[Hypothesis, dict[Candidate, float]]:
    """Drop effects one by one, the least needed first, until all that are left stand out from the structure left.

    What takes away no more than the errors that the others' forms may have is no effect of its own; all that is left counts against each.
    """
    settings = fits.settings
    while True:
        shares, smaller = {}, {}
        doubt = {effect: FORM_ERROR_RATIO * _output(best, effect) for effect in best.effects}
        left = best.excess + settings.max_noise_excess / 10
        rests = [tuple(c for c in best.effects if c != effect) for effect in best.effects]
        without = fits.fit_all([(rest, best.estimate.named) for rest in rests])
        for effect, rest, found in zip(best.effects, rests, without, strict=True):
            shares[effect] = np.inf  # where the model cannot do the runs without it
            if found is not None:
                smaller[effect] = found
                taken = found.excess - best.excess
                shares[effect] = taken / left if taken >= max(settings.min_excess_removed, sum(doubt[c] for c in rest)) else 0.0
        weakest = min(shares, key=shares.__getitem__, default=None)
        if weakest is None or shares[weakest] >= settings.even_odds_ratio:
            return best, shares
        best = smaller[weakest]


def _output(hypothesis: Hypothesis, effect: Candidate) -> float:
    """Mean square of what one effect of a hypothesis changes in the modelled positions, over the noise's; 0 where that cannot be told."""
    estimate = hypothesis.estimate
    problem = replace(estimate.problem, plant=estimate.plant.with_values(effect.null), free=())
    try:
        without = problem.residuals(np.zeros(0))
    except PredictionError:  # the model cannot do the runs without it
        return 0.0
    changed = sum(float(np.sum((a.values - b.values) ** 2)) for a, b in zip(without, estimate.residuals, strict=True))
    return changed / max(estimate.count, 1)


def _alternatives(
    fits: Fits, best: Hypothesis, effect: Candidate, missing: Sequence[Candidate], seed: int
) -> list[tuple[Hypothesis, float]]:
    """`best` and what it would be with another effect in the place of `effect`, with probabilities."""
    rest = fits.fit(tuple(c for c in best.effects if c != effect), best.estimate.named)
    others = [] if rest is None else [h for h in _round(fits, rest, missing, best) if effect not in h.effects]
    others = [h for h in others if _beats(h, best, seed, fits.settings) or all(c.form_of != effect.form_of for c in h.effects)]
    group = [best, *(h for h in others if h is not best)]
    return list(zip(group, weights([h.evidence for h in group], seed).tolist(), strict=True))
