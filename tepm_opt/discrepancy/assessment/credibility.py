"""How sure it is that an effect acts: against its rivals, against laws that nobody has named, against what is left."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tepm_opt.discrepancy.adapters.network import PARAMETER
from tepm_opt.discrepancy.assessment.constancy import Sizes, steadiness
from tepm_opt.discrepancy.assessment.result import Errors, VerdictStatus, shrinks, widens
from tepm_opt.discrepancy.problem.plant import Candidate, without_run_restriction
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.cross_validation import weights
from tepm_opt.discrepancy.selection.fitting import Hypothesis
from tepm_opt.discrepancy.selection.forward_backward import Explanation
from tepm_opt.discrepancy.selection.matching_pursuit import odds
from tepm_opt.discrepancy.symbolic.places import ALL, Place
from tepm_opt.discrepancy.symbolic.score import Scored, alternatives
from tepm_opt.solvers.hierarchy import clustering, off_centre
from tepm_opt.solvers.identify import ParameterEstimate
from tepm_opt.solvers.network_plant import NetworkPlant

CLEAR = 0.8  # probability from which an effect is named: that it is a cause, and it rather than its rivals
POSSIBLE = 0.1  # probability from which a rival counts
UNEVEN = 0.3  # spread of sizes that is worth a remark
UNLIKELY = 0.002  # chance of a pattern at which it is as likely as not that what scatters is something else
GIVES_WAY = 0.7  # part of what is left that a force by place may leave beside a force of known form for that to be doubted
NOISE_KNOWN = 0.015  # excess that noise which is a little more than was assumed may seem to be


@dataclass(frozen=True, eq=False)
class Doubt:
    """What an effect that leaves structure has to beat.

    Attributes:
        holds: probability of the effect rather than of a smooth law elsewhere in its place.
        elsewhere: the law that does best there.
    """

    holds: float
    elsewhere: Scored


@dataclass(frozen=True)
class Judgement:
    """What the search's best hypothesis is worth.

    Attributes:
        status: what became of the question.
        cause: by effect, the probability that it is a cause, not a stand-in for something that is in no library.
        remarks: what spoke against effects, in sentences.
        listed: effects that the answer tells, each with the one of the best hypothesis in whose place it is, the hypothesis it is from and
            its probability: the best hypothesis' own, and those that cannot be told from them.
    """

    status: VerdictStatus
    cause: Mapping[Candidate, float] = field(default_factory=dict)
    listed: tuple[tuple[Candidate, Candidate, Hypothesis, float], ...] = ()
    remarks: tuple[str, ...] = ()


def doubts(explanation: Explanation, settings: SearchSettings, seed: int) -> dict[Candidate, Doubt]:
    """What the effects of the best hypothesis have to beat.

    A force of known form gives way to one by place beside it that surely predicts better, however little is left. Where more than noise
    is, a law in the place of an effect that acts through something else, or elsewhere, and predicts left-out data better, although it is
    only fitted to first order, says that the effect stands in for something.
    """
    best = explanation.best
    found: dict[Candidate, Doubt] = {}
    if pushing := [effect for effect in best.effects if effect.exact and effect.acts == ("force",)]:
        springs = [law for law in alternatives(best.estimate) if law.place.kind == "force" and law.place.variable == "position"]
        first = min(springs, key=lambda law: law.evidence.excess, default=None)
        if first is not None and first.evidence.excess < GIVES_WAY * best.excess:  # a force of known form that gives way is a spring
            holds = float(weights([best.evidence, first.evidence], seed)[0])
            if holds < 1 - settings.min_probability:  # of next to nothing chance may take away half
                found = dict.fromkeys(pushing, Doubt(holds, first))
    if best.only_noise(settings):
        return found
    for effect in (effect for effect in best.effects if effect not in found):
        rest = next((h for h in explanation.tried if h.effects == tuple(c for c in best.effects if c != effect)), None)
        laws = [] if rest is None else [law for law in alternatives(rest.estimate) if not _may_be(effect, law.place)]
        if laws:
            first = min(laws, key=lambda law: law.evidence.excess)
            found[effect] = Doubt(float(weights([best.evidence, first.evidence], seed)[0]), first)
    return found


def _may_be(effect: Candidate, place: Place) -> bool:
    """Whether an effect acts where a law does, so that both may say the same."""
    if place.kind not in effect.acts:
        return False
    return place.kind == "force" or place.target == (effect.detail or ALL) or effect.name == PARAMETER


def judged(
    explanation: Explanation, errors: Errors, settings: SearchSettings, unseen: bool, doubted: Mapping[Candidate, Doubt],
    constancy: Mapping[Candidate, Mapping[str, Sizes]],
) -> Judgement:  # fmt: skip
    """What the best hypothesis is worth.

    Args:
        explanation: what the search found.
        errors: of the models, on runs not used where there are such.
        settings: of the search.
        unseen: whether there are runs not used.
        doubted: what effects have to beat besides their rivals.
        constancy: sizes of effects in parts of the data.
    """
    best = explanation.best
    if not best.effects:
        only_noise = explanation.without.only_noise(settings)
        return Judgement(VerdictStatus.NO_DISCREPANCY if only_noise else VerdictStatus.UNEXPLAINED)
    holds = {effect: doubted[effect].holds if effect in doubted else 1.0 for effect in best.effects}
    shown = explanation.shown
    one = {e: 1.0 if e in shown else holds[e] * steadiness(constancy.get(e, {})) * _scatters(best.estimate, e) for e in best.effects}
    cause = {e: _cause(e, explanation, settings) * one[e] * _beside(e, one, explanation) for e in best.effects}
    cause |= {e: 1.0 for e in shown if e in cause}
    unclear = [group for group in explanation.groups.values() if group[0][1] < CLEAR]
    listed = []
    for effect in best.effects:
        for hypothesis, weight in explanation.groups[effect]:
            others = [c for c in hypothesis.effects if c not in best.effects] or [effect]
            if hypothesis is best or (weight > POSSIBLE and unclear):
                listed += [(effect, other, hypothesis, cause[effect] * weight) for other in others]
    listed.sort(key=lambda each: -each[-1])
    most = {effect: max(p for of, _, _, p in listed if of == effect) for effect in best.effects}
    refuted = [e for e in best.effects if e.runs] if unseen and widens(errors) else []
    if refuted:  # what acts in runs of its own has no excuse for spoiling others
        status = VerdictStatus.UNEXPLAINED
    elif unseen and not shrinks(errors):
        status = VerdictStatus.PARTIAL
    elif unclear and all(cause[effect] >= settings.min_listed_probability for effect in best.effects):
        status = VerdictStatus.INDISTINGUISHABLE
    elif (min(most.values()) >= CLEAR or _nearly_all(explanation, most, settings)) and _more_than_shown(explanation, settings):
        status = VerdictStatus.NAMED
    else:
        status = VerdictStatus.PARTIAL if max(most.values()) >= settings.min_listed_probability else VerdictStatus.UNEXPLAINED
    remarks = (*_remarks(explanation, doubted, constancy), *(_refuted(effect) for effect in refuted))
    return Judgement(status, cause, () if status is VerdictStatus.UNEXPLAINED else tuple(listed), remarks)


def _more_than_shown(explanation: Explanation, settings: SearchSettings) -> bool:
    """Whether something was found besides what gauges show, or that is all: sure as it is, it does not explain what it leaves."""
    best, taken = explanation.best, explanation.without.excess - explanation.best.excess
    clear = CLEAR * settings.even_odds_ratio * best.excess <= (1 - CLEAR) * taken
    return best.only_noise(settings) or clear or set(best.effects) != set(explanation.shown)


def _nearly_all(explanation: Explanation, probability: Mapping[Candidate, float], settings: SearchSettings) -> bool:
    """Whether of many effects those that are named take away nearly all that all of them do, and the others may well act."""
    unsure = [effect for effect, likely in probability.items() if likely < CLEAR]
    best = explanation.best
    most = settings.max_unsure_share * (explanation.there_was - best.excess)
    little = sum(explanation.shares[effect] for effect in unsure) * best.excess <= most
    return len(best.effects) > settings.many_effects and little and min(probability.values()) >= settings.min_listed_probability


def _remarks(
    explanation: Explanation, doubted: Mapping[Candidate, Doubt], constancy: Mapping[Candidate, Mapping[str, Sizes]]
) -> Iterator[str]:
    """What speaks against effects, a sentence each."""
    for effect, doubt in doubted.items():
        if doubt.holds < 0.5:
            law = doubt.elsewhere
            yield (
                f"{effect.told} fits as well as anything known, but it stands in for something: "
                f"a smooth law {law.place.label} in its place, or beside it, predicts left-out data better."
            )
    for effect, by in constancy.items():
        for name, sizes in by.items():
            if sizes.spread > UNEVEN:
                files = [run.file for run in explanation.best.estimate.problem.runs]
                parts = ", ".join(f"{ratio:.2g} {_part(name, part, files)}" for part, ratio in zip(sizes.parts, sizes.ratio, strict=True))
                yield f"{effect.told} is not of one size: it is {parts} of what it is over all."


def _refuted(effect: Candidate) -> str:
    """That the runs kept for validation speak against an effect of some runs."""
    return f"{effect.told} stands in for something: with it in the model the runs kept for validation fit worse."


def _part(partition: str, part: Hashable, files: Sequence[str]) -> str:
    """A part of the data in words."""
    if partition == "run":
        return f"in {files[int(str(part))]}"
    if partition == "half":
        return "in the second halves of the runs" if part else "in the first halves of the runs"
    return "where inputs rise" if part else "where inputs fall"


def _cause(effect: Candidate, explanation: Explanation, settings: SearchSettings) -> float:
    """Probability that an effect is a cause: even odds where what only it takes away is so many times what is left.

    Effects whose forms all are known leave nothing, so that what is left weighs more against them, the more the farther it is from what
    chance and a noise known to half a percent leave; of others hardly, where that counts as noise. Of many effects that leave next to
    nothing of what there was, each is the likelier: what is left is what all their forms are wrong by together. What may act in any of
    the runs has as many chances to fit.
    """
    best, exact = explanation.best, all(other.exact for other in explanation.best.effects)
    even = settings.even_odds_exact if exact else settings.even_odds_ratio
    if best.only_noise(settings):
        least = max(NOISE_KNOWN, best.by_chance)
        structure = np.clip((best.left - least) / max(settings.max_noise_excess - least, 1e-12), 0, 1) if exact else 0.0
        even = settings.even_odds_noise + structure * (even - settings.even_odds_noise)
    elif len(best.effects) > settings.many_effects:
        even *= odds(best.excess, explanation.there_was, settings)
    even *= settings.all_runs_odds if effect.runs else 1
    return float(1 / (1 + even / max(explanation.shares[effect], 1e-9)))


def _beside(effect: Candidate, believed: Mapping[Candidate, float], explanation: Explanation) -> float:
    """Probability that an effect is not only there to mend what others that stand in for something leave.

    The more of the structure they take away alone, the more it depends on them.
    """
    left = max(explanation.best.excess, 1e-12)
    taken = {other: min(explanation.shares[other] * left / max(explanation.without.excess, 1e-12), 1.0) for other in believed}
    return float(np.prod([1 - (1 - believed[other]) * taken[other] for other in believed if other != effect]))


def _scatters(estimate: ParameterEstimate, effect: Candidate) -> float:
    """Probability that what is said to scatter over all actuators does so by chance, not from module to module nor about a mean of its own.

    Even odds where chance makes what is seen once in 500 times.
    """
    plant = without_run_restriction(estimate.plant)
    if not isinstance(plant, NetworkPlant):
        return 1.0
    names = list(effect.parameters)
    chances = [*clustering(estimate, plant.model.layout.modules, names), *off_centre(estimate, names)]
    return float(np.prod([1 / (1 + (UNLIKELY / max(chance, 1e-12)) ** 2) for chance in chances]))
