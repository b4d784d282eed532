"""State space about an equilibrium: against statics, simulation and closed forms; names, delay, held states."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lsim

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.models.compile import compile_model
from tepm_opt.solvers.linear.gain import solve_gain
from tepm_opt.solvers.linear.modes import modes, state_matrix
from tepm_opt.solvers.linear.state_space import Linear, linearise
from tepm_opt.solvers.mechanics.simulate import simulate
from tepm_opt.solvers.mechanics.statics import Equilibrium, StaticsSettings, solve_actuated_statics, solve_statics
from tests.solvers.dynamics import with_dynamics

BENT = np.array([1e5, 0, 2e5, 3e5, 1e5, 0, 1, 2, 3, 4, 5, 6.0])
EFFECTS = {
    "creep": {"creep": {"share": 0.2, "relaxation_time": 0.5}},
    "lag": {"regulator_lag": {"filling_time": 0.06, "exhausting_time": 0.12}},
    "delay": {"time_delay": {"delay": 0.03}},
    "friction": {"structural_friction": {"force": 0.2, "distance": 1e-3}},
    "hysteresis behind a lag": {
        "regulator_lag": {"filling_time": 0.1, "exhausting_time": 0.1},
        "pressure_hysteresis": {"width": 5e3, "distance": 2e4},
    },
}


def held(name: str, loads: list[float] | None = None) -> Equilibrium:
    """Bent equilibrium of a model."""
    return solve_statics(compile_model(with_dynamics(**EFFECTS[name])), BENT, loads)


@pytest.fixture(scope="module")
def bent(kang):
    return linearise(solve_statics(kang, BENT, [0.2, -0.1, 0.1]))


def test_without_effects_it_is_the_matrix_of_statics(bent):
    other = state_matrix(bent.equilibrium)
    assert abs(bent.A - other).max() < 1e-12 * abs(other).max()
    assert not bent.D.any()
    assert not bent.held.any()
    assert bent.without_held_states() is bent


def check_gain(linear: Linear) -> None:
    """By inputs and by forces; the hysteresis has no width, and holds."""
    gain, ranges = solve_gain(linear.equilibrium), linear.ranges
    expected = np.hstack([gain.matrix, gain.by_load.reshape(3, -1)]) * ranges
    found = linear.select(outputs="s4").gain(scaled=True)
    assert abs(found - expected).max() < 1e-9 * abs(expected).max()
    slowly = linear.select(outputs="s4").response([1e-9], scaled=True)[0]
    assert abs(slowly - expected).max() < 1e-6 * abs(expected).max()


def test_gain_at_rest_is_that_of_statics(bent):
    check_gain(bent)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["creep", "lag", "delay"])
def test_gain_at_rest_with_effects_is_that_of_statics(name):
    at = held(name, [0.2, -0.1, 0.1])
    check_gain(linearise(at))


@pytest.mark.slow
@pytest.mark.parametrize("rising", [False, True])
@pytest.mark.parametrize("name", EFFECTS)
def test_small_motion_is_that_of_the_simulation(name, rising):
    """Ramps up, or down, of a pressure and a tension by 50 Pa and 1 mN, held then."""
    model = compile_model(with_dynamics(**EFFECTS[name]))
    time = np.arange(0.0, 1.2001, 0.005)
    part = np.interp(time, [0.1, 0.3], [0.0, 1.0]) * (1.0 if rising else -1.0)
    change = np.zeros((len(time), 12))
    change[:, 0], change[:, 10] = 50.0 * part, 1e-3 * part
    motion = simulate(model, SetPoints(time, BENT + change, np.zeros((len(time), 3))), step=0.0025, tolerance=1e-9)
    linear = linearise(motion.start, rising=rising)
    late = np.column_stack([np.interp(time - linear.delay, time, column) for column in change.T])
    system = linear.select(("pressure", "tension")).to_control(pade=0)
    expected = lsim((system.A, system.B, system.C, system.D), late, time)[1]
    found = np.hstack([motion.points.reshape(len(time), -1), motion.lengths.reshape(len(time), -1)])
    found -= found[0]
    for rows in (slice(0, 12), slice(12, 18)):
        assert abs(found[:, rows] - expected[:, rows]).max() < 0.01 * abs(expected[:, rows]).max()


@pytest.mark.slow
def test_sticking_friction_is_a_spring():
    linear = linearise(held("friction"))
    kinds = linear.kinds[linear.held].tolist()
    assert (kinds.count("edge"), kinds.count("input")) == (36, 18)  # friction, and the hysteresis that has no width here
    assert (abs(np.linalg.eigvals(linear.A)) < 1e-6).sum() == 54
    moving = linear.without_held_states()
    assert len(moving.A) == len(linear.A) - 54
    assert np.linalg.eigvals(moving.A).real.max() < -0.09  # the slow part of creep forgets in 10 s
    assert not moving.held.any()
    slack, stuck = (of.select("pressure", "s4").gain(scaled=True) for of in (linearise(held("lag")), linear))
    assert np.linalg.norm(stuck) < 0.8 * np.linalg.norm(slack)
    frequencies = np.array([0.3, 3.0, 30.0])
    whole = [linear.C @ np.linalg.solve(2j * np.pi * f * np.eye(len(linear.A)) - linear.A, linear.B) for f in frequencies]
    np.testing.assert_allclose(linear.response(frequencies), whole, rtol=1e-6, atol=1e-9 * abs(np.array(whole)).max())


@pytest.mark.slow
def test_hysteresis_holds_behind_a_lag():
    linear = linearise(held("hysteresis behind a lag"))
    values = np.linalg.eigvals(linear.without_held_states().A)
    assert (abs(values) > 0.09).all()  # the slow part of creep forgets in 10 s
    free = linearise(held("lag")).select("pressure", "s4").gain(scaled=True)
    assert abs(linear.select("pressure", "s4").gain(scaled=True) - 0.75 * free).max() < 1e-6 * abs(free).max()  # 1 - width / distance


@pytest.mark.slow
def test_a_lag_has_two_time_constants():
    at = held("lag")
    for rising, time in ((True, 0.06), (False, 0.12)):
        of_inputs = [mode for mode in modes(linearise(at, rising=rising)) if mode.memory == "memory of the actuation"]
        assert [mode.time_constant for mode in of_inputs] == pytest.approx([time] * 6, rel=1e-4)
    assert "input" not in linearise(at, actuators=False).kinds


def test_names_and_selection(bent):
    assert bent.inputs[0] == "pressure_11"
    assert bent.inputs[11] == "tension_23"
    assert bent.inputs[-1] == "force_s4_z"
    assert bent.outputs[:3] == ("s1_x", "s1_y", "s1_z")
    assert bent.outputs[-1] == "length_23"
    system = bent.to_control(("tension_23", "force_s4"), ("s4", "length_11"))
    assert system.input_labels == ["tension_23", "force_s4_x", "force_s4_y", "force_s4_z"]
    assert system.output_labels == ["s4_x", "s4_y", "s4_z", "length_11"]
    np.testing.assert_allclose(system.dcgain(), bent.select(("tension_23", "force_s4"), ("s4", "length_11")).gain(), rtol=1e-9)
    assert system.state_labels == list(bent.state_names)
    assert (bent.state_names[0], bent.state_names[107], bent.state_names[108]) == ("n1_0_x", "n12_2_z", "v_n1_0_x")
    scaled = bent.to_control("pressure", "s4_z", scaled=True)
    np.testing.assert_allclose(scaled.dcgain(), 5e5 * bent.to_control("pressure", "s4_z").dcgain(), rtol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"inputs": "presure_11"}, "unknown input 'presure_11': did you mean 'pressure_11'"),
        ({"outputs": ["s4_x", "s9"]}, "unknown output 's9'"),
        ({"outputs": ["s4_x", "s4"]}, "one stands twice"),
        ({"inputs": []}, "none"),
        ({"pade": -1}, "pade: -1; valid: an order 0 … 10"),
    ],
)
def test_wrong_names_are_refused(bent, arguments, says):
    with pytest.raises(InputError, match=says) as error:
        bent.to_control(**arguments)
    assert "\n" not in str(error.value)


def test_a_failed_equilibrium_is_refused(kang):
    found = solve_statics(kang, np.zeros(12), [0, 0, 0.1], settings=StaticsSettings(max_iterations=0))
    assert not found.solved
    with pytest.raises(InputError, match="no equilibrium to linearise about: not converged"):
        linearise(found)


@pytest.mark.slow
def test_states_that_remember_have_names():
    """As many as there are, each once, also where some are taken out or a delay adds some."""
    linear = linearise(held("friction"))
    assert len(set(linear.state_names)) == len(linear.A)
    assert set(linear.state_names) - set(linear.without_held_states().state_names) == {
        linear.state_names[k] for k in np.flatnonzero(linear.held)
    }
    late = linearise(held("delay")).to_control(("pressure_11", "tension_11"), "s4", pade=2)
    assert late.state_labels[-4:] == [f"delay_{name}_11_{k}" for name in ("pressure", "tension") for k in (1, 2)]
    assert len(set(late.state_labels)) == late.nstates


@pytest.mark.slow
def test_delay_by_pade():
    linear = linearise(held("delay"))
    assert linear.delay == pytest.approx(0.03)
    chosen = ("pressure_11", "force_s4_x", "tension_11"), "s4"
    exact, states = linear.select(*chosen).response([0.1, 1.0, 5.0]), linear.to_control(*chosen, pade=0).nstates
    for order, error in ((1, 0.2), (2, 5e-3), (3, 1e-4)):
        system = linear.to_control(*chosen, pade=order)
        assert system.nstates == states + 2 * order
        found = np.moveaxis(system(2j * np.pi * np.array([0.1, 1.0, 5.0])), -1, 0)
        assert abs(found - exact).max(axis=(1, 2)) == pytest.approx(0, abs=error * abs(exact).max())
        late = abs(found - exact)[-1] / abs(exact[-1])
        assert late.max() < error
        assert late[:, 1].max() < 1e-7  # forces act at once


@pytest.mark.slow
def test_effective_actuation_acts_at_once():
    model = compile_model(with_dynamics(**EFFECTS["lag"]))
    mapped = linearise(solve_actuated_statics(model, BENT, model.check_loads(None)))
    assert "input" not in mapped.kinds
    commanded = linearise(solve_statics(model, BENT), actuators=False)
    np.testing.assert_allclose(mapped.B, commanded.B, atol=1e-12 * abs(commanded.B).max())
