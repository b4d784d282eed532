"""How far apart hypotheses will be, against plain least squares on a plant that is linear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.experiments.separation import predict_with_uncertainty, separation
from tepm_opt.discrepancy.problem.plant import Candidate, collect_free_parameters
from tepm_opt.solvers.identification.identify import ParameterEstimate, Problem, identify
from tests.discrepancy.straight import Straight, effect, planned

NOISE = 0.3
DRAG, TWIN = effect("drag", size=0.2), effect("twin", size=0.2)
PLANT = Straight.of(DRAG, TWIN, twin=("drag.size", 0.05))


def measured(files: tuple[str, ...], seed: int = 0) -> list[Run]:
    truth, random = PLANT.with_values({"drag.size": 0.6, "stiffness": 1.05}), np.random.default_rng(seed)
    return [replace(run, points=truth.predict(run).points + NOISE * random.normal(size=run.points.shape)) for run in planned(*files)]


def fitted(candidate: Candidate, runs: list[Run]) -> ParameterEstimate:
    free = collect_free_parameters(PLANT.free(PLANT.known), PLANT, [candidate])
    return identify(Problem(PLANT, tuple(runs), free, NOISE))


@pytest.fixture(scope="module")
def both() -> list[ParameterEstimate]:
    runs = measured(("a.csv", "b.csv", "c.csv"))
    return [fitted(candidate, runs) for candidate in (DRAG, TWIN)]


def test_separation_is_what_a_refit_with_what_is_known_leaves(both: list[ParameterEstimate]) -> None:
    (run,) = planned("new.csv")
    misses = []
    for one, other in (both, both[::-1]):
        said = [estimate.plant.predict(run, [f.name for f in estimate.problem.free]) for estimate in (one, other)]
        difference = (said[1].points - said[0].points).ravel() / NOISE
        by = said[0].by.reshape(len(one.values), -1).T / NOISE
        root = np.linalg.cholesky(np.linalg.inv(one.covariance)).T
        whole, rows = np.append(difference, np.zeros(len(root))), np.vstack([by, root])
        misses.append(np.linalg.norm(whole - rows @ np.linalg.lstsq(rows, whole, rcond=None)[0]))
    assert separation(both, run, NOISE) == pytest.approx(min(misses), rel=1e-6)
    assert min(misses) > 0.1


def test_less_noise_and_surer_parameters_separate_more(both: list[ParameterEstimate]) -> None:
    (run,) = planned("new.csv")
    assert separation(both, run, NOISE / 3) > separation(both, run, NOISE)
    sure = [replace(estimate, covariance=1e-4 * estimate.covariance) for estimate in both]
    assert separation(sure, run, NOISE) > separation(both, run, NOISE)


def test_what_says_the_same_is_not_separated(both: list[ParameterEstimate]) -> None:
    (run,) = planned("new.csv")
    assert separation([both[0], both[0]], run, NOISE) == pytest.approx(0.0, abs=1e-9)
    said = predict_with_uncertainty(both[0], run, NOISE)
    assert said.distance_to(said.points + said.doubt @ np.full(said.doubt.shape[1], 1e-3)) < 2e-3


def test_the_least_of_all_pairs_counts(both: list[ParameterEstimate]) -> None:
    (run,) = planned("new.csv")
    far = replace(both[0], values=both[0].values + 5.0)
    assert separation([*both, far], run, NOISE) == pytest.approx(separation(both, run, NOISE))


def test_a_run_that_cannot_be_done_separates_nothing(both: list[ParameterEstimate], monkeypatch: pytest.MonkeyPatch) -> None:
    from tepm_opt.solvers.mechanics.plant import PredictionError

    def refuse(*given: object) -> None:
        raise PredictionError("no motion")

    monkeypatch.setattr(Straight, "predict", refuse)
    assert separation(both, planned("new.csv")[0], NOISE) == 0.0
