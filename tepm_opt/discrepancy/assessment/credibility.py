"""Credibility of effects: against their rivals, against laws that nobody has named, against the structure left."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tepm_opt.discrepancy.adapters.network import PARAMETER
from tepm_opt.discrepancy.assessment.constancy import SegmentSizes, constancy_probability
from tepm_opt.discrepancy.assessment.result import Errors, VerdictStatus, increases_validation_error, reduces_validation_error
from tepm_opt.discrepancy.assessment.settings import DEFAULT, AssessmentSettings
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.cross_validation import weights
from tepm_opt.discrepancy.selection.fitting import Hypothesis
from tepm_opt.discrepancy.selection.forward_backward import Explanation
from tepm_opt.discrepancy.selection.matching_pursuit import odds
from tepm_opt.discrepancy.selection.significance import is_significant
from tepm_opt.discrepancy.symbolic.places import ALL, Place
from tepm_opt.discrepancy.symbolic.score import Scored, alternatives
from tepm_opt.solvers.identification.hierarchy import compute_clustering_chances, off_centre
from tepm_opt.solvers.identification.identify import ParameterEstimate

TIED = "may be a hose or a cable that pulls as a spring does to where it is tied: its force does not surely stay the same."


@dataclass(frozen=True, eq=False)
class AlternativeLaw:
    """A smooth law that nobody has named and that competes with an effect.

    Attributes:
        effect_probability: of the effect rather than of the law in its place, 0 to 1.
        law: the one that predicts left-out data best.
    """

    effect_probability: float
    law: Scored


@dataclass(frozen=True)
class Judgement:
    """Assessment of the search's best hypothesis.

    Attributes:
        status: kind of answer.
        cause: by effect, the probability that it is a cause, not a stand-in for something that is in no library.
        remarks: objections to effects, in sentences.
        listed: effects in the answer: those of the best hypothesis, and those that cannot be told from them. Each has the effect of the
            best hypothesis in whose place it is, the hypothesis it is from, and its probability.
    """

    status: VerdictStatus
    cause: Mapping[Candidate, float] = field(default_factory=dict)
    listed: tuple[tuple[Candidate, Candidate, Hypothesis, float], ...] = ()
    remarks: tuple[str, ...] = ()


def alternative_law_odds(
    explanation: Explanation, settings: SearchSettings, seed: int, thresholds: AssessmentSettings = DEFAULT
) -> dict[Candidate, AlternativeLaw]:
    """Compare the effects of the best hypothesis with smooth laws in their place.

    A force of known form gives way to one by place beside it that surely predicts better, however little is left, unless a law elsewhere
    surely predicts still better: then something else is left. Where more than noise is left, so does a single wrong value of the robot
    file to a drag beside it, and any effect competes with laws that act elsewhere. A law that predicts left-out data better, although it
    is only fitted to first order, shows that the effect is a stand-in.

    Args:
        explanation: result of the search.
        settings: of the search.
        seed: of random draws.
        thresholds: of the assessment.
    """
    best = explanation.best
    found: dict[Candidate, AlternativeLaw] = {}
    if pushing := [effect for effect in best.effects if effect.exact and effect.acts == ("force",)]:
        spring = _force_beside(best, "position", settings, seed, thresholds)
        found = dict.fromkeys(pushing, spring) if spring else {}
    if best.only_noise(settings):
        return found
    if [effect.name for effect in best.effects] == [PARAMETER] and (drag := _force_beside(best, "speed", settings, seed, thresholds)):
        return dict.fromkeys(best.effects, drag)
    for effect in (effect for effect in best.effects if effect not in found):
        rest = explanation.best_without(effect)
        laws = [] if rest is None else [law for law in alternatives(rest.estimate) if not _acts_like(effect, law.place)]
        if laws:
            first = min(laws, key=lambda law: law.evidence.excess)
            found[effect] = AlternativeLaw(float(weights([best.evidence.without_prior, first.evidence], seed)[0]), first)
    return found


def _force_beside(
    best: Hypothesis, variable: str, settings: SearchSettings, seed: int, thresholds: AssessmentSettings
) -> AlternativeLaw | None:
    """A force by position or speed that surely predicts better beside a hypothesis, and than which no law surely does; None without one.

    Args:
        best: the hypothesis.
        variable: "position" or "speed".
        settings: of the search.
        seed: of random draws.
        thresholds: of the assessment.
    """
    laws, unlikely = sorted(alternatives(best.estimate), key=lambda law: law.evidence.excess), 1 - settings.min_probability
    force = next((law for law in laws if (law.place.kind, law.place.variable) == ("force", variable)), None)
    if force is None or force.evidence.excess >= thresholds.beside_max_excess * best.excess:  # of next to nothing chance may take half
        return None
    holds = float(weights([best.evidence.without_prior, force.evidence], seed)[0])
    likely = float(weights([force.evidence, laws[0].evidence], seed)[0])
    return AlternativeLaw(holds, force) if holds < unlikely <= likely else None


def _acts_like(effect: Candidate, place: Place) -> bool:
    """Whether an effect acts where a law does, so that both may say the same; no value of the robot file is the drag of a medium."""
    if place.kind not in effect.acts or (effect.name == PARAMETER and (place.kind, place.variable) == ("force", "speed")):
        return False
    return place.kind == "force" or place.target == (effect.detail or ALL) or effect.name == PARAMETER


@dataclass(frozen=True, eq=False)
class EffectChecks:
    """Checks of single effects.

    Attributes:
        laws: that compete with effects besides their rivals.
        constancy: sizes of effects in segments of the data.
        constant: probabilities that forces are constant, see `tether.constant_force_probabilities`.
    """

    laws: Mapping[Candidate, AlternativeLaw] = field(default_factory=dict)
    constancy: Mapping[Candidate, Mapping[str, SegmentSizes]] = field(default_factory=dict)
    constant: Mapping[Candidate, float] = field(default_factory=dict)


def assess(
    explanation: Explanation, unseen: Errors | None, settings: SearchSettings, checks: EffectChecks, modules: int = 1,
    thresholds: AssessmentSettings = DEFAULT,
) -> Judgement:  # fmt: skip
    """Assess the best hypothesis: kind of answer, probabilities of its effects, objections.

    Args:
        explanation: result of the search.
        unseen: errors of the models on runs not used; None where there are no such.
        settings: of the search.
        checks: of single effects.
        modules: alike modules of the machine, see `SearchablePlant.modules`.
        thresholds: of the assessment.
    """
    best, laws, constancy = explanation.best, checks.laws, checks.constancy
    if not best.effects:
        only_noise = explanation.without.only_noise(settings)
        return Judgement(VerdictStatus.NO_DISCREPANCY if only_noise else VerdictStatus.UNEXPLAINED)
    shown, alone = explanation.gauge_effects, dict[Candidate, float]()
    for effect in best.effects:
        holds = laws[effect].effect_probability if effect in laws else 1.0
        steady = constancy_probability(constancy.get(effect, {}), thresholds) * checks.constant.get(effect, 1.0)
        alone[effect] = 1.0 if effect in shown else holds * steady * _chance_scatter(best.estimate, effect, modules, thresholds)
    cause = {e: _cause(e, explanation, settings, thresholds) * alone[e] * _independence(e, alone, explanation) for e in best.effects}
    cause |= {e: 1.0 for e in shown if e in cause}
    unclear = any(group[0][1] < thresholds.min_named for group in explanation.groups.values())
    listed = []
    for effect in best.effects:
        for hypothesis, weight in explanation.groups[effect]:
            others = [c for c in hypothesis.effects if c not in best.effects] or [effect]
            if hypothesis is best or (weight > thresholds.min_rival and unclear):
                listed += [(effect, other, hypothesis, cause[effect] * weight) for other in others]
    listed.sort(key=lambda each: -each[-1])
    vague = [e for e in best.effects if e not in shown and not is_significant(best.estimate, e, settings)]
    listed = [each for each in listed if each[0] not in vague]
    if not listed:
        return Judgement(VerdictStatus.UNEXPLAINED, cause, remarks=tuple(_vague(vague)))
    most = {effect: max(p for of, _, _, p in listed if of == effect) for effect in best.effects if effect not in vague}
    refuted = [e for e in best.effects if e.runs] if unseen and increases_validation_error(unseen, thresholds) else []
    if refuted:  # what acts in runs of its own has no excuse for spoiling others
        status = VerdictStatus.UNEXPLAINED
    elif unseen and not reduces_validation_error(unseen, thresholds):
        status = VerdictStatus.PARTIAL
    elif unclear and all(cause[effect] >= settings.min_listed_probability for effect in best.effects):
        status = VerdictStatus.INDISTINGUISHABLE
    elif _explains_all(explanation, most, settings, thresholds):
        status = VerdictStatus.NAMED
    else:
        status = VerdictStatus.PARTIAL if max(most.values()) >= settings.min_listed_probability else VerdictStatus.UNEXPLAINED
    spoils = "stands in for something: with it in the model the runs kept for validation fit worse."
    remarks = (
        *_vague(vague),
        *_objections(explanation, laws, constancy, thresholds),
        *(f"{e.full_label} {TIED}" for e in best.effects if checks.constant.get(e, 1.0) < thresholds.min_named),
        *(f"{effect.full_label} {spoils}" for effect in refuted),
    )
    return Judgement(status, cause, () if status is VerdictStatus.UNEXPLAINED else tuple(listed), remarks)


def _vague(effects: Sequence[Candidate]) -> list[str]:
    """Remarks on effects that the fit needs but whose size is not known to differ from none."""
    return [f"{e.full_label} helps the fit, but its size does not differ significantly from none: it is not named." for e in effects]


def _explains_all(
    explanation: Explanation, probability: Mapping[Candidate, float], settings: SearchSettings, thresholds: AssessmentSettings
) -> bool:
    """Whether all effects, or those that explain nearly all of the gap, are sure, and more was found than gauges show, or that is all.

    An effect that gauges show is sure but does not explain what it leaves.
    """
    clear, best = thresholds.min_named, explanation.best
    if min(probability.values()) < clear:
        little = sum(explanation.shares[effect] for effect, p in probability.items() if p < clear) * best.excess
        few_left = len(best.effects) > settings.many_effects and little <= settings.max_unsure_share * (
            explanation.initial_excess - best.excess
        )
        if not few_left or min(probability.values()) < settings.min_listed_probability:
            return False
    taken = explanation.without.excess - best.excess
    explained = clear * settings.even_odds_ratio * best.excess <= (1 - clear) * taken
    return best.only_noise(settings) or explained or set(best.effects) != set(explanation.gauge_effects)


def _objections(
    explanation: Explanation, laws: Mapping[Candidate, AlternativeLaw], constancy: Mapping[Candidate, Mapping[str, SegmentSizes]],
    thresholds: AssessmentSettings,
) -> Iterator[str]:  # fmt: skip
    """Objections to effects, a sentence each."""
    for effect, other in laws.items():
        if other.effect_probability < 0.5:
            yield (
                f"{effect.full_label} fits as well as anything known, but it stands in for something: "
                f"a smooth law {other.law.place.label} in its place, or beside it, predicts left-out data better."
            )
    for effect, by in constancy.items():
        for name, sizes in by.items():
            if sizes.spread > thresholds.spread_remark:
                files = [run.file for run in explanation.best.estimate.problem.runs]
                pairs = zip(sizes.parts, sizes.ratio, strict=True)
                parts = ", ".join(f"{ratio:.2g} {_describe_segment(name, part, files)}" for part, ratio in pairs)
                yield f"{effect.full_label} is not of one size: it is {parts} of what it is over all."


def _describe_segment(partition: str, part: Hashable, files: Sequence[str]) -> str:
    """A segment of the data in words."""
    if partition == "run":
        return f"in {files[int(str(part))]}"
    if partition == "half":
        return "in the second halves of the runs" if part else "in the first halves of the runs"
    return "where inputs rise" if part else "where inputs fall"


def _cause(effect: Candidate, explanation: Explanation, settings: SearchSettings, thresholds: AssessmentSettings) -> float:
    """Probability that an effect is a cause, by the share of the gap that only it closes over the excess left.

    Effects whose forms all are known leave nothing, so an excess weighs more against them, the more so the farther it is from chance and
    from a noise known to half a percent. It hardly weighs against others where it counts as noise. Of several effects that leave next to
    nothing, each is the likelier: the excess is the error of all their forms together; but not beside another value of the robot file,
    which mends errors of any form. An effect of some runs has as many chances to fit.
    """
    best, exact = explanation.best, all(other.exact for other in explanation.best.effects)
    even = settings.even_odds_exact if exact else settings.even_odds_ratio
    if best.only_noise(settings):
        least = max(thresholds.noise_excess, best.by_chance)
        structure = np.clip((best.left - least) / max(settings.max_noise_excess - least, 1e-12), 0, 1) if exact else 0.0
        even = settings.even_odds_noise + structure * (even - settings.even_odds_noise)
    elif len(best.effects) > settings.several_effects and all(other.name != PARAMETER for other in best.effects):
        even *= odds(best.excess, explanation.initial_excess, settings)
    even *= settings.all_runs_odds if effect.runs else 1
    return float(1 / (1 + even / max(explanation.shares[effect], 1e-9)))


def _independence(effect: Candidate, believed: Mapping[Candidate, float], explanation: Explanation) -> float:
    """Probability that an effect does not only compensate errors of other effects that are stand-ins.

    The more of the structure they take away alone, the more it depends on them.
    """
    left = max(explanation.best.excess, 1e-12)
    taken = {other: min(explanation.shares[other] * left / max(explanation.without.excess, 1e-12), 1.0) for other in believed}
    return float(np.prod([1 - (1 - believed[other]) * taken[other] for other in believed if other != effect]))


def _chance_scatter(estimate: ParameterEstimate, effect: Candidate, modules: int, thresholds: AssessmentSettings) -> float:
    """Probability that parameters said to scatter over all actuators do so by chance, not by module or about another mean."""
    names = list(effect.parameters)
    chances = [*compute_clustering_chances(estimate, modules, names), *off_centre(estimate, names)]
    return float(np.prod([1 / (1 + (thresholds.scatter_even_odds / max(chance, 1e-12)) ** 2) for chance in chances]))
