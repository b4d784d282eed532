"""Scatter of alike parameters: whether it is about zero, and causes common to all of them in its place or beside it."""

from __future__ import annotations

from collections.abc import Sequence

from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.fitting import Fits, Hypothesis, may_act_beside
from tepm_opt.solvers.identification.hierarchy import off_centre


def is_centred(hypothesis: Hypothesis, settings: SearchSettings) -> bool:
    """Whether every scatter of a hypothesis is about zero, or may be by chance; true where nothing scatters."""
    scatters = [effect for effect in hypothesis.effects if effect.scatters]
    chances = [chance for effect in scatters for chance in off_centre(hypothesis.estimate, list(effect.parameters))]
    return min(chances, default=1.0) >= settings.min_centred_chance


def fit_common_causes(fits: Fits, best: Hypothesis, rest: Hypothesis, effect: Candidate, missing: Sequence[Candidate]) -> list[Hypothesis]:
    """Fit causes common to all actuators in the place of scatter that is not about zero: alone, with a single part, with scatter about it.

    They are those that have no first order, such as a dead zone, which pairs proposed to first order do not find.

    Args:
        fits: all fits so far.
        best: hypothesis with the scatter.
        rest: hypothesis without it.
        effect: the scatter.
        missing: the candidates.
    """
    if not effect.scatters or is_centred(best, fits.settings):
        return []
    common = [c for c in missing if not (c.smooth or c.part) and may_act_beside(c, rest.effects)]
    asked = [((*rest.effects, c), {**rest.estimate.named, **c.probes[0]}) for c in common]
    alone = [h for h in fits.fit_all(asked) if h is not None]
    if not alone:
        return []
    first = fits.complete(min(alone, key=lambda h: h.excess))
    linear = fits.linear(first, missing)
    parts = [c for c in linear.able if c.part and may_act_beside(c, first.effects)]
    _, start, part = max(((*linear.gain((*first.effects, c)), c) for c in parts), key=lambda each: each[0], default=(0.0, {}, None))
    more = [] if part is None else [((*first.effects, part), {**first.estimate.named, **start})]
    more += [((*first.effects, effect), first.estimate.named)]
    return [*alone, *(h for h in fits.fit_all(more) if h is not None)]
