"""What an answer is called: by probabilities, by what rivals, unknown laws and runs not used say."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tepm_opt.discrepancy.adapters.network import candidate
from tepm_opt.discrepancy.assessment import credibility as belief
from tepm_opt.discrepancy.assessment.constancy import SegmentSizes
from tepm_opt.discrepancy.assessment.credibility import AlternativeLaw, EffectChecks, Judgement, alternative_law_odds, assess
from tepm_opt.discrepancy.assessment.result import Errors, VerdictStatus
from tepm_opt.discrepancy.assessment.settings import AssessmentSettings
from tepm_opt.discrepancy.assessment.stated_set import describe_stated_set, score_causes
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.cross_validation import Evidence
from tepm_opt.discrepancy.selection.fitting import Hypothesis
from tepm_opt.discrepancy.selection.forward_backward import Explanation

LAG, LOAD = candidate("regulator_lag"), candidate("external_load")
SHRUNK = Errors(noise_floor=5e-4, nominal=5e-3, recalibrated=4e-3, corrected=6e-4, black_box=1e-3)
SETTINGS = SearchSettings()


def hypothesis(effects: tuple[Any, ...], excess: float) -> Hypothesis:
    counts = np.full(10, 100)
    problem = SimpleNamespace(runs=(SimpleNamespace(file="a.csv"), SimpleNamespace(file="b.csv")), free=())
    estimate: Any = SimpleNamespace(cost=1000 * (1 + excess), count=1000, problem=problem, values=(), std=(), at_bound=())
    return Hypothesis(effects, estimate, Evidence(counts * (1 + excess), counts, 1, np.zeros(1)))


def answer(
    effect: Any, share: float, weight: float = 1.0, errors: Errors = SHRUNK, doubt: Any = None, spread: float = 0.0, left: float = 0.2
) -> Any:
    best, other, without = hypothesis((effect,), left), hypothesis((candidate("creep"),), 2 * left), hypothesis((), 10.0)
    found = Explanation(without, best, best, [without, best, other], [], {effect: share}, {effect: [(best, weight), (other, 1 - weight)]})
    constancy = {effect: {"run": SegmentSizes((0, 1), np.array([0.2, 1.8]), np.ones(2), spread)}}
    law: Any = SimpleNamespace(place=SimpleNamespace(label="axial[12](length)"))
    checks = EffectChecks({} if doubt is None else {effect: AlternativeLaw(doubt, law)}, constancy)
    return assess(found, errors, SETTINGS, checks)


@pytest.mark.parametrize(("beside", "score"), [(0.06, 0.56), (0.3, 0.0)])
def test_what_removes_most_of_what_is_left_is_not_ruled_out(beside: float, score: float) -> None:
    """A rival counts with its probability, a further effect with the share of the structure left that it removes."""
    creep, delay = candidate("creep"), candidate("time_delay")
    best, rival, without = hypothesis((LAG,), 0.2), hypothesis((delay,), 0.2), hypothesis((), 10.0)
    more, alone = hypothesis((LAG, creep), beside), hypothesis((LOAD,), 9.0)
    tried = [without, best, rival, more, alone]
    found = Explanation(without, best, best, tried, [], {LAG: 100.0}, {LAG: [(best, 0.7), (rival, 0.3)]})
    judgement = assess(found, SHRUNK, SETTINGS, EffectChecks())
    scores = dict(score_causes(found, judgement, SETTINGS))
    assert scores == pytest.approx({"regulator_lag": 0.68, "time_delay": 0.3} | ({"creep": score} if score else {}), abs=0.01)
    assert next(iter(scores)) == "regulator_lag"
    assert ("creep" in describe_stated_set(tuple(scores.items()))) == bool(score)


@pytest.mark.parametrize(("third", "even"), [("creep", 3 * 0.4), ("parameter", 3.0)])
def test_three_effects_share_the_error_of_their_forms_but_not_with_a_value_of_the_robot(third: str, even: float) -> None:
    """They leave 2 % of what there was."""
    effects = (LAG, candidate("structural_friction"), replace(candidate("creep"), name=third))
    best, without = hypothesis(effects, 0.2), hypothesis((), 10.0)
    groups = {effect: [(best, 1.0)] for effect in effects}
    found = Explanation(without, best, best, [without, best], [], dict.fromkeys(effects, 10.0), groups)
    cause = belief._cause(LAG, found, SETTINGS, AssessmentSettings())
    assert cause == pytest.approx(10 / (10 + even))


def test_sure_effects_are_named() -> None:
    found = answer(LAG, 100.0)
    assert found.status is VerdictStatus.NAMED
    assert [(effect, round(p, 2)) for _, effect, _, p in found.listed] == [(LAG, 0.97)]


def test_named_asks_for_four_fifths_of_the_product() -> None:
    assert answer(LAG, 9.0).status is VerdictStatus.PARTIAL
    assert answer(LAG, 20.0, weight=0.85).status is VerdictStatus.PARTIAL


def test_what_is_left_weighs_more_against_an_exact_form() -> None:
    assert answer(LAG, 15.0).status is VerdictStatus.NAMED
    assert answer(LOAD, 150.0).status is VerdictStatus.PARTIAL
    assert answer(LOAD, 2.0).status is VerdictStatus.UNEXPLAINED
    assert answer(LOAD, 2.0).listed == ()


def test_what_acts_in_some_runs_only_must_take_away_more() -> None:
    assert answer(LAG, 10.0, left=0.02).status is VerdictStatus.NAMED
    assert answer(replace(LAG, runs=("a.csv",)), 10.0, left=0.02).status is VerdictStatus.PARTIAL


def test_where_only_noise_is_left_little_weighs_against_any_form() -> None:
    for effect in (LAG, LOAD):
        assert answer(effect, 10.0, left=0.02).status is VerdictStatus.NAMED
        assert answer(effect, 2.0, left=0.02).status is VerdictStatus.PARTIAL


@pytest.mark.parametrize(("effect", "left", "even"), [(LAG, 0.049, 1.0), (LOAD, 0.01, 1.0), (LOAD, 0.0325, 100.5), (LOAD, 0.05, 200.0)])
def test_what_an_exact_form_leaves_beyond_chance_weighs_against_it(effect: Any, left: float, even: float) -> None:
    """Ten times as much is taken away as is left; the noise is known to half a percent, samples are many."""
    best, without = hypothesis((effect,), left), hypothesis((), 1.0)
    best.estimate.cost, best.estimate.count = 1e6 * (1 + left), 1_000_000
    found = Explanation(without, best, best, [without, best], [], {effect: 10.0}, {effect: [(best, 1.0)]})
    assert assess(found, SHRUNK, SETTINGS, EffectChecks()).cause[effect] == pytest.approx(10 / (10 + even))


@pytest.mark.parametrize(("corrected", "runs", "refuted"), [(6e-3, ("a.csv",), True), (6e-3, (), False), (4.1e-3, ("a.csv",), False)])
def test_what_acts_in_some_runs_only_must_not_spoil_the_runs_kept(corrected: float, runs: tuple[str, ...], refuted: bool) -> None:
    """What acts in all runs fitted to may have been taken off before the others."""
    found = answer(replace(LAG, runs=runs), 1000.0, errors=replace(SHRUNK, corrected=corrected))
    assert found.status is (VerdictStatus.UNEXPLAINED if refuted else VerdictStatus.PARTIAL)
    assert any("fit worse" in remark for remark in found.remarks) == refuted


def test_both_of_two_in_the_place_of_one_are_listed() -> None:
    two = candidate("creep"), candidate("mass_distribution")
    best, other, without = hypothesis((LAG,), 0.2), hypothesis(two, 0.2), hypothesis((), 10.0)
    found = Explanation(without, best, best, [without, best, other], [], {LAG: 100.0}, {LAG: [(best, 0.6), (other, 0.4)]})
    listed = assess(found, SHRUNK, SETTINGS, EffectChecks()).listed
    assert [(each.name, round(p, 2)) for _, each, _, p in listed] == [("regulator_lag", 0.58), ("creep", 0.39), ("mass_distribution", 0.39)]


def test_what_mends_a_stand_in_is_doubted_with_it() -> None:
    """As much as the stand-in takes away of the structure."""
    best, without = hypothesis((LAG, LOAD), 0.2), hypothesis((), 10.0)
    law: Any = SimpleNamespace(place=SimpleNamespace(label="axial[12](length)"))
    groups = {effect: [(best, 1.0)] for effect in best.effects}
    for taken in (9.0, 1.0):
        found = Explanation(without, best, best, [without, best], [], {LAG: taken / 0.2, LOAD: 1e9}, groups)
        doubted = {LAG: AlternativeLaw(0.1, law)}
        assert assess(found, SHRUNK, SETTINGS, EffectChecks(doubted)).cause[LOAD] == pytest.approx(1 - 0.9 * taken / 10, rel=1e-6)


def test_nothing_is_named_that_does_not_shrink_the_gap_on_runs_not_used() -> None:
    same = replace(SHRUNK, corrected=SHRUNK.recalibrated)
    assert answer(LAG, 1000.0, errors=same).status is VerdictStatus.PARTIAL


def test_runs_not_used_that_show_nothing_say_nothing() -> None:
    quiet = replace(SHRUNK, recalibrated=5e-4, corrected=5e-4)
    assert answer(LAG, 1000.0, errors=quiet).status is VerdictStatus.NAMED


def test_rivals_are_listed() -> None:
    found = answer(LAG, 100.0, weight=0.6)
    assert found.status is VerdictStatus.INDISTINGUISHABLE
    assert [effect.name for _, effect, _, _ in found.listed] == ["regulator_lag", "creep"]


@pytest.mark.parametrize(("holds", "status"), [(1.0, VerdictStatus.NAMED), (0.5, VerdictStatus.PARTIAL), (0.1, VerdictStatus.UNEXPLAINED)])
def test_a_law_elsewhere_that_predicts_better_casts_doubt(holds: float, status: VerdictStatus) -> None:
    found = answer(LAG, 1000.0, doubt=holds)
    assert found.status is status
    assert any("axial[12](length)" in remark for remark in found.remarks) == (holds < 0.5)


@pytest.mark.parametrize("effect", [LOAD, LAG])
@pytest.mark.parametrize("left", [0.01, 0.04])
def test_a_force_of_known_form_has_to_hold_against_a_spring_however_little_is_left(
    effect: Any, left: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a hose that is tied somewhere is a constant load wherever only noise is left; other effects need not hold against springs."""
    best, without = hypothesis((effect,), left), hypothesis((), 1.0)
    found = Explanation(without, best, best, [without, best], [], {effect: 100.0}, {effect: [(best, 1.0)]})

    def doubted(part: float, samples: int = 10_000, elsewhere: float = 1.0) -> list[float]:
        """What the effect holds where a spring, and a law elsewhere, leave parts of what it leaves, in ten blocks of so many samples."""
        counts = np.full(10, samples)

        def law(kind: str, variable: str, rest: float) -> Any:
            place = SimpleNamespace(kind=kind, variable=variable, label=f"{kind}({variable})")
            return SimpleNamespace(place=place, evidence=Evidence(counts * (1 + rest * left), counts, 5, np.zeros(5)))

        monkeypatch.setattr(belief, "alternatives", lambda _: [law("force", "position", part), law("axial", "pressure", elsewhere)])
        measured = replace(best, evidence=Evidence(counts * (1 + left), counts, 1, np.zeros(1)))
        return [each.effect_probability for each in alternative_law_odds(replace(found, best=measured), SETTINGS, 0).values()]

    assert doubted(0.1) == ([pytest.approx(0.0, abs=0.05)] if effect is LOAD else [])
    assert doubted(0.9) == []
    assert doubted(0.5, elsewhere=0.1) == [], "what is left is something else's"
    assert len(doubted(0.1, elsewhere=0.1)) == (effect is LOAD)
    assert doubted(0.1, samples=40) == [], "so few may say that by chance"


@pytest.mark.parametrize(
    ("constant", "status"), [(1.0, VerdictStatus.NAMED), (0.6, VerdictStatus.PARTIAL), (0.01, VerdictStatus.UNEXPLAINED)]
)
def test_a_force_that_may_be_a_springs_is_doubted(constant: float, status: VerdictStatus) -> None:
    best, without = hypothesis((LOAD,), 0.01), hypothesis((), 1.0)
    found = Explanation(without, best, best, [without, best], [], {LOAD: 100.0}, {LOAD: [(best, 1.0)]})
    judged = assess(found, SHRUNK, SETTINGS, EffectChecks(constant={LOAD: constant}))
    assert judged.status is status
    assert any("hose" in remark for remark in judged.remarks) == (constant < 1)


@pytest.mark.parametrize("kind", ["drag", "spring"])
def test_a_wrong_damping_has_to_hold_against_the_drag_of_a_medium(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A spring may say the same as a wrong value of the robot file; it does not count."""
    damping = Candidate("parameter", "c_a", acts=("axial", "force", "measurement"))
    best, without = hypothesis((damping,), 0.2), hypothesis((), 10.0)
    found = Explanation(without, best, best, [without, best], [], {damping: 100.0}, {damping: [(best, 1.0)]})
    variable = "speed" if kind == "drag" else "position"
    place = SimpleNamespace(kind="force", variable=variable, target="all", label=f"force[all]({variable})")
    law = SimpleNamespace(place=place, evidence=hypothesis((), 0.01).evidence)
    monkeypatch.setattr(belief, "alternatives", lambda _: [law])
    doubts = alternative_law_odds(found, SETTINGS, 0)
    assert [each.effect_probability < 0.5 for each in doubts.values()] == ([True] if kind == "drag" else [])


DAMPING = Candidate("parameter", "c_a", acts=("axial", "force", "measurement"))


@pytest.mark.parametrize(
    ("effects", "left", "beside", "doubted"),
    [
        ((DAMPING,), 0.2, 0.1, True),
        ((DAMPING,), 0.2, 0.19, False),
        ((DAMPING,), 0.02, 0.005, False),
        ((DAMPING, LOAD), 0.2, 0.1, False),
        ((candidate("structural_friction"),), 0.2, 0.1, False),
    ],
    ids=["drag", "drag that says nothing", "only noise left", "one of two", "friction, whose form errs by speed"],
)
def test_a_single_wrong_value_has_to_hold_against_a_drag_beside_it(
    effects: tuple[Any, ...], left: float, beside: float, doubted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a bath the robot's damping is found instead, and a drag beside it still says more."""
    counts = np.full(10, 10_000)
    best = replace(hypothesis(effects, left), evidence=Evidence(counts * (1 + left), counts, 1, np.zeros(1)))
    found = Explanation(hypothesis((), 10.0), best, best, [best], [], {effects[0]: 100.0}, {effects[0]: [(best, 1.0)]})
    place = SimpleNamespace(kind="force", variable="speed", target="all", label="force[all](speed)")
    law = SimpleNamespace(place=place, evidence=Evidence(counts * (1 + beside), counts, 5, np.zeros(5)))
    monkeypatch.setattr(belief, "alternatives", lambda _: [law])
    odds = alternative_law_odds(found, SETTINGS, 0)
    assert [each.effect_probability < 0.05 for each in odds.values()] == [True] * doubted


def test_an_exact_form_beside_one_that_is_not_may_leave_structure() -> None:
    """What is left may be the other's."""
    best, without = hypothesis((LAG, LOAD), 0.2), hypothesis((), 10.0)
    groups = {effect: [(best, 1.0)] for effect in best.effects}
    both = assess(Explanation(without, best, best, [without, best], [], {LAG: 15.0, LOAD: 15.0}, groups), SHRUNK, SETTINGS, EffectChecks())
    assert both.cause[LOAD] == pytest.approx(15 / (15 + SETTINGS.even_odds_ratio))


def test_what_is_of_another_size_in_every_run_is_no_cause() -> None:
    assert answer(LAG, 1000.0, spread=0.05).status is VerdictStatus.NAMED
    found = answer(LAG, 1000.0, spread=1.0)
    assert found.status is VerdictStatus.UNEXPLAINED
    assert found.remarks == ("regulator_lag is not of one size: it is 0.2 in a.csv, 1.8 in b.csv of what it is over all.",)


def test_of_many_effects_those_that_take_little_may_be_less_sure() -> None:
    """Five that leave next to nothing: what gauges show is sure; the smallest is told with its probability, and does not spoil the rest."""
    five = tuple(Candidate(name, None, {f"{name}.size": 0.0}) for name in "abcde")
    best, without, begun = hypothesis(five, 1.0), hypothesis((), 500.0), hypothesis(five[:1], 100.0)
    groups = {effect: [(best, 1.0)] for effect in five}
    shares = dict(zip(five, (float("inf"), 30.0, 30.0, 30.0, 1.0), strict=True))

    def answered(shares: dict[Candidate, float], begun: Any = begun) -> Judgement:
        found = Explanation(without, best, best, [without, best], [], shares, groups, begun)
        return assess(found, SHRUNK, SETTINGS, EffectChecks())

    found = answered(shares)
    assert found.status is VerdictStatus.NAMED
    assert found.cause[five[0]] == 1.0
    assert 0.5 < found.cause[five[4]] < 0.8
    assert answered({**shares, five[1]: 1.0, five[2]: 1.0, five[3]: 1.0}, hypothesis(five[:1], 10.0)).status is VerdictStatus.PARTIAL


def test_what_gauges_show_does_not_explain_what_it_leaves() -> None:
    """A lag that is sure, and something foreign beside it that nothing explains: that is a part."""
    begun = hypothesis((LAG,), 100.0)

    def status(left: float) -> VerdictStatus:
        best, without = hypothesis((LAG,), left), hypothesis((), 500.0)
        found = Explanation(without, best, best, [without, best], [], {LAG: float("inf")}, {LAG: [(best, 1.0)]}, begun)
        return assess(found, SHRUNK, SETTINGS, EffectChecks()).status

    assert status(100.0) is VerdictStatus.PARTIAL
    assert status(1.0) is VerdictStatus.NAMED


def test_what_gauges_show_casts_no_doubt_where_nothing_is_left() -> None:
    """A model that is right to the noise leaves an excess of 0; the share of what gauges show is infinite."""
    best, without, begun = hypothesis((LAG, LOAD), 0.0), hypothesis((), 10.0), hypothesis((LAG,), 3.0)
    groups = {effect: [(best, 1.0)] for effect in best.effects}
    found = Explanation(without, best, best, [without, begun, best], [], {LAG: float("inf"), LOAD: 5e4}, groups, begun)
    told = assess(found, SHRUNK, SETTINGS, EffectChecks())
    assert told.status is VerdictStatus.NAMED
    assert told.cause[LOAD] > 0.99
