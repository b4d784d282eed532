"""Rivals of effects: what stands in for scatter, pairs that one of them outdoes, and replacements that do not hold."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tepm_opt.discrepancy.adapters.network import candidate
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection import alternatives as rivals
from tepm_opt.discrepancy.selection import elimination, forward_backward, scatter
from tepm_opt.discrepancy.selection.fitting import Hypothesis
from tests.discrepancy.table import EFFECTS, Table, hypothesis

SETTINGS = SearchSettings()
SCATTER = Candidate("actuator_scatter", "all", {f"offset_{k}": 0.0 for k in range(6)}, scatters=True)
DEAD_ZONE = Candidate("pressure_dead_zone", "dead", {"threshold": 0.0}, ({"threshold": 1.0},), smooth=False)
GAIN = Candidate("actuator_gain", "11", {"loss": 0.0}, part="actuator")
PAYLOAD, LOAD, MASSES = candidate("payload"), candidate("external_load"), candidate("mass_distribution")


def scattered(offsets: list[float], std: float = 0.1) -> Hypothesis:
    """A hypothesis whose scatter has these offsets."""
    found = hypothesis((SCATTER,), 0.01)
    free = [SimpleNamespace(name=name, group="offsets", prior_mean=0.0) for name in SCATTER.parameters]
    estimate: Any = SimpleNamespace(**vars(found.estimate) | {"problem": SimpleNamespace(free=free), "values": offsets, "std": [std] * 6})
    return replace(found, estimate=estimate)


def test_offsets_that_are_all_alike_are_not_centred() -> None:
    """A dead zone of 5 kPa lowers all pressures."""
    assert not scatter.is_centred(scattered([-5.2, -5.3, -5.3, -5.4, -5.3, -5.2]), SETTINGS)
    assert scatter.is_centred(scattered([-5.2, 3.1, 0.4, -1.2, 4.3, -2.0]), SETTINGS)
    assert scatter.is_centred(scattered([-5.2, -5.3, -5.3, -5.4, -5.3, -5.2], std=5.0), SETTINGS), "they may be anything"
    assert scatter.is_centred(hypothesis((GAIN,), 0.0), SETTINGS), "nothing scatters"


@pytest.mark.parametrize("centred", [True, False])
def test_what_all_actuators_have_in_common_is_tried_where_scatter_is_not_centred(centred: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Alone, with the part that promises most beside it, and with scatter about it."""
    monkeypatch.setattr(scatter, "is_centred", lambda *_: centred)
    table: Any = Table(SETTINGS, {"dead": 3.0, "11 dead": 0.01}, {})
    table.linear = lambda *_: SimpleNamespace(gain=lambda effects: (0.9, {}), able=[GAIN, LOAD])
    found = scatter.fit_common_causes(table, hypothesis((SCATTER,), 0.01), hypothesis((), 8.0), SCATTER, [SCATTER, DEAD_ZONE, GAIN, LOAD])
    assert [{*h.effects} for h in found] == ([] if centred else [{DEAD_ZONE}, {DEAD_ZONE, GAIN}, {DEAD_ZONE, SCATTER}])


def test_scatter_about_another_mean_gives_way_to_what_fits_nearly_as_well() -> None:
    best, other = scattered([-5.2, 3.1, 0.4, -1.2, 4.3, -2.0]), hypothesis((DEAD_ZONE, GAIN), 0.011)
    assert rivals._favour_centred([best, other], np.array([0.9, 0.1]), SETTINGS) == pytest.approx([0.9, 0.1])
    best = scattered([-5.2, -5.3, -5.3, -5.4, -5.3, -5.2])
    assert rivals._favour_centred([best, other], np.array([0.9, 0.1]), SETTINGS) == pytest.approx([0.018, 0.982], abs=1e-3)
    assert rivals._favour_centred([best, other], np.array([1.0, 1e-9]), SETTINGS)[0] == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("centred", [True, False])
def test_what_keeps_scatter_about_zero_stays_however_little_it_removes(centred: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Scatter alone leaves hardly more, as all of its offsets do what the dead zone does."""
    monkeypatch.setattr(elimination, "is_significant", lambda *_: True)
    monkeypatch.setattr(elimination, "_output", lambda *_: 0.0)
    monkeypatch.setattr(elimination, "is_centred", lambda h, _: centred or DEAD_ZONE in h.effects)
    table: Any = Table(SETTINGS, {"": 50.0, "all": 0.012, "dead": 30.0, "all dead": 0.01}, {})
    best, shares = elimination.eliminate_backward(table, table.fit((SCATTER, DEAD_ZONE), {}))
    assert {*best.effects} == ({SCATTER} if centred else {SCATTER, DEAD_ZONE})
    assert shares.get(DEAD_ZONE, 0.0) == (0.0 if centred else np.inf)


@pytest.mark.parametrize(("beside", "weight"), [(0.2, 0.0), (0.8, 0.5)])
def test_a_pair_one_of_which_outdoes_it_beside_the_effect_is_no_rival(beside: float, weight: float) -> None:
    """What a load and masses do better than a payload may be the load's work."""
    best, pair = hypothesis((PAYLOAD,), 0.5), hypothesis((LOAD, MASSES), 0.4)
    table: Any = Table(SETTINGS, {}, {})
    beside_it = hypothesis((LOAD, PAYLOAD), beside)
    table.done = {h.effects: h for h in (beside_it,)}
    found = rivals._exclude_outdone_pairs(table, [best, pair], np.array([0.5, 0.5]), 0)
    assert found == pytest.approx([1 - weight, weight])


def test_a_pair_in_the_place_of_scatter_is_not_compared_with_scatter_beside_it() -> None:
    """One more parameter for every actuator predicts better than two in any case."""
    best, pair = hypothesis((SCATTER,), 0.01), hypothesis((GAIN, LOAD), 0.02)
    table: Any = Table(SETTINGS, {}, {})
    assert rivals._exclude_outdone_pairs(table, [best, pair], np.array([0.2, 0.8]), 0) == pytest.approx([0.2, 0.8])
    assert not table.done


@pytest.mark.parametrize(("left", "excess", "again"), [(0.3, 0.5, True), (0.3, 0.7, False), (0.01, 0.02, False)])
def test_a_close_rival_is_fitted_again_from_the_best_fit(left: float, excess: float, again: bool) -> None:
    """Which leaves less depends on the values of what both share, unless only noise is left."""
    best, rival, table = hypothesis((PAYLOAD, LOAD), left), hypothesis((LOAD, MASSES), excess), Table(SETTINGS, {}, {})
    best.estimate.named.update({"external_load.x": 0.1, "payload.mass": 0.02})
    rival.estimate.named.update({"external_load.x": 0.2, "mass_distribution.plates": 0.3})
    starts, better = [], hypothesis(rival.effects, excess / 2)

    def refit(effects: Any, start: dict[str, float], stage: str) -> Hypothesis:
        starts.append(start)
        return better

    cast(Any, table).refit = refit
    assert rivals._refit_close(cast(Any, table), best, [rival]) == [better if again else rival]
    assert starts == [{"external_load.x": 0.1, "mass_distribution.plates": 0.3, "payload.mass": 0.02}] * again


@pytest.mark.parametrize(
    ("left", "excess", "back"),
    [("s2 s3", 0.5, False), ("s2", 0.5, True), ("s2", 0.01, False), ("", 0.5, False)],
    ids=["nothing eliminated", "worse with as many", "not worse", "fewer"],
)
def test_a_rival_that_does_not_hold_is_taken_back(left: str, excess: float, back: bool) -> None:
    """What elimination leaves of it would have been a rival by itself, and a worse one."""
    best, better = hypothesis((EFFECTS["s1"],), 0.02), hypothesis((EFFECTS["s2"], EFFECTS["s3"]), 0.02)
    then, table = hypothesis(tuple(EFFECTS[label] for label in left.split()), excess), Table(SETTINGS, {}, {})
    assert forward_backward._takes_back(cast(Any, table), then, better, best, EFFECTS["s1"], 0) is back


def test_an_exchange_ends_where_elimination_leaves_no_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    best, better = hypothesis((EFFECTS["s1"],), 0.5), hypothesis((EFFECTS["s2"],), 0.4)
    nothing, table = hypothesis((), 20.0), Table(SETTINGS, {}, {})
    monkeypatch.setattr(forward_backward, "_eliminate", lambda *_: (nothing, {}, {}))
    groups = {EFFECTS["s1"]: [(best, 0.1), (better, 0.9)]}
    assert forward_backward._exchange(cast(Any, table), (best, {}, groups), [], 0, set()) == (nothing, {}, {})


@pytest.mark.parametrize(("excess", "back"), [(0.06, False), (0.1, True)])
def test_a_part_that_leaves_little_more_than_scatter_stays_in_its_place(excess: float, back: bool) -> None:
    """Scatter has a parameter for every actuator, which take up some of what errors in the forms of others leave."""
    best, better, then = hypothesis((SCATTER,), 0.02), hypothesis((GAIN, LOAD), 0.03), hypothesis((GAIN,), excess)
    table = Table(SETTINGS, {}, {}, done={(): hypothesis((), 20.0)})
    assert forward_backward._takes_back(cast(Any, table), then, better, best, SCATTER, 0) is back


@pytest.mark.parametrize(
    ("pair", "beside", "chosen"),
    [(0.3, 0.25, True), (0.3, 0.01, False), (0.6, 0.25, False)],
    ids=["no worse than scatter beside a load", "worse than that", "worse than scatter"],
)
def test_a_part_and_a_load_that_leave_less_than_scatter_take_its_place(pair: float, beside: float, chosen: bool) -> None:
    """Unless scatter beside the load leaves much less still."""
    best, both = hypothesis((SCATTER,), 0.5), hypothesis((GAIN, LOAD), pair)
    table = Table(SETTINGS, {}, {})
    table.done = {
        h.effects: h for h in (hypothesis(tuple(sorted((SCATTER, LOAD), key=lambda c: c.label)), beside), hypothesis((LOAD,), 15.0))
    }
    assert rivals._outdoes_scatter(cast(Any, table), both, best, SCATTER) is chosen


def test_a_group_without_a_rival_shares_its_probability() -> None:
    one, other, third = (hypothesis((EFFECTS[label],), 0.1) for label in ("s1", "s2", "s3"))
    left = forward_backward._leave_out(other, [(one, 0.1), (other, 0.6), (third, 0.3)])
    assert {h.effects: p for h, p in left} == pytest.approx({one.effects: 0.25, third.effects: 0.75})
    assert forward_backward._leave_out(other, [(one, 0.0), (other, 1.0)]) == [(one, 1.0)]


def test_what_acts_in_the_first_runs_may_be_what_acts_in_the_others() -> None:
    """A payload hung on before the fourth run looks like masses that are missing in the first three."""
    files = ("a.csv", "b.csv", "c.csv", "d.csv")
    linear = SimpleNamespace(able=[PAYLOAD], gain=lambda effects: (0.5, {}))
    fits: Any = SimpleNamespace(
        settings=SETTINGS, linear=lambda *_: linear, problem=SimpleNamespace(runs=[SimpleNamespace(file=file) for file in files])
    )
    found = rivals._scores(fits, hypothesis((), 8.0), replace(MASSES, runs=files[:3]), [PAYLOAD])
    assert {score.candidate.runs for score in found} == {(), files[:3], files[3:]}


@pytest.mark.parametrize(
    ("left", "always", "fitted"),
    [(2.0, 6.0, True), (0.01, 6.0, False), (2.0, 0.1, False)],
    ids=["more than noise left", "noise left", "explains most in all runs"],
)
def test_effects_of_some_runs_are_fitted_alone_where_several_leave_more_than_noise(left: float, always: float, fitted: bool) -> None:
    """Drifts and loads make up for a payload that was hung on between runs."""
    files = ("a.csv", "b.csv", "c.csv")

    class Spans(Table):
        @property
        def problem(self) -> Any:
            return SimpleNamespace(runs=[SimpleNamespace(file=file) for file in files])

        def linear(self, base: Hypothesis, _: object) -> Any:
            return SimpleNamespace(gain=lambda effects: (0.9 if effects[-1].runs == files[1:] else 0.1, {}), able=[PAYLOAD], excess=8e3)

    spans: Any = Spans(SETTINGS, {}, {})
    spans.done = {(PAYLOAD,): hypothesis((PAYLOAD,), always)}
    found = forward_backward._fit_in_span_alone(spans, hypothesis((), 8.0), hypothesis((LOAD, GAIN), left), [PAYLOAD])
    assert [h.effects for h in found] == [(replace(PAYLOAD, runs=files[1:]),)] * fitted
