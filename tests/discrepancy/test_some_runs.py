"""A cause that acts in some runs only, a wrong robot file: to first order, fitted, sized run by run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.network import SearchableNetwork, candidate, wrong_values
from tepm_opt.discrepancy.assessment.constancy import active_runs, effect_size_by_segment, estimate_spread, extend_to_validation_runs
from tepm_opt.discrepancy.problem.plant import Candidate, InSomeRuns, collect_free_parameters, restrict_effects_to_runs
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.fitting import Fits, Hypothesis
from tepm_opt.discrepancy.selection.forward_backward import explain
from tepm_opt.discrepancy.selection.linearised import Linearised, linearise
from tepm_opt.discrepancy.selection.run_subsets import list_helped_runs, list_run_spans, select_longest_span
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.model import Model
from tepm_opt.solvers.identification.identify import Problem
from tests.discrepancy.small import NOISE, changed, cut, dataset_of, measured, planned, true_values

NOMINAL = Model.from_robot("kang2017")
FILES = ("single_pressure.csv", "elongation.csv", "tip_load.csv", "mixed.csv")
LATE = ("tip_load.csv",)
MASS = 0.012  # kg, put on before the last of the runs fitted to
PAYLOAD = candidate("payload")
RADIUS = next(c for c in wrong_values(NOMINAL) if c.detail == "r")


@pytest.fixture(scope="module")
def loadable() -> CompiledModel:
    """With a payload and a load of null."""
    return compile_model(NOMINAL.with_effect("payload", mass=0.0).with_effect("external_load", x=0.0, y=0.0, z=0.0))


@pytest.fixture(scope="module")
def heavy(loadable: CompiledModel) -> CompiledModel:
    return changed(loadable, **{"payload.mass": MASS})


@pytest.fixture(scope="module")
def network(kang: CompiledModel, loadable: CompiledModel) -> SearchableNetwork:
    channels = dataset_of(kang, []).channels
    others = (PAYLOAD, candidate("external_load"), RADIUS)
    return SearchableNetwork(loadable, known_model=NOMINAL, candidates=others, signals=channels.signals)


@pytest.fixture(scope="module")
def runs(kang: CompiledModel, heavy: CompiledModel) -> list[Run]:
    """Of a machine that carries something in the last run fitted to, and in the one kept for validation."""
    asked = planned(FILES)
    found = []
    for k, (light, loaded) in enumerate(zip(*(measured(changed(m, **true_values(m)), asked) for m in (kang, heavy)), strict=True)):
        found.append(cut(loaded if k >= 2 else light, 4.0))
    return found


@pytest.fixture(scope="module")
def fits(network: SearchableNetwork, runs: list[Run]) -> Fits:
    fit = tuple(run for run in runs if run.role == "fit")
    problem = Problem(network, fit, network.free(network.known), NOISE, derivatives_apart=network.derivatives_apart)
    return Fits(problem, SearchSettings())


@pytest.fixture(scope="module")
def without(fits: Fits) -> Hypothesis:
    found = fits.fit((), {})
    assert found is not None
    return found


@pytest.fixture(scope="module")
def linear(fits: Fits, without: Hypothesis, network: SearchableNetwork) -> Linearised:
    return fits.linear(without, network.candidates)


LIMITED = replace(PAYLOAD, runs=LATE)


@pytest.mark.slow
class TestFirstOrder:
    def test_what_acts_in_one_run_promises_more_there(self, linear: Linearised) -> None:
        everywhere, late = linear.gain([PAYLOAD])[0], linear.gain([LIMITED])[0]
        early = linear.gain([replace(PAYLOAD, runs=FILES[:2])])[0]
        assert late == pytest.approx(1.0, abs=0.05)
        assert max(everywhere, early) < 0.8
        assert linear.gain([LIMITED])[1]["payload.mass"] == pytest.approx(MASS, rel=0.1)

    def test_a_set_promises_no_less_than_its_parts(self, linear: Linearised, network: SearchableNetwork) -> None:
        alone = [linear.gain([c])[0] for c in network.candidates]
        assert linear.gain(network.candidates)[0] >= max(alone) - 1e-9

    def test_an_effect_of_the_fit_can_be_taken_back(self, fits: Fits, without: Hypothesis, network: SearchableNetwork) -> None:
        """What a fit leaves without its effect is what was left before it, up to the second order."""
        with_it = fits.fit((LIMITED,), {"payload.mass": 0.01})
        assert with_it is not None
        linear = linearise(with_it.estimate, fits.problem.free, (LIMITED,), network.candidates, fits.settings)
        left = linear.cost.sum() - linear.gain([])[0] * linear.excess
        before = without.estimate.cost * linear.count.sum() / without.estimate.count
        assert left == pytest.approx(before, rel=0.1)
        assert linear.gain([LIMITED])[0] * linear.excess == pytest.approx(0.0, abs=20.0), "what a refit to fewer samples gains"

    def test_memory_is_bounded_by_thinning(self, fits: Fits, without: Hypothesis, network: SearchableNetwork) -> None:
        few = linearise(without.estimate, fits.problem.free, (), network.candidates, SearchSettings(max_derivative_bytes=80_000))
        assert few.count.sum() < 0.5 * sum(np.isfinite(run.points).sum() for run in fits.problem.sparse.runs)
        assert few.gain([LIMITED])[0] == pytest.approx(1.0, abs=0.1)


class TestSpans:
    @pytest.mark.parametrize(
        ("after", "expected"),
        [((2.0, 1.0, 4.0), ("a", "b")), ((2.0, 1.0, 0.5), ()), ((9.0, 9.0, 4.0), ())],
        ids=["worse in one", "better in all", "worse in all"],
    )
    def test_runs_that_an_effect_helps(self, after: tuple[float, ...], expected: tuple[str, ...]) -> None:
        def fit(squares: Sequence[float]) -> Any:
            return SimpleNamespace(residuals=[SimpleNamespace(file=f, squares=s, count=1) for f, s in zip("abc", squares, strict=True)])

        assert list_helped_runs(fit((8.0, 4.0, 1.0)), fit(after)) == expected

    def test_a_run_that_did_not_stand_out_does_not_get_its_own_effect(self) -> None:
        fits: Any = [
            SimpleNamespace(residuals=[SimpleNamespace(file=f, squares=s, count=1) for f, s in two])
            for two in ((("a", 1.0), ("b", 4.0)), (("a", 0.5), ("b", 5.0)))
        ]
        assert list_helped_runs(*fits) == ()

    def test_from_one_on_until_one_or_in_one(self) -> None:
        assert list_run_spans(["a", "b", "c"]) == [("a",), ("a", "b"), ("b",), ("b", "c"), ("c",)]

    def test_a_run_that_does_not_show_an_effect_does_not_end_it(self) -> None:
        """One that speaks against it does."""
        for last, expected in ((1000.0 - 1.0, ("b", "c")), (1000.0 - 10.0, ("b",))):
            gains = {("b",): 1000.0, ("b", "c"): last, ("c",): 0.0}
            linear: Any = SimpleNamespace(gain=lambda effects, gains=gains: (gains[effects[-1].runs] / 1000, {}), excess=1000.0)
            assert select_longest_span(linear, [(replace(PAYLOAD, runs=runs),) for runs in gains], SearchSettings())[-1].runs == expected


@pytest.mark.slow
class TestPlant:
    def test_an_effect_acts_in_its_runs_only(self, network: SearchableNetwork, runs: list[Run]) -> None:
        plant = restrict_effects_to_runs(network, [LIMITED]).with_values({"payload.mass": MASS})
        light, late = runs[0], next(run for run in runs if run.file in LATE)
        assert np.array_equal(plant.predict(light).points, network.predict(light).points)
        assert not np.allclose(plant.predict(late).points, network.predict(late).points)
        assert not plant.predict(light, ["payload.mass", "K_a"]).by[0].any()
        assert plant.predict(light, ["payload.mass", "K_a"]).by[1].any()
        assert restrict_effects_to_runs(network, [PAYLOAD]) is network

    def test_a_wrong_value_is_free_of_its_prior(self, network: SearchableNetwork) -> None:
        stiffness = next(c for c in wrong_values(NOMINAL) if c.detail == "K_a")
        known = network.free(network.known)
        free = {f.name: f for f in collect_free_parameters(known, network, [stiffness, RADIUS])}
        assert (free["K_a"].low, free["K_a"].high) == pytest.approx((35.886, 3588.6))
        assert (free["r"].low, free["r"].high) == pytest.approx((0.004, 0.4))
        assert len(free) == len(known) + 1


@pytest.mark.slow
class TestSearch:
    def test_finds_in_which_runs_a_cause_acts(self, fits: Fits, network: SearchableNetwork, kang: CompiledModel, runs: list[Run]) -> None:
        found = explain(fits, network.candidates, 0)
        assert [c.full_label for c in found.best.effects] == ["payload in tip_load.csv"]
        dataset = dataset_of(kang, runs)
        best = found.best.estimate
        assert active_runs(found.best.effects[0], best, dataset, NOISE) == ("tip_load.csv", "mixed.csv")
        onwards = extend_to_validation_runs(best.plant, found.best.effects, dataset)
        assert isinstance(onwards, InSomeRuns)
        assert onwards.effects[0].runs == ("tip_load.csv", "mixed.csv"), "it is taken to go on"

    def test_what_ended_before_validation_is_told_so(self, fits: Fits, kang: CompiledModel, runs: list[Run]) -> None:
        """The same, with a validation run of the light machine."""
        best = fits.fit((LIMITED,), {"payload.mass": 0.01})
        assert best is not None
        light = [replace(run, role="validation", file="again.csv") if k == 0 else run for k, run in enumerate(runs) if k != 3]
        dataset = dataset_of(kang, [runs[0], *light[1:], light[0]])
        assert active_runs(LIMITED, best.estimate, dataset, NOISE) == LATE


class TestSizes:
    @pytest.mark.slow
    def test_a_cause_is_of_the_same_size_everywhere(self, fits: Fits, heavy: CompiledModel) -> None:
        loaded = [cut(run, 4.0) for run in measured(changed(heavy, **true_values(heavy)), planned(FILES)) if run.role == "fit"]
        everywhere = Fits(replace(fits.problem, runs=tuple(loaded)), fits.settings)
        once = Fits(replace(fits.problem, runs=tuple(run for run in fits.problem.runs if run.file != "single_pressure.csv")), fits.settings)
        for own, same in ((everywhere, True), (once, False)):
            found = own.fit((PAYLOAD,), {"payload.mass": 0.01})
            assert found is not None
            by_run = effect_size_by_segment(linearise(found.estimate, own.problem.free, (PAYLOAD,), (), own.settings), PAYLOAD)["run"]
            assert (by_run.spread < 0.2) == same, by_run

    def test_chance_spreads_nothing(self) -> None:
        random = np.random.default_rng(0)
        std = np.full(200, 0.1)
        assert estimate_spread(1 + std * random.normal(size=200), std) < 0.05
        assert estimate_spread(1 + 0.3 * random.normal(size=200), std) == pytest.approx(np.sqrt(0.3**2 - 0.1**2), rel=0.15)


def test_a_candidate_says_where_it_acts() -> None:
    assert LIMITED.full_label == "payload in tip_load.csv"
    assert LIMITED != PAYLOAD
    assert isinstance(LIMITED, Candidate)
