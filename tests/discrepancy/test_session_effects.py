"""What the rig does in a session's time in forms of its own, explained by the effects that ask what time it is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tepm_opt.discrepancy.adapters.network import candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.fitting import Fits
from tepm_opt.discrepancy.selection.shape_suggestions import apply_suggested_shapes
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.effects import find_effect
from tepm_opt.models.model import Model
from tepm_opt.models.robot import load_robot
from tepm_opt.solvers.identification.identify import ParameterEstimate, Problem, identify
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant
from tepm_opt.studies.blind.excitation import excitations
from tepm_opt.studies.blind.machine import Deviation, rig_file, simulate_run
from tests.tools import in_company

KANG, NOISE = load_robot("kang2017"), 3e-4
HIDDEN: dict[str, tuple[str, dict[str, Any], dict[str, float]]] = {
    "muscles that warm linearly": ("warm_up", {"change": -0.1, "full_s": 40.0}, {}),
    "a pose that goes to and fro": ("tracker_drift", {"shift_m": (0.004, -0.003, 0.002), "period_s": 200.0}, {}),
    "a tendon that slides": ("tendon_slip", {"share": {"13": 0.4}, "instant_s": 15.8}, {"share": 0.4}),
    "a base with harmonics": ("base_vibration", {"amplitude_m": (1e-3, -5e-4, 3e-4), "frequency_Hz": 7.3}, {"frequency": 7.3}),
    "a stand that moves": (
        "base_vibration", {"amplitude_m": (1e-3, -5e-4, 3e-4), "frequency_Hz": 7.3, "felt": False}, {"frequency": 7.3, "inertia": 0.0}
    ),
    "a clock that gains more and more": ("clock_skew", {"rate": 0.005, "bend_per_s": 5e-5}, {"rate": 0.005}),
}  # fmt: skip
"""By what it is: the effect, the rig's sizes, and parameters that mean the same."""


@pytest.fixture(scope="module")
def company() -> CompiledModel:
    """All effects at their null values, those of actuators on the third."""
    return compile_model(in_company())


def excess(estimate: ParameterEstimate) -> float:
    return sum(r.squares for r in estimate.residuals) / sum(r.count for r in estimate.residuals) - 1


@pytest.mark.slow
@pytest.mark.parametrize("what", HIDDEN)
def test_it_is_explained_from_what_the_residuals_suggest(company: CompiledModel, what: str) -> None:
    name, sizes, same = HIDDEN[what]
    hidden = Deviation({name: sizes})
    runs = tuple(
        simulate_run(rig_file(KANG, hidden, NOISE, 1), hidden, run, k) for k, run in enumerate(excitations(3, short=True)[:4], start=1)
    )
    plant = NetworkPlant(company)
    known = plant.free(tuple(KANG.priors))
    without = identify(Problem(plant, runs, known, NOISE, step=0.02, derivatives_apart=0.04))
    missing = candidate(name, "13" if find_effect(name).detail else None)
    problem = apply_suggested_shapes(without, [missing]).problem
    own = problem.plant.free(missing.parameters)
    start = tuple(replace(f, start=float(value)) for f, value in zip(known, without.values, strict=True))
    found = identify(replace(problem, free=(*start, *own)), 15)
    assert excess(without) > 1
    assert excess(found) < 0.05 * excess(without)
    for parameter, value in same.items():
        label = f"{missing.label}.{parameter}"
        assert found.named[label] == pytest.approx(value, rel=0.05, abs=0.01), label


def test_what_is_suggested_for_runs_of_a_known_session() -> None:
    """An instant, and a line of either kind of phase, in noise."""
    random, began = np.random.default_rng(2), np.repeat([0.0, 25.3, 50.1], 1000)
    clock, left = began + np.tile(np.arange(1000) / 50, 3), random.normal(size=(3000, 12))
    slip, shaken = find_effect("tendon_slip"), find_effect("base_vibration")
    later = left + np.where(clock > 31.7, 2 * np.sin(clock), 0.0)[:, None]
    assert slip.suggest_values(clock, began, later)["instant"] == pytest.approx(31.7, abs=0.3)
    for restarts in (0.0, 1.0):
        line = left + 0.3 * np.sin(2 * np.pi * 7.3 * (clock - restarts * began) + 1)[:, None] + 2 * np.sin(0.8 * clock)[:, None]
        found = shaken.suggest_values(clock, began, line)
        assert found["frequency"] == pytest.approx(7.3, abs=7e-3)
        assert found["restarts"] == restarts


def test_an_arm_that_sways_hides_no_line() -> None:
    """Sway that decays has more power than the line; the line's second harmonic is no line of its own."""
    random, began = np.random.default_rng(3), np.repeat([0.0, 25.3, 50.1], 600)
    passed = np.tile(np.arange(600) / 50, 3)
    sways = np.repeat(random.normal(size=(3, 12)), 600, axis=0)  # another way in each run
    sway = 12 * sways * (np.exp(-passed / 4) * np.sin(2 * np.pi * 0.9 * passed))[:, None]
    turn = 2 * np.pi * 6.1 * (began + passed)
    left = random.normal(size=(1800, 12)) + sway + (np.sin(turn) + 0.1 * np.sin(2 * turn))[:, None]
    found = find_effect("base_vibration").suggest_values(began + passed, began, left)
    assert found["frequency"] == pytest.approx(6.1, abs=7e-3)


@pytest.mark.slow
def test_a_base_that_sets_in_at_once_is_fitted_from_a_slow_rise(company: CompiledModel) -> None:
    """The arm sways after the kick; from a rise of half a second no derivative leads there."""
    true = {f"sine_{axis}": size for axis, size in zip("xyz", (1e-3, -5e-4, 3e-4), strict=True)} | {"frequency": 7.3, "rise": 0.02}
    moved = NetworkPlant(company).with_values({f"base_vibration.{name}": value for name, value in true.items()})
    still, random = Deviation(), np.random.default_rng(5)
    runs = []
    for k, run in enumerate(excitations(3, short=True)[:3], start=1):
        ran = simulate_run(rig_file(KANG, still, NOISE, 1), still, run, k)
        seen = moved.predict(ran, step=0.02).points
        runs.append(replace(ran, points=seen + random.normal(0, NOISE, seen.shape)))
    plant = NetworkPlant(company)
    fits = Fits(Problem(plant, tuple(runs), plant.free(tuple(KANG.priors)), NOISE, step=0.02), SearchSettings())
    without, missing = fits.fit((), {}), candidate("base_vibration")
    assert without is not None
    linear = fits.linear(without, [missing])
    found = fits.fit((missing,), linear.gain((missing,))[1])
    assert found is not None
    assert found.excess < 0.02 * without.excess
    assert found.estimate.named["base_vibration.rise"] < 0.05


def test_data_of_equilibria_suggest_nothing() -> None:
    model = compile_model(Model.from_robot("kang2017"))
    without = Problem(NetworkPlant(model, static=True), (), (), NOISE)
    estimate = ParameterEstimate.__new__(ParameterEstimate)
    object.__setattr__(estimate, "problem", without)
    object.__setattr__(estimate, "residuals", [])
    assert apply_suggested_shapes(estimate, [candidate("warm_up")]) is estimate
