"""What each setting of the search does, on a table of what every set of effects leaves instead of fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tepm_opt.discrepancy.adapters.network import candidate
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection import alternatives as rivals
from tepm_opt.discrepancy.selection import elimination
from tepm_opt.discrepancy.selection import ranking as rounds
from tepm_opt.discrepancy.selection.cross_validation import weights
from tepm_opt.discrepancy.selection.fitting import Effects, Hypothesis, may_act_beside
from tepm_opt.discrepancy.selection.forward_backward import Explanation, explain
from tepm_opt.discrepancy.selection.screening import Score
from tests.discrepancy.table import BLOCKS, EFFECTS, MOTION, SAMPLES, Table, hypothesis


@pytest.fixture(autouse=True)
def exact_forms(monkeypatch: pytest.MonkeyPatch) -> None:
    """No doubt about the effects' forms and sizes, and outputs that differ."""
    for room in (elimination, rivals):
        monkeypatch.setattr(room, "is_significant", lambda *_: True)
    monkeypatch.setattr(elimination, "_output", lambda *_: 0.0)
    monkeypatch.setattr(rivals, "coincidence", lambda *_: 0.0)


def searched(excess: dict[str, float], gains: dict[str, float] | None = None, uneven: dict[str, float] | None = None, **settings: Any):
    """What a search finds and the table it was made on."""
    table: Any = Table(SearchSettings(**settings), excess, gains or {"s1": 1.0, "s2": 0.9}, uneven or {})
    return explain(table, list(EFFECTS.values()), 0), table


def named(found: Explanation) -> str:
    return " ".join(str(c.detail) for c in found.best.effects)


ONE = {"": 4.0, "s1": 0.02, "s2": 3.9, "s1 s2": 0.02}
"""s1 explains all but noise."""


def test_what_takes_away_too_little_is_not_named() -> None:
    small = {**ONE, "": 0.4}
    assert named(searched(small)[0]) == "s1"
    assert named(searched(small, min_excess_removed=0.5)[0]) == ""


@pytest.mark.parametrize(("without", "left", "kept"), [(0.1, 0.0, "s1 s2"), (0.04, 0.0, "s1"), (0.2, 0.1, "s1"), (0.3, 0.1, "s1 s2")])
def test_beside_another_it_is_enough_to_separate_noise_from_more(without: float, left: float, kept: str) -> None:
    """0.05 counts as noise; where more is left in any case, s2 has to take away 0.15."""
    assert named(searched({"": 4.0, "s1": without, "s2": 3.9, "s1 s2": left}, min_share_closed=0.0, repeat_forward=False)[0]) == kept


@pytest.mark.parametrize(("smooth", "answer"), [(True, "s1"), (False, "s4")])
def test_what_has_no_first_order_is_fitted_where_more_than_noise_is_left(
    smooth: bool, answer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """s4 promises a hundredth of what s1 does and explains everything; s1 leaves a quarter."""
    monkeypatch.setitem(EFFECTS, "s4", replace(EFFECTS["s4"], smooth=smooth))
    assert named(searched({"": 8.0, "s1": 2.0, "s4": 0.01}, {"s1": 1.0, "s4": 0.01})[0]) == answer


def test_of_three_each_must_take_away_more() -> None:
    """Small ones together may be in the place of something else."""
    assert named(searched({"": 4.0, "s1": 2.0, "s2": 3.0, "s1 s2": 0.1, "s1 s2 s3": 0.0}, {"s1": 1.0, "s2": 0.9, "s3": 0.8})[0]) == "s1 s2"


def test_an_effect_must_beat_going_without() -> None:
    """By a probability, here of one that is better in some blocks of time and worse in others."""
    excess, uneven = {**ONE, "": 1.0, "s1": 0.8, "s2": 2.0}, {"s1": 0.9}
    with_it, without = hypothesis((EFFECTS["s1"],), 0.8, 0.9), hypothesis((), 1.0)
    sure = weights([with_it.evidence, without.evidence], 0)[0]
    assert 0.6 < sure < 0.999
    for asked, tried in ((sure - 1e-3, ("s1",)), (sure + (1 - sure) / 2, ())):
        found = searched(excess, uneven=uneven, min_probability=asked, max_effects=1)[0]
        assert tuple(c.detail for c in found.widest.effects) == tried


def test_what_stays_takes_away_a_share_of_what_is_left() -> None:
    """Here s1 takes away 3 times as much as it leaves."""
    excess = {"": 4.0, "s1": 1.0, "s2": 3.9, "s1 s2": 1.0}
    assert named(searched(excess, least_share=2.0)[0]) == "s1"
    assert named(searched(excess, least_share=4.0)[0]) == ""


def test_where_much_is_unexplained_nothing_is_named() -> None:
    """The best leaves 5 % of the motion's standard deviation."""
    excess = {"": 40.0, "s1": (0.05 * MOTION) ** 2, "s2": 39.0, "s1 s2": 1.0}
    assert named(searched(excess)[0]) == "s1"
    found = searched(excess, max_unexplained_ratio=0.04)[0]
    assert found.best is found.without
    assert [c.detail for c in found.widest.effects] == ["s1"], "though it was tried"


@pytest.mark.parametrize("fits", [0, 1, 2])
def test_later_rounds_fit_so_many(fits: int) -> None:
    excess = {"": 8.0, "s1": 1.0, "s2": 7.0, "s3": 7.0, "s4": 7.0}
    _, table = searched(excess, {"s1": 1.0, "s2": 0.9, "s3": 0.8, "s4": 0.7}, fits_later_rounds=fits)
    assert sum(len(effects) == 2 for effects in table.done) == fits


class TestRules:
    """What is no setting."""

    def test_only_what_promises_a_share_of_the_best_is_fitted(self) -> None:
        _, table = searched({**ONE, "s1": 1.0}, {"s1": 1.0, "s2": 0.3, "s3": 0.2}, max_effects=1)
        assert {c.detail for effects in table.done for c in effects} == {"s1", "s2"}

    @pytest.mark.parametrize(("own", "fitted"), [(0.99, {"s1"}), (0.9, {"s1", "s2"})])
    def test_where_an_effect_leaves_only_noise_far_rivals_are_not_fitted(self, own: float, fitted: set[str]) -> None:
        """What they promise to leave is more than first order is wrong by, as the effect's own promise shows."""
        _, table = searched(ONE, {"s1": own, "s2": 0.6})
        assert {c.detail for effects in table.done for c in effects} == fitted

    @pytest.mark.parametrize(("left", "tried"), [(0.85, ["s1"]), (0.75, ["s1", "s2"])])
    def test_one_more_effect_must_close_a_fifth(self, left: float, tried: list[str]) -> None:
        found, _ = searched({"": 8.0, "s1": 1.0, "s2": 7.0, "s1 s2": left})
        assert [c.detail for c in found.widest.effects] == tried

    @pytest.mark.parametrize(
        ("output", "first", "left", "kept"),
        [(0.0, 900.0, 0.3, "s1 s2"), (400.0, 900.0, 0.3, "s1"), (400.0, 900.0, 0.05, "s1 s2"), (1e4, 80.0, 0.3, "s1 s2")],
    )
    def test_what_may_mend_another_effects_form_is_dropped(
        self, monkeypatch: pytest.MonkeyPatch, output: float, first: float, left: float, kept: str
    ) -> None:
        """s2 takes away 0.9 beside s1, whose form may be wrong by a four-hundredth of its squared output; no mending leaves nothing.

        No form spoils more than a four-hundredth of what there is to explain.
        """
        monkeypatch.setattr(elimination, "_output", lambda _, effect: output if effect == EFFECTS["s1"] else 0.0)
        assert named(searched({"": first, "s1": 0.9 + left, "s2": 7.0, "s1 s2": left})[0]) == kept

    @pytest.mark.parametrize(("exact", "kept"), [(True, ["s1", "s2"]), (False, ["s1"])])
    def test_a_form_that_is_known_exactly_needs_no_mending(self, monkeypatch: pytest.MonkeyPatch, exact: bool, kept: list[str]) -> None:
        monkeypatch.setattr(elimination, "_output", lambda *_: 400.0)
        sure = replace(EFFECTS["s1"], exact=exact)
        table: Any = Table(SearchSettings(), {"": 900.0, "s1": 1.2, "s2": 700.0, "s1 s2": 0.3}, {})
        best, _ = elimination.eliminate_backward(table, table.fit((sure, EFFECTS["s2"]), {}))
        assert [c.detail for c in best.effects] == kept

    @pytest.mark.parametrize(("refuted", "kept"), [((), ["s1"]), (((EFFECTS["s1"],),), ["s1", "s2"])])
    def test_what_separates_it_from_a_hypothesis_that_gave_way_mends_nothing(
        self, monkeypatch: pytest.MonkeyPatch, refuted: tuple[Effects, ...], kept: list[str]
    ) -> None:
        """Else the search goes round: s1 gives way to another, that to s1 and s2, and these again to s1."""
        monkeypatch.setattr(elimination, "_output", lambda *_: 400.0)
        table: Any = Table(SearchSettings(), {"": 900.0, "s1": 1.2, "s2": 700.0, "s1 s2": 0.3}, {})
        best, shares = elimination.eliminate_backward(table, table.fit((EFFECTS["s1"], EFFECTS["s2"]), {}), refuted)
        assert [c.detail for c in best.effects] == kept
        assert all(share > 1 for share in shares.values())

    def test_of_two_that_are_not_needed_the_one_that_takes_away_less_goes(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Both stand below the errors of forms; without s2 (the last in order) next to nothing more is left, without s1 much is."""
        monkeypatch.setattr(elimination, "_output", lambda *_: 1e4)
        table: Any = Table(SearchSettings(), {"": 1e4, "s1": 0.5, "s2": 7.0, "s1 s2": 0.4}, {})
        best, _ = elimination.eliminate_backward(table, table.fit((EFFECTS["s1"], EFFECTS["s2"]), {}))
        assert [c.detail for c in best.effects] == ["s1"]


def test_fits_without_what_surely_stays_end_early_until_nothing_else_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    """With three effects, one of which does nothing: bounds while it is dropped, and none for the shares of those that stay."""
    bounds: list[tuple[int, bool]] = []
    table: Any = Table(SearchSettings(), {"s1": 7.0, "s2": 6.0, "s1 s2": 0.01, "s1 s3": 6.0, "s2 s3": 7.0, "s1 s2 s3": 0.01}, {})
    fit_all = table.fit_all

    def watched(asked: Sequence[tuple[Effects, object]], rival: object = None, bound: float = np.inf) -> list[Hypothesis]:
        bounds.append((len(asked), bool(np.isfinite(bound))))
        return fit_all(asked, rival, bound)

    monkeypatch.setattr(table, "fit_all", watched)
    best, shares = elimination.eliminate_backward(table, table.fit(tuple(EFFECTS[label] for label in ("s1", "s2", "s3")), {}))
    assert [c.detail for c in best.effects] == ["s1", "s2"]
    assert bounds == [(3, True), (2, True), (2, False)]
    assert shares == pytest.approx({EFFECTS["s1"]: 5.99 / 0.015, EFFECTS["s2"]: 6.99 / 0.015}, rel=0.01)


@pytest.mark.parametrize(("promise", "begins"), [(0.5, "there"), (-50.0, "here")])
def test_rivals_begin_where_the_best_fit_ended_if_that_promises_more(promise: float, begins: str) -> None:
    """From the fit without the effect they may have to go so far that first order leads astray."""
    rest, best, rival = hypothesis((), 8.0), hypothesis((EFFECTS["s1"],), 1.0), EFFECTS["s2"]
    table = Table(SearchSettings(), {}, {})
    score = Score(rival, 0.6, {"from": 0.0})

    def linear(base: Hypothesis, _: object) -> Any:
        gain, start = (promise, {"from": 1.0}) if base is best else (0.6, {"from": 0.0})
        return SimpleNamespace(gain=lambda effects: (gain, start), able=[rival], excess=base.excess, count=np.ones(1))

    table.linear = linear  # type: ignore[method-assign]
    (found,) = rivals._start_from_best(table, best, rest, [score], [rival])  # type: ignore[arg-type]
    assert found.start == {"from": 1.0 if begins == "there" else 0.0}
    assert found.gain == score.gain, "what ranks them is what they do in its place"
    assert not table.again


@pytest.mark.parametrize(("before", "again"), [(7.0, True), (2.0, False)])
def test_a_rival_whose_fit_went_astray_is_fitted_anew(before: float, again: bool) -> None:
    """Where it ended is far from what first order promises at the best fit."""
    rest, best, rival = hypothesis((), 8.0), hypothesis((EFFECTS["s1"],), 1.0), EFFECTS["s2"]
    table = Table(SearchSettings(), {"s2": before}, {})
    table.fit((rival,), {})

    def linear(base: Hypothesis, _: object) -> Any:
        count = np.array([BLOCKS * SAMPLES])
        return SimpleNamespace(gain=lambda effects: (0.0, {}), able=[rival], excess=(1.0 if base is best else 8.0) * count[0], count=count)

    table.linear = linear  # type: ignore[method-assign]
    rivals._start_from_best(table, best, rest, [Score(rival, 0.1, {})], [rival])  # type: ignore[arg-type]
    assert table.again == (((rival,),) if again else ())


@pytest.mark.parametrize(("runs", "weight"), [((), 0.5), (("a.csv",), 0.25)])
def test_what_acts_always_is_more_probable_than_what_acts_in_some_runs(
    runs: tuple[str, ...], weight: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    effect = replace(EFFECTS["s1"], runs=runs)
    rest, best, other = hypothesis((), 8.0), hypothesis((effect,), 1.0), hypothesis((EFFECTS["s2"],), 1.0)
    table: Any = Table(SearchSettings(), {}, {})
    table.done = {h.effects: h for h in (rest, best, other)}
    monkeypatch.setattr(rivals, "fit_promising", lambda *_: [other])
    monkeypatch.setattr(rivals, "_scores", lambda *_: [])
    monkeypatch.setattr(rivals, "_fit_changes_in_pause", lambda *_: [])
    found = rivals.replacements(table, best, effect, list(EFFECTS.values()), 0)
    assert [round(p, 6) for _, p in found] == [weight, 1 - weight]


PAYLOAD, TWO = candidate("payload"), (candidate("external_load"), candidate("mass_distribution"))


@pytest.mark.parametrize(("promise", "excess", "tried"), [(-0.2, 1.0, True), (-3.0, 1.0, False), (-0.2, 0.01, False)])
def test_two_that_promise_as_much_are_fitted_in_the_place_of_one(promise: float, excess: float, tried: bool) -> None:
    """Where more than noise is left, and only of what is rich enough to do the work of two."""
    rest, best = hypothesis((), 8.0), hypothesis((PAYLOAD,), excess)
    table: Any = Table(SearchSettings(), {}, {})
    gains = {frozenset(TWO): promise}

    def linear(base: Hypothesis, _: object) -> Any:
        return SimpleNamespace(gain=lambda effects: (gains.get(frozenset(effects), -9.0), {}), able=[PAYLOAD, *TWO], excess=base.excess)

    table.linear = linear
    found = rivals._fit_pair(table, best, rest, PAYLOAD, [Score(TWO[0], 0.6, {})], [PAYLOAD, *TWO])
    assert [set(h.effects) for h in found] == [set(TWO)] * tried
    assert not rivals._fit_pair(table, best, rest, candidate("base_tilt"), [Score(TWO[0], 0.6, {})], [PAYLOAD, *TWO])


@pytest.mark.parametrize(("excess", "least", "most"), [(1.0, 0.04, 0.05), (0.5, 0.99, 1.0)])
def test_two_causes_must_say_more_than_one(monkeypatch: pytest.MonkeyPatch, excess: float, least: float, most: float) -> None:
    """Where they predict left-out data a little better, they may only mend what other forms leave."""
    rest, best, both = hypothesis((), 8.0), hypothesis((PAYLOAD,), 1.0), hypothesis(TWO, excess)
    table: Any = Table(SearchSettings(), {}, {})
    table.done = {h.effects: h for h in (rest, best, both)}
    monkeypatch.setattr(rivals, "_fit_pair", lambda *_: [both])
    monkeypatch.setattr(rivals, "_scores", lambda *_: [])
    found = rivals.replacements(table, best, PAYLOAD, [PAYLOAD, *TWO], 0)
    assert [h.effects for h, _ in found] == [best.effects, TWO]
    assert least < found[1][1] <= most


@pytest.mark.parametrize(("left", "tried"), [(0.3, True), (0.01, False)])
def test_three_that_promise_as_much_are_fitted_in_the_place_of_scatter(left: float, tried: bool) -> None:
    """Each is the one that promises most beside those before it; they may be of any kind, and no two forms of one."""
    scatter = Candidate("actuator_scatter", None, {f"actuator_scatter.{k}": 0.0 for k in range(13)})
    three = candidate("base_tilt"), candidate("actuator_gain", "13"), candidate("sensor_misalignment")
    rest, best = hypothesis((), 400.0), hypothesis((scatter,), left)
    table: Any = Table(SearchSettings(), {}, {})
    able = [scatter, candidate("creep"), *three]

    def gain(effects: Effects) -> tuple[float, dict[str, float]]:
        return -(900.0 - sum(300.0 for c in effects if c in three)) / left, {}

    table.linear = lambda *_: SimpleNamespace(gain=gain, able=able, excess=left, count=np.ones(1))
    found = rivals._fit_pair(table, best, rest, scatter, [], able)
    assert [set(h.effects) for h in found] == [set(three)] * tried


@pytest.mark.parametrize(("left", "excess", "believed"), [(0.0, 0.04, True), (0.0, 0.1, False), (0.5, 0.6, True), (0.5, 0.7, False)])
def test_two_parts_that_leave_hardly_more_are_no_scatter_of_all(
    monkeypatch: pytest.MonkeyPatch, left: float, excess: float, believed: bool
) -> None:
    """Where what has a number for every muscle leaves only noise, up to noise; else up to a fiftieth of what it removes."""
    scatter = Candidate("actuator_scatter", None, {f"actuator_scatter.{k}": 0.0 for k in range(13)})
    parts = Candidate("actuator_gain", "13", {"a": 0.0}, part="actuator"), Candidate("actuator_offset", "12", {"b": 0.0}, part="actuator")
    rest, best, both = hypothesis((), 8.0), hypothesis((scatter,), left), hypothesis(parts, excess)
    table: Any = Table(SearchSettings(), {}, {})
    table.done = {h.effects: h for h in (rest, best, both)}
    monkeypatch.setattr(rivals, "_fit_pair", lambda *_: [both])
    monkeypatch.setattr(rivals, "_scores", lambda *_: [])
    found = {h.effects: p for h, p in rivals.replacements(table, best, scatter, [scatter, *parts], 0)}
    assert found[parts] == pytest.approx(float(believed), abs=1e-3)


def test_two_sets_are_followed_where_asked_for() -> None:
    """What looks best at first leads nowhere; what is a little worse is one of two causes."""
    excess = {"": 10.0, "s1": 4.0, "s2": 4.2, "s1 s3": 3.9, "s2 s3": 0.02, "s3": 9.9, "s1 s2": 3.9}
    gains = {"s1": 1.0, "s2": 0.9, "s3": 0.5}
    assert named(searched(excess, gains, beam=2)[0]) == "s2 s3"
    assert named(searched(excess, gains)[0]) != "s2 s3"


class TestForms:
    """Of one thing, at one place."""

    PLAIN = Candidate("dry_friction", "slide", {"a": 0.0}, family="friction")
    RICH = Candidate("hysteresis", "slide", {"b": 0.0, "c": 0.0}, family="friction")
    NEEDY = Candidate("stribeck_friction", "slide", {"d": 0.0}, beside=("dry_friction",))

    def test_do_not_stand_beside_each_other(self) -> None:
        assert not may_act_beside(self.RICH, [self.PLAIN])
        assert may_act_beside(self.RICH, [replace(self.PLAIN, detail="other")])

    def test_come_with_what_they_need(self) -> None:
        assert not may_act_beside(self.NEEDY, [])
        assert may_act_beside(self.NEEDY, [self.PLAIN])

    @pytest.mark.parametrize(("gain", "kept"), [(0.95, ["dry_friction"]), (0.5, ["hysteresis", "dry_friction"])])
    def test_the_plainer_one_is_tried_where_it_promises_as_much(self, gain: float, kept: list[str]) -> None:
        scores = [Score(self.RICH, 1.0, {}), Score(self.PLAIN, gain, {})]
        assert [score.candidate.name for score in rounds.drop_richer_forms(scores, SearchSettings())] == kept
