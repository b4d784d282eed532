"""What else would do: another effect in the place of one that was found, fitted and weighed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from tepm_opt.discrepancy.adapters.network import PARAMETER
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.selection.cross_validation import in_sample, weights
from tepm_opt.discrepancy.selection.fitting import Fits, Hypothesis, SearchSettings, may
from tepm_opt.discrepancy.selection.ranking import beats, fitted, is_wide
from tepm_opt.discrepancy.selection.screening import Score

ONE_CAUSE = 20.0  # times as probable that one cause acts as that two do in its place, where data say the same
SOME_RUNS = 3.0  # times as probable that a cause acts always as that it acts in some of the runs, where data say the same
COINCIDE = 0.98  # cosine from which two effects' outputs are called the same
ASTRAY, ANEW = 3.0, 2  # times what is promised that an earlier fit leaves to be made anew, and how many are
TOGETHER = 3  # parameters from which an effect of the body may do what two others do together
FIRST = 3  # effects, those that promise most alone, that are tried in pairs
MOST_OF = 0.1  # part of what is left without an effect as wide as several that two of single parts may promise to leave
NEARLY = 0.5  # times what an effect leaves that two in its place may promise to leave besides


def replacements(
    fits: Fits, best: Hypothesis, effect: Candidate, missing: Sequence[Candidate], seed: int
) -> list[tuple[Hypothesis, float]]:
    """A hypothesis, and what it would be with another effect in the place of one of its own, with probabilities.

    Args:
        fits: all so far.
        best: the hypothesis.
        effect: of it.
        missing: the candidates.
        seed: of random draws.
    """
    rest = fits.fit(tuple(c for c in best.effects if c != effect), best.estimate.named)
    others: list[Hypothesis] = []
    if rest is not None:
        scores = _from_there(fits, best, rest, _scores(fits, rest, effect, missing), missing)
        others += [h for h in fitted(fits, rest, scores, best) if effect not in h.effects]
        others += [h for h in (*_begun(fits, rest, effect, missing), *_two(fits, best, rest, effect, scores, missing)) if h not in others]
    others = [h for h in others if beats(h, best, seed, fits.settings) or all(c.form_of != effect.form_of for c in h.effects)]
    group = [best, *(h for h in others if h is not best)]
    weight = weights([h.evidence for h in group], seed)
    if rest is not None and not fits.problem.plant.quick:
        weight = _agreed(group, weight, rest, fits.settings, seed)
    weight = _plain(group, weight)
    enough = [k for k, h in enumerate(group) if is_wide(effect) and h.left <= best.left + fits.settings.max_noise_excess and h is not best]
    if enough:  # what one or two single parts do but for what counts as noise is no scatter of all
        weight = np.eye(len(group))[min(enough, key=lambda k: group[k].left)]
    return list(zip(group, weight.tolist(), strict=True))


def _plain(group: Sequence[Hypothesis], weight: np.ndarray) -> np.ndarray:
    """Probabilities of hypotheses where what is plainer counts for more: what acts always, and one cause than two that would do as well.

    Args:
        group: the hypotheses, first the one in which others take an effect's place.
        weight: their probabilities by what they predict, (hypotheses,).
    """
    partly = np.array([sum(bool(c.runs) for c in h.effects) for h in group])
    causes = np.array([len(h.effects) for h in group])
    weight = weight / SOME_RUNS ** (partly - partly.min()) / ONE_CAUSE ** (causes - causes.min())
    return weight / weight.sum()


def _from_there(fits: Fits, best: Hypothesis, rest: Hypothesis, scores: list[Score], missing: Sequence[Candidate]) -> list[Score]:
    """Scores of what may take an effect's place, with values to fit from that begin at the best fit where they promise to leave less there.

    What was fitted from elsewhere before and led astray is fitted anew.

    Args:
        fits: all so far.
        best: with the effect.
        rest: without it.
        scores: of what may take its place.
        missing: the candidates.
    """
    if fits.problem.plant.quick or (len(best.effects) == 1 and best.only_noise(fits.settings)):
        return scores  # beside nothing else first order leads astray hardly anywhere
    here, there = fits.linear(rest, missing), fits.linear(best, missing)
    found, astray = [], []
    for score in scores:
        if score.candidate in there.able:
            effects = (*rest.effects, score.candidate)
            gain, start = there.gain(effects)
            if (left := (1 - gain) * there.excess) < (1 - score.gain) * here.excess:
                score = replace(score, start=start)
                before = fits.known(effects)
                if before is not None and before.excess > ASTRAY * max(left / there.count.sum(), best.excess):
                    astray.append((left, effects, start))
        found.append(score)
    for _, effects, start in sorted(astray, key=lambda each: each[0])[:ANEW]:
        fits.anew(effects, start)
    return found


def _two(
    fits: Fits, best: Hypothesis, rest: Hypothesis, effect: Candidate, scores: Sequence[Score], missing: Sequence[Candidate]
) -> list[Hypothesis]:
    """The fit of the two effects that promise most in the place of one, where that may be what they do together.

    In the place of one as wide as several two of single parts are asked for, also where that leaves only noise. Values of the robot file
    that may be wrong are not asked: with one of them nearly everything does what another effect does.

    Args:
        fits: all so far.
        best: with the effect.
        rest: without it.
        effect: in whose place they are.
        scores: of what may take its place alone.
        missing: the candidates.
    """
    wide, rich = is_wide(effect), effect.stage == "body" and len(effect.parameters) >= TOGETHER
    if fits.problem.plant.quick or effect.runs or not (wide or (rich and not best.only_noise(fits.settings))):
        return []
    linear = fits.linear(best, missing)
    able = [c for c in linear.able if c != effect and not is_wide(c) and may(c, rest.effects) and c.name != PARAMETER]
    first = [c for c in able if c.part] if wide else [score.candidate for score in scores if score.candidate in able][:FIRST]
    both = combinations(first, 2) if wide else ((one, other) for one in first for other in able)
    promised = [(*linear.gain((*rest.effects, *pair)), pair) for pair in both if pair[0].form_of != pair[1].form_of]
    gain, start, pair = max(promised, key=lambda each: each[0], default=(-np.inf, {}, ()))
    if -gain * linear.excess > (MOST_OF * rest.excess * float(linear.count.sum()) if wide else NEARLY * linear.excess):
        return []
    return [h for h in fits.fit_all([((*rest.effects, *pair), {**best.estimate.named, **start})], best) if h is not None]


def _begun(fits: Fits, rest: Hypothesis, effect: Candidate, missing: Sequence[Candidate]) -> list[Hypothesis]:
    """Fits of what may have happened in the pause before the runs from which on an effect acts for good."""
    runs = fits.problem.runs
    first = next((k for k, run in enumerate(runs) if run.file in effect.runs), 0)
    if not first or effect.runs != tuple(run.file for run in runs[first:]):
        return []
    ended = runs[first - 1].began + runs[first - 1].time[-1]
    happened = float(ended + runs[first].began) / 2
    able = [c for c in missing if c.happens and c.detail == effect.detail and may(c, rest.effects)]
    found = [fits.anew((*rest.effects, c), {**rest.estimate.named, **c.probes[0], c.happens: happened}) for c in able]
    return [h for h in found if h is not None]


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
        return [score for score in fits.screen(rest, missing) if not is_wide(score.candidate) or score.candidate == effect]
    linear = fits.linear(rest, missing)
    able = [c for c in linear.able if not is_wide(c)]
    others = [*able, *(replace(c, runs=effect.runs) for c in able)]
    return sorted((Score(c, *linear.gain((*rest.effects, c))) for c in others), key=lambda score: -score.gain)
