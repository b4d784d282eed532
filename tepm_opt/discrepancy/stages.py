"""Stages of the discrepancy workflow: check the set-up, prepare, recalibrate, screen, select, validate, assess, report.

Each stage takes the frozen state that the stage before it returned and adds what it found.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.outliers import without_strays
from tepm_opt.discrepancy.assessment.calibration import calibrate_judgement
from tepm_opt.discrepancy.assessment.constancy import SegmentSizes, active_runs, effect_size_by_segment
from tepm_opt.discrepancy.assessment.credibility import EffectChecks, Judgement, alternative_law_odds
from tepm_opt.discrepancy.assessment.credibility import assess as assess_effects
from tepm_opt.discrepancy.assessment.result import Errors, VerdictStatus, reduces_validation_error
from tepm_opt.discrepancy.assessment.settings import DEFAULT as ASSESSMENT
from tepm_opt.discrepancy.assessment.stated_set import score_causes
from tepm_opt.discrepancy.assessment.tether import constant_force_probabilities
from tepm_opt.discrepancy.assessment.validation import Comparison, compare_models, predict_runs, validation_errors
from tepm_opt.discrepancy.baseline.baseline import Baseline
from tepm_opt.discrepancy.baseline.judgement import judge_change
from tepm_opt.discrepancy.preparation.clock import check_clock
from tepm_opt.discrepancy.preparation.devices import identify_devices
from tepm_opt.discrepancy.preparation.measured_inputs import (
    downstream_candidates,
    exclude_by_measured_inputs,
    measured_inputs,
    with_measured_inputs,
)
from tepm_opt.discrepancy.preparation.noise import describe_noise, estimate_noise
from tepm_opt.discrepancy.preparation.time_step import choose_time_step
from tepm_opt.discrepancy.problem.plant import Candidate, restrict_effects_to_runs, without_run_restriction
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.problem.time_limit import TimeLimit
from tepm_opt.discrepancy.reporting.report import build_verdict
from tepm_opt.discrepancy.selection.fitting import Fits
from tepm_opt.discrepancy.selection.forward_backward import explain
from tepm_opt.discrepancy.selection.linearised import linearise
from tepm_opt.discrepancy.setup.check import find_setup_errors
from tepm_opt.discrepancy.state import Assessed, Discovery, Prepared, Question, Recalibrated, Screened, Selected, Validated
from tepm_opt.solvers.identification.identify import Problem, identify
from tepm_opt.solvers.identification.initial_state import with_estimated_initial_state
from tepm_opt.solvers.identification.residuals import independent_after


def check_setup(state: Question) -> Question:
    """Look for mistakes of wiring, axes, units and markers, and mend them in the data."""
    baseline, noise = state.baseline, state.noise
    spreads = None if baseline is None else dict(zip(baseline.posterior.names, baseline.posterior.std.tolist(), strict=True))
    noise = noise if baseline is None else baseline.error.size
    found, runs = find_setup_errors(state.plant, state.dataset.runs, noise, state.progress, spreads=spreads)
    return replace(state, dataset=state.dataset.with_runs(runs), setup=found) if found else state


def prepare(state: Question) -> Prepared:
    """Remove outliers, read the regulators off the gauges, choose the time step."""
    dataset, plant, noise, plain = state.dataset, state.plant, state.noise, state.plant.without_candidates
    state.progress("simulating the runs with the model as it is", 0, 0)
    nominal, remarks = predict_runs(plain, dataset, noise), list[str]()
    missing = downstream_candidates(plant.candidates, dataset.gauges)
    if not plant.static:
        dataset, remarks = without_strays(dataset, nominal, noise)
    devices = identify_devices(dataset, plant)
    if devices is not None:
        dataset, remarks, missing = dataset.with_runs(devices.runs), [*remarks, f"{devices.note}."], devices.narrow_candidates(missing)
    step = choose_time_step(plain, dataset, nominal, noise, state.settings)
    problem = Problem(plant, dataset.fit, plant.free(plant.known), noise, step=step, derivatives_apart=plant.derivatives_apart)
    fields: dict[str, Any] = vars(state) | {"dataset": dataset}
    return Prepared(**fields, nominal=nominal, open_candidates=missing, devices=devices, problem=problem, remarks=remarks)


def recalibrate(state: Prepared) -> Recalibrated:
    """Fit the known parameters alone; take the noise from what that leaves of motions."""
    problem, noise, remarks = with_initial_states(state.problem, state.settings), state.noise, state.remarks
    if state.baseline is not None:
        return _constrain(state, state.baseline, problem)
    first = Fits(problem, state.settings, progress=state.progress, limit=state.limit)
    fit = first.fit((), {})
    if fit is not None and not problem.plant.static:
        noise, scatters = estimate_noise(noise, problem.runs, fit.estimate.residuals)
        remarks = [*remarks, *describe_noise(scatters, state.noise, state.plant.signals)]
    done = first.done if np.all(noise == problem.noise) else {}
    shown, values = ((), {}) if state.devices is None else (state.devices.gauge_effects, state.devices.values)
    fits = Fits(replace(problem, noise=noise), state.settings, state.store, state.key, state.progress, shown, values, done, state.limit)
    fields: dict[str, Any] = vars(state) | {"noise": noise, "remarks": remarks}
    return Recalibrated(**fields, fits=fits)


def _constrain(state: Prepared, baseline: Baseline, problem: Problem) -> Recalibrated:
    """The search for what changed: parameters within the baseline's posterior, the model's error there in the place of noise."""
    shown, values = ((), {}) if state.devices is None else (state.devices.gauge_effects, state.devices.values)
    fits = Fits(baseline.constrain(problem), state.settings, state.store, state.key, state.progress, shown, values, limit=state.limit)
    fields: dict[str, Any] = vars(state) | {"open_candidates": baseline.rebase(state.open_candidates)}
    return Recalibrated(**fields, fits=fits)


def screen(state: Recalibrated) -> Screened:
    """Exclude candidates by a search with measured inputs, where gauges measure inputs and have not shown the regulators already.

    Where the recording moves otherwise than its baseline, nothing could be named, and no candidate is left.
    """
    if state.baseline is not None and not state.baseline.moves_alike(state.dataset.fit):
        return Screened(**vars(state), candidates=())
    fits, signals = state.fits, state.plant.signals
    shown = None if state.devices is not None else with_measured_inputs(fits.problem.runs, signals)
    if shown is None:
        return Screened(**vars(state), candidates=state.open_candidates)
    state.progress("with measured inputs, for what happens behind them", 0, 0)
    store = other_store(state.store, "measured")
    behind_them = Fits(replace(fits.problem, runs=shown), state.settings, store, state.key, state.progress, limit=state.limit)
    body = explain(behind_them, downstream_candidates(state.open_candidates, measured_inputs(fits.problem.runs, signals)), state.seed)
    state.progress("with commanded inputs", 0, 0)
    return Screened(**vars(state), candidates=exclude_by_measured_inputs(body, state.open_candidates, state.settings))


def select(state: Screened) -> Selected:
    """Select the set of effects that explains the gap."""
    return Selected(**vars(state), explanation=explain(state.fits, state.candidates, state.seed))


def validate(state: Selected) -> Validated:
    """Predict all runs with the nominal, the recalibrated and the corrected model and a black box."""
    state.progress("judging on validation runs", 0, 0)
    dataset, noise = state.dataset, state.noise
    compared = compare_models(state.fits, state.explanation, dataset, state.plant, state.nominal, noise, state.seed)
    predictions, errors = compared.predictions, validation_errors(dataset, noise, compared.predictions, compared.black_box)
    if state.explanation.best.effects and dataset.validation and not reduces_validation_error(errors):
        predictions, errors = _leave_out_absent(state, compared, errors)
    shift = None if state.plant.static else check_clock(dataset.runs, predictions["recalibrated"], predictions["corrected"], noise)
    return Validated(
        **vars(state),
        predictions=predictions,
        black_box=compared.black_box,
        localisation=compared.localisation,
        best=compared.best,
        errors=errors,
        clock_shift=shift,
    )


def _leave_out_absent(state: Selected, compared: Comparison, errors: Errors) -> tuple[dict[str, list[np.ndarray]], Errors]:
    """Predictions and errors with effects left out of validation runs that do not show them, where that closes the gap; else as they were.

    What hung on the arm may have been taken off before those runs: then its model is right, but without it there.
    """
    dataset, noise, effects = state.dataset, state.noise, state.explanation.best.effects
    acts = [replace(effect, runs=active_runs(effect, compared.best, dataset, noise)) for effect in effects]
    if all(one.runs == other.runs for one, other in zip(acts, effects, strict=True)):
        return compared.predictions, errors
    plant = restrict_effects_to_runs(without_run_restriction(compared.best.plant), acts)
    predictions = compared.predictions | {"corrected": predict_runs(plant, dataset, noise)}
    found = validation_errors(dataset, noise, predictions, compared.black_box)
    demand = replace(ASSESSMENT, min_gap_closed=ASSESSMENT.min_gap_closed_absent)
    return (predictions, found) if reduces_validation_error(found, demand) else (compared.predictions, errors)


def assess(state: Validated) -> Assessed:
    """Weigh every selected effect; drop all of them where a clock or something unknown is the likelier cause."""
    explanation, settings = state.explanation, state.settings
    checks = EffectChecks(
        alternative_law_odds(explanation, settings, state.seed), _constancy(state), constant_force_probabilities(explanation.best, settings)
    )
    judgement = assess_effects(explanation, state.errors if state.dataset.validation else None, settings, checks, state.plant.modules)
    if state.baseline is not None:
        judgement = judge_change(judgement, explanation, settings, state.baseline, state.dataset.fit)
    judgement = _limit(judgement, state.limit, settings)
    judgement = calibrate_judgement(judgement, explanation.gauge_effects)
    dropped = explanation.best.effects and (state.clock_shift or judgement.status is VerdictStatus.UNEXPLAINED)
    if not dropped:
        return Assessed(**vars(state), judgement=judgement, cause_scores=score_causes(explanation, judgement, settings))
    predictions = state.predictions | {"corrected": state.predictions["recalibrated"]}
    fields: dict[str, Any] = vars(state) | {
        "explanation": (nothing := replace(explanation, best=explanation.without, shares={}, groups={})),
        "predictions": predictions,
        "best": explanation.without.estimate,
        "errors": validation_errors(state.dataset, state.noise, predictions, state.black_box),
    }
    judgement = Judgement(VerdictStatus.UNEXPLAINED, remarks=judgement.remarks)
    return Assessed(**fields, judgement=judgement, cause_scores=score_causes(nothing, judgement, settings))


def report(state: Assessed) -> Discovery:
    """Put the answer into words and tables."""
    return Discovery(build_verdict(state), state.dataset, state.noise, state.localisation, state.predictions, state.explanation)


STAGES: tuple[Callable[[Any], Any], ...] = (check_setup, prepare, recalibrate, screen, select, validate, assess, report)
"""The workflow: each takes the state that the one before it returns, from a `Question` to a `Discovery`."""


def other_store(store: Path | None, name: str) -> Path | None:
    """A file for the fits of another search."""
    return None if store is None else store.with_name(f"{store.name}-{name}")


def _limit(judgement: Judgement, limit: TimeLimit, settings: SearchSettings) -> Judgement:
    """Take the answer of a search that left something untried for a part at best.

    Every untried set of effects without an effect counts as one more of its rivals, as probable as the most probable of them.
    """
    if not limit.was_short:
        return judgement
    most: dict[Candidate, float] = {}
    for of, _, _, p in judgement.listed:
        most[of] = max(most.get(of, 0.0), p)
    listed = tuple((of, effect, fit, p / (1 + limit.rivals(effect) * most[of])) for of, effect, fit, p in judgement.listed)
    remarks = (limit.remark, *judgement.remarks)
    if max((p for *_, p in listed), default=0.0) < settings.min_listed_probability:
        return Judgement(VerdictStatus.UNEXPLAINED, remarks=remarks)
    status = VerdictStatus.PARTIAL if judgement.status is VerdictStatus.NAMED else judgement.status
    return replace(judgement, status=status, listed=listed, remarks=remarks)


def _constancy(state: Validated) -> dict[Candidate, dict[str, SegmentSizes]]:
    """Sizes of every effect in parts of the data, but for those that gauges have shown."""
    best = state.explanation.best
    if not (state.settings.check_constancy and best.effects):
        return {}
    linear = linearise(best.estimate, state.fits.problem.free, best.effects, (), state.settings)
    return {effect: effect_size_by_segment(linear, effect) for effect in best.effects if effect not in state.explanation.gauge_effects}


def with_initial_states(problem: Problem, settings: SearchSettings) -> Problem:
    """The problem with estimated initial states of its runs and blocks as long as residuals remember, where settings ask for it."""
    if not settings.estimate_beginnings:
        return problem
    found = identify(problem)
    runs = tuple(
        with_estimated_initial_state(found.plant, run, noise, problem.step) for run, noise in zip(problem.runs, problem.noises, strict=True)
    )
    block = problem.block if problem.plant.static else independent_after(found.residuals, runs)
    return replace(problem, runs=runs, block=block)
