"""Significance of an effect whose strength is known only together with its shape."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tepm_opt.data.run import Role, Run, RunSet
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.adapters.callable_plant import Simulator
from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.assessment.settings import DEFAULT as ASSESSMENT
from tepm_opt.discrepancy.laws.effect import Law, Quantity
from tepm_opt.discrepancy.pipeline import discover
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.reporting.effect_table import describe_sizes
from tepm_opt.discrepancy.selection import significance
from tepm_opt.solvers.identification.identify import _at_least

WEAR = Candidate("wear", null={"wear.change": 0.0, "wear.bend": 0.0}, shapes=("wear.bend",))
NOISE = 3e-3


def estimate(change: float, bend: float, deviations: tuple[float, float], correlation: float) -> Any:
    """Fit of a strength and a shape that trade."""
    size = np.outer(deviations, deviations) * np.array([[1, correlation], [correlation, 1]])
    free = [SimpleNamespace(name=name) for name in WEAR.null]
    return SimpleNamespace(values=np.array([change, bend]), covariance=size, problem=SimpleNamespace(free=free, scale=np.array([0.1, 1.0])))


def test_shapes_are_held() -> None:
    """What trades with the shape does not make the effect doubtful: of a correlation r, 1 - r² of the variance is left."""
    found = significance.standard_deviations_from_null(estimate(0.1, 2.0, (0.1, 2.0), 0.6), WEAR)
    assert found == pytest.approx(1 / np.sqrt(1 - 0.6**2))
    assert significance.standard_deviations_from_null(estimate(0.1, 2.0, (0.1, 2.0), 0.0), WEAR) == pytest.approx(1)


@pytest.mark.parametrize("acts", [True, False])
def test_a_shape_that_acts_alone_is_not_held(acts: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A regulator whose rate is limited chokes, but no time constant of it is known."""
    monkeypatch.setattr(significance, "_acts_without_strengths", lambda *_: acts)
    assert significance.is_significant(estimate(0.15, 2.0, (0.1, 2.0), 0.8), WEAR, SearchSettings()) is not acts
    assert significance.is_significant(estimate(0.3, 2.0, (0.1, 2.0), 0.8), WEAR, SearchSettings())
    assert not significance.is_significant(estimate(0.1, 2.0, (0.1, 0.05), 0.0), WEAR, SearchSettings())


def test_no_direction_is_known_better_than_white_noise_allows() -> None:
    random = np.random.default_rng(3)
    for _ in range(20):
        first, second = ((m := random.normal(size=(4, 4))) @ m.T for _ in range(2))
        found = _at_least(first, second)
        for other in (first, second):
            assert np.linalg.eigvalsh(found - other).min() > -1e-9 * np.linalg.norm(found)
        np.testing.assert_allclose(_at_least(first + second, second), first + second, rtol=1e-8)
        np.testing.assert_allclose(_at_least(0.1 * second, second), second, rtol=1e-8)


def ageing(run: Run, values: Mapping[str, Any]) -> np.ndarray:
    """A spring that softens with a time constant far beyond the recording: only change over time constant is known."""
    load, minutes = run.inputs.T
    share = values["ageing[spring].change"] * -np.expm1(-minutes / values["ageing[spring].time_constant"])
    return values["compliance"] * load * (1 + share)


def worn(role: Role, seed: int, change: float) -> Run:
    """Deflections over the load in five minutes, of a spring that softens with a time constant of an hour."""
    random, rows = np.random.default_rng(seed), 400
    inputs = np.column_stack([random.uniform(0.2, 1, rows), np.linspace(0, 5, rows)])
    run = Run(f"{role}.csv", role, np.full(rows, np.nan), inputs, np.zeros((rows, 3)), np.zeros((rows, 1, 1)))
    true = {"compliance": 1.02, "ageing[spring].change": change, "ageing[spring].time_constant": 60.0}
    measured = ageing(run, true) + NOISE * random.normal(size=rows)
    return Run(run.file, role, run.time, inputs, run.tip_force, measured[:, None, None])


def test_an_effect_is_named_where_only_strength_over_time_constant_is_known() -> None:
    m = Simulator("a spring", Signals.from_names(["load", "minutes"], ["deflection"]))
    m.parameter("compliance", 1.0, std=0.05)
    time_constant = Quantity("time_constant", "1", 100.0, (100.0,), 20.0, 1e4, shape=True)
    m.effects([Law("ageing", "body", (Quantity("change", "1", 0.0, (0.05,), -0.9, 10.0), time_constant))], "spring")
    m.effects([Law("offset", "output", (Quantity("by", "signal", 0.0, (0.01,), -1.0, 1.0),))], "deflection", signal=1.0)
    plant, answers = m.plant(ageing, static=True), []
    for change in (0.2, 0.0):
        dataset = RunSet.from_runs("worn", [worn("fit", 1, change), worn("validation", 2, change)])
        answers.append(discover(dataset, plant, NOISE).verdict)
    assert [answer.status for answer in answers] == [VerdictStatus.NAMED, VerdictStatus.NO_DISCREPANCY]
    [effect] = answers[0].effects
    assert effect.candidate.name == "ageing"
    change, time_constant = (effect.parameters[name] for name in ("change", "time_constant"))
    assert change.std > change.value / 2 / ASSESSMENT.interval_factor, "alone it would not be significant"
    share, true = (c * -np.expm1(-5 / t) for c, t in ((change.value, time_constant.value), (0.2, 60)))
    assert share == pytest.approx(true, rel=0.25), "after five minutes, about three standard deviations"
    assert describe_sizes(effect)[-1] == "known only together"


def pulled(run: Run, values: Mapping[str, Any]) -> np.ndarray:
    """A spring that a cable relieves; one that has lost 98 % of its force is slack, whatever more it loses."""
    load, force = run.inputs.T
    return values["compliance"] * (load - force * np.maximum(1 - 1.02 * values["worn_cable[cable].loss"], 0.0))


def relieved(role: Role, seed: int, loss: float) -> Run:
    """Deflections over load and force of a cable that has lost a share of it."""
    random, rows = np.random.default_rng(seed), 200
    run = Run(f"{role}.csv", role, np.full(rows, np.nan), random.uniform(0.2, 1, (rows, 2)), np.zeros((rows, 3)), np.zeros((rows, 1, 1)))
    measured = pulled(run, {"compliance": 1.02, "worn_cable[cable].loss": loss}) + NOISE * random.normal(size=rows)
    return Run(run.file, role, run.time, run.inputs, run.tip_force, measured[:, None, None])


@pytest.mark.parametrize("loss", [1.0, 0.3, 0.0])
def test_a_cable_that_lost_everything_is_told(loss: float) -> None:
    """There its loss has no derivative but from below."""
    m = Simulator("a relieved spring", Signals.from_names(["load", "force"], ["deflection"]))
    m.parameter("compliance", 1.0, std=0.05)
    m.effects([Law("worn_cable", "input", (Quantity("loss", "1", 0.0, (0.05,), -1.0, 1.0),))], "cable")
    m.effects([Law("offset", "output", (Quantity("by", "signal", 0.0, (0.01,), -1.0, 1.0),))], "deflection", signal=1.0)
    dataset = RunSet.from_runs("cable", [relieved("fit", 1, loss), relieved("validation", 2, loss)])
    answer = discover(dataset, m.plant(pulled, static=True), NOISE).verdict
    assert answer.status is (VerdictStatus.NAMED if loss else VerdictStatus.NO_DISCREPANCY)
    assert [effect.candidate.name for effect in answer.effects] == ["worn_cable"] * bool(loss)
    assert all(0 < effect.parameters["loss"].std < 0.02 for effect in answer.effects)
