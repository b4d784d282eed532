"""What the workflow tells in words."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.network import candidate
from tepm_opt.discrepancy.assessment.result import Errors, Named, Value, VerdictStatus
from tepm_opt.discrepancy.reporting.effect_table import describe_sizes, effect_rows, with_unit
from tepm_opt.discrepancy.reporting.sentences import (
    _describe_effects,
    _describe_groups,
    describe_repeatability,
    next_step,
    not_fitted_reason,
    single_effect_reason,
)
from tepm_opt.discrepancy.selection.cross_validation import Evidence
from tepm_opt.discrepancy.selection.fitting import Hypothesis
from tepm_opt.discrepancy.selection.forward_backward import Explanation
from tepm_opt.discrepancy.selection.screening import Score
from tepm_opt.solvers.mechanics.plant import Free


def run(file: str, seed: int, pressure: float) -> Run:
    points = np.random.default_rng(seed).normal(0, 1e-3, (500, 4, 3))
    return Run(file, "fit", np.arange(500) / 50, np.full((500, 12), pressure), np.zeros((500, 3)), points)


def test_repeated_runs_tell_the_repeatability() -> None:
    lines = describe_repeatability([run("a.csv", 1, 1e5), run("b.csv", 2, 1e5), run("c.csv", 3, 2e5)], 1e-3)
    assert lines == ["a.csv and b.csv repeat the same inputs: 1.73 mm each (noise alone: 1.73 mm)."]


def test_long_times_are_in_seconds() -> None:
    """Small units are for small values."""

    def told(seconds: float) -> list[str]:
        return describe_sizes(Named(candidate("time_delay"), 1.0, {"delay": Value(seconds, 0.002, "s", 0.0)}, 1.0))

    assert told(0.03) == ["delay 30 ± 2 ms"]
    assert told(30.4) == ["delay 30.4 ± 0.002 s"]


def test_many_effects_are_listed_without_their_sizes() -> None:
    """A dozen sizes in one sentence is nothing that anybody reads."""
    names = ("time_delay", "payload", "base_tilt", "tendon_friction")
    named = [
        Named(candidate(name), p, {"size": Value(1.0, 0.1, "1", 0.0)}, 1.0) for name, p in zip(names, (1.0, 0.9, 0.8, 0.4), strict=True)
    ]
    assert _describe_effects(named[:2]) == "time_delay (size 100 ± 10 %; probability 1.00) and payload (size 100 ± 10 %; probability 0.90)"
    listed = "time_delay (1.00), payload (0.90), base_tilt (0.80); perhaps also tendon_friction (0.40)"
    assert _describe_effects(named) == f"4 effects, with their probabilities: {listed}"


def test_sizes_that_are_not_told_from_null_are_not_given() -> None:
    """Neither by a number that reads as a finding; those of a shape are left out as before."""
    holders = Named(
        candidate("mass_distribution"),
        1.0,
        {"holders": Value(0.00204, 0.023, "1", 0.0), "plates": Value(0.24, 0.065, "1", 0.0)},
        1.0,
    )
    assert describe_sizes(holders) == ["plates 24 ± 6.5 %", "holders not significantly different from 0"]
    assert effect_rows([holders]) == [
        ("mass_distribution", "–", "plates 24 ± 6.5 %", "1.00", "100 %"),
        ("", "", "holders not significantly different from 0", "", ""),
    ]
    delay = Named(candidate("time_delay"), 1.0, {"delay": Value(0.031, 0.002, "s", 0.03)}, 1.0)
    assert describe_sizes(delay) == ["delay not significantly different from 30 ms"]
    loss = Named(candidate("actuator_gain", "13"), 1.0, {"loss": Value(0.099974, 3.7e-5, "1", 0.0)}, 1.0)
    assert describe_sizes(loss) == ["loss 9.9974 ± 0.0037 %"], "as many digits as are known"
    assert [with_unit(0.95, unit) for unit in ("-", "1", "kg")] == ["0.95", "95 %", "950 g"]
    bend = Named(candidate("pressure_crosstalk"), 1.0, {"bend": Value(-6e-7, 1e-8, "1/Pa", 0.0)}, 1.0)
    assert describe_sizes(bend) == ["bend -0.06 ± 0.001 %/kPa"]


def considered(
    effects: tuple[Any, ...],
    excess: float,
    free: Sequence[Free] = (),
    values: Sequence[float] = (),
    bound: bool = False,
    early: bool = False,
) -> Any:
    """A hypothesis with some parameters, all at their bounds or none, whose fit may have been ended early."""
    counts = np.full(10, 100)
    named = {each.name: value for each, value in zip(free, values, strict=True)}
    problem = SimpleNamespace(free=tuple(free), plant=SimpleNamespace(quick=False))
    at_bound = np.full(len(free), bound)
    estimate: Any = SimpleNamespace(problem=problem, values=np.array(values), named=named, at_bound=at_bound, out_of_reach=early)
    return Hypothesis(effects, estimate, Evidence(counts * (1 + excess), counts, 1 + len(free), np.zeros(1)))


def test_nothing_is_not_less_than_nothing() -> None:
    assert not_fitted_reason(Score(candidate("creep"), -0.0, {})) == "to first order it could close 0 % of the gap"


def test_a_rival_that_closes_nearly_all_has_a_reason() -> None:
    """What it leaves beside the noise, the values that it would need, how many causes it takes; one that closes less needs none."""
    payload, lag, tilt = candidate("payload"), candidate("regulator_lag"), candidate("base_tilt")
    stiffness = Free("K_a", "N/m", 358.0, 340.0, 380.0, 1.0)
    best = considered((lag,), 0.01, [stiffness], [360.0])
    without = considered((), 1000.0)

    def against(*given: Any, **more: Any) -> str:
        found = considered(*given, **more)
        return single_effect_reason(Explanation(without, best, best, [without, best, found], [], {}, {}), found)

    assert (
        against((tilt,), 4.0)
        == "alone it closes 99.6 % of the gap on held-out data; what it leaves is 2 times the noise, the answer 0.1 times"
    )
    assert against((tilt,), 500.0) == "alone it closes 50 % of the gap on held-out data"
    assert "leave far more than the answer does" in against((tilt,), 4.0, early=True)
    mass = Free("payload.mass", "kg", 0.0, 0.0, 0.5, 0.01)
    heavy = against((payload,), 0.01, [mass], [0.5], bound=True)
    assert heavy.endswith("; it would need payload.mass at the end of its range (500 g)")
    soft = against((tilt,), 0.01, [stiffness], [375.0])
    assert soft.endswith("; it would need K_a 375 N/m instead of 360 N/m")
    assert "; it takes 2 causes in the place of 1, each 20 times less probable beforehand" in against((tilt, payload), 0.01)


@pytest.mark.parametrize("status", list(VerdictStatus))
def test_every_status_has_a_next_step(status: VerdictStatus) -> None:
    assert next_step(status)
    assert next_step(status, "all runs: shifted clock") == "put inputs and positions on one clock"


def test_a_table_says_where_and_in_which_runs() -> None:
    weak = Named(candidate("actuator_gain", "13"), 0.42, {"loss": Value(0.1, 0.01, "1", 0.0)}, float("nan"), ("circle.csv",))
    assert effect_rows([weak]) == [("actuator_gain", "actuator 13, only in circle.csv", "loss 10 ± 1 %", "0.42", "–")]


def test_the_old_name_of_the_gap_closed_warns() -> None:
    errors = Errors(noise_floor=1.0, nominal=5.0, recalibrated=4.0, corrected=2.0, black_box=2.0)
    with pytest.warns(DeprecationWarning, match="gap_closed_fraction"):
        assert errors.closed == errors.gap_closed_fraction == 0.75


def test_an_effect_that_is_too_small_to_be_named_has_no_place_in_the_sentence() -> None:
    """Of the best hypothesis' three effects one is not named; another has a rival."""
    sure, small, unclear, rival = (candidate(name) for name in ("creep", "payload", "time_delay", "clock_skew"))
    best, other = (SimpleNamespace(effects=effects) for effects in ((sure, small, unclear), (sure, small, rival)))
    groups = {sure: [(best, 1.0)], small: [(best, 1.0)], unclear: [(best, 0.6), (other, 0.4)]}
    named = [SimpleNamespace(candidate=each, probability=p) for each, p in ((sure, 0.9), (unclear, 0.6), (rival, 0.4))]
    told = _describe_groups(named, SimpleNamespace(groups=groups, best=best))
    assert told == (
        "Missing: creep (probability 0.90); besides, time_delay (probability 0.60) or clock_skew (probability 0.40), "
        "which these runs cannot tell apart"
    )
