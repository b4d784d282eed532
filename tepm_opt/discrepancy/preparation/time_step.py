"""The time step of the search's simulations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tepm_opt.data.run import RunSet
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.solvers.identification.initial_state import predictions
from tepm_opt.solvers.mechanics.plant import Plant, PredictionError
from tepm_opt.solvers.mechanics.predict import LONGEST_STEP

PRECISE_STEP = 0.01  # s, of predictions that are reported


def choose_time_step(
    plant: Plant, dataset: RunSet, precise: Sequence[np.ndarray], noise: float | np.ndarray, settings: SearchSettings
) -> float:
    """The longest time step in s whose errors are small beside the noise.

    Args:
        plant: the model.
        dataset: all runs.
        precise: predictions with the precise step, (rows, points, 3) in m a run.
        noise: of the measurements, 1 sigma per axis.
        settings: with the excess that counts as noise.
    """
    if plant.static:
        return PRECISE_STEP
    try:
        coarse = predictions(plant, dataset.fit, noise, LONGEST_STEP)
    except PredictionError:
        return PRECISE_STEP
    fit = [points for run, points in zip(dataset.runs, precise, strict=True) if run.role == "fit"]
    square = np.mean(np.array([np.mean(((a.points - b) / noise) ** 2) for a, b in zip(coarse, fit, strict=True)]))
    return LONGEST_STEP if square < settings.max_noise_excess / 5 else PRECISE_STEP
