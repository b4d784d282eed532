"""Backward elimination: drop effects that do not stand out from the structure left."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from functools import partial

import numpy as np

from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.fitting import Effects, Fits, Hypothesis
from tepm_opt.discrepancy.selection.matching_pursuit import form_error_allowance, material_excess
from tepm_opt.discrepancy.selection.scatter import is_centred
from tepm_opt.discrepancy.selection.significance import is_significant
from tepm_opt.solvers.mechanics.plant import PredictionError
from tepm_opt.solvers.numerics.parallel import in_parallel

Shares = dict[Candidate, float]


def eliminate_backward(fits: Fits, best: Hypothesis, refuted: Collection[Effects] = ()) -> tuple[Hypothesis, Shares]:
    """Drop effects one by one, the least needed first, until all that are left stand out from the structure left.

    An effect stands out where it removes more than form errors of the others may (see `form_error_allowance`), a material excess and a
    share of what is left, and where its size is significant. Forms that are known exactly have no errors, and none can spoil more than
    there is to explain. Fits without an effect end early where it surely stays, until nothing else is to be dropped.

    Args:
        fits: all fits so far.
        best: the hypothesis.
        refuted: hypotheses that gave way to others; an effect without which `best` is one of them does not mend form errors.
    """
    settings, nothing = fits.settings, fits.fit((), {})
    most = np.inf if nothing is None else nothing.excess
    while True:
        several = best.effects if len(best.effects) > 1 else ()  # nothing else's form is wrong beside a single one
        guessed = [effect for effect in several if not effect.exact]
        outputs = in_parallel(partial(_output, best), guessed, threads=fits.problem.plant.concurrent)
        doubt = {effect: settings.form_error_ratio * min(output, most) for effect, output in zip(guessed, outputs, strict=True)}
        stays = max(settings.sure_share * _excess_left(best, settings), settings.min_excess_removed, sum(doubt.values()))
        bound = best.estimate.cost + settings.early_end_ratio * stays * best.estimate.count if several else np.inf
        shares, smaller = _drop_weakest(fits, best, doubt, bound, refuted)
        if smaller is None and np.isfinite(bound):
            shares, smaller = _drop_weakest(fits, best, doubt, np.inf, refuted)
        if smaller is None:
            return best, shares
        best = smaller


def _drop_weakest(
    fits: Fits, best: Hypothesis, doubt: dict[Candidate, float], bound: float, refuted: Collection[Effects]
) -> tuple[Shares, Hypothesis | None]:
    """Shares of all effects, and the hypothesis without the weakest one; None where all stand out.

    Args:
        fits: all fits so far.
        best: the hypothesis.
        doubt: excess that form errors of each effect may leave.
        bound: squares above which a fit without an effect may end early.
        refuted: hypotheses that gave way to others.
    """
    rests = [tuple(c for c in best.effects if c != effect) for effect in best.effects]
    found = fits.fit_all([(rest, best.estimate.named) for rest in rests], bound=bound)
    without = dict(zip(best.effects, found, strict=True))
    shares, lost = _shares(fits, best, without, doubt, refuted)
    weakest = min(shares, key=lambda effect: (shares[effect], lost[effect]), default=None)
    smaller = None if weakest is None else without[weakest]
    if weakest is None or smaller is None or shares[weakest] >= fits.settings.least_share or smaller.estimate.out_of_reach:
        return shares, None
    return shares, smaller


def _excess_left(best: Hypothesis, settings: SearchSettings) -> float:
    """Excess that a hypothesis leaves, and a little of the noise besides."""
    return best.excess + settings.max_noise_excess / 10


def _shares(
    fits: Fits, best: Hypothesis, without: dict[Candidate, Hypothesis | None], doubt: dict[Candidate, float], refuted: Collection[Effects]
) -> tuple[Shares, dict[Candidate, float]]:
    """Share of every effect: the excess that it removes over the excess left, 0 where form errors of others may; and that excess itself.

    Both are infinite where the model cannot do the runs without an effect, gauges show it, or scatter in its place is not about zero.

    Args:
        fits: all fits so far.
        best: the hypothesis.
        without: fits without each effect; None where the model cannot do the runs.
        doubt: excess that form errors of each effect may leave.
        refuted: hypotheses that gave way to others.
    """
    shares, lost, left = Shares(), dict[Candidate, float](), _excess_left(best, fits.settings)
    for effect, found in without.items():
        shares[effect], lost[effect] = np.inf, np.inf
        common = found is not None and is_centred(best, fits.settings) and not is_centred(found, fits.settings)
        if found is not None and effect not in fits.gauge_effects and not common:
            taken = lost[effect] = found.excess - best.excess
            wrong = sum(size for other, size in doubt.items() if other != effect)
            allowance = 0.0 if found.effects in refuted else form_error_allowance(effect, wrong, taken, left, fits.settings)
            stands_out = taken >= max(allowance, material_excess(best, fits.settings))
            shares[effect] = taken / left if stands_out and is_significant(best.estimate, effect, fits.settings) else 0.0
    return shares, lost


def _output(hypothesis: Hypothesis, effect: Candidate) -> float:
    """Mean square over the noise's of the change of modelled positions by one effect; 0 where the model cannot do the runs without it."""
    estimate = hypothesis.estimate
    problem = replace(estimate.problem, plant=estimate.plant.with_values(effect.null), free=())
    try:
        without = problem.residuals(np.zeros(0))
    except PredictionError:
        return 0.0
    changed = sum(float(np.sum((a.values - b.values) ** 2)) for a, b in zip(without, estimate.residuals, strict=True))
    return changed / max(estimate.count, 1)
