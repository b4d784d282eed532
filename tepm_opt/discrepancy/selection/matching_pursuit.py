"""Many effects at once: where to first order several are needed, they are taken together, fitted, and looked at again from there.

One by one, each of many effects has to beat what all the others leave, and stands in for them; together each has only its own to do.
Sets are chosen by orthogonal matching pursuit on the linearised fit (Pati, Rezaiifar, Krishnaprasad, Asilomar 1993): the effect that
takes away most beside those chosen, all of them and the parameters following, until the next takes away too little. The way back and
rivals are looked at to first order, too; what that cannot tell is fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tepm_opt.discrepancy.adapters.network import PARAMETER
from tepm_opt.discrepancy.assessment.constancy import constancy_probability, effect_size_by_segment
from tepm_opt.discrepancy.problem.plant import Candidate, acting, freed
from tepm_opt.discrepancy.selection.cross_validation import weights
from tepm_opt.discrepancy.selection.fitting import Effects, Fits, Hypothesis, may
from tepm_opt.discrepancy.selection.linearised import Linearised
from tepm_opt.solvers.plant import PredictionError

MANY = 4  # effects up to which the way back and rivals are fits of their own
SEVERAL = 3  # effects that first order must ask for, each taking away `SHARE` of what the others leave
SHARE = 0.1  # part of what is left that one more effect must promise to take away
EXPLAINED = 0.05  # part of the structure that many effects may leave to be looked at together: else something else acts
HOLDS = 0.5  # part of the squares that several effects may leave with the values that first order gives them: else it does not hold
AT_MOST, AT_ONCE = 14, 5  # effects in all, and new ones at once
FORM_ERROR_RATIO = 0.0025  # part of what the other effects take away that their forms may be wrong by (5 % of the size)
MENDS = 0.2  # part of what an effect takes away from which on, where so much is left, it may as well mend the others' forms
LEAST_ODDS = 1 / 6  # to which odds fall
LISTED = 0.3  # probability from which an effect is told
LITTLE = 0.1  # part of what many effects take away that those may which are not sure, or which are dropped
AS_GOOD = 1.3  # times what is left that a rival in an effect's place may promise to leave, to be fitted


def several(fits: Fits, base: Hypothesis, missing: Sequence[Candidate]) -> Hypothesis | None:
    """The fit of as many effects as surely take away more and more.

    None where first order does not ask for several, or does not hold, or much is left.

    Args:
        fits: all so far.
        base: what they stand beside.
        missing: the candidates.
    """
    best = grown(fits, base, missing, SEVERAL)
    while best is not base and (more := grown(fits, best, missing)) is not best:
        best = more
    return None if best is base or best.excess > EXPLAINED * base.excess else best


def grown(fits: Fits, best: Hypothesis, missing: Sequence[Candidate], least: int = 1) -> Hypothesis:
    """The fit with the effects that first order asks for beside a hypothesis; the hypothesis where they are too few, or help too little.

    Args:
        fits: all so far.
        best: the hypothesis.
        missing: the candidates.
        least: number of effects that must be asked for; where it is several, first order must hold for what it asks for.
    """
    settings = fits.settings
    if fits.problem.plant.quick or best.only_noise(settings):
        return best
    effects, start = pursued(fits, best, missing)
    if len(effects) - len(best.effects) < least:
        return best
    came = {name for c in effects if c not in best.effects for name in c.parameters}
    careful = {name: value if name in came else best.estimate.named.get(name, value) for name, value in start.items()}
    begin, left = min(((values, _cost(fits, effects, values)) for values in (start, careful)), key=lambda each: each[1])
    if least > 1 and left > HOLDS * best.estimate.cost:
        return best
    found = fits.fit(effects, begin)
    found = None if found is None else fits.finished(found)
    return best if found is None or found.excess > (1 - settings.min_share_closed) * best.excess else found


def _cost(fits: Fits, effects: Effects, values: Mapping[str, float]) -> float:
    """Squares that effects with some values leave."""
    problem = fits.problem
    free = freed(problem.free, problem.plant, effects)
    at = np.array([np.clip(values.get(f.name, f.start), f.low, f.high) for f in free])
    try:
        found = replace(problem, plant=acting(problem.plant, effects), free=free).residuals(at, [])
    except PredictionError:
        return np.inf
    return sum(r.squares for r in found)


def pursued(fits: Fits, base: Hypothesis, missing: Sequence[Candidate]) -> tuple[Effects, dict[str, float]]:
    """A hypothesis' effects and those that first order asks for beside them, with values to fit from.

    Args:
        fits: all so far.
        base: the hypothesis.
        missing: the candidates.
    """
    linear, chosen = fits.linear(base, missing), list(base.effects)
    gain, start = linear.gain(chosen)
    noise = fits.settings.max_noise_excess * float(linear.count.sum())
    while len(chosen) < min(AT_MOST, len(base.effects) + AT_ONCE) and (1 - gain) * linear.excess > noise:
        able = [c for c in linear.able if c in missing and c not in chosen and c.name != PARAMETER and may(c, chosen)]
        promised = [(*linear.gain((*chosen, c)), c) for c in able]
        more, begin, first = max(promised, key=lambda each: each[0], default=(gain, start, None))
        if first is None or more - gain < SHARE * (1 - gain):
            break
        chosen.append(first)
        gain, start = more, begin
    return tuple(chosen), {**base.estimate.named, **start}


def odds(left: float, there_was: float) -> float:
    """Part to which the odds against each of many effects fall that leave next to nothing of what there was.

    What is left is what all their forms are wrong by together, so that each is the likelier.
    """
    return float(np.clip(left / max(there_was, 1e-12) / EXPLAINED, LEAST_ODDS, 1))


def settled(fits: Fits, best: Hypothesis, missing: Sequence[Candidate]) -> tuple[Hypothesis, dict[Candidate, float]]:
    """What is left of a fit once effects that do not stand out from what is left are dropped, the least needed first, and shares.

    What stays is likelier than `LISTED` to act, as far as it takes away more than is left, and more than the others' forms may be wrong by,
    and is of one size in all runs: else it mends what the others leave. What takes away much stays in any case. A loss is told to first
    order, and by a fit where the effect is to be dropped, or where first order asks for more than there was.

    Args:
        fits: all so far.
        best: the fit.
        missing: the candidates.
    """
    settings = fits.settings
    without = fits.fit((), {})
    begun = fits.fit(fits.seen, {}) or without
    most, there_was = (found.excess if found else np.inf for found in (without, begun))
    fitted: dict[Candidate, float] = {}
    stay: set[Candidate] = set()
    while True:
        linear, left = fits.linear(best, missing), best.excess + settings.max_noise_excess / 10
        even = settings.even_odds_ratio * odds(best.excess, there_was)
        costs = {effect: fitted.get(effect, lost(linear, effect)) for effect in best.effects}
        for effect in (effect for effect, cost in costs.items() if cost > most and effect not in {*fitted, *fits.seen}):
            costs[effect] = fitted[effect] = min(_less(fits, best, effect)[1], most)
        whole = sum(max(cost, 0.0) for cost in costs.values())
        wrong = {effect: FORM_ERROR_RATIO * (whole - max(cost, 0.0)) for effect, cost in costs.items()}
        least = {effect: max(settings.min_excess_removed, mended(effect, wrong[effect], cost, left)) for effect, cost in costs.items()}
        shares, steady, acts = dict.fromkeys(fits.seen, np.inf), {}, {}
        for effect in (effect for effect in best.effects if effect not in fits.seen):
            shares[effect] = costs[effect] / left if costs[effect] >= least[effect] else 0.0
            steady[effect] = constancy_probability(effect_size_by_segment(linear, effect))
            acts[effect] = steady[effect] * shares[effect] / (shares[effect] + even)
        unsure = [effect for effect in acts if acts[effect] < LISTED and effect not in stay]
        if not unsure:
            return best, shares
        weakest = min(unsure, key=lambda effect: (acts[effect], costs[effect]))
        rest, cost = _less(fits, best, weakest)
        taken = max(settings.min_excess_removed, mended(weakest, wrong[weakest], cost, left))
        stands_out = cost >= taken and steady[weakest] * cost >= LISTED * (cost + even * left)
        if rest is None or cost >= LITTLE * whole or stands_out:
            fitted[weakest] = cost if np.isfinite(cost) else most
            stay.add(weakest)
        else:
            best, fitted, stay = rest, {}, set()


def mended(effect: Candidate, wrong: float, taken: float, left: float) -> float:
    """What an effect may take away by mending the forms of others: all that those are wrong by, unless it leaves next to nothing of it.

    What only mends forms does not mend them to the noise, but for one more value of the robot file.

    Args:
        effect: which.
        wrong: what the others' forms may leave.
        taken: what it takes away.
        left: with it.
    """
    return wrong if effect.name == PARAMETER else wrong * min(left / max(MENDS * taken, 1e-12), 1.0)


def _less(fits: Fits, best: Hypothesis, effect: Candidate) -> tuple[Hypothesis | None, float]:
    """A hypothesis without one of its effects, fitted, and the excess that it leaves more; infinite where the model cannot do the runs."""
    rest = fits.fit(tuple(c for c in best.effects if c != effect), best.estimate.named)
    if rest is None:
        return None, np.inf
    rest = fits.finished(rest)
    return rest, rest.excess - best.excess


def rivals(fits: Fits, best: Hypothesis, effect: Candidate, missing: Sequence[Candidate], seed: int) -> list[tuple[Hypothesis, float]]:
    """A hypothesis, and with the effect in the place of one of its own that promises most where that is nearly as good; probabilities.

    Args:
        fits: all so far.
        best: the hypothesis.
        effect: of it.
        missing: the candidates.
        seed: of random draws.
    """
    linear, rest = fits.linear(best, missing), tuple(c for c in best.effects if c != effect)
    able = [c for c in linear.able if c not in best.effects and c.form_of != effect.form_of and may(c, rest)]
    gain, start, other = max(((*linear.gain((*rest, c)), c) for c in able), key=lambda each: each[0], default=(-np.inf, {}, None))
    if other is None or (1 - gain) * linear.excess > AS_GOOD * max(best.excess, fits.settings.max_noise_excess) * float(linear.count.sum()):
        return [(best, 1.0)]
    found = fits.fit((*rest, other), {**best.estimate.named, **start})
    if found is None:
        return [(best, 1.0)]
    group = [best, fits.finished(found)]
    return list(zip(group, weights([h.evidence for h in group], seed).tolist(), strict=True))


def lost(linear: Linearised, effect: Candidate) -> float:
    """Excess that a fit would have more without one of its effects, to first order, everything else following."""
    rest = tuple(c for c in linear.effects if c != effect)
    return (linear.gain(linear.effects)[0] - linear.gain(rest)[0]) * linear.excess / float(linear.count.sum())
