"""Many effects at once on a machine that has five of them: the set, the way back, rivals; and that one effect does not ask for several."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.network import candidates, with_all_candidates
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.fitting import Fits, Hypothesis
from tepm_opt.discrepancy.selection.matching_pursuit import (
    excess_without,
    fit_by_matching_pursuit,
    prune_insignificant,
    select_by_matching_pursuit,
    weigh_best_rival,
)
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.model import Model
from tepm_opt.solvers.identification.identify import Problem
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant, free_parameters
from tests.discrepancy.small import NOISE, changed, cut, measured, planned, true_values

pytestmark = pytest.mark.slow
NOMINAL = Model.from_robot("kang2017")
HIDDEN = {
    "payload.mass": 0.03,
    "base_tilt.x": 0.02,
    "sensor_offset[s2].x": 5e-3,
    "actuator_gain[13].loss": 0.06,
    "regulator_lag.filling_time": 0.1,
    "regulator_lag.exhausting_time": 0.2,
}
LABELS = {name.rsplit(".", 1)[0] for name in HIDDEN}
FILES = ("single_pressure.csv", "elongation.csv", "antagonists.csv")


@pytest.fixture(scope="module")
def library() -> CompiledModel:
    return compile_model(with_all_candidates(NOMINAL, candidates(NOMINAL)))


def fits_of(library: CompiledModel, kang: CompiledModel, hidden: dict[str, float]) -> Fits:
    runs: list[Run] = [cut(run, 6.0) for run in measured(changed(library, **true_values(kang), **hidden), planned(FILES))]
    problem = Problem(NetworkPlant(library), tuple(replace(run, role="fit") for run in runs), free_parameters(library), NOISE, step=0.02)
    return Fits(replace(problem, derivatives_apart=0.04), SearchSettings())


@pytest.fixture(scope="module")
def missing() -> tuple[Candidate, ...]:
    kept = {*LABELS, "external_load", "creep", "rigid_plates", "actuator_gain[12]", "sensor_offset[s3]", "time_delay"}
    return tuple(c for c in candidates(NOMINAL) if c.label in kept)


@pytest.fixture(scope="module")
def fits(library: CompiledModel, kang: CompiledModel) -> Fits:
    return fits_of(library, kang, HIDDEN)


@pytest.fixture(scope="module")
def found(fits: Fits, missing: tuple[Candidate, ...]) -> Hypothesis:
    base = fits.fit((), {})
    assert base is not None
    best = fit_by_matching_pursuit(fits, base, missing)
    assert best is not None
    return prune_insignificant(fits, best, missing)[0]


def test_all_are_found_and_nothing_else(fits: Fits, found: Hypothesis, missing: tuple[Candidate, ...]) -> None:
    assert {effect.label for effect in found.effects} == LABELS
    shares = prune_insignificant(fits, found, missing)[1]
    assert min(shares.values()) > 1, "none stays without a share, the tilt that takes away least of all neither"
    assert found.excess < 0.1
    assert found.estimate.named["payload.mass"] == pytest.approx(0.03, rel=0.2)
    assert found.estimate.named["actuator_gain[13].loss"] == pytest.approx(0.06, rel=0.2)


def test_what_an_effect_takes_away_to_first_order_is_what_a_fit_without_it_leaves(
    fits: Fits, found: Hypothesis, missing: tuple[Candidate, ...]
) -> None:
    linear = fits.linear(found, missing)
    for effect in found.effects:
        if effect.name == "sensor_offset":
            rest = fits.fit(tuple(c for c in found.effects if c != effect), found.estimate.named)
            assert rest is not None
            left = rest.estimate.cost / rest.estimate.count - found.estimate.cost / found.estimate.count
            assert excess_without(linear, effect) == pytest.approx(left, rel=0.1)
        assert excess_without(linear, effect) > 0.1


def test_rivals_are_weighed(fits: Fits, found: Hypothesis, missing: tuple[Candidate, ...]) -> None:
    for effect in found.effects:
        group = weigh_best_rival(fits, found, effect, missing, 0)
        assert group[0][0] is found
        assert sum(weight for _, weight in group) == pytest.approx(1)
        assert group[0][1] > 0.9


def test_what_gauges_have_shown_stays(fits: Fits, found: Hypothesis, missing: tuple[Candidate, ...]) -> None:
    """An effect that does nothing is dropped, but for one that gauges show."""
    idle = next(c for c in missing if c.label == "time_delay")
    with_idle = fits.fit((*found.effects, idle), found.estimate.named)
    assert with_idle is not None
    assert idle not in prune_insignificant(fits, with_idle, missing)[0].effects
    kept, shares = prune_insignificant(replace(fits, gauge_effects=(idle,)), with_idle, missing)
    assert idle in kept.effects
    assert shares[idle] == float("inf")


def test_one_effect_does_not_ask_for_several(library: CompiledModel, kang: CompiledModel, missing: tuple[Candidate, ...]) -> None:
    one = fits_of(library, kang, {"payload.mass": 0.05})
    base = one.fit((), {})
    assert base is not None
    assert len(select_by_matching_pursuit(one, base, missing)[0]) == 1, "a weight or a force that pulls down"
    assert fit_by_matching_pursuit(one, base, missing) is None


def test_several_are_not_taken_together_where_first_order_does_not_hold(
    fits: Fits, missing: tuple[Candidate, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where the robot file is of another robot: with the values that first order asks for more is left than there was."""
    base = fits.fit((), {})
    assert base is not None
    effects, start = select_by_matching_pursuit(fits, base, missing)
    assert fit_by_matching_pursuit(fits, base, missing) is not None
    far = {name: 3 * value if "." in name else value for name, value in start.items()}
    monkeypatch.setattr("tepm_opt.discrepancy.selection.matching_pursuit.select_by_matching_pursuit", lambda *_: (effects, far))
    assert fit_by_matching_pursuit(fits, base, missing) is None


def test_what_the_model_cannot_do_without_leaves_the_others_their_shares(
    fits: Fits, found: Hypothesis, missing: tuple[Candidate, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    idle = next(c for c in missing if c.label == "time_delay")
    with_idle = fits.fit((*found.effects, idle), found.estimate.named)
    assert with_idle is not None
    monkeypatch.setattr("tepm_opt.discrepancy.selection.matching_pursuit._fit_without", lambda *_: (None, float("inf")))
    kept, shares = prune_insignificant(fits, with_idle, missing)
    assert set(kept.effects) == set(with_idle.effects)
    assert all(0 < shares[effect] < float("inf") for effect in found.effects), shares
