"""A round of the search: the candidates that promise most are fitted; which of some hypotheses is believed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.selection.cross_validation import weights
from tepm_opt.discrepancy.selection.fitting import Effects, Fits, Hypothesis, SearchSettings
from tepm_opt.discrepancy.selection.screening import Score

WIDE = 6  # parameters above which an effect is as much as several
PLAIN = 0.9  # part of a form's gain from which a plainer form of the same is fitted in its place
NEAR, NEARLY_ALL = 5.0, 0.05  # times what an answer that leaves only noise promised to leave, and a part more: where rivals end
MIN_GAIN_RATIO = 0.25  # part of the best candidate's first-order gain below which others are not worth a fit


def fitted(fits: Fits, base: Hypothesis, scores: Sequence[Score], rival: Hypothesis | None = None) -> list[Hypothesis]:
    """Fits of the candidates that promise most beside those of a hypothesis; what competes with a rival, or with the first, may end early.

    Args:
        fits: all so far.
        base: what they stand beside.
        scores: of candidates, largest gain first.
        rival: what they have to compete with; None for the first of them.
    """
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


def is_wide(candidate: Candidate) -> bool:
    """Whether it is as much as several effects at once: it is asked for where a pair does not do as well."""
    return len(candidate.parameters) > WIDE


def most_probable(hypotheses: Sequence[Hypothesis], seed: int, most: int) -> list[Hypothesis]:
    """So many of some hypotheses, the most probable first."""
    order = np.argsort(-weights([h.evidence for h in hypotheses], seed), kind="stable") if hypotheses else []
    return [hypotheses[k] for k in order[:most]]


def beats(one: Hypothesis, other: Hypothesis, seed: int, settings: SearchSettings) -> bool:
    """Whether a hypothesis is more probable than another one, by as much as the settings ask for.

    Args:
        one: that shall be more probable.
        other: that it is compared with.
        seed: of random draws.
        settings: of the search.
    """
    return bool(weights([one.evidence, other.evidence], seed)[0] > settings.min_probability)
