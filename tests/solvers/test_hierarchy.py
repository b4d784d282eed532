"""Spreads of alike parameters, on machines that are sums and whose spreads are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tepm_opt.solvers.identification.hierarchy import (
    SMALLEST,
    compute_clustering_chances,
    identify_with_spreads,
    off_centre,
    spreads,
    with_spreads,
)
from tepm_opt.solvers.identification.identify import Problem, identify
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant
from tepm_opt.solvers.mechanics.plant import Free, Prediction

NOISE, ROWS, MEMBERS = 1e-3, 40, 12


@dataclass(frozen=True)
class Sum:
    """A machine that measures the sum of some curves: of twelve alike ones and of a common one."""

    curves: np.ndarray  # (ROWS, 13)
    values: Mapping[str, float] = field(default_factory=dict)
    concurrent = static = quick = False
    states: Mapping[str, float] = field(default_factory=dict)

    def with_values(self, values: Mapping[str, float]) -> Sum:
        return replace(self, values={**self.values, **values})

    def free(self, names: Sequence[str]) -> tuple[Free, ...]:
        alike = {name: name != "common" for name in names}
        return tuple(
            Free(n, "m", 0.0, -np.inf, np.inf, 1e-3, prior_std=0.1 if group else np.inf, group="alike" if group else "")
            for n, group in alike.items()
        )

    def predict(self, run: Run, by: Sequence[str] = (), step: float = np.inf) -> Prediction:
        columns = {name: self.curves[:, k] for k, name in enumerate(self.values)}
        points = sum((value * columns[name] for name, value in self.values.items()), start=np.zeros(ROWS))
        slopes = np.array([np.repeat(columns[name][:, None, None], 3, axis=2) for name in by]).reshape(len(by), ROWS, 1, 3)
        return Prediction(np.repeat(points[:, None, None], 3, axis=2), slopes)


def made(spread: float, seed: int) -> tuple[Problem, np.ndarray]:
    """A problem and the true values, with curves that the members nearly share so that data alone tell little of each."""
    random = np.random.default_rng(seed)
    names = [f"member_{k}" for k in range(MEMBERS)] + ["common"]
    truth = np.append(spread * random.normal(size=MEMBERS), 0.5)
    plant = Sum(random.normal(size=(ROWS, 1)) + 0.3 * random.normal(size=(ROWS, MEMBERS + 1)), dict.fromkeys(names, 0.0))
    points = np.repeat((plant.curves @ truth)[:, None, None], 3, axis=2) + NOISE * random.normal(size=(ROWS, 1, 3))
    run = Run("made.csv", "fit", np.arange(ROWS) / 10, np.zeros((ROWS, 1)), np.zeros((ROWS, 3)), points)
    return Problem(plant, (run,), plant.free(names), NOISE), truth


def found_spread(problem: Problem) -> float:
    return next(free.prior_std for free in identify_with_spreads(problem).problem.free if free.group)


@pytest.mark.parametrize("spread", [3e-3, 0.02, 1.0])
def test_a_spread_is_found_whatever_was_guessed(spread):
    found = [found_spread(made(spread, seed)[0]) for seed in range(30)]
    drawn = [np.sqrt(np.mean(made(spread, seed)[1][:MEMBERS] ** 2)) for seed in range(30)]
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(np.sqrt(np.mean(np.square(drawn))), rel=0.1)


def test_members_that_do_not_scatter_have_none():
    """The spread falls far below what the data would tell of one alone."""
    problem, _ = made(0.0, 1)
    alone = identify(problem).std[:MEMBERS].mean()
    estimate = identify_with_spreads(problem)
    assert found_spread(problem) < 0.7 * alone
    assert np.abs(estimate.values[:MEMBERS]).max() < alone


@pytest.mark.slow
def test_members_are_known_better_together():
    """Nearer to the truth than with the first guess or with no prior, over many machines."""
    errors = {"none": [], "spread": []}
    for seed in range(30):
        problem, truth = made(2e-4, seed)
        free = tuple(replace(free, prior_std=np.inf, group="") for free in problem.free)
        errors["none"].append(identify(replace(problem, free=free)).values - truth)
        errors["spread"].append(identify_with_spreads(problem).values - truth)
    rms = {kind: float(np.sqrt(np.mean(np.square(each)))) for kind, each in errors.items()}
    assert rms["spread"] < 0.9 * rms["none"]


def test_a_spread_is_what_values_and_doubts_make():
    problem, _ = made(0.02, 3)
    estimate = identify(problem)
    members = slice(0, MEMBERS)
    expected = np.sqrt(np.mean(estimate.values[members] ** 2 + estimate.covariance.diagonal()[members]))
    assert spreads(estimate) == {"alike": pytest.approx(expected)}
    changed = with_spreads(problem, {"alike": 0.0}).free
    assert {free.prior_std for free in changed} == {SMALLEST * 1e-3, np.inf}


def test_without_groups_it_is_the_plain_fit():
    problem, _ = made(0.02, 3)
    plain = replace(problem, free=tuple(replace(free, group="") for free in problem.free))
    assert (identify_with_spreads(plain).values == identify(plain).values).all()


def test_scatter_of_a_robots_muscles_is_a_group_for_each_kind():
    model = compile_model(Model.from_robot("kang2017").with_effect("actuator_scatter"), backend="python")
    names = [name for name in model.values if name.startswith("actuator_scatter.")]
    free = {each.name.partition(".")[2]: each for each in NetworkPlant(model).free(names)}
    assert (free["gain_13"].group, free["gain_13"].prior_std, free["gain_13"].prior_mean) == ("gain", 0.02, 0.0)
    assert (free["offset_21"].group, free["offset_21"].prior_std) == ("offset", 2e3)
    assert (free["one_sided"].group, free["one_sided"].prior_std) == ("", np.inf)


def test_a_difference_between_clusters_is_no_scatter() -> None:
    """Members that are alike in each of two clusters, and members that scatter."""
    names = [f"member_{k}" for k in range(MEMBERS)]
    problem, truth = made(0.1, 3)
    by_chance = compute_clustering_chances(identify_with_spreads(problem), 2, names)
    apart = np.append(np.repeat([0.0, 0.2], MEMBERS // 2), truth[-1])
    plant = problem.plant
    assert isinstance(plant, Sum)
    run = replace(problem.runs[0], points=np.repeat((plant.curves @ apart)[:, None, None], 3, axis=2))
    by_cluster = compute_clustering_chances(identify_with_spreads(replace(problem, runs=(run,))), 2, names)
    assert 0.02 < by_chance[0] < 1
    assert by_cluster[0] < 1e-6
    assert compute_clustering_chances(identify_with_spreads(problem), 1, names) == []
    assert compute_clustering_chances(identify_with_spreads(problem), 2, ["common"]) == []


def test_what_all_members_have_is_no_scatter() -> None:
    """Members that scatter about zero, and members that all are about the same."""
    names = [f"member_{k}" for k in range(MEMBERS)]
    problem, truth = made(0.1, 3)
    plant = problem.plant
    assert isinstance(plant, Sum)
    alike = np.append(0.3 + 0.1 * truth[:-1], truth[-1])
    run = replace(problem.runs[0], points=np.repeat((plant.curves @ alike)[:, None, None], 3, axis=2))
    assert 0.02 < off_centre(identify_with_spreads(problem), names)[0] < 1
    assert off_centre(identify_with_spreads(replace(problem, runs=(run,))), names)[0] < 1e-3
    assert off_centre(identify_with_spreads(problem), ["common"]) == []
