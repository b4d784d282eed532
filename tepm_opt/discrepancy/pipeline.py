"""The discrepancy workflow as a pipeline of stages (`stages.py`), run, timed and repeated where a beginning or a run is odd.

States are frozen, so that a stage can be run, timed or replaced alone (`DiscoverOptions(stages=…)`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from tepm_opt.data.run import RunSet
from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.assessment.validation import predict_runs
from tepm_opt.discrepancy.baseline.baseline import Baseline, fit_baseline
from tepm_opt.discrepancy.preparation.beginnings import remove_beginnings
from tepm_opt.discrepancy.problem.plant import SearchablePlant
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.problem.time_limit import TimeLimit
from tepm_opt.discrepancy.reporting.sentences import next_step
from tepm_opt.discrepancy.setup.errors import foreign_run
from tepm_opt.discrepancy.setup.foreign import is_outermost, odd_run
from tepm_opt.discrepancy.stages import STAGES, other_store, prepare, recalibrate
from tepm_opt.discrepancy.state import Discovery, Question
from tepm_opt.errors import InputError
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.mechanics.plant import PredictionError


def learn_baseline(question: Question) -> Baseline:
    """Fit the known parameters to an earlier recording and estimate what the model misses there.

    Its set-up is taken as it is: a set-up that has changed since shows in the other recording.

    Args:
        question: about the recording.

    Raises:
        InputError: no run to fit to, too short a recording, or the model cannot do the runs.
    """
    require_fit_runs(question.dataset)
    try:
        state = recalibrate(prepare(question))
        fits = state.fits
        without = fits.fit((), {})
        if without is None:
            raise PredictionError("no motion with any values of the parameters")
        shown = fits.fit(fits.gauge_effects, {**without.estimate.named, **fits.values}) if fits.gauge_effects else None
        found = shown or without
        estimate = replace(found.estimate, problem=replace(found.estimate.problem, plant=found.estimate.plant))
        return fit_baseline(question.dataset.name, estimate, found.evidence, question.plant.known, question.settings)
    except PredictionError as error:
        raise InputError(f"{question.dataset.name}: the model cannot do the runs: {error}") from error


def require_fit_runs(dataset: RunSet) -> None:
    """Refuse a data set without a run to fit to, which costs nothing before a model is compiled.

    Raises:
        InputError: no run has the role "fit".
    """
    if not dataset.fit:
        raise InputError(f"{dataset.name}: no run has the role 'fit'; there is nothing to learn from")


@dataclass(frozen=True)
class DiscoverOptions:
    """Options of a search for what is missing.

    Attributes:
        seed: of all random draws.
        settings: thresholds of the search; those for the plant where absent.
        store: file that keeps the fits, so that an interrupted search can go on; None keeps nothing.
        key: content of `store` is used only if it was made with the same key.
        stages: of the pipeline; others, or these with more between, may stand in their place.
        limit: after which no more sets of effects are fitted; the answer says which were not, and is `partial` at best.
    """

    seed: int = 0
    settings: SearchSettings | None = None
    store: Path | None = None
    key: str = ""
    stages: Sequence[Callable[[Any], Any]] = STAGES
    limit: TimeLimit | None = None


@threadpool_limits.wrap(limits=1, user_api="blas")  # the cores have runs to simulate; and numbers do not depend on how many there are
def discover(
    dataset: RunSet, plant: SearchablePlant, noise: float | np.ndarray, baseline: Baseline | None = None,
    options: DiscoverOptions | None = None, progress: Progress = silent,
) -> Discovery:  # fmt: skip
    """Explain the gap between a model and a data set.

    Args:
        dataset: checked data.
        plant: the model, with the effects that may be missing at their null values.
        noise: of the measurements, 1 sigma per axis in m, or of each point, (points, 1).
        baseline: an earlier recording of the machine (`learn_baseline`); the answer then tells what changed since.
        options: seed, thresholds, limit and stages of the search, and where it keeps its fits.
        progress: told of every piece of work.

    Raises:
        InputError: no run to fit to, or the model cannot do the runs.
    """
    began, options = time.monotonic(), options or DiscoverOptions()
    require_fit_runs(dataset)
    settings, stages = options.settings or SearchSettings.for_plant(plant), options.stages
    if baseline is not None:
        plant, settings = plant.with_values(baseline.values), baseline.adapt(settings, dataset.fit)
    limit = options.limit or TimeLimit()
    question = Question(dataset, plant, noise, settings, options.seed, options.store, options.key, progress, baseline=baseline, limit=limit)
    found = run_stages(question, stages)
    if found.verdict.status is VerdictStatus.UNEXPLAINED and settings.drop_beginnings and not plant.static:
        found = _without_beginnings(question, found, stages)
    if found.verdict.status in (VerdictStatus.UNEXPLAINED, VerdictStatus.PARTIAL):
        found = _without_odd_run(question, found, stages)
    return replace(found, verdict=replace(found.verdict, seconds=time.monotonic() - began))


def _without_beginnings(question: Question, found: Discovery, stages: Sequence[Callable[[Any], Any]]) -> Discovery:
    """The workflow once more without beginnings of runs that no model explains; what was found before where that names nothing."""
    shorter, remarks = remove_beginnings(found.dataset, found.predictions["recalibrated"], found.noise)
    if not remarks:
        return found
    if question.limit.is_over:
        return _remark(found, "Beginnings of runs that nothing explains are still in the data: there was no time to search without them.")
    question.progress("once more without beginnings that nothing explains", 0, 0)
    again = run_stages(replace(question, dataset=shorter, store=other_store(question.store, "shorter")), stages)
    if not again.verdict.effects:
        return found
    notes = tuple(dict.fromkeys((*remarks, *again.verdict.notes)))
    return replace(again, verdict=replace(again.verdict, notes=notes))


def _without_odd_run(question: Question, found: Discovery, stages: Sequence[Callable[[Any], Any]]) -> Discovery:
    """The workflow once more without a run that disagrees with all others; what was found before where that does not explain the rest.

    Effects that stand in for what is different in that run may hide it: the model without effects counts as well, where it explains all
    the others.
    """
    dataset, allowed = found.dataset, {VerdictStatus.NO_DISCREPANCY}
    odd = odd_run(dataset.runs, found.predictions["corrected"], found.noise)
    if odd is None:
        odd = odd_run(dataset.runs, found.predictions["recalibrated"], found.noise)
    else:
        allowed.add(VerdictStatus.NAMED)
    if odd is None:
        return found
    rest = dataset.with_runs([run for number, run in enumerate(dataset.runs) if number != odd[0]])
    if not rest.fit or bool(rest.validation) is not bool(dataset.validation):
        return found
    file = dataset.runs[odd[0]].file
    if question.limit.is_over:
        return _remark(found, f"{file} disagrees with all other runs: there was no time to search without it.")
    question.progress(f"once more without {file}", 0, 0)
    again = run_stages(replace(question, dataset=rest, store=other_store(question.store, "without")), stages)
    if again.verdict.status not in allowed:
        return found
    still = odd_run(dataset.runs, predict_runs(again.explanation.best.estimate.plant, dataset, again.noise), again.noise)
    if still is None or still[0] != odd[0]:
        return found
    if is_outermost(dataset.runs, odd[0]) and any(effect.timed for effect in again.explanation.best.effects):
        return found  # how the effect goes on is the effect's form, not another set-up
    status, setup = VerdictStatus.SETUP_ERROR, (*again.verdict.setup, foreign_run(file, still[1]))
    return replace(again, verdict=replace(again.verdict, status=status, setup=setup, next=next_step(status)))


def _remark(found: Discovery, sentence: str) -> Discovery:
    """The outcome with one more note."""
    return replace(found, verdict=replace(found.verdict, notes=(*found.verdict.notes, sentence)))


def run_stages(question: Question, stages: Sequence[Callable[[Any], Any]] = STAGES) -> Discovery:
    """Run the stages one after the other, each timed.

    Raises:
        InputError: the model cannot do the runs.
    """
    state: Any = question
    seconds: dict[str, float] = {}
    for stage in stages:
        began = time.monotonic()
        try:
            state = stage(state)
        except PredictionError as error:
            raise InputError(f"{question.dataset.name}: the model cannot do the runs: {error}") from error
        seconds[stage.__name__] = time.monotonic() - began
    return replace(state, seconds=seconds)
