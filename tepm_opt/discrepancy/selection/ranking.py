"""A round of the search: fit the candidates that promise most, and rank hypotheses by probability."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tepm_opt.discrepancy.adapters.network import PARAMETER
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.cross_validation import weights
from tepm_opt.discrepancy.selection.fitting import Effects, Fits, Hypothesis
from tepm_opt.discrepancy.selection.screening import Score


def fit_promising(fits: Fits, base: Hypothesis, scores: Sequence[Score], rival: Hypothesis | None = None) -> list[Hypothesis]:
    """Fit the candidates that promise most, each beside the effects of a hypothesis; fits that cannot compete may end early.

    Where the first of all leave more than noise, so many more are fitted, and all that have no first order.

    Args:
        fits: all fits so far.
        base: the hypothesis.
        scores: of candidates, largest gain first.
        rival: hypothesis that they compete with; None for the first of them.
    """
    settings = fits.settings
    if not scores:
        return []
    ranked, most = rank_promising(base, scores, settings)
    promising = ranked[:most]

    def list_starts(some: Sequence[Score]) -> list[list[tuple[Effects, dict[str, float]]]]:
        return [
            [((*base.effects, score.candidate), {**base.estimate.named, **start}) for start in score.starts[: settings.starts]]
            for score in some
        ]

    asked, bound = list_starts(promising), _early_end_bound(fits, base)
    trials = fits.fit_all(asked[0], bound=bound)[:1] if asked and not rival else []
    solved = rival or next(iter(trials), None)
    first = next((score for score in scores if solved is not None and score.candidate in solved.effects), None)
    if first is not None and solved is not None and solved.only_noise(settings) and settings.adapt_fit_count:
        reach = 1 - settings.far_rival_ratio * max(1 - first.gain, 0.01) - settings.far_rival_margin
        asked = [each for each, score in zip(asked, promising, strict=True) if score.gain >= reach]
    trials += fits.fit_all([each for one in asked[len(trials) :] for each in one], solved, bound)
    least_left = min((t for t in trials if t is not None), key=lambda t: t.excess, default=None)
    if settings.adapt_fit_count and not (base.effects or rival or least_left is None or least_left.only_noise(settings)):
        further, tried = ranked[most : 2 * most], {score.candidate for score in ranked[: 2 * most]}
        further += [score for score in scores if not score.candidate.smooth and score.candidate not in tried]  # first order misjudges them
        trials += fits.fit_all([each for one in list_starts(further) for each in one], least_left, bound)
    found = [trial for trial in trials if trial is not None]
    below = _scores_above_best(found if rival is None else [*found, rival], scores, ranked)
    found += [t for t in fits.fit_all([each for one in list_starts(below) for each in one], solved, bound) if t is not None]
    return list(dict.fromkeys(found))


def fit_values_at_limits(fits: Fits, base: Hypothesis, missing: Sequence[Candidate], rival: Hypothesis | None = None) -> list[Hypothesis]:
    """Fit each value of the robot file that ended at its prior's limit as a wrong one: what drove it there may be it alone.

    Args:
        fits: all fits so far.
        base: the hypothesis beside whose effects the value is wrong.
        missing: the candidates.
        rival: a hypothesis that they compete with, whose values at limits are fitted, too.
    """
    begun = [h for h in (base, rival) if h is not None]
    limits = {f.name for h in begun for f, at in zip(h.estimate.problem.free, h.estimate.at_bound, strict=True) if at}
    wrong = [c for c in missing if c.name == PARAMETER and c.detail in limits and c.label not in {e.label for e in base.effects}]
    asked = [((*base.effects, c), h.estimate.named) for c in wrong for h in begun]
    return list(dict.fromkeys(h for h in fits.fit_all(asked, rival) if h is not None))


def _scores_above_best(fitted: Sequence[Hypothesis], scores: Sequence[Score], ranked: Sequence[Score]) -> list[Score]:
    """Scores that are not among the fitted and promise more than the fit that leaves least: first order says little near the noise.

    Args:
        fitted: hypotheses, the best of which may be chosen.
        scores: of all candidates, one of each.
        ranked: those of them that are worth a fit.
    """
    chosen = min(fitted, key=lambda h: h.excess, default=None)
    added = {effect for h in fitted for effect in h.effects}
    least = max((score.gain for score in scores if chosen is not None and score.candidate in chosen.effects), default=np.inf)
    return [score for score in ranked if score.gain > least and score.candidate not in added]


def rank_promising(base: Hypothesis, scores: Sequence[Score], settings: SearchSettings) -> tuple[list[Score], int]:
    """Scores that are worth a fit beside a hypothesis, largest gain first, and how many of them are fitted at first."""
    most = settings.fits_later_rounds if base.effects else settings.fits_first_round
    least = settings.min_share_closed / 2 if base.effects and settings.beam > 1 else 0.0
    least = max(settings.min_gain_ratio * scores[0].gain, least) if scores else least
    return drop_richer_forms([score for score in scores if score.gain >= least], settings), most


def _early_end_bound(fits: Fits, base: Hypothesis) -> float:
    """Squares above which a fit with one more effect may end early; infinite where fits take few steps anyway."""
    if fits.settings.beam == 1:
        return np.inf
    estimate = base.estimate
    return estimate.count + (1 - fits.settings.min_share_closed) * max(estimate.cost - estimate.count, 0.0)


def drop_richer_forms(scores: Sequence[Score], settings: SearchSettings) -> list[Score]:
    """Scores without those forms whose family has a form with fewer parameters that promises nearly as much."""
    return [
        score
        for score in scores
        if not any(
            other.candidate.form_of == score.candidate.form_of
            and len(other.candidate.parameters) < len(score.candidate.parameters)
            and other.gain >= settings.plain_form_ratio * score.gain
            for other in scores
        )
    ]


def most_probable(hypotheses: Sequence[Hypothesis], seed: int, most: int) -> list[Hypothesis]:
    """The `most` most probable of some hypotheses, best first."""
    order = np.argsort(-weights([h.evidence for h in hypotheses], seed), kind="stable") if hypotheses else []
    return [hypotheses[k] for k in order[:most]]


def largest_excess_of_parts(best: Hypothesis, rest: Hypothesis | None, effect: Candidate, settings: SearchSettings) -> float:
    """Excess up to which single parts in the place of a wide effect are believed instead, below 0 for another effect.

    Parts that do what it does, but for what counts as noise, are no scatter of all; where more than noise is left, what the errors of all
    forms leave may hide a small share, which is no more than what it leaves itself.

    Args:
        best: hypothesis with the effect.
        rest: hypothesis without it; None where the model cannot do the runs.
        effect: the effect.
        settings: of the search.
    """
    if not settings.is_wide(effect):
        return -1.0
    removed = 0.0 if rest is None or best.only_noise(settings) else rest.excess - best.excess
    return best.left + max(settings.max_noise_excess, min(settings.max_parts_loss * removed, best.left))


def beats(one: Hypothesis, other: Hypothesis, seed: int, settings: SearchSettings) -> bool:
    """Whether a hypothesis is more probable than another one by at least `min_probability`.

    Args:
        one: hypothesis that should be more probable.
        other: hypothesis that it is compared with.
        seed: of random draws.
        settings: of the search.
    """
    return bool(weights([one.evidence, other.evidence], seed)[0] > settings.min_probability)
