"""Search of the effects that explain the data: forward selection and backward elimination until neither changes anything."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.alternatives import replacements
from tepm_opt.discrepancy.selection.elimination import Shares, eliminate_backward
from tepm_opt.discrepancy.selection.fitting import Effects, Fits, Hypothesis, labels
from tepm_opt.discrepancy.selection.matching_pursuit import (
    extend_by_matching_pursuit,
    fit_by_matching_pursuit,
    prune_insignificant,
    weigh_best_rival,
)
from tepm_opt.discrepancy.selection.ranking import (
    beats,
    drop_richer_forms,
    fit_promising,
    fit_values_at_limits,
    largest_excess_of_parts,
    most_probable,
)
from tepm_opt.discrepancy.selection.run_subsets import list_helped_runs, list_run_spans, select_longest_span
from tepm_opt.discrepancy.selection.screening import Score, screen_pairs
from tepm_opt.solvers.identification.identify import Problem
from tepm_opt.solvers.mechanics.plant import PredictionError
from tepm_opt.solvers.numerics.text import shorten

Groups = dict[Candidate, list[tuple[Hypothesis, float]]]


@dataclass(frozen=True, eq=False)
class Explanation:
    """Result of the search.

    Attributes:
        without: the known parameters recalibrated, no effect added.
        best: effects that stand out, all fitted together with the parameters; none where nothing does.
        widest: the largest set that was followed.
        tried: every hypothesis fitted, in order.
        scores: first-order gains of all candidates against `without`, beside what gauges show.
        shares: for each effect of `best`: how many times the structure left only this effect removes.
        groups: for each effect of `best`: hypotheses that have another one in its place, `best` first, and their probabilities.
        gauge_fit: fit of the effects that gauges have shown, with which the search began; None where there are none.
        settings: of the search.
    """

    without: Hypothesis
    best: Hypothesis
    widest: Hypothesis
    tried: list[Hypothesis]
    scores: list[Score]
    shares: Shares
    groups: Groups
    gauge_fit: Hypothesis | None = None
    settings: SearchSettings = field(default_factory=SearchSettings)

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Explanation({shorten(labels(self.best), 60)}, closes {self.closes(self.best):.0%}, {len(self.tried)} fits)"

    @property
    def gauge_effects(self) -> Effects:
        """Effects that gauges have shown."""
        return self.gauge_fit.effects if self.gauge_fit else ()

    @property
    def initial_excess(self) -> float:
        """Excess before anything was looked for: beside what gauges have shown."""
        return (self.gauge_fit or self.without).excess

    def closes(self, hypothesis: Hypothesis) -> float:
        """Share of the structure left by recalibration that a hypothesis removes."""
        return 1 - hypothesis.excess / max(self.without.excess, 1e-12)

    def best_without(self, effect: Candidate) -> Hypothesis | None:
        """The fit of the best hypothesis' other effects; None where it was not made."""
        others = tuple(c for c in self.best.effects if c != effect)
        return next((hypothesis for hypothesis in self.tried if hypothesis.effects == others), None)


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
    base = (fits.fit(fits.gauge_effects, {**without.estimate.named, **fits.values}) if fits.gauge_effects else None) or without
    alone = min(fit_values_at_limits(fits, base, missing), key=lambda h: h.excess, default=base)
    together = alone if alone is not base and alone.only_noise(settings) else fit_by_matching_pursuit(fits, base, missing)
    best = together or _select_forward(fits, base, missing, seed)
    if together is None:
        best = most_probable([best, *_fit_wide_alone(fits, without, best, missing)], seed, 1)[0]
    best = most_probable([best, *_fit_in_span_alone(fits, base, best, missing)], seed, 1)[0]
    widest, visited, refuted, dropped = best, set[Effects](), set[Effects](), set[Candidate]()
    while True:
        dropped |= {*best.effects}
        best, shares, groups = _eliminate(fits, best, missing, seed, refuted)
        dropped -= {*best.effects}
        best, shares, groups = _exchange(fits, (best, shares, groups), missing, seed, refuted)
        if best.effects in visited or not settings.repeat_forward:
            break
        visited.add(best.effects)
        if len(best.effects) > settings.many_effects:
            onward = extend_by_matching_pursuit(fits, best, [c for c in missing if c not in dropped])
        else:
            onward = _select_forward(fits, best, missing, seed)
        if onward is best:
            break
        best = widest = onward
    if best.excess > settings.max_unexplained_ratio**2 * _motion(fits.problem):
        best, shares, groups = without, {}, {}
    unchanged = settings.chance_excess > 0 and best is without and best.only_noise(settings)
    tried, scores = list(fits.done.values()), [] if unchanged else fits.screen(base, missing)
    return Explanation(without, best, widest, tried, scores, shares, groups, base if fits.gauge_effects else None, settings)


def _exchange(
    fits: Fits, left: tuple[Hypothesis, Shares, Groups], missing: Sequence[Candidate], seed: int, refuted: set[Effects]
) -> tuple[Hypothesis, Shares, Groups]:
    """Exchange effects for more probable rivals that hold by themselves, the weakest first, as often as there are any.

    Args:
        fits: all fits so far.
        left: what elimination left: the hypothesis with the effects' shares and rivals.
        missing: candidates.
        seed: of random draws.
        refuted: hypotheses that gave way to others; those exchanged are added.
    """
    best, shares, groups = left
    for _ in range(fits.settings.max_effects):
        if not groups:
            break
        weakest = min(groups, key=lambda effect, groups=groups: groups[effect][0][1])
        better, weight = max(groups[weakest], key=lambda pair: pair[1])
        if better is best or weight < 0.5:
            break
        then = _eliminate(fits, fits.complete(better), missing, seed, {*refuted, best.effects})
        if _takes_back(fits, then[0], better, best, weakest, seed):
            groups = {e: _leave_out(better, group) for e, group in groups.items()}
        else:
            refuted.add(best.effects)
            best, shares, groups = then
    return best, shares, groups


def _takes_back(fits: Fits, then: Hypothesis, better: Hypothesis, best: Hypothesis, effect: Candidate, seed: int) -> bool:
    """Whether what elimination leaves of a rival has no fewer effects than the hypothesis that it displaced, and surely predicts worse.

    Args:
        fits: all fits so far.
        then: what is left of the rival.
        better: the rival.
        best: the hypothesis displaced.
        effect: in whose place the rival has others; parts in that of a wide one may leave more.
        seed: of random draws.
    """
    if then.effects == better.effects or len(then.effects) < len(best.effects):
        return False
    rest = fits.find(tuple(c for c in best.effects if c != effect))
    enough = largest_excess_of_parts(best, rest, effect, fits.settings)
    return then.left > enough and beats(best, then, seed, fits.settings)


def _leave_out(rival: Hypothesis, group: list[tuple[Hypothesis, float]]) -> list[tuple[Hypothesis, float]]:
    """A group of hypotheses and probabilities without one of them."""
    left = [(h, weight) for h, weight in group if h is not rival]
    total = sum(weight for _, weight in left)
    return [(h, weight / total if total > 0 else float(k == 0)) for k, (h, weight) in enumerate(left)]


def _select_forward(fits: Fits, base: Hypothesis, missing: Sequence[Candidate], seed: int) -> Hypothesis:
    """Extend a hypothesis as long as an extension surely explains more; returns the most probable one."""
    settings, best, front = fits.settings, base, [base]
    while front and not best.only_noise(settings):
        grown = {h.effects: h for other in front for h in _extend(fits, other, missing, seed)}
        front = most_probable(list(grown.values()), seed, settings.beam)
        front = [h for h in front if h.excess <= settings.beam_excess_ratio * front[0].excess]
        best = most_probable([best, *front], seed, 1)[0] if settings.beam > 1 else next(iter(front), best)
    return best


def _fit_wide_alone(fits: Fits, without: Hypothesis, best: Hypothesis, missing: Sequence[Candidate]) -> list[Hypothesis]:
    """Fit every wide effect alone where several effects of single parts leave more than noise: they may be one wide effect."""
    parts = [effect for effect in best.effects if effect.part and not effect.runs]
    if not fits.settings.linear_moves or best.only_noise(fits.settings) or len(parts) < 2:
        return []
    linear = fits.linear(without, missing)
    asked = [((c,), {**without.estimate.named, **linear.gain((c,))[1]}) for c in linear.able if fits.settings.is_wide(c)]
    return [h for h in fits.fit_all(asked) if h is not None]


def _fit_in_span_alone(fits: Fits, base: Hypothesis, best: Hypothesis, missing: Sequence[Candidate]) -> list[Hypothesis]:
    """Fit alone, in some runs, the effects that promise most there, where more than noise is left: other effects may make up for one.

    One that explains most in all runs acts in all.
    """
    settings, spans = fits.settings, list_run_spans([run.file for run in fits.problem.runs])
    most = min(settings.fits_first_round, settings.fits_later_rounds) if len(base.effects) < settings.max_effects else 0
    if not (settings.linear_moves and spans and most) or best.only_noise(settings):
        return []
    linear = fits.linear(base, missing)
    able = [c for c in linear.able if c.smooth and not settings.is_wide(c)]
    sets = [select_longest_span(linear, [(*base.effects, replace(c, runs=runs)) for runs in spans], settings) for c in able]
    ranked = sorted(((*linear.gain(effects), effects) for effects in sets), key=lambda each: -each[0])
    asked = [(effects, {**base.estimate.named, **start}) for _, start, effects in ranked[:most]]
    always = fits.fit_all([((*base.effects, replace(effects[-1], runs=())), start) for effects, start in asked])
    asked = [each for each, h in zip(asked, always, strict=True) if h is None or h.excess > settings.min_pair_share * base.excess]
    return [h for h in fits.fit_all(asked) if h is not None]


def _eliminate(
    fits: Fits, best: Hypothesis, missing: Sequence[Candidate], seed: int, refuted: Collection[Effects]
) -> tuple[Hypothesis, Shares, Groups]:
    """Eliminate effects of a hypothesis and weigh the rivals of the rest; returns it with the effects' shares and rivals.

    Where no effect is left, because several stood in for one, take the single effect that stands out and leaves least.

    Args:
        fits: all fits so far.
        best: the hypothesis.
        missing: candidates.
        seed: of random draws.
        refuted: hypotheses that gave way to others.
    """
    shares, weigh = Shares(), weigh_best_rival
    if len(best.effects) > fits.settings.many_effects:
        best, shares = prune_insignificant(fits, best, missing)
    if len(best.effects) <= fits.settings.many_effects:
        weigh = replacements
        more = len(best.effects) > 1
        best, shares = eliminate_backward(fits, best, refuted)
        if more and not best.effects:
            alone = [eliminate_backward(fits, fits.complete(h)) for h in list(fits.done.values()) if len(h.effects) == 1]
            best, shares = min(alone, key=lambda end: end[0].excess, default=(best, shares))
    return best, shares, {e: [(best, 1.0)] if e in fits.gauge_effects else weigh(fits, best, e, missing, seed) for e in best.effects}


def _motion(problem: Problem) -> float:
    """Mean square of the measured motion about each run's mean position, or the equilibria's about that of all, over the noise's."""
    parts = [(run.points / sigma).reshape(run.rows, -1) for run, sigma in zip(problem.runs, problem.noises, strict=True)]
    total, count = 0.0, 0
    for part in [np.concatenate(parts)] if problem.plant.static else parts:
        for column in part.T:
            seen = column[np.isfinite(column)]
            total, count = total + float(np.var(seen) if seen.size else 0.0) * seen.size, count + seen.size
    return total / max(count, 1)


def _extend(fits: Fits, base: Hypothesis, missing: Sequence[Candidate], seed: int) -> list[Hypothesis]:
    """The most probable hypotheses that surely explain more than `base`: with one effect more, or by other moves where that is not all."""
    settings = fits.settings

    def better(trials: Sequence[Hypothesis]) -> list[Hypothesis]:
        first = [fits.complete(trial) for trial in most_probable([base, *trials], seed, settings.beam) if trial is not base]
        return [h for h in first if h.excess <= (1 - settings.min_share_closed) * base.excess and beats(h, base, seed, settings)]

    if len(base.effects) >= settings.max_effects:
        return []
    narrow = [score for score in fits.screen(base, missing) if not settings.is_wide(score.candidate)]
    singles = fit_promising(fits, base, narrow)
    found = better(singles)
    if any(h.only_noise(settings) for h in found):
        return found
    if settings.linear_moves:
        return better([*found, *_fit_other_moves(fits, base, missing)])
    limited = _fit_in_some_runs(fits, base, singles, missing)
    return better([*found, *limited]) if found or limited else better(_fit_pairs(fits, base, missing))


def _fit_other_moves(fits: Fits, base: Hypothesis, missing: Sequence[Candidate]) -> list[Hypothesis]:
    """Fit what promises more than one effect more: two at once, an exchange, a wide effect, an effect of some runs."""
    settings, linear, scores = fits.settings, fits.linear(base, missing), fits.screen(base, missing)
    if not scores:
        return []
    asked: list[tuple[float, tuple[Candidate, ...]]] = []
    first = [s.candidate for s in drop_richer_forms(scores, settings) if not settings.is_wide(s.candidate)][: settings.pair_candidates]
    alone = max((score.gain for score in scores if not settings.is_wide(score.candidate)), default=0.0)
    worth = alone + settings.min_pair_share * (1 - alone)

    def propose(sets: Iterable[tuple[Candidate, ...]], least: float) -> None:
        ranked = sorted(((linear.gain(effects)[0], effects) for effects in sets), key=lambda pair: -pair[0])
        asked.extend(pair for pair in ranked[: settings.fits_per_move] if pair[0] > least)

    propose(((*base.effects, one, other) for one, other in combinations(first, 2) if one.form_of != other.form_of), worth)
    paired = max((gain for gain, _ in asked), default=alone)
    wide = [c for c in linear.able if settings.is_wide(c)]
    propose(((*base.effects, c) for c in wide), paired + settings.min_wide_share * (1 - paired))
    if base.effects:  # several of one kind may be one
        propose(((*(e for e in base.effects if not e.part), c) for c in wide), alone)
    propose(
        (
            (*(c for c in base.effects if c != gone), come)
            for gone in base.effects
            for come in linear.able
            if come.form_of != gone.form_of and not settings.is_wide(come)
        ),
        alone,
    )
    spans = list_run_spans([run.file for run in fits.problem.runs])
    limited = [
        select_longest_span(linear, [(*base.effects, replace(one, runs=runs)) for runs in spans], settings) for one in first if spans
    ]
    propose(limited, worth)
    asked.sort(key=lambda pair: -pair[0])
    first_of_all = asked[: settings.fits_per_move + 1]
    trials = fits.fit_all([(effects, {**base.estimate.named, **linear.gain(effects)[1]}) for _, effects in first_of_all])
    return list(dict.fromkeys(trial for trial in trials if trial is not None))


def _fit_in_some_runs(fits: Fits, base: Hypothesis, singles: Sequence[Hypothesis], missing: Sequence[Candidate]) -> list[Hypothesis]:
    """Fit effects that may have begun or ended between runs: smooth ones by first order, others in the runs that they help.

    Args:
        fits: all fits so far.
        base: the hypothesis without the effects.
        singles: hypotheses with one effect more, in all runs.
        missing: candidates.
    """
    settings, linear, asked = fits.settings, fits.linear(base, missing), []
    spans = list_run_spans([run.file for run in fits.problem.runs])
    alone = max((1 - h.excess / max(base.excess, 1e-12) for h in singles), default=0.0)
    limited = [
        select_longest_span(linear, [(*base.effects, replace(one, runs=runs)) for runs in spans], settings)
        for one in linear.able
        if spans and one.smooth
    ]
    ranked = sorted(((*linear.gain(effects), effects) for effects in limited), key=lambda each: -each[0])
    for gain, start, effects in ranked[: settings.fits_per_move]:
        if gain > alone + settings.min_pair_share * (1 - alone):
            asked.append((effects, {**base.estimate.named, **start}))
    for single in sorted(singles, key=lambda h: h.excess)[: settings.fits_per_move]:
        (effect,) = (c for c in single.effects if c not in base.effects)
        if not effect.smooth and (runs := list_helped_runs(base.estimate, single.estimate)):
            asked.append(((*base.effects, replace(effect, runs=runs)), single.estimate.named))
    return [trial for trial in fits.fit_all(asked) if trial is not None]


def _fit_pairs(fits: Fits, base: Hypothesis, missing: Sequence[Candidate]) -> list[Hypothesis]:
    """Fit the pairs that promise most together where there is no effect yet: each may hide the other."""
    settings, scores = fits.settings, fits.screen(base, missing)
    if len(scores) < 2 or base.effects or settings.max_effects < 2:
        return []
    screened = screen_pairs(base.estimate, drop_richer_forms(scores, settings), settings.pair_candidates)
    pairs = [(pair, start) for pair, _, start in screened if pair[0].form_of != pair[1].form_of]
    asked = [(pair, {**base.estimate.named, **start}) for pair, start in pairs[: settings.fits_first_round]]
    return [trial for trial in fits.fit_all(asked) if trial is not None]
