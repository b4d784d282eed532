"""Effects that ask what time it is in the session: closed forms, the same on all ways, runs that know when they began."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.effect import Context
from tepm_opt.models.effects import find_effect
from tepm_opt.models.model import Model
from tepm_opt.solvers.mechanics.predict import predict
from tepm_opt.solvers.mechanics.simulate import Directions, simulate
from tepm_opt.solvers.mechanics.statics import solve_statics
from tests.tools import in_company, with_all_effects

BEGAN = 40.0


pytestmark = pytest.mark.slow
"""They need the motion of a model with all effects, which compiles for half a minute."""


@pytest.fixture(scope="module")
def setpoints(kang: CompiledModel) -> SetPoints:
    """Waves of all inputs over 3 s."""
    time = np.linspace(0, 3.0, 151)
    waves = 0.5 - 0.5 * np.cos(np.outer(time, np.random.default_rng(3).uniform(1, 4, 12)))
    return SetPoints(time, (0.1 + 0.1 * waves) * kang.input_max, np.zeros((151, 3)))


@pytest.fixture(scope="module")
def company() -> CompiledModel:
    """All effects at their null values."""
    model = compile_model(with_all_effects(Model.from_robot("kang2017")))
    return at(model, {})


def at(model: CompiledModel, values: dict[str, float]) -> CompiledModel:
    """All effects at their null values but for these."""
    null = {f"{e.label}.{p.name}": p.null for e in model.model.effects for p in find_effect(e.name).parameters}
    return model.with_theta([({**model.values, **null, **values})[name] for name in model.network.parameter_names])


def test_a_drift_is_a_shift_in_proportion_to_the_session_s_time(company, setpoints):
    rate = np.array([1e-5, -2e-5, 3e-5])
    drifting = at(company, {f"tracker_drift.shift_{axis}": value for axis, value in zip("xyz", rate, strict=True)})
    found, plain = (simulate(model, setpoints, step=0.02, began=BEGAN) for model in (drifting, company))
    np.testing.assert_allclose(found.points - plain.points, np.multiply.outer(BEGAN + setpoints.time, [rate] * 4), atol=1e-12)


def test_a_drift_that_decays_nears_its_end_exponentially(company, setpoints):
    values = {"tracker_drift.shift_x": 1e-4, "tracker_drift.decay": 0.05}
    found, plain = (simulate(model, setpoints, step=0.02, began=BEGAN) for model in (at(company, values), company))
    expected = 1e-4 / 0.05 * (1 - np.exp(-0.05 * (BEGAN + setpoints.time)))
    np.testing.assert_allclose((found.points - plain.points)[:, :, 0], np.tile(expected[:, None], 4), atol=1e-12)


@pytest.mark.parametrize("decay", [-0.004, -1e-6, 0.0, 2e-5, 3e-5, 0.1])
def test_a_drift_and_its_derivatives_are_smooth_in_its_decay(company, decay):
    """Near none, where the exponential is expanded, too."""
    clock = 40.0
    theta, points = ca.SX.sym("theta", 2), ca.SX.zeros(3, 4)
    effect = find_effect("tracker_drift")
    own = {p.name: ca.SX(0) for p in effect.parameters} | {"shift_x": theta[0], "decay": theta[1], "clock": ca.SX(clock)}
    context = Context(company.layout, None, np.eye(3), np.zeros(3), np.zeros(3))
    shift = effect.outputs(points, own, context)[0, 0]
    value, slope = ca.Function("drift", [theta], [shift, ca.gradient(shift, theta)])([1e-4, decay])
    time = np.linspace(0, clock, 20_001)
    kept = np.exp(-decay * time)
    expected = [np.trapezoid(kept, time), -1e-4 * np.trapezoid(time * kept, time)]
    np.testing.assert_allclose(np.array(slope).ravel(), expected, rtol=1e-5)
    np.testing.assert_allclose(float(value), 1e-4 * expected[0], rtol=1e-6)


def test_a_skew_makes_positions_older_and_older_from_each_run_s_start(company, setpoints):
    """What is said to be of t is of t (1 - rate), by a machine that keeps its pace."""
    rate = 0.02
    found = simulate(at(company, {"clock_skew.rate": rate}), setpoints, error=1e-6, began=BEGAN)
    older = (1 - rate) * setpoints.time
    time = np.unique(np.append(setpoints.time, older))
    inputs = np.stack([np.interp(time, setpoints.time, column) for column in setpoints.inputs.T], axis=1)
    plain = simulate(company, SetPoints(time, inputs, np.zeros((len(time), 3))), error=1e-6)
    assert abs(found.points - plain.points[np.searchsorted(time, older)]).max() < 5e-6
    early = simulate(at(company, {"clock_skew.rate": -rate}), setpoints, error=1e-6, began=BEGAN)
    assert abs(early.points - found.points).max() > 1e-3


def test_a_skew_is_one_of_known_forces_too(company, setpoints):
    """Sensitivities included: forces alone move the robot."""
    force = 0.3 * np.sin(3 * setpoints.time)[:, None] * [[1.0, 0.0, 0.0]]
    still = SetPoints(setpoints.time, np.tile(setpoints.inputs[:1], (151, 1)), force)
    names = ["clock_skew.rate"]

    def points(rate):
        return simulate(at(company, {names[0]: rate}), still, step=0.01, tolerance=1e-11, began=BEGAN).points

    found = simulate(
        at(company, {names[0]: 2e-3}), still, step=0.01, tolerance=1e-11, began=BEGAN, directions=Directions.from_names(company, names)
    ).sensitivities[0]
    expected = (points(2e-3 + 1e-5) - points(2e-3 - 1e-5)) / 2e-5
    assert abs(found - expected).max() < 1e-3 * abs(expected).max()
    time = np.unique(np.append(still.time, 0.98 * still.time))
    same = [np.stack([np.interp(time, still.time, column) for column in part.T], axis=1) for part in (still.inputs, still.tip_force)]
    plain = simulate(company, SetPoints(time, *same), step=0.01).points[np.searchsorted(time, 0.98 * still.time)]
    assert abs(points(0.02) - plain).max() < 2e-4 < abs(plain - plain[0]).max()


def test_a_tendon_has_slipped_after_the_instant_and_not_before(company, setpoints):
    name = next(each.label for each in company.model.effects if each.name == "tendon_slip")
    number = company.layout.actuator_names.index(name[-3:-1]) + 6
    slipping = at(company, {f"{name}.share": 0.3, f"{name}.instant": BEGAN})
    before, none = (simulate(model, setpoints, step=0.02, began=BEGAN - 10) for model in (slipping, company))
    np.testing.assert_allclose(before.points, none.points, atol=1e-12)
    weaker = setpoints.inputs.copy()
    weaker[:, number] *= 0.7
    after, less = (
        simulate(slipping, setpoints, step=0.02, began=BEGAN + 10),
        simulate(company, replace(setpoints, inputs=weaker), step=0.02),
    )
    np.testing.assert_allclose(after.points, less.points, atol=1e-10)


def test_muscles_that_are_warm_are_softer_and_a_run_starts_in_their_equilibrium(company, setpoints):
    warming = at(company, {"warm_up.change": -0.1, "warm_up.time_constant": 1.0})
    warm = simulate(warming, setpoints, step=0.02, began=BEGAN)
    expected = solve_statics(warming.at_time(BEGAN), setpoints.inputs[0])
    np.testing.assert_allclose(warm.points[0], expected.points, atol=1e-9)
    cold = solve_statics(warming, setpoints.inputs[0])
    np.testing.assert_allclose(cold.points, solve_statics(company, setpoints.inputs[0]).points, atol=1e-12)
    assert expected.lengths.mean() > cold.lengths.mean() + 1e-4


def test_a_bend_delays_the_warming_and_hastens_its_end(company):
    """Half as warm before the time constant, warmer after it; at it all bends are as warm."""
    softer = {"warm_up.change": -0.1, "warm_up.time_constant": 100.0}
    inputs = np.full(12, 1e5) * (np.arange(12) < 6)

    def length(bend: float, time: float) -> float:
        return float(solve_statics(at(company, {**softer, "warm_up.bend": bend}).at_time(time), inputs).lengths.mean())

    assert length(2.0, 100.0) == pytest.approx(length(1.0, 100.0), abs=1e-12)
    assert length(2.0, 30.0) < length(1.0, 30.0) - 1e-5
    assert length(2.0, 200.0) > length(1.0, 200.0) + 1e-5


def test_a_second_harmonic_is_seen_beside_the_first(company, setpoints):
    still = SetPoints(setpoints.time, np.tile(setpoints.inputs[:1], (151, 1)), setpoints.tip_force)
    values = {"base_vibration.sine_x": 1e-3, "base_vibration.frequency": 5.0, "base_vibration.inertia": 0.0}
    harmonics = {"base_vibration.harmonic_sine": 0.2, "base_vibration.harmonic_cosine": -0.1}
    rest = solve_statics(company, still.inputs[0]).points
    moved = simulate(at(company, values | harmonics), still, error=1e-6).points[:, :, 0] - rest[:, 0]
    turn = 2 * np.pi * 5 * still.time
    wave = 1e-3 * (np.sin(turn) + 0.2 * np.sin(2 * turn) - 0.1 * np.cos(2 * turn))
    np.testing.assert_allclose(moved, wave[:, None] * np.ones(4), atol=1e-9)


def test_a_base_that_moves_faster_than_the_robot_sways_leaves_the_tip_behind(company, setpoints):
    """Above all resonances masses stand still in space: what the tracker sees at the tip is less than the base's motion."""
    still = SetPoints(setpoints.time, np.tile(setpoints.inputs[:1], (151, 1)), setpoints.tip_force)
    values = {"base_vibration.sine_x": 1e-3, "base_vibration.frequency": 20.0}
    rest = solve_statics(company, still.inputs[0]).points
    moved = {inertia: simulate(at(company, {**values, "base_vibration.inertia": inertia}), still, error=1e-6) for inertia in (0.0, 1.0)}
    wave = 1e-3 * np.sin(2 * np.pi * 20 * still.time)
    np.testing.assert_allclose(moved[0.0].points[:, :, 0] - rest[:, 0], wave[:, None] * np.ones(4), atol=1e-9)
    late = moved[1.0].points[100:, -1, 0] - rest[-1, 0]
    assert late.std() < 0.5 * wave.std()


@pytest.mark.parametrize("hold", [False, True])
def test_both_backends_tell_the_same_time(compiler, setpoints, hold):
    names = ("warm_up", "tracker_drift", "clock_skew", "base_vibration", "regulator_lag")
    present = {name: {p.name: p.probe for p in find_effect(name).parameters} for name in names}
    model = in_company(**present, tendon_slip={"share": 0.2, "instant": BEGAN + 0.07})
    short = SetPoints(setpoints.time[:8], setpoints.inputs[:8], setpoints.tip_force[:8])
    c, python = (compile_model(model, backend) for backend in ("c", "python"))
    for settings in ({"step": 0.01}, {}, {"method": "rk4"}):
        one, other = (simulate(each, short, hold=hold, began=BEGAN, tolerance=1e-10, **settings) for each in (c, python))
        np.testing.assert_allclose(one.points, other.points, atol=1e-9)
        assert one.effort.steps == other.effort.steps
        later = simulate(c, short, hold=hold, began=BEGAN + 25, tolerance=1e-10, **settings)
        assert abs(later.points - one.points).max() > 1e-5
    directions = Directions.from_names(c, [name for name in c.network.parameter_names if "." in name or name == "K_a"])
    one, other = (simulate(each, short, hold=hold, began=BEGAN, step=0.01, tolerance=1e-10, directions=directions) for each in (c, python))
    for name, a, b in zip(directions.names, one.sensitivities, other.sensitivities, strict=True):
        assert abs(a - b).max() <= 1e-7 * abs(a).max() + 1e-14, name


def test_a_run_is_predicted_at_the_time_at_which_it_began(company, setpoints):
    run = Run("late.csv", "fit", setpoints.time + 7, setpoints.inputs, setpoints.tip_force, np.zeros((151, 4, 3)), began=BEGAN)
    model = at(company, {"tracker_drift.shift_x": 1e-5})
    expected = simulate(model, setpoints, step=0.02, began=BEGAN)
    np.testing.assert_allclose(predict(model, run).points, expected.points, atol=1e-9)
    earlier = predict(model, replace(run, began=0.0))
    np.testing.assert_allclose(expected.points - earlier.points, np.multiply.outer(np.full(151, BEGAN * 1e-5), [[1, 0, 0]] * 4), atol=1e-9)


def test_a_model_without_such_effects_does_not_know_the_time(kang, setpoints):
    assert not {"clock", "began"} & set(kang.network.parameter_names)
    np.testing.assert_array_equal(simulate(kang, setpoints, step=0.02, began=BEGAN).points, simulate(kang, setpoints, step=0.02).points)
