"""Alternatives: other effects in the place of one that was found, fitted and weighed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from tepm_opt.discrepancy.adapters.network import PARAMETER
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.cross_validation import in_sample, weights
from tepm_opt.discrepancy.selection.fitting import Effects, Fits, Hypothesis, may_act_beside
from tepm_opt.discrepancy.selection.ranking import beats, fit_promising, fit_values_at_limits, largest_excess_of_parts, rank_promising
from tepm_opt.discrepancy.selection.scatter import fit_common_causes, is_centred
from tepm_opt.discrepancy.selection.screening import Score, screen_by_fits
from tepm_opt.discrepancy.selection.significance import is_significant


def replacements(
    fits: Fits, best: Hypothesis, effect: Candidate, missing: Sequence[Candidate], seed: int
) -> list[tuple[Hypothesis, float]]:
    """Probabilities of a hypothesis and of those with another effect, or a pair, in the place of one of its own.

    Args:
        fits: all fits so far.
        best: the hypothesis.
        effect: one of its effects.
        missing: the candidates.
        seed: of random draws.
    """
    settings = fits.settings
    rest = fits.fit(tuple(c for c in best.effects if c != effect), best.estimate.named)
    others: list[Hypothesis] = []
    if rest is not None:
        scores = _start_from_best(fits, best, rest, _scores(fits, rest, effect, missing), missing)
        others += [h for h in fit_promising(fits, rest, scores, best) if effect not in h.effects]
        more = (*_fit_changes_in_pause(fits, rest, effect, missing), *_fit_pair(fits, best, rest, effect, scores, missing))
        more = (*more, *fit_common_causes(fits, best, rest, effect, missing), *fit_values_at_limits(fits, rest, missing, best))
        others += [h for h in more if h not in others]
        others = _refit_close(fits, best, others)
    others = [h for h in others if all(is_significant(h.estimate, c, settings) for c in h.effects if c not in best.effects)]
    other_forms = [h for h in others if effect in h.effects or all(c.form_of != effect.form_of for c in h.effects)]
    others = [h for h in others if h in other_forms or beats(h, best, seed, settings)]
    group = [best, *(h for h in others if h is not best)]
    weight = weights([h.evidence for h in group], seed)
    if rest is not None and not settings.refit_folds:
        weight = _average_coincident(group, weight, rest, settings, seed)
    weight = _favour_plain(group, weight, settings)
    weight = _favour_centred(group, weight, settings)
    weight = _exclude_outdone_pairs(fits, group, weight, seed)
    most = largest_excess_of_parts(best, rest, effect, settings)
    enough = [
        k
        for k, h in enumerate(group)
        if h is not best and (_outdoes_scatter(fits, h, best, effect) if _is_mixed_pair(h, best) else h.left <= most)
    ]
    if enough:
        weight = np.eye(len(group))[min(enough, key=lambda k: group[k].left)]
    return list(zip(group, weight.tolist(), strict=True))


def _is_mixed_pair(hypothesis: Hypothesis, best: Hypothesis) -> bool:
    """Whether a part and something else, which can do much of what scatter does, are in the place of an effect of the best hypothesis."""
    new = [c for c in hypothesis.effects if c not in best.effects]
    return len(new) == 2 and bool(new[0].part) != bool(new[1].part)


def _outdoes_scatter(fits: Fits, pair: Hypothesis, best: Hypothesis, effect: Candidate) -> bool:
    """Whether a part and something else leave less than a wide effect in their place, and hardly more than it beside that something else.

    Args:
        fits: all fits so far.
        pair: hypothesis with the two.
        best: hypothesis with the effect.
        effect: the effect.
    """
    (other,) = (c for c in pair.effects if c not in best.effects and not c.part)
    if not fits.settings.is_wide(effect) or pair.left >= best.left or not may_act_beside(other, best.effects):
        return False
    start, rest = pair.estimate.named | best.estimate.named, (c for c in best.effects if c != effect)
    beside, without = fits.fit_all([((*best.effects, other), start), ((*rest, other), start)])
    return beside is not None and pair.left <= largest_excess_of_parts(beside, without, effect, fits.settings)


def _favour_plain(group: Sequence[Hypothesis], weight: np.ndarray, settings: SearchSettings) -> np.ndarray:
    """Probabilities with priors for plain hypotheses: one cause rather than two, in all runs rather than in some.

    Args:
        group: the hypotheses, first the one in which others take an effect's place.
        weight: their probabilities from predictions alone, (hypotheses,).
        settings: of the search.
    """
    partly = np.array([sum(bool(c.runs) for c in h.effects) for h in group])
    causes = np.array([len(h.effects) for h in group])
    weight = weight / settings.all_runs_odds ** (partly - partly.min()) / settings.one_cause_odds ** (causes - causes.min())
    return weight / weight.sum()


def _favour_centred(group: Sequence[Hypothesis], weight: np.ndarray, settings: SearchSettings) -> np.ndarray:
    """Probabilities of hypotheses where scatter about another mean than zero gives way to all that fits nearly as well.

    Args:
        group: the hypotheses.
        weight: their probabilities, (hypotheses,).
        settings: of the search.
    """
    odds = [1.0 if is_centred(h, settings) else settings.min_centred_chance for h in group]
    return weight * odds / max(float(weight @ odds), 1e-300)


def _exclude_outdone_pairs(fits: Fits, group: Sequence[Hypothesis], weight: np.ndarray, seed: int) -> np.ndarray:
    """Probabilities without pairs in the place of an effect one of which, beside that effect, predicts better than both of them.

    What such a pair does better than the effect alone is the work of the one that can stand beside it.

    Args:
        fits: all fits so far.
        group: the hypotheses, first the one in which others take an effect's place.
        weight: their probabilities, (hypotheses,).
        seed: of random draws.
    """
    best, found = group[0], weight.copy()
    gone = {e for h in group for e in best.effects if e not in h.effects}
    if any(fits.settings.is_wide(effect) for effect in gone):
        return weight
    for k, pair in enumerate(group):
        new = [c for c in pair.effects if c not in best.effects]
        if len(new) == 2 and weight[k] > fits.settings.min_pair_weight:
            asked = [((*best.effects, c), pair.estimate.named | best.estimate.named) for c in new if may_act_beside(c, best.effects)]
            beside = [h for h in fits.fit_all(asked) if h is not None]
            found[k] = 0.0 if any(weights([h.evidence, pair.evidence], seed)[0] > 0.5 for h in beside) else weight[k]
    return found / found.sum() if found.sum() > 0 else np.eye(len(group))[0]


def _start_from_best(fits: Fits, best: Hypothesis, rest: Hypothesis, scores: list[Score], missing: Sequence[Candidate]) -> list[Score]:
    """Scores of rivals, with first values linearised at the best fit where that promises to leave less, of those that will be fitted.

    Earlier fits of rivals that left far more than that are repeated from there.

    Args:
        fits: all fits so far.
        best: hypothesis with the effect.
        rest: hypothesis without it.
        scores: of the rivals.
        missing: the candidates.
    """
    settings = fits.settings
    if not settings.linear_moves or (len(best.effects) == 1 and best.only_noise(settings)):
        return scores  # beside nothing else first order leads astray hardly anywhere
    ranked, most = rank_promising(rest, scores, settings)
    tried = [score.candidate for score in scores if fits.find((*rest.effects, score.candidate)) is not None]
    here, there = fits.linear(rest, missing), fits.linearise_in(best, [*(score.candidate for score in ranked[:most]), *tried])
    found, astray = [], []
    for score in scores:
        if score.candidate in there.able:
            effects = (*rest.effects, score.candidate)
            gain, start = there.gain(effects)
            if (left := (1 - gain) * there.excess) < (1 - score.gain) * here.excess:
                score = replace(score, start=start)
                before = fits.find(effects)
                if before is not None and before.excess > settings.astray_ratio * max(left / there.count.sum(), best.excess):
                    astray.append((left, effects, start))
        found.append(score)
    for _, effects, start in sorted(astray, key=lambda each: each[0])[: settings.max_repeated_fits]:
        fits.refit(effects, start)
    return found


def _refit_close(fits: Fits, best: Hypothesis, others: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Rivals, the closest fitted again from the best hypothesis' values of all that they share, where more than noise is left.

    Which of two near alike effects leaves less depends on how well those beside them are fitted.
    """
    settings = fits.settings
    if not settings.linear_moves or best.only_noise(settings):
        return list(others)
    close = sorted((h for h in others if h.left <= settings.close_rival_ratio * best.left), key=lambda h: h.left)
    stage = f"beside {' '.join(c.full_label for c in best.effects)}:"
    again = {h: fits.refit(h.effects, h.estimate.named | best.estimate.named, stage) for h in close[: settings.max_repeated_fits]}
    return [again.get(h) or h for h in others]


def _fit_pair(
    fits: Fits, best: Hypothesis, rest: Hypothesis, effect: Candidate, scores: Sequence[Score], missing: Sequence[Candidate]
) -> list[Hypothesis]:
    """Fit the pair of effects that promises most in the place of one that may be their common work; in that of a wide one also a triple.

    In the place of a wide effect it is a pair of single parts, and one of a part and something else, also where only noise is left; the
    triple is of any effects, one added to another. Values of the robot file are left out: with one of them nearly every effect does what
    another one does.

    Args:
        fits: all fits so far.
        best: hypothesis with the effect.
        rest: hypothesis without it.
        effect: the effect in whose place they are.
        scores: of single rivals.
        missing: the candidates.
    """
    settings = fits.settings
    wide, rich = settings.is_wide(effect), effect.stage == "body" and len(effect.parameters) >= settings.min_rich_parameters
    if not settings.linear_moves or effect.runs or not (wide or (rich and not best.only_noise(settings))):
        return []
    linear = fits.linear(best, missing)
    able = [c for c in linear.able if c != effect and not settings.is_wide(c) and may_act_beside(c, rest.effects) and c.name != PARAMETER]
    parts, others = [c for c in able if c.part], [c for c in able if not c.part]
    first = [score.candidate for score in scores if score.candidate in able][: settings.rich_pair_candidates]
    sorts = (combinations(parts, 2), product(parts, others)) if wide else (product(first, able),)
    most = settings.max_wide_pair_share * rest.excess * float(linear.count.sum()) if wide else settings.max_pair_excess * linear.excess
    sets = []
    for pairs in sorts:
        promised = [(*linear.gain((*rest.effects, *pair)), pair) for pair in pairs if pair[0].form_of != pair[1].form_of]
        gain, start, pair = max(promised, key=lambda each: each[0], default=(-np.inf, {}, ()))
        if -gain * linear.excess <= most:
            sets.append(((*rest.effects, *pair), {**best.estimate.named, **start}))
    if wide and not best.only_noise(settings):
        sets += _propose_triples(fits, best, rest, able, missing)
    return list(dict.fromkeys(h for h in fits.fit_all(sets, best) if h is not None))


def _propose_triples(
    fits: Fits, best: Hypothesis, rest: Hypothesis, able: Sequence[Candidate], missing: Sequence[Candidate]
) -> list[tuple[Effects, dict[str, float]]]:
    """Three effects in the place of a wide one, with values to fit from: by first order at the fit with it and at the one without it.

    Args:
        fits: all fits so far.
        best: hypothesis with the wide effect.
        rest: hypothesis without it.
        able: effects to choose from.
        missing: the candidates.
    """
    found = []
    for base in (best, rest):
        linear = fits.linear(base, missing)
        effects = rest.effects
        for _ in range(3):
            beside = [c for c in able if may_act_beside(c, effects)]
            effects = max(((*effects, c) for c in beside), key=lambda several: linear.gain(several)[0], default=effects)
        gain, start = linear.gain(effects)
        if (1 - gain) * linear.excess <= fits.settings.max_wide_pair_share * rest.excess * float(linear.count.sum()):
            found.append((effects, {**base.estimate.named, **start}))
    return found


def _fit_changes_in_pause(fits: Fits, rest: Hypothesis, effect: Candidate, missing: Sequence[Candidate]) -> list[Hypothesis]:
    """Fit lasting changes that may have happened in the pause before the runs from which on an effect acts."""
    runs = fits.problem.runs
    first = next((k for k, run in enumerate(runs) if run.file in effect.runs), 0)
    if not first or effect.runs != tuple(run.file for run in runs[first:]):
        return []
    ended = runs[first - 1].began + runs[first - 1].time[-1]
    happened = float(ended + runs[first].began) / 2
    able = [c for c in missing if c.happens and c.detail == effect.detail and may_act_beside(c, rest.effects)]
    found = [fits.refit((*rest.effects, c), {**rest.estimate.named, **c.probes[0], c.happens: happened}) for c in able]
    return [h for h in found if h is not None]


def _average_coincident(
    group: Sequence[Hypothesis], weight: np.ndarray, rest: Hypothesis, settings: SearchSettings, seed: int
) -> np.ndarray:
    """Probabilities in which hypotheses whose outputs coincide with the first one's are also compared on the data fitted to.

    Their outputs are the same, so leaving out runs compares only what the other parameters do there. Both probabilities are averaged.
    Where one of them leaves only noise, likelihoods can be trusted, and those of the data fitted to are taken alone.

    Args:
        group: the hypotheses.
        weight: their probabilities from held-out data, (hypotheses,).
        rest: hypothesis without the effect in whose place they have others.
        settings: of the search.
        seed: of random draws.
    """
    same = [k for k, h in enumerate(group) if k == 0 or coincidence(rest, group[0], h) > settings.min_coincidence]
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
    """Scores of rivals of an effect; of one that acts in some runs only, rivals in the same runs, in all others, or in all.

    What acts in the first runs only is, beside other values of all parameters, what does the reverse from then on.
    """
    is_wide = fits.settings.is_wide
    if not effect.runs:
        return [score for score in fits.screen(rest, missing) if not is_wide(score.candidate) or score.candidate == effect]
    linear = fits.linear(rest, missing)
    able = [c for c in linear.able if not is_wide(c)]
    elsewhere = tuple(run.file for run in fits.problem.runs if run.file not in effect.runs)
    others = [*able, *(replace(c, runs=runs) for runs in (effect.runs, elsewhere) if runs for c in able)]
    scores = [Score(c, *linear.gain((*rest.effects, c))) for c in others]
    if fits.settings.screen_by_fits:
        nonsmooth = [replace(c, runs=effect.runs) for c in missing if not c.smooth and may_act_beside(c, rest.effects)]
        scores += screen_by_fits(rest.estimate, nonsmooth, fits.settings)
    return sorted(scores, key=lambda score: -score.gain)
