"""Which effects explain the data: screen, fit, judge on held-out data; forward and backward until neither changes anything."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from tepm_opt.discrepancy.evidence import in_sample, weights
from tepm_opt.discrepancy.fits import Effects, Fits, Hypothesis, SearchSettings, labels, may
from tepm_opt.discrepancy.plant import Candidate
from tepm_opt.discrepancy.screen import Score, screen_pairs
from tepm_opt.discrepancy.spans import longest, spans
from tepm_opt.solvers.identify import Problem
from tepm_opt.solvers.plant import PredictionError
from tepm_opt.solvers.text import shortened

# part of the squared output of the other effects that their forms may be wrong by (5 % of the size); an effect that takes away less
# beside them may only mend their forms
FORM_ERROR_RATIO = 0.0025
MOVES = 2  # sets of effects fitted of each kind of move that is not one effect more
WORTH_WIDE = 0.5  # part of what the best pair leaves that an effect as wide as several must promise to close
WIDE = 6  # parameters above which an effect is as much as several
WORTH = 0.2  # part of what the best single effect leaves that a pair, or one in some runs, must promise to close besides
PAIRED = 10  # candidates, those that promise most alone, that are tried in pairs where none of them helps alone
ABREAST = 1.5  # times the excess of the best set of effects that another may leave to be followed, too
PLAIN = 0.9  # part of a form's gain from which a plainer form of the same is fitted in its place
NEAR, NEARLY_ALL = 5.0, 0.05  # times what an answer that leaves only noise promised to leave, and a part more: where rivals end
MIN_GAIN_RATIO = 0.25  # part of the best candidate's first-order gain below which others are not worth a fit
COINCIDE = 0.98  # cosine from which two effects' outputs are called the same
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
    best = _forward(fits, without, missing, seed)
    best = _most_probable([best, *_at_once(fits, without, best, missing)], seed, 1)[0]
    widest, seen = best, set()
    while True:
        best, shares, groups = _settled(fits, best, missing, seed)
        for _ in range(settings.max_effects):
            weakest = min(groups.values(), key=lambda group: group[0][1], default=[(best, 1.0)])
            better, weight = max(weakest, key=lambda pair: pair[1])
            if better is best or weight < 0.5:
                break
            best, shares, groups = _settled(fits, fits.finished(better), missing, seed)
        if best.effects in seen or fits.problem.plant.quick:
            break
        seen.add(best.effects)
        onward = _forward(fits, best, missing, seed)
        if onward is best:
            break
        best = widest = onward
    if best.excess > settings.max_unexplained_ratio**2 * _motion(fits.problem):
        best, shares, groups = without, {}, {}
    return Explanation(without, best, widest, list(fits.done.values()), fits.screen(without, missing), shares, groups)


def _forward(fits: Fits, base: Hypothesis, missing: Sequence[Candidate], seed: int) -> Hypothesis:
    """The most probable of what surely explains more and more from a hypothesis on, until nothing does."""
    settings, best, front = fits.settings, base, [base]
    while front and not best.only_noise(settings):
        grown = {h.effects: h for other in front for h in _grown(fits, other, missing, seed)}
        front = _most_probable(list(grown.values()), seed, settings.beam)
        front = [h for h in front if h.excess <= ABREAST * front[0].excess]
        best = _most_probable([best, *front], seed, 1)[0] if settings.beam > 1 else next(iter(front), best)
    return best


def _at_once(fits: Fits, without: Hypothesis, best: Hypothesis, missing: Sequence[Candidate]) -> list[Hypothesis]:
    """Fits of what is as much as several effects, alone, where several parts of one kind leave more than noise: they may be one."""
    parts = [effect for effect in best.effects if effect.part and not effect.runs]
    if fits.problem.plant.quick or best.only_noise(fits.settings) or len(parts) < 2:
        return []
    linear = fits.linear(without, missing)
    asked = [((c,), {**without.estimate.named, **linear.gain((c,))[1]}) for c in linear.able if _wide(c)]
    return [h for h in fits.fit_all(asked) if h is not None]


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
    """The most probable of what surely explains more than `base`: with one effect more, or changed in another way where that is not all."""
    settings = fits.settings

    def better(trials: Sequence[Hypothesis]) -> list[Hypothesis]:
        first = [fits.finished(trial) for trial in _most_probable([base, *trials], seed, settings.beam) if trial is not base]
        return [h for h in first if h.excess <= (1 - settings.min_share_closed) * base.excess and _beats(h, base, seed, settings)]

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
    first = [score.candidate for score in plainest(scores) if not _wide(score.candidate)][:PAIRED]
    alone = max((score.gain for score in scores if not _wide(score.candidate)), default=0.0)

    def best_of(sets: Iterable[tuple[Candidate, ...]], least: float) -> None:
        ranked = sorted(((linear.gain(effects)[0], effects) for effects in sets), key=lambda pair: -pair[0])
        asked.extend(pair for pair in ranked[:MOVES] if pair[0] > least)

    rest = 1 - alone
    best_of(((*base.effects, one, other) for one, other in combinations(first, 2) if one.form_of != other.form_of), alone + WORTH * rest)
    paired = max((gain for gain, _ in asked), default=alone)
    wide = [c for c in linear.able if _wide(c)]
    best_of(((*base.effects, c) for c in wide), paired + WORTH_WIDE * (1 - paired))
    if base.effects:  # several of one kind may be one
        best_of(((*(e for e in base.effects if not e.part), c) for c in wide), alone)
    best_of(
        (
            (*(c for c in base.effects if c != gone), come)
            for gone in base.effects
            for come in linear.able
            if come.form_of != gone.form_of and not _wide(come)
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
    return _fitted(fits, base, [score for score in fits.screen(base, missing) if not _wide(score.candidate)], rival)


def _wide(candidate: Candidate) -> bool:
    """Whether it is as much as several effects at once: it is asked for where a pair does not do as well."""
    return len(candidate.parameters) > WIDE


def _fitted(fits: Fits, base: Hypothesis, scores: Sequence[Score], rival: Hypothesis | None = None) -> list[Hypothesis]:
    """Fits of what has the largest scores beside `base`, see `_round`."""
    settings = fits.settings
    if not scores:
        return []
    most = settings.fits_later_rounds if base.effects else settings.fits_first_round
    least = settings.min_share_closed / 2 if base.effects and settings.beam > 1 else 0.0
    ranked = plainest([score for score in scores if score.gain >= max(MIN_GAIN_RATIO * scores[0].gain, least)])
    promising = ranked[:most]

    def begun(some: Sequence[Score]) -> list[list[tuple[Effects, dict[str, float]]]]:
        return [
            [((*base.effects, score.candidate), {**base.estimate.named, **start}) for start in score.starts[: settings.starts]]
            for score in some
        ]

    asked = begun(promising)
    trials = fits.fit_all(asked[0], bound=_bound(fits, base))[:1] if asked and not rival else []
    solved = rival or next(iter(trials), None)
    first = next((score for score in scores if solved is not None and score.candidate in solved.effects), None)
    if first is not None and solved is not None and solved.only_noise(settings) and not fits.problem.plant.quick:
        reach = (
            1 - NEAR * max(1 - first.gain, 0.01) - NEARLY_ALL
        )  # what the answer itself promised, with room for what first order does not see
        asked = [each for each, score in zip(asked, promising, strict=True) if score.gain >= reach]
    trials += fits.fit_all([each for one in asked[len(trials) :] for each in one], solved, _bound(fits, base))
    least_left = min((t for t in trials if t is not None), key=lambda t: t.excess, default=None)
    if not (base.effects or rival or fits.problem.plant.quick or least_left is None or least_left.only_noise(settings)):
        trials += fits.fit_all([each for one in begun(ranked[most : 2 * most]) for each in one], least_left, _bound(fits, base))
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


def _alternatives(
    fits: Fits, best: Hypothesis, effect: Candidate, missing: Sequence[Candidate], seed: int
) -> list[tuple[Hypothesis, float]]:
    """`best` and what it would be with another effect in the place of `effect`, with probabilities."""
    rest = fits.fit(tuple(c for c in best.effects if c != effect), best.estimate.named)
    others: list[Hypothesis] = []
    if rest is not None:
        scores = _from_there(fits, best, rest, _scores(fits, rest, effect, missing), missing)
        others += [h for h in _fitted(fits, rest, scores, best) if effect not in h.effects]
        others += [h for h in _begun(fits, rest, effect, missing) if h not in others]
    others = [h for h in others if _beats(h, best, seed, fits.settings) or all(c.form_of != effect.form_of for c in h.effects)]
    group = [best, *(h for h in others if h is not best)]
    weight = weights([h.evidence for h in group], seed)
    if rest is not None and not fits.problem.plant.quick:
        weight = _agreed(group, weight, rest, fits.settings, seed)
    return list(zip(group, weight.tolist(), strict=True))


def _from_there(fits: Fits, best: Hypothesis, rest: Hypothesis, scores: list[Score], missing: Sequence[Candidate]) -> list[Score]:
    """Scores of what may take an effect's place, with values to fit from that begin at the best fit where they promise to leave less there.

    Args:
        fits: all so far.
        best: with the effect.
        rest: without it.
        scores: of what may take its place.
        missing: the candidates.
    """
    if fits.problem.plant.quick or best.only_noise(fits.settings):
        return scores
    here, there = fits.linear(rest, missing), fits.linear(best, missing)
    found = []
    for score in scores:
        if score.candidate in there.able:
            gain, start = there.gain((*rest.effects, score.candidate))
            if (1 - gain) * there.excess < (1 - score.gain) * here.excess:
                score = replace(score, start=start)
        found.append(score)
    return found


def _begun(fits: Fits, rest: Hypothesis, effect: Candidate, missing: Sequence[Candidate]) -> list[Hypothesis]:
    """Fits of what may have happened in the pause before the runs from which on an effect acts for good."""
    runs = fits.problem.runs
    first = next((k for k, run in enumerate(runs) if run.file in effect.runs), 0)
    if not first or effect.runs != tuple(run.file for run in runs[first:]):
        return []
    ended = runs[first - 1].began + runs[first - 1].time[-1]
    happened = float(ended + runs[first].began) / 2
    able = [c for c in missing if c.happens and c.detail == effect.detail and may(c, rest.effects)]
    asked = [((*rest.effects, c), {**rest.estimate.named, **c.probes[0], c.happens: happened}) for c in able]
    return [h for h in fits.fit_all(asked) if h is not None]


def _agreed(group: Sequence[Hypothesis], weight: np.ndarray, rest: Hypothesis, settings: SearchSettings, seed: int) -> np.ndarray:
    """Probabilities of hypotheses that say nearly the same as the first of them: those of held-out data and of the data fitted to, both.

    What they would say of the runs is the same, so leaving out runs compares what the other parameters do there. Where one of them leaves
    only noise, likelihoods are what they say they are, and what is seen counts alone.

    Args:
        group: the hypotheses.
        weight: their probabilities from held-out data, (hypotheses,).
        rest: without the effect in whose place they have others.
        settings: of the search.
        seed: of random draws.
    """
    same = [k for k, h in enumerate(group) if k == 0 or coincidence(rest, group[0], h) > COINCIDE]
    if len(same) < 2:
        return weight
    both = [group[k] for k in same]
    seen = weights([in_sample(h.estimate, h.evidence) for h in both], seed)
    alone = min(h.estimate.cost / max(h.estimate.count, 1) for h in both) - 1 <= settings.max_noise_excess
    total = weight[same].sum()
    found = weight.copy()
    found[same] = total * (seen if alone else (seen + weight[same] / max(total, 1e-30)) / 2)
    return found


def coincidence(rest: Hypothesis, one: Hypothesis, other: Hypothesis) -> float:
    """Cosine between what two hypotheses change in the modelled positions beside what they have in common."""
    base, a, b = (np.concatenate([r.values.ravel() for r in h.estimate.residuals]) for h in (rest, one, other))
    a, b = base - a, base - b
    return float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-30))


def _scores(fits: Fits, rest: Hypothesis, effect: Candidate, missing: Sequence[Candidate]) -> list[Score]:
    """Scores of what may act in the place of an effect: where that acts in some runs only, in the same ones or in all."""
    if not effect.runs:
        return [score for score in fits.screen(rest, missing) if not _wide(score.candidate) or score.candidate == effect]
    linear = fits.linear(rest, missing)
    able = [c for c in linear.able if not _wide(c)]
    others = [*able, *(replace(c, runs=effect.runs) for c in able)]
    return sorted((Score(c, *linear.gain((*rest.effects, c))) for c in others), key=lambda score: -score.gain)
