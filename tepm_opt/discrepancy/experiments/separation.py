"""Separation of hypotheses by a planned run: model discrimination."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from tepm_opt.data.run import Run, thin_out
from tepm_opt.discrepancy.problem.plant import without_run_restriction
from tepm_opt.solvers.identification.identify import ParameterEstimate
from tepm_opt.solvers.mechanics.plant import Plant, PredictionError


@dataclass(frozen=True, eq=False)
class UncertainPrediction:
    """Prediction of a run by a fitted hypothesis, with its uncertainty after the data so far.

    Attributes:
        points: over the noise, (coordinates,).
        doubt: their change by one standard deviation along each axis of the fit's parameters, (coordinates, parameters).
    """

    points: np.ndarray
    doubt: np.ndarray

    def distance_to(self, points: np.ndarray) -> float:
        """Standard deviations from points over the noise, (coordinates,), to the nearest prediction of this hypothesis after a refit.

        The least of |difference - J d|² + dᵀ C⁻¹ d over all changes d of its parameters, where C is their covariance after the data so
        far: the part of the difference that no value of the parameters which these data allow takes away. T-optimality with a prior
        (Atkinson and Fedorov, Biometrika 62, 1975); the variance of the prediction discounts as in Box and Hill (Technometrics 9, 1967).
        """
        left = points - self.points
        pull = self.doubt.T @ left
        taken = pull @ np.linalg.solve(np.eye(len(pull)) + self.doubt.T @ self.doubt, pull)
        return float(np.sqrt(max(left @ left - taken, 0.0)))


def predict_with_uncertainty(estimate: ParameterEstimate, run: Run, noise: float) -> UncertainPrediction:
    """Predict a run with the step at which derivatives are taken; effects that act in some runs only are taken to act.

    Args:
        estimate: the fit.
        run: planned.
        noise: of a coordinate, 1 sigma in m.

    Raises:
        PredictionError: the model cannot do the run.
    """
    plant: Plant = without_run_restriction(estimate.plant)
    problem, scale = estimate.problem, estimate.problem.scale
    found = plant.predict(run, [free.name for free in problem.free], max(problem.step, problem.derivatives_apart))
    values, axes = np.linalg.eigh(estimate.covariance / np.outer(scale, scale))
    root = scale[:, None] * axes * np.sqrt(np.maximum(values, 0.0))
    by = found.by.reshape(len(scale), -1).T / noise
    return UncertainPrediction(found.points.ravel() / noise, by @ root)


def separation(estimates: Sequence[ParameterEstimate], run: Run, noise: float) -> float:
    """Standard deviations by which a run will tell any two of some fitted hypotheses apart, whichever of them is true; the least of all.

    Half its square is what the logarithm of their odds changes by on average. 0 where one of them cannot do the run. Motions are smooth:
    where samples come faster than derivatives are taken, those between say as much as their neighbours.

    Args:
        estimates: of the hypotheses, two or more.
        run: planned.
        noise: of a coordinate, 1 sigma in m.
    """
    apart = max(estimate.problem.derivatives_apart for estimate in estimates)
    seen = thin_out(run, apart) if apart and run.rows > 1 else run
    try:
        said = [predict_with_uncertainty(estimate, seen, noise) for estimate in estimates]
    except PredictionError:
        return 0.0
    more = np.sqrt(run.rows / seen.rows)
    return float(more) * min(min(one.distance_to(other.points), other.distance_to(one.points)) for one, other in combinations(said, 2))
