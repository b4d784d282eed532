"""Matching pursuit: select many effects at once on the linearised fit, then fit them together and prune.

One by one, each of many effects has to beat what all the others leave, and stands in for them. Selected together, each has only its own
share to explain. Sets are chosen by orthogonal matching pursuit (Pati, Rezaiifar, Krishnaprasad, Asilomar 1993). It adds the effect that
removes most beside those chosen, with all parameters following, until the next removes too little. Pruning and rivals are judged to first
order, too, and fitted where that does not decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tepm_opt.discrepancy.adapters.network import PARAMETER
from tepm_opt.discrepancy.assessment.constancy import constancy_probability, effect_size_by_segment
from tepm_opt.discrepancy.problem.plant import Candidate, collect_free_parameters, restrict_effects_to_runs
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.cross_validation import weights
from tepm_opt.discrepancy.selection.fitting import Effects, Fits, Hypothesis, may_act_beside
from tepm_opt.discrepancy.selection.linearised import Linearised
from tepm_opt.discrepancy.selection.ranking import largest_excess_of_parts
from tepm_opt.solvers.mechanics.plant import PredictionError


def fit_by_matching_pursuit(fits: Fits, base: Hypothesis, missing: Sequence[Candidate]) -> Hypothesis | None:
    """Fit many effects at once, and add more as long as each addition helps.

    None where first order does not ask for several effects, or does not hold, or where much is left.

    Args:
        fits: all fits so far.
        base: the hypothesis that they stand beside.
        missing: the candidates.
    """
    best = extend_by_matching_pursuit(fits, base, missing, fits.settings.min_pursued)
    while best is not base and (more := extend_by_matching_pursuit(fits, best, missing)) is not best:
        best = more
    return None if best is base or best.excess > fits.settings.max_share_left * base.excess else best


def extend_by_matching_pursuit(fits: Fits, best: Hypothesis, missing: Sequence[Candidate], least: int = 1) -> Hypothesis:
    """Fit a hypothesis with the effects that first order adds to it; the hypothesis itself where they are too few or help too little.

    Args:
        fits: all fits so far.
        best: the hypothesis.
        missing: the candidates.
        least: fewest effects to add; for several at once first order must hold in a simulation.
    """
    settings = fits.settings
    if not settings.linear_moves or best.only_noise(settings):
        return best
    effects, start = select_by_matching_pursuit(fits, best, missing)
    if len(effects) - len(best.effects) < least:
        return best
    came = {name for c in effects if c not in best.effects for name in c.parameters}
    careful = {name: value if name in came else best.estimate.named.get(name, value) for name, value in start.items()}
    begin, left = min(((values, _cost(fits, effects, values)) for values in (start, careful)), key=lambda each: each[1])
    if least > 1 and left > settings.max_cost_ratio * best.estimate.cost:
        return best
    found = fits.fit(effects, begin)
    found = None if found is None else fits.complete(found)
    return best if found is None or found.excess > (1 - settings.min_share_closed) * best.excess else found


def _cost(fits: Fits, effects: Effects, values: Mapping[str, float]) -> float:
    """Squares that effects with some values leave; infinite where the model cannot do the runs."""
    problem = fits.problem
    free = collect_free_parameters(problem.free, problem.plant, effects)
    at = np.array([np.clip(values.get(f.name, f.start), f.low, f.high) for f in free])
    try:
        found = replace(problem, plant=restrict_effects_to_runs(problem.plant, effects), free=free).residuals(at, [])
    except PredictionError:
        return np.inf
    return sum(r.squares for r in found)


def select_by_matching_pursuit(fits: Fits, base: Hypothesis, missing: Sequence[Candidate]) -> tuple[Effects, dict[str, float]]:
    """Select effects to add to a hypothesis: its own and the selected ones, with values to fit from.

    Args:
        fits: all fits so far.
        base: the hypothesis.
        missing: the candidates.
    """
    settings = fits.settings
    linear, chosen = fits.linear(base, missing), list(base.effects)
    gain, start = linear.gain(chosen)
    noise = settings.max_noise_excess * float(linear.count.sum())
    while len(chosen) < min(settings.max_pursued, len(base.effects) + settings.max_pursued_at_once) and (1 - gain) * linear.excess > noise:
        able = [c for c in linear.able if c in missing and c not in chosen and c.name != PARAMETER and may_act_beside(c, chosen)]
        promised = [(*linear.gain((*chosen, c)), c) for c in able]
        more, begin, first = max(promised, key=lambda each: each[0], default=(gain, start, None))
        if first is None or more - gain < settings.min_pursued_share * (1 - gain):
            break
        chosen.append(first)
        gain, start = more, begin
    return tuple(chosen), {**base.estimate.named, **start}


def odds(left: float, initial_excess: float, settings: SearchSettings) -> float:
    """Factor on the odds against each of many effects that leave next to nothing of the excess.

    What is left comes from the errors of all their forms together, so that each effect is the likelier.

    Args:
        left: excess with the effects.
        initial_excess: excess without them.
        settings: of the search.
    """
    return float(np.clip(left / max(initial_excess, 1e-12) / settings.max_share_left, settings.min_odds_factor, 1))


def prune_insignificant(fits: Fits, best: Hypothesis, missing: Sequence[Candidate]) -> tuple[Hypothesis, dict[Candidate, float]]:
    """Drop effects that do not stand out from the structure left, the least needed first; returns the rest and the effects' shares.

    An effect stays where its probability to act is at least `min_listed_probability`: where it removes more than is left and more than the
    form errors of the others, and has one size in all runs. An effect that removes much stays in any case. Removals are judged to first
    order. They are fitted before an effect is dropped, and where first order says more than there was.

    Args:
        fits: all fits so far.
        best: the hypothesis.
        missing: the candidates.
    """
    settings = fits.settings
    without = fits.fit((), {})
    gauge_fit = fits.fit(fits.gauge_effects, {}) or without
    most, initial_excess = (found.excess if found else np.inf for found in (without, gauge_fit))
    fitted: dict[Candidate, float] = {}
    stay: set[Candidate] = set()
    while True:
        linear, left = fits.linear(best, missing), best.excess + settings.max_noise_excess / 10
        even = settings.even_odds_ratio * odds(best.excess, initial_excess, settings)
        costs = {effect: fitted.get(effect, excess_without(linear, effect)) for effect in best.effects}
        for effect in (effect for effect, cost in costs.items() if cost > most and effect not in {*fitted, *fits.gauge_effects}):
            costs[effect] = fitted[effect] = min(_fit_without(fits, best, effect)[1], most)
        whole = sum(max(cost, 0.0) for cost in costs.values())
        wrong = {effect: settings.form_error_ratio * (whole - max(cost, 0.0)) for effect, cost in costs.items()}
        material = material_excess(best, settings)
        least = {e: max(material, form_error_allowance(e, wrong[e], cost, left, settings)) for e, cost in costs.items()}
        shares, steady, acts = dict.fromkeys(fits.gauge_effects, np.inf), {}, {}
        for effect in (effect for effect in best.effects if effect not in fits.gauge_effects):
            shares[effect] = costs[effect] / left if costs[effect] >= least[effect] else 0.0
            steady[effect] = constancy_probability(effect_size_by_segment(linear, effect))
            acts[effect] = steady[effect] * shares[effect] / (shares[effect] + even)
        unsure = [effect for effect in acts if acts[effect] < settings.min_listed_probability and effect not in stay]
        if not unsure:
            return best, shares
        weakest = min(unsure, key=lambda effect: (acts[effect], costs[effect]))
        rest, cost = _fit_without(fits, best, weakest)
        stands_out = cost >= max(material, form_error_allowance(weakest, wrong[weakest], cost, left, settings))
        likely = steady[weakest] * cost >= settings.min_listed_probability * (cost + even * left)
        if rest is None or cost >= settings.max_unsure_share * whole or (stands_out and likely):
            fitted[weakest] = cost if np.isfinite(cost) else most
            stay.add(weakest)
        else:
            best, fitted, stay = rest, {}, set()


def material_excess(best: Hypothesis, settings: SearchSettings) -> float:
    """Excess that an effect of a hypothesis must remove at least; of a pair, what separates noise from more than noise.

    Of more effects each may be small together with the others in the place of something else.
    """
    if len(best.effects) == 2 and best.only_noise(settings):
        return max(settings.max_noise_excess, best.by_chance)
    return settings.min_excess_removed


def form_error_allowance(effect: Candidate, wrong: float, taken: float, left: float, settings: SearchSettings) -> float:
    """Excess that an effect could remove by compensating errors in the other effects' forms.

    Those count in full, unless next to nothing is left: compensation does not reach the noise. Another value of the robot file does.

    Args:
        effect: the effect.
        wrong: excess that the form errors of the others may leave.
        taken: excess that the effect removes.
        left: excess with the effect.
        settings: of the search.
    """
    part = 1.0 if effect.name == PARAMETER else min(left / max(settings.min_mend_share * taken, 1e-12), 1.0)
    return wrong * part


def _fit_without(fits: Fits, best: Hypothesis, effect: Candidate) -> tuple[Hypothesis | None, float]:
    """Fit a hypothesis without one of its effects; the excess that it adds is infinite where the model cannot do the runs."""
    rest = fits.fit(tuple(c for c in best.effects if c != effect), best.estimate.named)
    if rest is None:
        return None, np.inf
    rest = fits.complete(rest)
    return rest, rest.excess - best.excess


def weigh_best_rival(
    fits: Fits, best: Hypothesis, effect: Candidate, missing: Sequence[Candidate], seed: int
) -> list[tuple[Hypothesis, float]]:
    """Probabilities of a hypothesis and of one with the best rival in the place of an effect, fitted where it promises nearly as much.

    Args:
        fits: all fits so far.
        best: the hypothesis.
        effect: one of its effects.
        missing: the candidates.
        seed: of random draws.
    """
    settings = fits.settings
    linear, rest = fits.linear(best, missing), tuple(c for c in best.effects if c != effect)
    able = [c for c in linear.able if c not in best.effects and c.form_of != effect.form_of and may_act_beside(c, rest)]
    gain, start, other = max(((*linear.gain((*rest, c)), c) for c in able), key=lambda each: each[0], default=(-np.inf, {}, None))
    enough = settings.rival_excess_ratio * max(best.excess, settings.max_noise_excess) * float(linear.count.sum())
    if other is None or (1 - gain) * linear.excess > enough:
        return [(best, 1.0)]
    found = fits.fit((*rest, other), {**best.estimate.named, **start})
    if found is None:
        return [(best, 1.0)]
    group = [best, fits.complete(found)]
    without = fits.fit(rest, best.estimate.named) if settings.is_wide(effect) else None
    if group[1].left <= largest_excess_of_parts(best, without, effect, settings):
        return [(best, 0.0), (group[1], 1.0)]
    return list(zip(group, weights([h.evidence for h in group], seed).tolist(), strict=True))


def excess_without(linear: Linearised, effect: Candidate) -> float:
    """Excess that a fit would add without one of its effects, to first order, with everything else following."""
    rest = tuple(c for c in linear.effects if c != effect)
    return (linear.gain(linear.effects)[0] - linear.gain(rest)[0]) * linear.excess / float(linear.count.sum())
