"""What each effect does to the robot, against closed forms; the contract all effects share is in test_effect_contract.py."""

from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tepm_opt.errors import InputError
from tepm_opt.models.compile import compile_model
from tepm_opt.models.effect import ActiveEffect, Context
from tepm_opt.models.effects import effects, find_effect, register
from tepm_opt.models.effects.payload import Payload
from tepm_opt.models.effects.regulator_leak import LAMINAR, lost_pressure
from tepm_opt.models.layout import VERTICAL, Layout
from tepm_opt.models.memories import Memory
from tepm_opt.models.model import Model
from tepm_opt.solvers.kinematics.ik import solve_ik
from tepm_opt.solvers.linear.modes import poles
from tepm_opt.solvers.mechanics.statics import solve_statics
from tests.independent import Network
from tests.tools import in_company, random_inputs, variant, with_effect

NOMINAL = Model.from_robot("kang2017")
COARSE = Model.from_robot(variant(geometry={"segments_per_module": 1}))
HANGING = Model.from_robot(variant(mount={"base_rotation_deg": (170.0, 20.0, 30.0)}))


def in_python(model):
    return compile_model(model, backend="python")


def properties(model, force=(0.0, 0.0, 0.0), part=0.0):
    """The network's properties by name, (levels, rows), under a tip force in G and inputs at part of their ranges."""
    model = in_python(model)
    external = np.append(np.zeros((model.layout.points - 1, 3)), [force], axis=0)
    P = model.reference.prepare(part * model.input_max, False, external.ravel(), model.theta)[1]
    return {name: P[:, rows] for name, rows in model.network.property_rows.items()}


def at_rest(model):
    """Reference points of the undeformed robot as measured, (points, 3)."""
    model = in_python(model)
    return model.reference.observe(model.rest, model.theta)[: 3 * model.layout.points].reshape(-1, 3)


def test_a_payload_is_a_weight_on_the_tip(kang):
    loaded = compile_model(in_company(payload={"mass": 0.03}))
    for u in random_inputs(kang, 3, 0):
        found = solve_statics(loaded, u, [0.2, 0.0, 0.1])
        expected = solve_statics(kang, u, [0.2, 0.0, 0.1 - 0.03 * 9.81])
        assert abs(found.points - expected.points).max() < 1e-12


@pytest.mark.slow
def test_a_payload_is_inertia_too(kang):
    """Sway slows down more than by the weight alone, which a force on the tip takes away again."""
    loaded = compile_model(in_company(payload={"mass": 0.03}))
    with_mass = abs(poles(solve_statics(loaded, np.zeros(12), [0, 0, 0.03 * 9.81]))[0])
    without = abs(poles(solve_statics(kang, np.zeros(12)))[0])
    assert 0.75 < with_mass / without < 0.95


@pytest.mark.slow
def test_a_payload_beside_the_tip_bends_the_body_that_way(kang):
    """By the moment of its weight: as much as that of two opposite vertical forces on the muscles does, to first order."""
    u, mass = np.r_[np.full(6, 1.5e5), np.zeros(6)], 2e-3
    tips = [
        solve_statics(compile_model(NOMINAL.with_effect("payload", mass=mass, beside_x=x, beside_y=y)), u).points[-1]
        for x, y in ((0.0, 0.0), (0.2, 0.0), (-0.2, 0.0), (0.0, 0.2))
    ]
    centre, right, left, forward = tips
    assert right[0] - centre[0] > 1e-4
    np.testing.assert_allclose(right - centre, (left - centre) * [-1, -1, 1], atol=2e-3 * (right[0] - centre[0]))
    np.testing.assert_allclose((forward - centre)[1], (right - centre)[0], rtol=0.05)


def test_a_dead_zone_takes_the_threshold_off_the_pressure(kang):
    model = compile_model(in_company(pressure_dead_zone={"threshold": 2e4}))
    u = np.array([0, 1.5e4, 1.6e4, 2e4, 2.4e4, 2e5, 0, 1, 2, 3, 4, 5])
    effective = model.statics.actuation(u, model.theta)
    np.testing.assert_allclose(effective[[0, 1, 2, 4, 5]], [0, 0, 0, 4e3, 1.8e5], atol=1e-9)
    assert 0 < effective[3] <= 0.2 * 2e4 / 4  # in the rounded corner
    np.testing.assert_array_equal(effective[6:], u[6:])
    found = solve_statics(model, u)
    expected = solve_statics(kang, effective)
    assert abs(found.points - expected.points).max() < 1e-12


def test_a_dead_zones_corner_is_smooth():
    """Value and slope of the effective pressure are continuous where the parabola meets its lines."""
    model = compile_model(in_company(pressure_dead_zone={"threshold": 2e4}))
    pressures = np.array([1.6e4, 2.4e4])
    for p in pressures:
        below, at, above = (model.statics.actuation(np.array([p + d] + [0.0] * 11), model.theta)[0] for d in (-1.0, 0.0, 1.0))
        assert above - at == pytest.approx(at - below, abs=1e-3)


def test_mass_is_concentrated_at_plates_and_holders():
    model = NOMINAL.with_effect("mass_distribution", plates=0.3, holders=0.1)
    module = np.array([0.6, 0.6, 0.6 + 6 * 0.1, 0.6, 0.6, 0.6 + 6 * 0.3]) / 6 * 0.22
    np.testing.assert_allclose(3 * properties(model)["mass"][:, 0], np.tile(module, 2), rtol=1e-12)


def test_a_holder_between_two_levels_is_shared_by_them():
    odd = Model.from_robot(variant(geometry={"segments_per_module": 3})).with_effect("mass_distribution", plates=0.0, holders=0.3)
    module = np.array([0.7 / 3 + 0.15, 0.7 / 3 + 0.15, 0.7 / 3]) * 0.22
    np.testing.assert_allclose(3 * properties(odd)["mass"][:, 0], np.tile(module, 2), rtol=1e-12)
    coarse = COARSE.with_effect("mass_distribution", plates=0.3, holders=0.2)  # the base takes half of the first holder
    np.testing.assert_allclose(3 * properties(coarse)["mass"][:, 0], np.array([1.0, 0.9]) * 0.22, rtol=1e-12)


def test_a_payload_is_no_part_of_a_modules_mass():
    shared = {"plates": 0.3, "holders": 0.1}
    after = properties(NOMINAL.with_effect("payload", mass=0.03).with_effect("mass_distribution", **shared))["mass"]
    before = properties(NOMINAL.with_effect("mass_distribution", **shared))["mass"]
    np.testing.assert_allclose(3 * (after - before)[:, 0], [0] * 11 + [0.03], atol=1e-15)


@pytest.mark.parametrize(("model", "stiff"), [(NOMINAL, [0, 5, 6, 11]), (COARSE, [0, 1])])
def test_plates_stiffen_the_segments_next_to_them_once(model, stiff):
    found, plain = properties(model.with_effect("rigid_plates", stiffening=0.5)), properties(model)
    factor = np.ones((len(plain["stiffness"]), 1))
    factor[stiff] = 1.5
    np.testing.assert_allclose(found["stiffness"], factor * plain["stiffness"], rtol=1e-14)
    np.testing.assert_array_equal(found["damping"], plain["damping"])


@pytest.mark.parametrize("model", [NOMINAL, COARSE])
def test_hardening_adds_powers_of_the_stretch_to_a_muscles_force(model):
    """Whatever the number of segments; other edges are left alone."""
    hard, plain = (in_python(m) for m in (model.with_effect("stiffness_hardening", quadratic=20.0, cubic=50.0), model))
    vertical = [edge.kind == VERTICAL for edge in hard.layout.edges]
    for stretch in (-0.3, 0.0, 0.25, 0.5):
        x = hard.rest.reshape(len(hard.rest), -1, 3) * [1, 1, 1 + stretch]
        forces = [
            m.reference.edges(x.reshape(hard.rest.shape), m.reference.prepare(np.zeros(12), False, np.zeros(12), m.theta)[1], m.theta)[0]
            for m in (hard, plain)
        ]
        np.testing.assert_allclose(forces[0][:, vertical], 358.86 * 0.2 * stretch + 20 * stretch**2 + 50 * stretch**3, rtol=1e-9, atol=1e-9)
        others = np.logical_not(vertical)
        np.testing.assert_allclose(forces[0][:, others], forces[1][:, others], rtol=1e-12, atol=1e-12)


def test_a_weak_actuator_loses_a_share_of_its_pressure():
    model = in_python(NOMINAL.with_effect("actuator_gain", "21", loss=0.25).with_effect("actuator_gain", "13", loss=-0.1))
    u = np.array([1e5, 2e5, 3e5, 4e5, 5e5, 1e5, 1, 2, 3, 4, 5, 6])
    np.testing.assert_allclose(model.statics.actuation(u, model.theta), u * [1, 1, 1.1, 0.75, 1, 1, 1, 1, 1, 1, 1, 1], rtol=1e-14)


@pytest.mark.slow
def test_a_muscles_offset_is_a_rest_length_that_is_off(kang):
    """The network of another route with longer rest lengths; the force is there at no pressure, behind a dead zone, and pulls, too."""
    network = Network()
    for off in (3e-3, -1e-3):
        pressure = 358.86 * off / 50.27e-6
        model = compile_model(in_company(actuator_offset={"pressure": pressure}, pressure_dead_zone={"threshold": 2e4}))
        network.rest = Network().rest.copy()
        network.rest[:6, 2] += off / 6  # in_company's effect is on actuator 13
        for u in (np.zeros(12), np.append(np.full(6, 2e5), np.arange(6))):
            effective = model.statics.actuation(u, model.theta)
            nodes, _ = network.solve(network.push(effective), network.loads(), solve_statics(kang, effective).nodes)
            assert abs(solve_statics(model, u).points - network.points(nodes)).max() < 1e-9


@pytest.mark.slow
def test_a_regulator_gives_no_less_than_nothing(kang):
    """One-sided, an offset below 0 takes no more than there is; above 0 it is the same."""
    for pressure, at, left in ((-5e3, 2e3, 0.0), (-5e3, 8e3, 3e3), (5e3, 0.0, 5e3)):
        model = compile_model(in_company(actuator_offset={"pressure": pressure, "one_sided": 1.0}))
        u, expected = np.full(12, 1e5), np.full(12, 1e5)
        u[6:] = expected[6:] = 1.0
        u[2], expected[2] = at, left
        assert abs(solve_statics(model, u).points - solve_statics(kang, expected).points).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("pressure", [-4e3, 4e3])
def test_regulators_whose_zero_is_off_leave_the_robot_within_its_reach(pressure):
    """Where tendons hold a tip by less force than none, regulators are far from their zeros; set points make up for them."""
    values = {f"offset_{name}": pressure for name in Layout.from_robot(NOMINAL.robot).actuator_names}
    model = compile_model(NOMINAL.with_effect("actuator_scatter", one_sided=1.0, **values))
    target = np.array([5e-3, 0.0, 0.345])
    found = solve_ik(model, target)
    assert found.solved
    assert found.forces.min() < 0
    assert abs(solve_statics(model, found.allocation.inputs).tip - target).max() < 1e-3  # set points are on a grid


@pytest.mark.slow
def test_scatter_is_gains_and_offsets_of_all_at_once():
    gains, offsets = 0.01 * np.arange(-3, 3), 1e3 * np.arange(6)
    names = Layout.from_robot(NOMINAL.robot).actuator_names
    values = {f"gain_{name}": gain for name, gain in zip(names, gains, strict=True)}
    values |= {f"offset_{name}": offset for name, offset in zip(names, offsets, strict=True)}
    at_once, one_by_one = NOMINAL.with_effect("actuator_scatter", **values), NOMINAL
    for name, gain, offset in zip(names, gains, offsets, strict=True):
        one_by_one = one_by_one.with_effect("actuator_gain", name, loss=-gain).with_effect("actuator_offset", name, pressure=offset)
    for part in (0.0, 0.3):
        for name, found in properties(at_once, part=part).items():
            np.testing.assert_allclose(found, properties(one_by_one, part=part)[name], rtol=1e-12, atol=1e-12)


def test_scatter_has_parameters_of_every_muscle_a_robot_has():
    model = Model.from_robot(variant(geometry={"modules": 3, "actuator_angles_deg": (0.0, 90.0, 180.0, 270.0)})).with_effect(
        "actuator_scatter"
    )
    assert len(model.effects[0].parameters) == 2 * 12 + 1
    assert {"gain_34", "offset_11"} <= model.effects[0].parameters.keys()
    assert compile_model(model, backend="python").values["actuator_scatter.gain_34"] == 0.02


def test_a_choked_leak_takes_a_share_of_the_absolute_pressure():
    """Next to nothing without pressure, monotonous between; a loss that no gain and no offset has."""
    model = in_python(NOMINAL.with_effect("regulator_leak", "11", share=0.05))
    commanded = np.array([0.0, 1e4, 5e4, 3e5, 4e5])
    kept = np.array([model.statics.actuation(np.array([p] + [0.0] * 11), model.theta)[0] for p in commanded])
    lost, inside = commanded - kept, kept + 101325.0
    np.testing.assert_allclose(lost[[0, 3, 4]], [0.0, *(0.05 * inside[3:])], rtol=LAMINAR, atol=1e-6)
    assert (np.diff(lost) > 0).all()
    assert 0 < lost[1] < lost[2] < 0.05 * inside[2]


@pytest.mark.parametrize("share", [1e-3, 0.05, 0.5])
@pytest.mark.parametrize("critical_ratio", [0.05, 0.35, 0.6])
def test_a_leak_ends_where_the_flows_of_regulator_and_orifice_are_equal(share, critical_ratio):
    """By the standard's ellipse, choked and not; derivatives are finite down to no pressure and no leak."""
    model = in_python(NOMINAL.with_effect("regulator_leak", "11", share=share, critical_ratio=critical_ratio))
    commanded = np.geomspace(300.0, 5e5, 40)
    inside = 101325.0 + np.array([model.statics.actuation(np.array([p] + [0.0] * 11), model.theta)[0] for p in commanded])
    flow = inside * np.sqrt(1 - (np.maximum(101325.0 / inside - critical_ratio, 0) / (1 - critical_ratio)) ** 2)
    np.testing.assert_allclose(inside + share * flow - 101325.0, commanded, rtol=2e-3, atol=share * 300.0)
    absolute, size = ca.SX.sym("absolute"), ca.SX.sym("size")
    slopes = ca.gradient(lost_pressure(absolute, size, critical_ratio), ca.vertcat(absolute, size))
    found = np.array([ca.Function("slopes", [absolute, size], [slopes])(101325.0 + p, s) for p in (0.0, *commanded) for s in (0.0, share)])
    assert np.isfinite(found).all()


def test_a_tendons_gain_leaves_its_muscle_alone():
    model = in_python(NOMINAL.with_effect("tension_gain", "21", loss=0.25))
    u = np.array([1e5, 2e5, 3e5, 4e5, 5e5, 1e5, 1, 2, 3, 4, 5, 6])
    np.testing.assert_allclose(model.statics.actuation(u, model.theta), u * [1, 1, 1, 1, 1, 1, 1, 1, 1, 0.75, 1, 1], rtol=1e-14)


def muscle_pressures(model, path, duration=0.02):
    """Effective pressure of muscle 11 along commanded pressures, (rows,), each reached linearly after a duration in s."""
    y, found = np.zeros(model.reference_stepper.dynamics.input_states), [path[0]]
    for before, now in pairwise(path):
        inputs, rate = np.zeros(12), np.zeros(12)
        inputs[0], rate[0] = now, (now - before) / duration
        a, y = model.reference_stepper.values("input_motion", inputs, rate, y, duration, model.theta)
        found.append(float(a.ravel()[0]))
        y = y.ravel()
    return np.array(found)


def test_a_choked_valve_fills_at_a_rate():
    """Far from the set point at 1 / choke, near it with the time constant: the solution of dy/dt = -y / (T + c |y|)."""
    model = in_python(NOMINAL.with_effect("regulator_lag", filling_time=0.05, exhausting_time=0.1, filling_choke=2e-6, opening=0.0))
    found = muscle_pressures(model, np.concatenate([[0.0], np.full(60, 3e5)]), 0.01)[2:]
    left, time = 3e5 - found, 0.01 * np.arange(len(found))
    expected = 0.05 * np.log(left[0] / left) + 2e-6 * (left[0] - left)  # time since the first of them
    np.testing.assert_allclose(expected, time, atol=2e-3)
    assert np.diff(found)[0] < 0.01 / 2e-6
    emptying = muscle_pressures(model, np.concatenate([[3e5], np.zeros(20)]), 0.01)[2:]
    np.testing.assert_allclose(emptying[1:] / emptying[:-1], np.exp(-0.1), rtol=1e-9)  # exhausting does not choke


def test_a_valve_opens_in_proportion_to_the_error_and_then_no_further():
    """At 1 / choke beyond 30 kPa, with choke times 30 kPa as time constant within."""
    model = in_python(NOMINAL.with_effect("regulator_lag", filling_time=0.06, exhausting_time=0.0, filling_choke=2e-6, opening=3e4))
    found = muscle_pressures(model, np.concatenate([[0.0], np.full(400, 3e5)]), 1e-3)[2:]
    far, near = found < 3e5 - 3.1e4, found > 3e5 - 2.9e4
    np.testing.assert_allclose(np.diff(found[far]), 1e-3 / 2e-6, rtol=1e-5)
    left = 3e5 - found[near]
    np.testing.assert_allclose(left[1:] / left[:-1], np.exp(-1e-3 / 0.06), rtol=1e-6)


@pytest.mark.slow
def test_a_choked_valve_empties_the_slower_the_less_is_inside():
    """At 1 / choke at 125 kPa, by sqrt(P² - P_a²) elsewhere, down to a tenth of the atmosphere's flow."""
    model = in_python(NOMINAL.with_effect("regulator_lag", filling_time=0.0, exhausting_time=0.0, exhausting_choke=5e-6, opening=0.0))
    found = muscle_pressures(model, np.concatenate([[4e5], np.zeros(4000)]), 1e-3)[2:]
    rates = -np.diff(found) / 1e-3
    for gauge in (3e5, 1.25e5, 5e4):
        k = int(np.argmin(abs(found - gauge)))
        assert rates[k] * 5e-6 == pytest.approx(np.sqrt((gauge + 101325.0) ** 2 - 101325.0**2) / (2 * 101325.0), rel=0.02)
    assert 0 <= found[-1] < 1.0


@pytest.mark.slow
def test_a_hysteresis_may_be_uneven():
    """Trails by its width on the way up, by its ratio of it on the way down."""
    model = in_python(NOMINAL.with_effect("pressure_hysteresis", width=4e3, distance=1e3, falling_ratio=0.25))
    path = np.concatenate([np.linspace(0, 2e5, 101), np.linspace(2e5, 1e5, 51)[1:]])
    found = muscle_pressures(model, path)
    assert path[100] - found[100] == pytest.approx(4e3, rel=1e-6)
    assert found[-1] - path[-1] == pytest.approx(1e3, rel=1e-6)


@pytest.mark.slow
def test_a_hysteresis_that_sticks_leaves_the_force_where_it_is():
    """On a reversal, over most of the loop's width; without sticking it comes back at once. One play is all three of no spread."""
    path = np.concatenate([np.linspace(0, 2e5, 201), np.linspace(2e5, 1e5, 101)[1:]])
    held = {}
    for sticking, distance in ((0.0, 4e3), (1.0, 1e3)):
        model = in_python(NOMINAL.with_effect("pressure_hysteresis", width=4e3, distance=distance, sticking=sticking, spread=0.0))
        found = muscle_pressures(model, path)
        assert found[200] == pytest.approx(1.96e5, rel=1e-4)
        assert found[-1] == pytest.approx(1.04e5, rel=1e-4)
        held[sticking] = found[200] - found[204]  # after half of the width
    assert held[1.0] == pytest.approx(0, abs=100)
    assert held[0.0] < -1000, "two widths over the distance is more than the command itself goes back"


@pytest.mark.slow
def test_plays_remember_reversals_within_reversals() -> None:
    """Against the mean of three play operators that are narrower and wider by half of the width, round and round within a loop."""
    path = np.concatenate([np.linspace(0, 2e5, 401), np.linspace(2e5, 1.9e5, 41)[1:], np.linspace(1.9e5, 1.96e5, 25)[1:]])
    path = np.concatenate([path, np.linspace(1.96e5, 1.8e5, 65)[1:], np.linspace(1.8e5, 2.1e5, 121)[1:]])
    model = in_python(NOMINAL.with_effect("pressure_hysteresis", width=6e3, distance=50.0, sticking=1.0, spread=0.5))
    found = muscle_pressures(model, path)
    plays, expected = np.zeros(3), []
    for value in path:
        plays = np.clip(plays, value - 6e3 * np.array([0.5, 1.0, 1.5]), value + 6e3 * np.array([0.5, 1.0, 1.5]))
        expected.append(plays.mean())
    late = np.arange(len(path)) > 100  # begun in the middle of the loop, not as if filled
    np.testing.assert_allclose(found[late], np.array(expected)[late], atol=100)


@pytest.mark.slow
def test_devices_act_before_the_muscle_however_effects_are_listed() -> None:
    """A play follows what the regulator has let in, not what was commanded."""
    lag, hysteresis = {"filling_time": 0.2, "exhausting_time": 0.2}, {"width": 6e3, "distance": 50.0, "sticking": 1.0, "spread": 0.0}
    path = np.concatenate([[0.0], np.full(200, 1e5), np.full(60, 8e4)])
    found = [
        muscle_pressures(in_python(model), path)
        for model in (
            NOMINAL.with_effect("regulator_lag", **lag).with_effect("pressure_hysteresis", **hysteresis),
            NOMINAL.with_effect("pressure_hysteresis", **hysteresis).with_effect("regulator_lag", **lag),
        )
    ]
    np.testing.assert_array_equal(*found)
    inside = 8e4 + 2e4 * np.exp(-0.02 * np.arange(60) / 0.2)
    stays = np.minimum(1e5 - 6e3, inside + 6e3)  # until the pressure has fallen by twice the width
    np.testing.assert_allclose(found[0][-59:], stays[1:], atol=400)


@pytest.mark.slow
def test_what_is_far_behind_a_limit_comes_back():
    """Filled from above, a muscle is further above its middle than an uneven hysteresis lets it be on the way down."""
    model = in_python(NOMINAL.with_effect("pressure_hysteresis", width=4e3, distance=50.0, falling_ratio=0.25, filled=-1.0, sticking=1.0))
    found = muscle_pressures(model, np.concatenate([[1e5], np.full(3, 1e5), np.linspace(1e5, 9e4, 11)]))
    assert np.isfinite(found).all()
    assert found[-1] - 9e4 == pytest.approx(1e3, rel=1e-3)


@pytest.mark.slow
def test_a_dead_zones_corner_may_be_soft():
    """With a wide corner there is some force from the beginning on, none without pressure, and no corner at all."""
    for rounding in (0.2, 1.0, 3.0):
        model = in_python(NOMINAL.with_effect("pressure_dead_zone", threshold=2e4, rounding=rounding))
        pressures = np.linspace(0, 1e5, 1001)
        found = np.array([model.statics.actuation(np.array([p] + [0.0] * 11), model.theta)[0] for p in pressures])
        assert found[0] == 0
        slopes = np.diff(found) / np.diff(pressures)
        assert slopes.min() >= -1e-12
        assert slopes.max() <= 1 + 1e-12
        assert np.abs(np.diff(slopes)).max() < 0.02  # continuous
        assert (slopes[0] > 0.01) == (rounding > 1)


def test_shapes_that_a_model_does_not_give_are_usual():
    """Files from before an effect had them go on to mean the same; what says how strongly has to be there."""
    given = Model(NOMINAL.robot, effects=(ActiveEffect("regulator_lag", None, {"filling_time": 0.1, "exhausting_time": 0.2}),))
    shapes = {"filling_choke": 0.0, "exhausting_choke": 0.0, "opening": 1e4}
    assert given.effects[0].parameters == {"filling_time": 0.1, "exhausting_time": 0.2, **shapes}
    assert given == NOMINAL.with_effect("regulator_lag", filling_time=0.1, exhausting_time=0.2)
    with pytest.raises(InputError, match="parameter 'filling_time' is missing; it needs: exhausting_time, filling_time"):
        Model(NOMINAL.robot, effects=(ActiveEffect("regulator_lag", None, {"exhausting_time": 0.2}),))


def test_the_inverse_kinematics_knows_a_muscles_offset():
    model = compile_model(in_company(actuator_offset={"pressure": 2e4}))
    found = solve_ik(model, [0.05, 0.02, 0.38])
    assert found.outcome.solved
    reached = solve_statics(model, found.allocation.inputs)
    assert abs(reached.points[-1] - [0.05, 0.02, 0.38]).max() < 1e-6


def test_crosstalk_reaches_the_neighbours_in_the_module():
    model = in_python(NOMINAL.with_effect("pressure_crosstalk", coupling=0.1))
    u = np.array([1e5, 2e5, 3e5, 4e5, 0, 0, 1, 2, 3, 4, 5, 6])
    expected = [1.5e5, 2.4e5, 3.3e5, 4e5, 4e4, 4e4, *u[6:]]
    np.testing.assert_allclose(model.statics.actuation(u, model.theta), expected, rtol=1e-14)
    model = in_python(NOMINAL.with_effect("pressure_crosstalk", coupling=0.1, bend=1e-6))
    expected = [1.5e5 + 8e3, 2.4e5 + 6e3, 3.3e5 + 2e3, 4e5, 4e4 + 1.2e4, 4e4 + 1.2e4, *u[6:]]  # less 1e-6 · 100 kPa of both neighbours
    np.testing.assert_allclose(model.statics.actuation(u, model.theta), expected, rtol=1e-14)


@pytest.mark.parametrize("bracing", ["single", "crossed"])
def test_crosstalk_does_not_reach_across(bracing):
    square = variant(geometry={"modules": 1, "actuator_angles_deg": (0.0, 180.0, 90.0, 270.0), "bracing": bracing})
    model = in_python(Model.from_robot(square).with_effect("pressure_crosstalk", coupling=0.1))
    found = model.statics.actuation(np.array([1e5, 0, 0, 0, 0, 0, 0, 0]), model.theta)
    np.testing.assert_allclose(found, [1e5, 0, 1e4, 1e4, 0, 0, 0, 0], rtol=1e-14)


@pytest.mark.parametrize("scale", [1e-4, 0.2, 1e4])
def test_a_memory_is_exact_for_a_drive_that_stays(scale):
    """dy/dt = a - y / scale has the solution (y_0 - a scale) exp(-t / scale) + a scale."""
    a, start, time = 3.0, 0.7, 0.5
    found = float(ca.evalf(Memory(ca.SX(a), ca.SX(1), ca.SX(scale)).advance(ca.SX(start), ca.SX(time))))
    assert found == pytest.approx((start - a * scale) * np.exp(-time / scale) + a * scale, rel=1e-7)


def tendon_ends(path, steps=20, **parameters):
    """Tension at the end of tendon 11 and what was commanded, along a path of commanded tensions."""
    model = in_python(NOMINAL.with_effect("tendon_friction", **parameters))
    commanded = np.concatenate([[path[0]], *(np.linspace(a, b, steps + 1)[1:] for a, b in pairwise(path))])
    y, found, duration = np.zeros(6), [path[0]], 0.01
    for before, after in pairwise(commanded):
        u, rate = np.zeros(12), np.zeros(12)
        u[6], rate[6] = after, (after - before) / duration
        a, y = (part.ravel() for part in model.reference_stepper.values("input_motion", u, rate, y, duration, model.theta))
        found.append(a[6])
    return commanded, np.array(found)


def test_tendon_friction_is_a_play():
    """Pulled, the end is behind by the friction; let go, it sticks over twice the friction, then is ahead by it."""
    commanded, found = tendon_ends((2.0, 6.0, 2.0), 200, constant=0.2, share=0.0, distance=1e-3)
    pulled, released = np.maximum(commanded[:201] - 0.2, 2.0), np.minimum(commanded[200:] + 0.2, 5.8)
    np.testing.assert_allclose(found[:201], pulled, atol=0.02)
    np.testing.assert_allclose(found[200:], released, atol=0.02)
    assert found[200] == pytest.approx(5.8, abs=1e-3)
    assert found[-1] == pytest.approx(2.2, abs=1e-3)


@pytest.mark.slow
def test_a_share_of_the_tension_is_lost_in_the_guides():
    for commanded, share in ((7.0, 0.1), (5.0, 0.02)):
        found = tendon_ends((0.0, commanded), 400, constant=0.0, share=share, distance=1e-3)[1]
        assert found[-1] == pytest.approx((1 - share) * commanded, abs=2e-3)


def test_friction_holds_tension_that_the_motor_has_let_go():
    found = tendon_ends((0.0, 5.0, 0.0), 200, constant=0.3, share=0.0, distance=1e-3)[1]
    assert found[-1] == pytest.approx(0.3, abs=2e-3)


def test_friction_may_let_go_with_the_motor():
    found = tendon_ends((0.0, 5.0, 0.0), 200, constant=0.3, share=0.0, distance=1e-3, released=1.0)[1]
    assert found[-1] == pytest.approx(0.0, abs=2e-3)
    assert found[200] == pytest.approx(4.7, abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("parameters", [(10.0, 0.9, 10.0), (3.0, 0.0, 0.01), (0.5, 0.2, 5.0), (0.0, 0.9, 1e-3), (2.0, 0.5, 1.0)])
def test_friction_only_resists(parameters):
    """The tendon never pushes, and its tension never moves against the command."""
    commanded, found = tendon_ends(
        (0.0, 7.0, 0.0, 1.0, 0.5, 4.0, 0.0), 70, **dict(zip(("constant", "share", "distance"), parameters, strict=True))
    )
    assert found.min() > -1e-9
    assert (np.diff(found) * np.diff(commanded)).min() > -1e-9


def carried(commanded: float, stretch: float, **parameters: float) -> float:
    """Tension in a tendon of an edge that is stretched by a share of its rest length: the slope of its potential."""
    length = ca.SX.sym("length")
    own = {name: ca.SX(value) for name, value in parameters.items()}
    context = Context(Layout.from_robot(NOMINAL.robot), None, np.eye(3), np.zeros(3), np.zeros(3))
    energy = commanded * length + find_effect("tendon_slack").tendon_energy(length, ca.SX(0.05), ca.SX(commanded), own, context)
    return float(ca.Function("slope", [length], [ca.gradient(energy, length)])(0.05 * (1 + stretch)))


def test_slack_is_taken_up_first():
    for tension, left in ((0.0, 0.0), (0.3, 0.0), (0.4, 0.0), (0.5, 0.025), (0.6, 0.1), (5.0, 4.5)):  # the corner is 0.1 N wide either side
        assert carried(tension, 0.1, tension=0.5, take_up=0.0) == pytest.approx(left, abs=1e-12)


def test_a_muscle_that_lengthens_takes_up_its_tendons_slack():
    """10 N a length: 0.5 N of slack is half gone at 2.5 %, all at 5 %; none comes back where the tendon carries all that is commanded."""
    for stretch, left in ((0.0, 4.5), (0.025, 4.75), (0.07, 5.0), (0.3, 5.0), (-0.05, 4.0)):
        assert carried(5.0, stretch, tension=0.5, take_up=10.0) == pytest.approx(left, abs=1e-12)
    assert carried(0.3, 0.3, tension=0.5, take_up=10.0) == pytest.approx(0.3, abs=1e-12)
    assert carried(0.0, 0.3, tension=0.5, take_up=10.0) == pytest.approx(0.0, abs=1e-12)


def test_slack_that_is_hardly_taken_up_is_as_good_as_constant():
    """The potential's two formulae agree where one takes over from the other."""
    for tension in (0.05, 0.45, 0.55, 3.0):
        slopes = [carried(tension, 0.1, tension=0.5, take_up=take_up) for take_up in (0.0, 0.99e-3, 1.01e-3, 2e-3)]
        np.testing.assert_allclose(slopes, slopes[0], atol=2.1e-4)


@pytest.mark.slow
def test_a_muscle_filled_from_zero_begins_below_its_middle():
    """Statics and the first sample of a run alike; from there a run goes on as if it had come from zero."""
    model = in_python(NOMINAL.with_effect("pressure_hysteresis", width=4e3, distance=1e4, filled=1.0, spread=0.0))
    u, still = np.append(np.array([0, 1e4, 3e4, 2e5, 0, 5e4]), np.zeros(6)), np.zeros(12)
    below = -4e3 * (1 - np.exp(-u[:6] / 1e4))
    np.testing.assert_allclose(model.statics.actuation(u, model.theta)[:6], u[:6] + below, rtol=1e-6)
    a, y = (part.ravel() for part in model.reference_stepper.values("input_motion", u, still, np.zeros(18), 0.1, model.theta))
    np.testing.assert_allclose(a[:6], u[:6] + below, rtol=1e-6)
    np.testing.assert_allclose(y, 0, atol=1e-9)
    rate = np.append(np.full(6, 1e4), np.zeros(6))
    further = u + 0.5 * rate
    a, y = (part.ravel() for part in model.reference_stepper.values("input_motion", further, rate, y, 0.5, model.theta))
    np.testing.assert_allclose(a[:6], further[:6] - 4e3 * (1 - np.exp(-further[:6] / 1e4)), rtol=1e-6)
    np.testing.assert_allclose(y, 0, atol=1e-6)


@pytest.mark.parametrize("model", [NOMINAL, HANGING])
def test_an_external_load_is_a_force_on_the_tip(model):
    found, expected = properties(model.with_effect("external_load", x=0.1, y=-0.2, z=0.3)), properties(model, (0.1, -0.2, 0.3))
    np.testing.assert_allclose(found["load"], expected["load"], atol=1e-15)


@pytest.mark.parametrize("mount", [{}, {"base_rotation_deg": (170.0, 20.0, 30.0)}])
def test_a_tilted_base_feels_gravity_from_elsewhere(mount):
    """On all masses, a payload's too; by +x the base's y side rises and the robot falls towards -y."""
    loaded = Model.from_robot(variant(mount=mount)).with_effect("base_tilt", x=0.2, y=-0.1).with_effect("payload", mass=0.03)
    gravity = Rotation.from_euler("XYZ", [0.2, -0.1, 0.0]).inv().apply([0, 0, -9.81])
    assert gravity[1] < 0
    expected = Model.from_robot(variant(mount={**mount, "gravity_m_per_s2": tuple(gravity)})).with_effect("payload", mass=0.03)
    np.testing.assert_allclose(properties(loaded)["load"], properties(expected)["load"], atol=1e-14)


def test_a_misaligned_tracker_measures_in_another_frame():
    angles, shift = (0.3, -0.2, 0.1), (0.01, 0.02, -0.03)
    values = {f"rotation_{axis}": angle for axis, angle in zip("xyz", angles, strict=True)}
    values |= {f"shift_{axis}": length for axis, length in zip("xyz", shift, strict=True)}
    expected = Rotation.from_euler("XYZ", angles).apply(at_rest(NOMINAL)) + shift
    np.testing.assert_allclose(at_rest(NOMINAL.with_effect("sensor_misalignment", **values)), expected, atol=1e-14)


def test_an_offset_displaces_one_point():
    moved = at_rest(NOMINAL.with_effect("sensor_offset", "s3", x=0.01, y=-0.02, z=0.03)) - at_rest(NOMINAL)
    np.testing.assert_allclose(moved, [[0, 0, 0], [0, 0, 0], [0.01, -0.02, 0.03], [0, 0, 0]], atol=1e-15)


def test_an_arm_turns_with_the_backbone():
    """Two arcs in planes of their own, turned as a whole: the arm at their end against rotations about the arcs' normals."""
    mount = Rotation.from_euler("XYZ", [0.5, -0.3, 0.2])
    bends, planes, length = (0.9, -0.6), (0.4, 1.7), 0.2
    at, frame, points = np.zeros(3), mount, []
    for bend, plane in zip(bends, planes, strict=True):
        turn = Rotation.from_euler("z", plane)
        for part in (0.5, 1.0):
            arc = length / bend * np.array([1 - np.cos(part * bend), 0, np.sin(part * bend)])
            points.append(at + frame.apply(turn.apply(arc)))
        at, frame = points[-1], frame * turn * Rotation.from_euler("y", bend) * turn.inv()
    arm, layout = np.array([0.01, -0.02, 0.03]), Layout.from_robot(NOMINAL.robot)
    context = Context(layout, 3, mount.as_matrix(), np.zeros(3), np.zeros(3))
    for turns in (0.0, 0.4, 1.0):
        values = {**dict(zip("xyz", map(ca.SX, arm), strict=True)), "turns": ca.SX(turns)}
        measured = ca.evalf(find_effect("sensor_offset").outputs(ca.SX(ca.DM(np.array(points).T)), values, context)).full().T
        expected = np.array(points)
        expected[3] += (1 - turns) * arm + turns * (frame * mount.inv()).apply(arm)
        np.testing.assert_allclose(measured, expected, atol=1e-14)


@pytest.mark.slow
def test_all_together_vanish_at_their_null_values(kang):
    model = NOMINAL
    for effect in effects():
        model = with_effect(model, effect, **{p.name: p.null for p in effect.parameters_of(Layout.from_robot(NOMINAL.robot))})
    assert len(model.effects) >= 18
    everything, (u,) = in_python(model), random_inputs(kang, 1, 0)
    found, plain = (solve_statics(m, u, [0.2, 0.0, 0.1]) for m in (everything, kang))
    assert abs(found.points - plain.points).max() < 1e-12
    assert abs(found.lengths - plain.lengths).max() < 1e-12


def test_names_are_looked_up_and_taken_once():
    names = [effect.name for effect in effects()]
    assert names == sorted(names)
    assert find_effect("payload").name == "payload"
    assert not {"gravity", "known_loads"} & set(names)  # part of every model
    with pytest.raises(InputError, match=r"file\.toml: unknown effect 'payloads': did you mean 'payload'"):
        find_effect("payloads", "file.toml")
    with pytest.raises(InputError, match="effect 'payload' exists already"):
        register(Payload())
