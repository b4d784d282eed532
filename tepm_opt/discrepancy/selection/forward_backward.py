"""Which effects explain the data: screen, fit, judge on held-out data; forward and backward until neither changes anything."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.selection.alternatives import replacements
from tepm_opt.discrepancy.selection.fitting import Effects, Fits, Hypothesis, labels
from tepm_opt.discrepancy.selection.matching_pursuit import FORM_ERROR_RATIO, MANY, grown, mended, rivals, settled, several
from tepm_opt.discrepancy.selection.ranking import beats, fitted, is_wide, most_probable, plainest
from tepm_opt.discrepancy.selection.run_subsets import longest, spans
from tepm_opt.discrepancy.selection.screening import Score, screen_pairs
from tepm_opt.solvers.identify import Problem
from tepm_opt.solvers.plant import PredictionError
from tepm_opt.solvers.text import shortened

MOVES = 2  # sets of effects fitted of each kind of move that is not one effect more
WORTH_WIDE = 0.5  # part of what the best pair leaves that an effect as wide as several must promise to close
WORTH = 0.2  # part of what the best single effect leaves that a pair, or one in some runs, must promise to close besides
PAIRED = 10  # candidates, those that promise most alone, that are tried in pairs where none of them helps alone
ABREAST = 1.5  # times the excess of the best set of effects that another may leave to be followed, too
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
        scores: first-order gains of all candidates against `without`, beside what gauges show.
        shares: for each effect of `best`: how many times the structure left only this effect takes away.
        groups: for each effect of `best`: hypotheses that have another one in its place, `best` first, and their probabilities.
        begun: effects that gauges have shown, with which the search began; None where there are none.
    """

    without: Hypothesis
    best: Hypothesis
    widest: Hypothesis
    tried: list[Hypothesis]
    scores: list[Score]
    shares: Shares
    groups: Groups
    begun: Hypothesis | None = None

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Explanation({shortened(labels(self.best), 60)}, closes {self.closes(self.best):.0%}, {len(self.tried)} fits)"

    @property
    def shown(self) -> Effects:
        """Effects that gauges have shown."""
        return self.begun.effects if self.begun else ()

    @property
    def there_was(self) -> float:
        """Excess before anything was looked for: beside what gauges have shown."""
        return (self.begun or self.without).excess

    def closes(self, hypothesis: Hypothesis) -> float:
        """Part of the structure left by recalibration that a hypothesis takes away."""
        return 1 - hypothesis.excess / max(self.without.excess, 1e-12)


def explain(fits: Fits, missing: Sequence[Candidate], seed: int) -> Explanation:
    """Search the effects that explain what recalibration leaves, beginning with those that gauges have shown.

    Raises:
        PredictionError: the model cannot do the runs even without an effect.
    """
    settings = fits.settings
    without = fits.fit((), {})
    if without is None:
        fits.problem.residuals(fits.problem.start)
        raise PredictionError("the model cannot do the runs")
    base = (fits.fit(fits.seen, {**without.estimate.named, **fits.values}) if fits.seen else None) or without
    together = several(fits, base, missing)
    best = together or _forward(fits, base, missing, seed)
    if together is None:
        best = most_probable([best, *_at_once(fits, without, best, missing)], seed, 1)[0]
    widest, visited, dropped = best, set[Effects](), set[Candidate]()
    while True:
        dropped |= {*best.effects}
        best, shares, groups = _settled(fits, best, missing, seed)
        dropped -= {*best.effects}
        for _ in range(settings.max_effects):
            weakest = min(groups.values(), key=lambda group: group[0][1], default=[(best, 1.0)])
            better, weight = max(weakest, key=lambda pair: pair[1])
            if better is best or weight < 0.5:
                break
            best, shares, groups = _settled(fits, fits.finished(better), missing, seed)
        if best.effects in visited or fits.problem.plant.quick:
            break
        visited.add(best.effects)
        many = len(best.effects) > MANY
        onward = grown(fits, best, [c for c in missing if c not in dropped]) if many else _forward(fits, best, missing, seed)
        if onward is best:
            break
        best = widest = onward
    if best.excess > settings.max_unexplained_ratio**2 * _motion(fits.problem):
        best, shares, groups = without, {}, {}
    return Explanation(
        without, best, widest, list(fits.done.values()), fits.screen(base, missing), shares, groups, base if fits.seen else None
    )


def _forward(fits: Fits, base: Hypothesis, missing: Sequence[Candidate], seed: int) -> Hypothesis:
    """The most probable of what surely explains more and more from a hypothesis on, until nothing does."""
    settings, best, front = fits.settings, base, [base]
    while front and not best.only_noise(settings):
        grown = {h.effects: h for other in front for h in _grown(fits, other, missing, seed)}
        front = most_probable(list(grown.values()), seed, settings.beam)
        front = [h for h in front if h.excess <= ABREAST * front[0].excess]
        best = most_probable([best, *front], seed, 1)[0] if settings.beam > 1 else next(iter(front), best)
    return best


def _at_once(fits: Fits, without: Hypothesis, best: Hypothesis, missing: Sequence[Candidate]) -> list[Hypothesis]:
    """Fits of what is as much as several effects, alone, where several parts of one kind leave more than noise: they may be one."""
    parts = [effect for effect in best.effects if effect.part and not effect.runs]
    if fits.problem.plant.quick or best.only_noise(fits.settings) or len(parts) < 2:
        return []
    linear = fits.linear(without, missing)
    asked = [((c,), {**without.estimate.named, **linear.gain((c,))[1]}) for c in linear.able if is_wide(c)]
    return [h for h in fits.fit_all(asked) if h is not None]


def _settled(fits: Fits, best: Hypothesis, missing: Sequence[Candidate], seed: int) -> tuple[Hypothesis, Shares, Groups]:
    """What is left of a hypothesis after the way back, with the shares of its effects and their rivals.

    Where that is nothing, because several stood in for one, the single effect that stands out and leaves least.
    """
    if len(best.effects) > MANY:
        best, shares = settled(fits, best, missing)
        if len(best.effects) > MANY:
            others = {e: [(best, 1.0)] if e in fits.seen else rivals(fits, best, e, missing, seed) for e in best.effects}
            return best, shares, others
    more = len(best.effects) > 1
    best, shares = _backward(fits, best)
    if more and not best.effects:
        alone = [_backward(fits, fits.finished(h)) for h in list(fits.done.values()) if len(h.effects) == 1]
        best, shares = min(alone, key=lambda end: end[0].excess, default=(best, shares))
    return best, shares, {e: [(best, 1.0)] if e in fits.seen else replacements(fits, best, e, missing, seed) for e in best.effects}


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
    """The most probable of what surely explains more than `base`: with one effect more, or changed in another way where that is not all."""
    settings = fits.settings

    def better(trials: Sequence[Hypothesis]) -> list[Hypothesis]:
        first = [fits.finished(trial) for trial in most_probable([base, *trials], seed, settings.beam) if trial is not base]
        return [h for h in first if h.excess <= (1 - settings.min_share_closed) * base.excess and beats(h, base, seed, settings)]

    if len(base.effects) >= settings.max_effects:
        return []
    found = better(_round(fits, base, missing))
    if found and (fits.problem.plant.quick or any(h.only_noise(settings) for h in found)):
        return found
    return better([*found, *(_pairs if fits.problem.plant.quick else _other_moves)(fits, base, missing)])


def _other_moves(fits: Fits, base: Hypothesis, missing: Sequence[Candidate]) -> list[Hypothesis]:
    """Fits of what promises more than one effect more: two at once, another one in the place of one, one that acts in some runs only."""
    linear, scores = fits.linear(base, missing), fits.screen(base, missing)
    if not scores:
        return []
    asked: list[tuple[float, tuple[Candidate, ...]]] = []
    first = [score.candidate for score in plainest(scores) if not is_wide(score.candidate)][:PAIRED]
    alone = max((score.gain for score in scores if not is_wide(score.candidate)), default=0.0)

    def best_of(sets: Iterable[tuple[Candidate, ...]], least: float) -> None:
        ranked = sorted(((linear.gain(effects)[0], effects) for effects in sets), key=lambda pair: -pair[0])
        asked.extend(pair for pair in ranked[:MOVES] if pair[0] > least)

    rest = 1 - alone
    best_of(((*base.effects, one, other) for one, other in combinations(first, 2) if one.form_of != other.form_of), alone + WORTH * rest)
    paired = max((gain for gain, _ in asked), default=alone)
    wide = [c for c in linear.able if is_wide(c)]
    best_of(((*base.effects, c) for c in wide), paired + WORTH_WIDE * (1 - paired))
    if base.effects:  # several of one kind may be one
        best_of(((*(e for e in base.effects if not e.part), c) for c in wide), alone)
    best_of(
        (
            (*(c for c in base.effects if c != gone), come)
            for gone in base.effects
            for come in linear.able
            if come.form_of != gone.form_of and not is_wide(come)
        ),
        alone,
    )
    parts = spans([run.file for run in fits.problem.runs])
    limited = [longest(linear, [(*base.effects, replace(one, runs=runs)) for runs in parts]) for one in first if parts]
    best_of(limited, alone + WORTH * rest)
    asked.sort(key=lambda pair: -pair[0])
    trials = fits.fit_all([(effects, {**base.estimate.named, **linear.gain(effects)[1]}) for _, effects in asked[: MOVES + 1]])
    return list(dict.fromkeys(trial for trial in trials if trial is not None))


def _round(fits: Fits, base: Hypothesis, missing: Sequence[Candidate], rival: Hypothesis | None = None) -> list[Hypothesis]:
    """Fits of the candidates that promise most beside those of `base`; what competes with a rival, or with the first, may end early."""
    return fitted(fits, base, [score for score in fits.screen(base, missing) if not is_wide(score.candidate)], rival)


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


def _backward(fits: Fits, best: Hypothesis) -> tuple[Hypothesis, dict[Candidate, float]]:
    """Drop effects one by one, the least needed first, until all that are left stand out from the structure left.

    What takes away no more than the errors that the others' forms may have is no effect of its own (see `mended`). All that is left counts
    against each.
    """
    settings = fits.settings
    while True:
        shares, smaller, lost = {}, {}, {}
        doubt = {effect: FORM_ERROR_RATIO * _output(best, effect) for effect in best.effects}
        left = best.excess + settings.max_noise_excess / 10
        rests = [tuple(c for c in best.effects if c != effect) for effect in best.effects]
        without = fits.fit_all([(rest, best.estimate.named) for rest in rests])
        for effect, rest, found in zip(best.effects, rests, without, strict=True):
            shares[effect], lost[effect] = np.inf, np.inf  # where the model cannot do the runs without it, or gauges show it
            if found is not None and effect not in fits.seen:
                smaller[effect] = found
                taken = lost[effect] = found.excess - best.excess
                least = max(settings.min_excess_removed, mended(effect, sum(doubt[c] for c in rest), taken, left))
                shares[effect] = taken / left if taken >= least else 0.0
        weakest = min(shares, key=lambda effect: (shares[effect], lost[effect]), default=None)
        if weakest is None or shares[weakest] >= settings.least_share:
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
