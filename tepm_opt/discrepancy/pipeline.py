"""The discrepancy workflow: is there a gap, where, which effect is missing, and how does the gap shrink once it is in the model?"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from tepm_opt.data.metrics import axes_measured, error_over_time
from tepm_opt.data.outliers import without_strays
from tepm_opt.data.run import RunSet
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.adapters.network import SearchableNetwork
from tepm_opt.discrepancy.assessment.black_box import predict_residuals
from tepm_opt.discrepancy.assessment.constancy import SegmentSizes, active_runs, effect_size_by_segment, extend_to_validation_runs
from tepm_opt.discrepancy.assessment.credibility import Judgement, alternative_law_odds, assess
from tepm_opt.discrepancy.assessment.residual_locations import Localisation, error_unit, localise
from tepm_opt.discrepancy.assessment.result import Errors, Named, Rival, Value, Verdict, VerdictStatus
from tepm_opt.discrepancy.preparation.beginnings import remove_beginnings
from tepm_opt.discrepancy.preparation.clock import check_clock
from tepm_opt.discrepancy.preparation.devices import identify_devices
from tepm_opt.discrepancy.preparation.measured_inputs import (
    downstream_candidates,
    exclude_by_measured_inputs,
    measured_inputs,
    with_measured_inputs,
)
from tepm_opt.discrepancy.preparation.noise import describe_noise, estimate_noise
from tepm_opt.discrepancy.problem.plant import Candidate, SearchablePlant
from tepm_opt.discrepancy.reporting import sentences as words
from tepm_opt.discrepancy.selection.fitting import Fits, Hypothesis, SearchSettings
from tepm_opt.discrepancy.selection.forward_backward import Explanation, explain
from tepm_opt.discrepancy.selection.linearised import linearised
from tepm_opt.discrepancy.symbolic.invent import Invention
from tepm_opt.errors import InputError
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.identify import ParameterEstimate, Problem, identify
from tepm_opt.solvers.parallel import beside
from tepm_opt.solvers.plant import Plant, PredictionError
from tepm_opt.solvers.predict import LONGEST_STEP
from tepm_opt.solvers.residuals import independent_after
from tepm_opt.solvers.start import begun
from tepm_opt.solvers.start import predictions as predicted
from tepm_opt.solvers.text import shortened

PRECISE_STEP = 0.01  # s, for the predictions that are reported
FINEST_STEP = 0.005  # s, for the values: what a longer step damps shows in a damping beside a deviation of a few 1e-4


@dataclass(frozen=True, eq=False)
class Discovery:
    """What the workflow found, with what figures need.

    Attributes:
        verdict: the answer.
        dataset: what it is about.
        noise: of what is measured, 1 sigma per axis.
        localisation: where the model misses.
        predictions: modelled points of every run by "nominal", "recalibrated" and "corrected", (rows, points, 3) in m each.
        explanation: all fits.
        law: what was found where no known effect explains what is left and a law was asked for.
    """

    verdict: Verdict
    dataset: RunSet
    noise: float | np.ndarray
    localisation: Localisation
    predictions: dict[str, list[np.ndarray]]
    explanation: Explanation
    law: Invention | None = None

    def __repr__(self) -> str:
        """The outcome and the main numbers, in a line."""
        return f"Discovery({self.verdict.status.value}, {shortened(self.dataset.name, 40)}, {len(self.explanation.tried)} fits)"


def require_fit_runs(dataset: RunSet) -> None:
    """Refuse a data set without a run to fit to, which costs nothing before a model is compiled.

    Raises:
        InputError: no run has the role "fit".
    """
    if not dataset.fit:
        raise InputError(f"{dataset.name}: no run has the role 'fit'; there is nothing to learn from")


@threadpool_limits.wrap(limits=1, user_api="blas")  # the cores have runs to simulate; and numbers do not depend on how many there are
def discover(
    dataset: RunSet, plant: SearchablePlant, noise: float | np.ndarray, seed: int = 0, store: Path | None = None, key: str = "",
    settings: SearchSettings | None = None, progress: Progress = silent,
) -> Discovery:  # fmt: skip
    """Explain the gap between a model and a data set.

    Args:
        dataset: checked data.
        plant: what is known of the machine, with the effects that may be missing at their null values.
        noise: assumed of what is measured, 1 sigma per axis, or of each point, (points, 1).
        seed: of all random draws.
        store: file that keeps the fits, so that an interrupted search can go on; None keeps nothing.
        key: what `store` must have been made from to be used.
        settings: when structure counts and when an effect is believed.
        progress: told of every piece of work.

    Raises:
        InputError: no run to fit to, or the model cannot do the runs.
    """
    began, settings = time.monotonic(), settings or SearchSettings.of(plant)
    require_fit_runs(dataset)
    found = _explain_all_data(dataset, plant, noise, seed, store, key, settings, progress)
    if found.verdict.status is VerdictStatus.UNEXPLAINED and plant.quick and not plant.static:
        shorter, remarks = remove_beginnings(found.dataset, found.predictions["recalibrated"], found.noise)
        if remarks:
            progress("once more without beginnings that nothing explains", 0, 0)
            aside = None if store is None else store.with_name(f"{store.name}-shorter")
            again = _explain_all_data(shorter, plant, noise, seed, aside, key, settings, progress)
            if again.verdict.effects:
                notes = tuple(dict.fromkeys((*remarks, *again.verdict.notes)))
                found = replace(again, verdict=replace(again.verdict, notes=notes))
    return replace(found, verdict=replace(found.verdict, seconds=time.monotonic() - began))


def _explain_all_data(
    dataset: RunSet, plant: SearchablePlant, noise: float | np.ndarray, seed: int, store: Path | None, key: str,
    settings: SearchSettings, progress: Progress,
) -> Discovery:  # fmt: skip
    """`discover`, all data taken as they are."""
    missing = downstream_candidates(plant.candidates, dataset.gauges)
    progress("simulating the runs with the model as it is", 0, 0)
    nominal = _predict(plant, dataset, noise)
    remarks: list[str] = []
    if not plant.static:
        dataset, remarks = without_strays(dataset, nominal, noise)
    seen = identify_devices(dataset, plant) if isinstance(plant, SearchableNetwork) and not plant.static else None
    if seen is not None:
        dataset, remarks = dataset.with_runs(seen.runs), [*remarks, f"{seen.note}."]
    step = _step(plant, dataset, nominal, noise, settings)
    problem = Problem(plant, dataset.fit, plant.free(plant.known), noise, step=step, derivatives_apart=plant.derivatives_apart)
    try:
        first = Fits(_recalibrated(problem), settings, progress=progress)
        noise, scattering = _noise_seen(first, noise, plant.signals)
        remarks += scattering
        done = first.done if np.all(noise == problem.noise) else {}
        shown, values = ((), {}) if seen is None else (seen.shown, seen.values)
        fits = Fits(replace(first.problem, noise=noise), settings, store, key, progress, shown, values, done)
        del first  # its fits are as large as the data
        possible = _possible(fits, missing, plant.signals, seed) if seen is None else seen.narrow_candidates(missing)
        explanation = explain(fits, possible, seed)
    except PredictionError as error:
        raise InputError(f"{dataset.name}: the model cannot do the runs: {error}") from error
    progress("judging on validation runs", 0, 0)
    predictions, bound, localisation, best = _compared(fits, explanation, dataset, plant.signals, nominal, noise, seed)
    recalibrated = predictions["recalibrated"]
    shift = "" if plant.static else check_clock(dataset.runs, recalibrated, predictions["corrected"], noise)
    errors = _errors(dataset, noise, predictions, bound)
    constancy = _constancy(fits.problem, explanation)
    laws, unseen = alternative_law_odds(explanation, settings, seed), bool(dataset.validation)
    judgement = assess(explanation, errors, settings, unseen, laws, constancy, plant.modules)
    if explanation.best.effects and (shift or judgement.status is VerdictStatus.UNEXPLAINED):
        # they take the place of a clock, which is no effect, or of what nobody knows
        explanation = replace(explanation, best=explanation.without, shares={}, groups={})
        predictions["corrected"], best = recalibrated, explanation.without.estimate
        errors = _errors(dataset, noise, predictions, bound)
        judgement = Judgement(VerdictStatus.UNEXPLAINED, remarks=judgement.remarks)
    looked_for = [effect for effect in explanation.best.effects if effect not in explanation.shown]
    acts = dict.fromkeys(explanation.shown, ()) | {effect: active_runs(effect, best, dataset, noise) for effect in looked_for}
    verdict = _verdict(dataset, plant, noise, explanation, best, errors, localisation, judgement, acts, shift)
    notes = tuple(dict.fromkeys((*([f"{shift}."] if shift else []), *remarks, *judgement.remarks, *verdict.notes)))
    verdict = replace(verdict, notes=notes)
    return Discovery(verdict, dataset, noise, localisation, predictions, explanation)


def _noise_seen(fits: Fits, noise: float | np.ndarray, signals: Signals) -> tuple[float | np.ndarray, list[str]]:
    """The noise as what recalibration leaves of motions shows it, and what a reader should know of it."""
    first = fits.fit((), {})
    if first is None or fits.problem.plant.static:
        return noise, []
    found, scatters = estimate_noise(noise, fits.problem.runs, first.estimate.residuals)
    return found, describe_noise(scatters, noise, signals)


def _possible(fits: Fits, missing: Sequence[Candidate], signals: Signals, seed: int) -> Sequence[Candidate]:
    """The candidates that are left once measured inputs, where there are some, have shown what happens behind them."""
    problem = fits.problem
    shown = with_measured_inputs(problem.runs, signals)
    if shown is None:
        return missing
    fits.progress("with measured inputs, for what happens behind them", 0, 0)
    aside = None if fits.store is None else fits.store.with_name(f"{fits.store.name}-measured")
    behind_them = Fits(replace(problem, runs=shown), fits.settings, aside, fits.key, fits.progress)
    body = explain(behind_them, downstream_candidates(missing, measured_inputs(problem.runs, signals)), seed)
    fits.progress("with commanded inputs", 0, 0)
    return exclude_by_measured_inputs(body, missing, fits.settings)


def _compared(
    fits: Fits, explanation: Explanation, dataset: RunSet, signals: Signals,
    nominal: list[np.ndarray], noise: float | np.ndarray, seed: int,
) -> tuple[dict[str, list[np.ndarray]], list[np.ndarray], Localisation, ParameterEstimate]:  # fmt: skip
    """Predictions of all runs, those of a black box for the judged ones, where the model misses, and the best fit with the precise step.

    Args:
        fits: with the problem they are of.
        explanation: what the search found.
        dataset: all runs.
        signals: what is measured.
        nominal: predictions of the model as it was.
        noise: of what is measured, 1 sigma per axis.
        seed: of random draws.
    """
    static = fits.problem.plant.static

    def corrected() -> tuple[ParameterEstimate, list[np.ndarray]]:
        best = _refined(explanation.best.estimate)
        return best, _predict(extend_to_validation_runs(best.plant, explanation.best.effects, dataset), dataset, noise)

    def looked_at() -> tuple[list[np.ndarray], Localisation, list[np.ndarray]]:
        recalibrated = _predict(explanation.without.estimate.plant, dataset, noise)
        nothing = not explanation.best.effects and explanation.without.only_noise(fits.settings)
        compared = nominal if nothing else recalibrated
        place = localise(dataset.runs, compared, noise, signals, static, seed, fits.problem.block)
        return recalibrated, place, _bounded(dataset, recalibrated, static)

    (recalibrated, place, bound), (best, points) = beside(looked_at, corrected, fits.problem.plant.concurrent)
    return {"nominal": nominal, "recalibrated": recalibrated, "corrected": points}, bound, place, best


def _constancy(problem: Problem, explanation: Explanation) -> dict[Candidate, dict[str, SegmentSizes]]:
    """Sizes of every effect in parts of the data, but for those that gauges have shown."""
    best = explanation.best
    if problem.plant.quick or not best.effects:
        return {}
    linear = linearised(best.estimate, problem.free, best.effects, ())
    return {effect: effect_size_by_segment(linear, effect) for effect in best.effects if effect not in explanation.shown}


def _recalibrated(problem: Problem) -> Problem:
    """The problem of a quick plant as recalibration leaves it: states from which its runs begin, blocks as long as residuals remember."""
    if not problem.plant.quick:
        return problem
    found = identify(problem)
    runs = tuple(begun(found.plant, run, noise, problem.step) for run, noise in zip(problem.runs, problem.noises, strict=True))
    block = problem.block if problem.plant.static else independent_after(found.residuals, runs)
    return replace(problem, runs=runs, block=block)


def _predict(plant: Plant, dataset: RunSet, noise: float | np.ndarray) -> list[np.ndarray]:
    try:
        return [found.points for found in predicted(plant, dataset.runs, noise, PRECISE_STEP)]
    except PredictionError as error:
        raise InputError(f"{dataset.name}: the model cannot do the runs: {error}") from error


def _step(plant: Plant, dataset: RunSet, precise: Sequence[np.ndarray], noise: float | np.ndarray, settings: SearchSettings) -> float:
    """The longest time step whose errors do not count beside the noise."""
    if plant.static:
        return PRECISE_STEP
    try:
        coarse = predicted(plant, dataset.fit, noise, LONGEST_STEP)
    except PredictionError:
        return PRECISE_STEP
    fit = [points for run, points in zip(dataset.runs, precise, strict=True) if run.role == "fit"]
    square = np.mean(np.array([np.mean(((a.points - b) / noise) ** 2) for a, b in zip(coarse, fit, strict=True)]))
    return LONGEST_STEP if square < settings.max_noise_excess / 5 else PRECISE_STEP


def _refined(estimate: ParameterEstimate) -> ParameterEstimate:
    """The fit with the finest step, from its values."""
    free = tuple(replace(f, start=float(value)) for f, value in zip(estimate.problem.free, estimate.values, strict=True))
    step = PRECISE_STEP if estimate.problem.plant.quick else FINEST_STEP
    try:
        return identify(replace(estimate.problem, free=free, step=step), 3, near=True)
    except PredictionError:
        return estimate


def _verdict(
    dataset: RunSet, plant: SearchablePlant, noise: float | np.ndarray, explanation: Explanation, best: ParameterEstimate,
    errors: Errors, localisation: Localisation, judgement: Judgement, acts: Mapping[Candidate, tuple[str, ...]], shift: str,
) -> Verdict:  # fmt: skip
    unit = error_unit(plant.signals, noise)
    status = judgement.status
    named = [
        Named(
            other,
            probability,
            _values(best if hypothesis is explanation.best else hypothesis.estimate, hypothesis.form_error, other),
            _only(explanation, effect, hypothesis),
            acts.get(effect, ()),
        )
        for effect, other, hypothesis, probability in judgement.listed
    ]
    rivals = _rivals(explanation, named, judgement.cause)
    corrected = plant.with_values(best.plant.values).corrected(explanation.best.effects)
    notes = words.collect_notes(dataset, plant.signals, explanation, best, noise, errors)
    form_error = explanation.best.form_error
    known = {name: _value(best, form_error, name, plant.values[name]) for name in plant.known}
    text = words.describe_answer(status, named, errors, localisation.sentence, known, explanation, unit)
    where = tuple(place for place in localisation.places if place.p <= 0.01)
    return Verdict(
        status,
        text,
        tuple(named),
        rivals,
        where,
        known,
        errors,
        corrected,
        notes,
        machine=plant.name,
        unit=unit,
        fits=len(explanation.tried),
        next=words.next_step(status, shift),
    )


def _only(explanation: Explanation, effect: Candidate, hypothesis: Hypothesis) -> float:
    """Part of the structure left by recalibration that is gone with the effect and there without it."""
    rest = tuple(c for c in explanation.best.effects if c != effect)
    there = max(explanation.without.excess, 1e-12)
    fitted = next((h.excess for h in explanation.tried if h.effects == rest), None)
    if fitted is None and effect in explanation.shares and np.isfinite(explanation.shares[effect]):
        return min(explanation.shares[effect] * hypothesis.excess / there, 1.0)  # to first order
    return ((explanation.without.excess if fitted is None else fitted) - hypothesis.excess) / there


def _value(estimate: ParameterEstimate, form_error: np.ndarray, name: str, nominal: float) -> Value:
    at = [f.name for f in estimate.problem.free].index(name)
    std = float(np.hypot(estimate.std[at], form_error[at]))
    return Value(float(estimate.values[at]), std, estimate.problem.free[at].unit, nominal)


def _values(estimate: ParameterEstimate, form_error: np.ndarray, candidate: Candidate) -> dict[str, Value]:
    return {name.rpartition(".")[2]: _value(estimate, form_error, name, candidate.null[name]) for name in candidate.parameters}


def _rivals(explanation: Explanation, named: Sequence[Named], cause: Mapping[Candidate, float]) -> tuple[Rival, ...]:
    """One entry for every effect that was not named: its best detail, fitted or not."""
    taken = {each.candidate.name for each in named}
    found: dict[str, Rival] = {}
    for effect, group in explanation.groups.items():
        for hypothesis, weight in group[1:]:
            other = next(c for c in hypothesis.effects if c not in explanation.best.effects)
            closes = explanation.closes(hypothesis)
            rival = Rival(other, weight * cause[effect], words.rejection_reason(explanation, effect, hypothesis), closes)
            if other.name not in taken and (other.name not in found or found[other.name].probability < rival.probability):
                found[other.name] = rival
    for hypothesis in explanation.tried:
        for other in hypothesis.effects:
            if len(hypothesis.effects) == 1 and other.name not in taken and other.name not in found:
                found[other.name] = Rival(other, 0.0, words.single_effect_reason(explanation, hypothesis), explanation.closes(hypothesis))
    for score in explanation.scores:
        if score.candidate.name not in taken and score.candidate.name not in found:
            found[score.candidate.name] = Rival(score.candidate, 0.0, words.not_fitted_reason(score), None)
    return tuple(sorted(found.values(), key=lambda rival: (-rival.probability, -(rival.closes or -1.0), rival.candidate.label)))


def _judged(dataset: RunSet) -> list[int]:
    """Numbers of the validation runs that measured something; of all runs where there are none."""
    runs = dataset.runs
    return [k for k, run in enumerate(runs) if run.role == "validation" and np.isfinite(run.points).any()] or list(range(len(runs)))


def _bounded(dataset: RunSet, recalibrated: Sequence[np.ndarray], static: bool) -> list[np.ndarray]:
    """Points of the judged runs as a black box has them that learns from the runs fitted to, (rows, points, 3) in m each."""
    learnt, judged = [k for k, run in enumerate(dataset.runs) if run.role == "fit"], _judged(dataset)
    left = [dataset.runs[k].points - recalibrated[k] for k in learnt]
    size = np.maximum(np.max([np.abs(run.inputs).max(axis=0) for run in dataset.runs], axis=0), 1e-12)
    guessed = predict_residuals([dataset.runs[k] for k in learnt], left, size, [dataset.runs[k] for k in judged], static)
    return [recalibrated[k] + guess for k, guess in zip(judged, guessed, strict=True)]


def _errors(dataset: RunSet, noise: float | np.ndarray, predictions: dict[str, list[np.ndarray]], bound: Sequence[np.ndarray]) -> Errors:
    """Of the predictions, and of a black box's for the judged runs."""
    judged = _judged(dataset)
    size, alone = (noise, 1.0) if np.ndim(noise) else (1.0, float(noise))  # quantities of different kinds are compared by their noise
    measured = np.concatenate([dataset.runs[k].points for k in judged]) / size
    found = {name: error_over_time(measured, np.concatenate([points[k] for k in judged]) / size) for name, points in predictions.items()}
    floor = float(np.sqrt(axes_measured(measured)) * alone)
    return Errors(noise_floor=floor, black_box=error_over_time(measured, np.concatenate(bound) / size), **found)
