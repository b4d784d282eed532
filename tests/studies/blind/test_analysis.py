"""Rates of made results, whose truth is known by hand."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt import studies
from tepm_opt.discrepancy.assessment.calibration import calibrate_probability
from tepm_opt.discrepancy.assessment.settings import DEFAULT
from tepm_opt.hw.simulation.imperfections import Imperfections
from tepm_opt.models.effects import effects
from tepm_opt.studies.blind.analysis import Rate, analyse_results, reliability, wilson
from tepm_opt.studies.blind.calibration import calibrate_stated_set, fit_calibration
from tepm_opt.studies.blind.causes import LIBRARY
from tepm_opt.studies.blind.foreign import FOREIGN
from tepm_opt.studies.blind.judged import Judged
from tepm_opt.studies.blind.run import BlindRun
from tepm_opt.studies.blind.table import markdown
from tepm_opt.studies.blind.trial import TrialSeries

SECONDS = {"wall": 12.0, "cpu": 11.0, "making": 2.0}
Hidden = tuple[str, str | None, float]
Said = tuple[str, str | None, float]


def result(family: str, hidden: list[Hidden], status: str, said: list[Said], number: int = 0, **label: Any) -> dict[str, Any]:
    """A line of trials.jsonl: names, details and misfits of what is hidden, and names, details and probabilities of what is said."""
    own = {
        "names": sorted(name for name, _, _ in hidden),
        "allowed": [],
        "detail": {name: detail for name, detail, _ in hidden if detail},
        "kind": {"closed": "lib", "open": "foreign", "null": "null"}.get(family, "lib"),
        "flaw": "",
        "causes": [{"cause": name, "names": [name], "size": 1.0, "misfit_over_noise": misfit} for name, _, misfit in hidden],
        "sizes": {},
        "true_parameters": {},
    }
    effects = [{"name": name, "detail": detail, "probability": p, "parameters": {}} for name, detail, p in said]
    errors = {"noise_floor": 1.0, "nominal": 9.0, "recalibrated": 5.0, "corrected": 2.0, "black_box": 4.0}
    verdict = {"status": status, "effects": effects, "rmse_m": errors, "recalibrated": {}}
    return {"family": family, "seed": 0, "number": number, "label": own | label, "verdict": verdict, "error": None, "seconds": SECONDS}


def refused(family: str, hidden: list[Hidden]) -> dict[str, Any]:
    return {**result(family, hidden, "", []), "verdict": None, "error": "InputError: no"}


def foreign(key: str, status: str, said: list[Said]) -> dict[str, Any]:
    cause = {"cause": key, "names": [], "size": 1.0, "misfit_over_noise": 5.0}
    return result("open", [], status, said, causes=[cause])


def judged(*args: Any, **kwargs: Any) -> Judged:
    return Judged(result(*args, **kwargs))


GAIN: list[Hidden] = [("actuator_gain", "12", 3.0)]


class TestOneTrial:
    def test_a_name_is_right_with_its_detail_only(self) -> None:
        assert judged("closed", GAIN, "named", [("actuator_gain", "12", 0.97)]).right
        elsewhere = judged("closed", GAIN, "named", [("actuator_gain", "13", 0.97)])
        assert not elsewhere.right
        assert elsewhere.false_above(0.9)
        assert not elsewhere.abstained
        assert not judged("closed", GAIN, "partial", [("actuator_gain", "12", 0.97)]).right

    def test_one_name_too_many_is_wrong_and_one_too_few_an_abstention(self) -> None:
        more = judged("closed", GAIN, "named", [("actuator_gain", "12", 0.97), ("payload", None, 0.6)])
        assert (more.right, more.abstained, more.false_above(0.5), more.false_above(0.9)) == (False, False, True, False)
        both = [*GAIN, ("payload", None, 3.0)]
        less = judged("closed", both, "named", [("actuator_gain", "12", 0.97)])
        assert (less.right, less.abstained) == (False, True)
        assert [less.lists_cause(cause) for cause in less.causes] == [True, False]
        assert judged("closed", GAIN, "named", [("actuator_gain", "12", 0.97), ("payload", None, 0.4)]).right

    def test_rivals_that_are_listed_count_with_their_probability(self) -> None:
        unsure = judged("closed", GAIN, "indistinguishable", [("actuator_gain", "12", 0.48), ("payload", None, 0.45)])
        assert (unsure.right, unsure.abstained) == (False, True)
        assert [each.acts for each in unsure.listed] == [True, False]

    def test_what_looks_the_same_is_as_right_at_the_same_place(self) -> None:
        slipped: list[Hidden] = [("tendon_slip", "12", 3.0)]
        alike = {"tendon_slip": ["tension_gain"]}
        assert judged("closed", slipped, "named", [("tension_gain", "12", 0.97)], alike=alike).right
        assert judged("closed", slipped, "named", [("tendon_slip", "12", 0.97)], alike=alike).right
        assert judged("closed", slipped, "named", [("tension_gain", "12", 0.97)], alike=alike).lists_cause({"names": ["tendon_slip"]})
        assert not judged("closed", slipped, "named", [("tension_gain", "13", 0.97)], alike=alike).right
        assert judged("closed", slipped, "named", [("tension_gain", "12", 0.97)]).false_above(0.9)

    def test_what_has_no_name_is_right_where_nothing_false_is_said(self) -> None:
        assert Judged(foreign("curved_field", "unexplained", [])).right
        assert Judged(foreign("curved_field", "partial", [("payload", None, 0.3)])).right
        assert not Judged(foreign("curved_field", "named", [("payload", None, 0.8)])).right
        assert not Judged(refused("open", [])).right

    def test_nothing_hidden_has_to_be_no_discrepancy(self) -> None:
        assert judged("null", [], "no_discrepancy", []).right
        assert not judged("null", [], "unexplained", []).right
        assert judged("wrong", [], "no_discrepancy", [], kind="noise").right

    def test_a_clock_may_look_like_a_delay(self) -> None:
        delay: list[Said] = [("time_delay", None, 0.99)]
        late = judged("wrong", [], "named", delay, kind="clock", allowed=["time_delay"])
        assert late.right
        assert late.listed[0].acts is None
        assert not judged("wrong", [], "named", delay, kind="clock").right

    def test_a_cause_of_some_runs_is_right_with_them(self) -> None:
        late = result("poor", GAIN, "partial", [("actuator_gain", "12", 0.9)], runs=["b", "c"])
        assert not Judged(late).right
        late["verdict"]["effects"][0]["runs"] = ["c", "b"]
        assert Judged(late).right
        late["verdict"]["effects"][0]["runs"] = ["c"]
        assert not Judged(late).right

    def test_intervals(self) -> None:
        line = result(
            "closed", GAIN, "named", [("actuator_gain", "12", 0.9)],
            sizes={"actuator_gain[12].loss": 0.1, "payload.mass": 1.0}, true_parameters={"K_a": 350.0},
        )  # fmt: skip
        line["verdict"]["effects"][0]["parameters"] = {"loss": {"value": 0.12, "std": 0.005}}
        line["verdict"]["recalibrated"] = {"K_a": {"value": 351.0, "std": 1.0}}
        assert Judged(line).covered == {"actuator_gain[12].loss": False, "K_a": True}
        line["label"]["other_meaning"] = ["K_a"]
        assert Judged(line).covered == {"actuator_gain[12].loss": False}

    def test_the_gap_is_what_recalibration_leaves(self) -> None:
        assert judged("closed", GAIN, "named", []).closed == pytest.approx((5 - 2) / (5 - 1))


def test_wilson_against_its_published_example() -> None:
    """81 of 263: 0.2553 … 0.3662 (Newcombe, Statistics in Medicine 17, 1998, 857, table I)."""
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert Rate("x", 3, 4, least=0.8).kept is False
    assert Rate("x", 4, 4, 0.9, 0.98).kept is False
    assert Rate("x", 0, 0, 0.9).kept is None


def test_rates_count_what_they_say() -> None:
    gain: list[Said] = [("actuator_gain", "12", 0.97)]
    pair: list[Hidden] = [*GAIN, ("payload", None, 4.0)]
    small: list[Hidden] = [("actuator_gain", "12", 1.0)]
    results = [
        result("closed", GAIN, "named", gain),
        result("closed", GAIN, "unexplained", []),
        result("closed", GAIN, "named", [("payload", None, 0.95)]),
        refused("closed", GAIN),
        result("closed", pair, "named", [*gain, ("payload", None, 0.8)]),
        result("closed", small, "indistinguishable", [("actuator_gain", "12", 0.55), ("payload", None, 0.4)]),
        foreign("curved_field", "named", [("payload", None, 0.7)]),
        result("null", [], "no_discrepancy", []),
        result("null", [], "unexplained", []),
        {"family": "null", "seed": 0, "number": 9, "label": None, "verdict": None, "error": "RuntimeError: x", "seconds": {}},
    ]
    found = analyse_results(results)
    rates = {rate.name: (rate.count, rate.of) for rate in found.rates}
    assert rates["a false name above 0.9"] == (1, 9)
    assert rates["a false name above 0.5"] == (2, 9)
    assert rates["a false name above 0.5: open"] == (1, 1)
    assert rates["right: one effect, clear"] == (1, 4)
    assert rates["right: two effects, clear"] == (1, 1)
    assert rates["found: one effect that leaves as much as the noise"] == (1, 1)
    assert rates["abstained: effects of the library, clear"] == (2, 5)
    assert rates["an alarm where nothing is hidden"] == (1, 2)
    assert found.failed == {"RuntimeError: x": 1}
    assert found.confusion["actuator_gain"] == {"actuator_gain": 2, "unexplained": 1, "payload": 1, "refused": 1}
    assert found.confusion["curved_field"] == {"payload": 1}
    assert found.confusion["nothing"] == {"no_discrepancy": 1, "unexplained": 1}
    assert [(every.name, every.count, every.of) for _, every, _ in found.detection if every.of] == [("0.8 … 1.25", 1, 1), ("2 … 3.5", 1, 4)]
    text = markdown(found)
    assert "| a false name above 0.9 | 11.1 % | 9 |" in text
    assert "≤ 0.8 %, **missed** |" in text
    assert "1 without data: RuntimeError: x." in text
    assert found.summary()["families"] == {"closed": 6, "null": 2, "open": 1}


@pytest.mark.slow
@pytest.mark.parametrize(("honest", "low", "high"), [(True, 0.0, 0.03), (False, 0.15, 0.25)])
def test_calibration_is_told_from_overconfidence(honest: bool, low: float, high: float) -> None:
    """Causes act as often as stated, or 0.2 less often."""
    random = np.random.default_rng(1)
    results = []
    for number in range(4000):
        stated = random.uniform(0.4, 1.0)
        acts = random.uniform() < stated - (0.0 if honest else 0.2)
        results.append(result("closed", GAIN, "named", [("actuator_gain", "12" if acts else "13", stated)], number))
    found = reliability([Judged(each) for each in results])
    assert found is not None
    assert found.counts.tolist() == [800] * 5
    assert low <= found.error <= high
    assert found.band[0] <= found.error <= found.band[1] + 0.01
    assert ((found.low < found.acts) & (found.acts < found.high)).all()
    assert np.all(np.diff(found.stated) > 0)
    assert reliability([Judged(each) for each in results[:5]]) is None


def test_the_page_lists_every_cause_outside_the_library() -> None:
    text = (Path(__file__).parents[3] / "docs" / "results" / "blind.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^\| (\w+) \| .* \| .* \|$", text.partition("## Causes outside")[2].partition("\n## ")[0], re.MULTILINE))
    assert listed - {"cause"} == set(FOREIGN)
    assert len(FOREIGN) >= 8
    assert not {effect.name for effect in effects()} & set(FOREIGN)


def test_every_effect_that_the_rig_has_is_hidden_somewhere() -> None:
    hidden = {name for cause in LIBRARY.values() for name in cause(np.random.default_rng(0)).names}
    known = {effect.name for effect in effects()}
    assert known & set(Imperfections.model_fields) <= hidden <= known


def test_figures(tmp_path: Path) -> None:
    """All four of many results; of few only what there is to draw."""
    many = [result("closed", GAIN, "named", [("actuator_gain", "12", 0.9)], number) for number in range(12)]
    null = [result("null", [], "no_discrepancy", [])]
    names = {"rates", "detection", "reliability", "confusion"}
    for results, missing in (([*many, *null], set()), (null, {"detection", "reliability"}), ([], names)):
        run = BlindRun(TrialSeries(len(results)), tuple(results))
        run.save(tmp_path)
        assert set(studies.draw_blind_trials(run, tmp_path)) == names - missing
        assert {path.stem for path in tmp_path.glob("*.png")} == names - missing
        assert json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["blind"]["trials"] == len(results)


def scored(number: int, hidden: list[Hidden], scores: dict[str, float]) -> dict[str, Any]:
    found = result("closed", hidden, "named", [], number)
    return {**found, "verdict": found["verdict"] | {"scores": scores}}


def test_a_set_holds_all_causes_where_it_begins_below_the_least_of_them() -> None:
    hidden = [("actuator_gain", "12", 3.0), ("creep", None, 3.0)]
    assert Judged(scored(1, hidden, {"creep": 0.9, "actuator_gain[12]": 0.3, "actuator_gain[13]": 0.2})).least_score == 0.3
    assert Judged(scored(1, hidden, {"creep": 0.9, "actuator_gain[13]": 0.2})).least_score == 0.0
    assert Judged(result("closed", hidden, "named", [])).least_score is None


def test_a_threshold_promises_a_coverage() -> None:
    """Of 39 trials for calibration two may lie below the threshold, as 5 % of 40; five are too few for a promise."""
    some = [scored(k, GAIN, {"actuator_gain[12]": 0.01 * (k + 1)}) for k in range(39)]
    assert calibrate_stated_set(map(Judged, some), 0.95) == pytest.approx(0.02)
    assert calibrate_stated_set(map(Judged, some[:5]), 0.95) == 0.0


def test_the_stated_set_is_judged_by_its_threshold() -> None:
    judged = [scored(k, GAIN, {"actuator_gain[12]": DEFAULT.min_stated + (0.01 if k else -0.01)}) for k in range(10)]
    rate = next(rate for rate in analyse_results(judged).rates if rate.name.startswith("the stated set"))
    assert (rate.count, rate.of) == (9, 10)


def test_coefficients_of_the_calibration_are_recovered() -> None:
    """Answers of two effects whose frequencies follow the formula, drawn from it."""
    random, trials = np.random.default_rng(3), []
    for number in range(3000):
        own = random.uniform(0.3, 0.999, 2)
        acts = random.random(2) < calibrate_probability(own, np.full(2, own.min()))
        hidden = [(name, None, 3.0) for name, does in zip(("creep", "payload"), acts, strict=True) if does]
        said = [(name, None, p) for name, p in zip(("creep", "payload"), own, strict=True)]
        trials.append(result("closed", hidden, "named", said, number))
    found, interval = fit_calibration([Judged(each) for each in trials])
    true = [DEFAULT.calibration_offset, DEFAULT.calibration_own, DEFAULT.calibration_weakest]
    assert np.all(np.abs(found - true) < 0.1)
    assert np.all((interval[0] < found) & (found < interval[1]))
