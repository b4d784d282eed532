"""The verdict, put together from what the stages found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.assessment.constancy import active_runs
from tepm_opt.discrepancy.assessment.residual_locations import error_unit
from tepm_opt.discrepancy.assessment.result import Named, Rival, Value, Verdict, VerdictStatus
from tepm_opt.discrepancy.assessment.settings import DEFAULT as ASSESSMENT
from tepm_opt.discrepancy.assessment.stated_set import describe_stated_set
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.reporting import sentences
from tepm_opt.discrepancy.reporting.change import describe_change, describe_model_error
from tepm_opt.discrepancy.selection.fitting import Hypothesis
from tepm_opt.discrepancy.selection.forward_backward import Explanation
from tepm_opt.discrepancy.setup.errors import foreign_run, late_run
from tepm_opt.discrepancy.state import Assessed
from tepm_opt.solvers.identification.identify import ParameterEstimate


def build_verdict(state: Assessed) -> Verdict:
    """The answer in words and tables.

    Args:
        state: of the pipeline, with the credibility of every selected effect.
    """
    dataset, plant, noise, explanation, best = state.dataset, state.plant, state.noise, state.explanation, state.best
    judgement, errors, shift = state.judgement, state.errors, state.clock_shift
    unit = error_unit(plant.signals, noise)
    setup = state.setup
    if shift and shift.file:
        setup = (*setup, late_run(shift.file, shift.seconds, 1 - shift.explained))
    acts: dict[Candidate, tuple[str, ...]] = dict.fromkeys(explanation.gauge_effects, ())
    acts |= {
        effect: active_runs(effect, best, dataset, noise) for effect in explanation.best.effects if effect not in explanation.gauge_effects
    }
    named = [
        Named(
            other,
            probability,
            _values(best if hypothesis is explanation.best else hypothesis.estimate, hypothesis.form_error, other),
            _share_alone(explanation, effect, hypothesis),
            acts.get(effect, ()),
        )
        for effect, other, hypothesis, probability in judgement.listed
    ]
    others = [each for each in named if _is_another_machine(each, dataset.runs)]
    setup = (*setup, *(foreign_run(each.runs[0], 0.0, each.candidate.label, each.probability) for each in others))
    form_error = explanation.best.form_error
    known = {name: _value(best, form_error, name, plant.values[name]) for name in plant.known}
    notes = sentences.collect_notes(dataset, plant.signals, explanation, best, noise, errors)
    if state.baseline is None and not plant.quick and judgement.status is not VerdictStatus.NO_DISCREPANCY:
        notes = (*notes, describe_stated_set(state.cause_scores))
    answer = sentences.describe_answer(judgement.status, named, errors, state.localisation.sentence, known, explanation, unit)
    if judgement.status is VerdictStatus.UNEXPLAINED and state.limit.was_short:
        answer = ("Undecided: the search ended before all that may explain the structure above the noise was tried.", *answer[1:])
    elif state.baseline is not None:
        answer = describe_change(answer, judgement.status, state.baseline, explanation.without, state.baseline.moves_alike(dataset.fit))
    if state.baseline is not None:
        notes = (*notes, describe_model_error(state.baseline, state.settings.chance_excess))
    return Verdict(
        VerdictStatus.SETUP_ERROR if setup else judgement.status,
        answer,
        tuple(named),
        _rivals(explanation, named, judgement.cause),
        tuple(place for place in state.localisation.places if place.p <= 0.01),
        known,
        errors,
        plant.with_values(best.plant.values).corrected_model(explanation.best.effects),
        tuple(dict.fromkeys((*([f"{shift.sentence}."] if shift else []), *state.remarks, *judgement.remarks, *notes))),
        machine=plant.name,
        unit=unit,
        fits=len(explanation.tried),
        next=sentences.next_step(VerdictStatus.SETUP_ERROR if setup else judgement.status, shift is not None),
        setup=setup,
        baseline="" if state.baseline is None else state.baseline.name,
        cause_scores=state.cause_scores,
    )


def _is_another_machine(named: Named, runs: Sequence[Run]) -> bool:
    """Whether one of several runs is clearly of a machine whose own value, as of its size or stiffness, is another one."""
    is_clear = named.probability >= ASSESSMENT.min_sure
    return is_clear and named.candidate.part == "parameter" and len(named.runs) == 1 and len(runs) > 2


def _share_alone(explanation: Explanation, effect: Candidate, hypothesis: Hypothesis) -> float:
    """Part of the structure left by recalibration that only this effect removes."""
    rest, there = explanation.best_without(effect), max(explanation.without.excess, 1e-12)
    if rest is None and effect in explanation.shares and np.isfinite(explanation.shares[effect]):
        return min(explanation.shares[effect] * hypothesis.excess / there, 1.0)  # to first order
    return min(((rest or explanation.without).excess - hypothesis.excess) / there, 1.0)


def _value(estimate: ParameterEstimate, form_error: np.ndarray, name: str, nominal: float) -> Value:
    at = [f.name for f in estimate.problem.free].index(name)
    std = float(np.hypot(estimate.std[at], form_error[at]))
    return Value(float(estimate.values[at]), std, estimate.problem.free[at].unit, nominal)


def _values(estimate: ParameterEstimate, form_error: np.ndarray, candidate: Candidate) -> dict[str, Value]:
    """Values of an effect's parameters; their standard deviations are as large as errors were in blind trials."""
    found = {name.rpartition(".")[2]: _value(estimate, form_error, name, candidate.null[name]) for name in candidate.parameters}
    return {name: replace(value, std=ASSESSMENT.interval_factor * value.std) for name, value in found.items()}


def _rivals(explanation: Explanation, named: Sequence[Named], cause: Mapping[Candidate, float]) -> tuple[Rival, ...]:
    """One entry for every effect that was not named: its best detail, fitted or not."""
    taken = {each.candidate.name for each in named}
    found: dict[str, Rival] = {}
    for effect, group in explanation.groups.items():
        for hypothesis, weight in group[1:]:
            other = next(c for c in hypothesis.effects if c not in explanation.best.effects)
            closes = explanation.closes(hypothesis)
            rival = Rival(other, weight * cause[effect], sentences.rejection_reason(explanation, effect, hypothesis), closes)
            if other.name not in taken and (other.name not in found or found[other.name].probability < rival.probability):
                found[other.name] = rival
    for hypothesis in explanation.tried:
        for other in hypothesis.effects:
            if len(hypothesis.effects) == 1 and other.name not in taken and other.name not in found:
                why = sentences.single_effect_reason(explanation, hypothesis)
                found[other.name] = Rival(other, 0.0, why, explanation.closes(hypothesis))
    for score in explanation.scores:
        if score.candidate.name not in taken and score.candidate.name not in found:
            found[score.candidate.name] = Rival(score.candidate, 0.0, sentences.not_fitted_reason(score), None)
    return tuple(sorted(found.values(), key=lambda rival: (-rival.probability, -(rival.closes or -1.0), rival.candidate.label)))
