"""Predictions of the compared models for all runs, and their errors on the validation runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.data.metrics import axes_measured, error_over_time
from tepm_opt.data.run import RunSet
from tepm_opt.discrepancy.assessment.black_box import predict_residuals
from tepm_opt.discrepancy.assessment.constancy import extend_to_validation_runs
from tepm_opt.discrepancy.assessment.residual_locations import Localisation, localise
from tepm_opt.discrepancy.assessment.result import Errors
from tepm_opt.discrepancy.preparation.time_step import PRECISE_STEP
from tepm_opt.discrepancy.problem.plant import SearchablePlant
from tepm_opt.discrepancy.selection.fitting import Fits
from tepm_opt.discrepancy.selection.forward_backward import Explanation
from tepm_opt.solvers.identification.identify import ParameterEstimate, identify
from tepm_opt.solvers.identification.initial_state import predictions
from tepm_opt.solvers.mechanics.plant import Plant, PredictionError
from tepm_opt.solvers.numerics.parallel import run_concurrently


@dataclass(frozen=True, eq=False)
class Comparison:
    """Predictions of the compared models.

    Attributes:
        predictions: by "nominal", "recalibrated" and "corrected", (rows, points, 3) in m a run.
        black_box: points of the validation runs as a black box predicts them.
        localisation: where the model misses.
        best: the selected fit with the precise time step.
    """

    predictions: dict[str, list[np.ndarray]]
    black_box: list[np.ndarray]
    localisation: Localisation
    best: ParameterEstimate


def predict_runs(plant: Plant, dataset: RunSet, noise: float | np.ndarray) -> list[np.ndarray]:
    """Points of all runs with the precise time step, (rows, points, 3) in m each.

    Raises:
        PredictionError: the model cannot do the runs.
    """
    return [found.points for found in predictions(plant, dataset.runs, noise, PRECISE_STEP)]


def compare_models(
    fits: Fits, explanation: Explanation, dataset: RunSet, machine: SearchablePlant,
    nominal: list[np.ndarray], noise: float | np.ndarray, seed: int,
) -> Comparison:  # fmt: skip
    """Predict all runs with the nominal, the recalibrated and the corrected model, and the validation runs with a black box.

    Args:
        fits: of the search.
        explanation: with the selected effects.
        dataset: all runs.
        machine: the nominal model.
        nominal: predictions of the model as it was.
        noise: of the measurements, 1 sigma per axis.
        seed: of random draws.
    """
    plant = fits.problem.plant

    def predict_corrected() -> tuple[ParameterEstimate, list[np.ndarray]]:
        best = _refine_fit(explanation.best.estimate, fits.settings.final_step)
        return best, predict_runs(extend_to_validation_runs(best.plant, explanation.best.effects, dataset), dataset, noise)

    def predict_recalibrated() -> tuple[list[np.ndarray], Localisation, list[np.ndarray]]:
        recalibrated = predict_runs(machine.without_candidates.with_values(explanation.without.estimate.named), dataset, noise)
        nothing = not explanation.best.effects and explanation.without.only_noise(fits.settings)
        compared = nominal if nothing else recalibrated
        place = localise(dataset.runs, compared, noise, machine.signals, plant.static, seed, fits.problem.block)
        return recalibrated, place, _predict_black_box(dataset, recalibrated, plant.static)

    (recalibrated, place, bound), (best, points) = run_concurrently(predict_recalibrated, predict_corrected, plant.concurrent)
    return Comparison({"nominal": nominal, "recalibrated": recalibrated, "corrected": points}, bound, place, best)


def validation_errors(
    dataset: RunSet, noise: float | np.ndarray, predictions: Mapping[str, list[np.ndarray]], black_box: Sequence[np.ndarray]
) -> Errors:
    """Errors of the models and of the black box on the validation runs.

    Args:
        dataset: all runs.
        noise: of the measurements, 1 sigma per axis.
        predictions: by model, (rows, points, 3) in m a run.
        black_box: points of the validation runs as a black box predicts them.
    """
    judged = _validation_runs(dataset)
    size, alone = (noise, 1.0) if np.ndim(noise) else (1.0, float(noise))  # quantities of different kinds are compared by their noise
    measured = np.concatenate([dataset.runs[k].points for k in judged]) / size
    found = {name: error_over_time(measured, np.concatenate([points[k] for k in judged]) / size) for name, points in predictions.items()}
    floor = float(np.sqrt(axes_measured(measured)) * alone)
    return Errors(noise_floor=floor, black_box=error_over_time(measured, np.concatenate(black_box) / size), **found)


def _validation_runs(dataset: RunSet) -> list[int]:
    """Numbers of the validation runs that measured something; of all runs where there are none."""
    runs = dataset.runs
    return [k for k, run in enumerate(runs) if run.role == "validation" and np.isfinite(run.points).any()] or list(range(len(runs)))


def _predict_black_box(dataset: RunSet, recalibrated: Sequence[np.ndarray], static: bool) -> list[np.ndarray]:
    """Points of the validation runs as a black box has them that learns from the runs fitted to, (rows, points, 3) in m each."""
    learnt, judged = [k for k, run in enumerate(dataset.runs) if run.role == "fit"], _validation_runs(dataset)
    left = [dataset.runs[k].points - recalibrated[k] for k in learnt]
    size = np.maximum(np.max([np.abs(run.inputs).max(axis=0) for run in dataset.runs], axis=0), 1e-12)
    guessed = predict_residuals([dataset.runs[k] for k in learnt], left, size, [dataset.runs[k] for k in judged], static)
    return [recalibrated[k] + guess for k, guess in zip(judged, guessed, strict=True)]


def _refine_fit(estimate: ParameterEstimate, step: float) -> ParameterEstimate:
    """The fit repeated from its values with a time step in s."""
    free = tuple(replace(f, start=float(value)) for f, value in zip(estimate.problem.free, estimate.values, strict=True))
    try:
        return identify(replace(estimate.problem, free=free, step=step), 3, near=True)
    except PredictionError:
        return estimate
