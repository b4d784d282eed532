"""From axial forces to set points (Eq. (3))."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tepm_opt.models.compile import compile_model
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.allocation import allocate, axial_forces, force_range
from tests.tools import in_company

AREA, STEP = 50.27e-6, 4.5e3
FORCES = st.lists(st.floats(0, 1), min_size=6, max_size=6)


@pytest.fixture(scope="module")
def dead_zone():
    return compile_model(in_company(pressure_dead_zone={"threshold": 3e4}))


def test_force_ranges_of_the_paper(kang):
    """0 … 0.5 MPa alone; with tension from -7 N to the grid's last pressure, 111 steps of 4.5 kPa."""
    np.testing.assert_allclose(force_range(kang, ActuationMode.PRESSURE), [[0] * 6, [0.5e6 * AREA] * 6])
    np.testing.assert_allclose(force_range(kang, ActuationMode.HYBRID), [[-7] * 6, [111 * STEP * AREA] * 6])


@given(FORCES)
def test_pressure_alone(kang, parts):
    low, high = force_range(kang, ActuationMode.PRESSURE)
    forces = low + np.array(parts) * (high - low)
    found = allocate(kang, forces, ActuationMode.PRESSURE)
    np.testing.assert_allclose(found.inputs[:6], forces / AREA, atol=1e-6)
    assert not found.inputs[6:].any()
    assert found.error < 1e-12
    assert abs(found.rounded[:6] - found.inputs[:6]).max() <= STEP * (1 + 1e-9)  # half a step, a whole one at the last


def check_hybrid(model, parts):
    low, high = force_range(model, ActuationMode.HYBRID)
    forces = low + np.array(parts) * (high - low)
    found = allocate(model, forces, ActuationMode.HYBRID)
    pressure, tension = found.inputs[:6], found.inputs[6:]
    np.testing.assert_allclose(axial_forces(model, found.inputs), forces, rtol=0, atol=1e-9)
    assert found.error < 1e-9
    np.testing.assert_allclose(pressure / STEP, np.round(pressure / STEP), atol=1e-9)
    assert pressure.min() >= 0
    assert pressure.max() <= 0.5e6
    assert tension.min() >= 0
    assert tension.max() <= 7
    inside = (pressure > 0) & (pressure < 111 * STEP)
    assert abs(tension[inside] - 3.5).max(initial=0) <= STEP * AREA / 2 + 1e-9
    assert abs(axial_forces(model, found.rounded) - forces).max() <= 1.05e-3 * (1 + 1e-9)


@given(FORCES)
def test_hybrid_meets_forces_exactly_on_the_grid_about_mid_tension(kang, parts):
    check_hybrid(kang, parts)


@given(FORCES)
def test_hybrid_with_an_effect_on_the_inputs_is_exact_too(dead_zone, parts):
    check_hybrid(dead_zone, parts)


@given(st.lists(st.floats(0.05, 1), min_size=6, max_size=6))
@example([1.0, 1.0, 1.0, 1.0, 1.0, 0.0625])  # steps that are doubled within the dead zone overshoot
def test_pressure_alone_makes_up_for_a_dead_zone(dead_zone, parts):
    """Beyond the rounded corner the threshold is added; within it the corner is inverted."""
    forces = np.array(parts) * force_range(dead_zone, ActuationMode.PRESSURE)[1]
    found = allocate(dead_zone, forces, ActuationMode.PRESSURE)
    assert found.error < 1e-9
    beyond = forces > 0.2 * 3e4 * AREA
    np.testing.assert_allclose(found.inputs[:6][beyond], (forces / AREA + 3e4)[beyond], atol=1e-3)


def test_mid_tension_can_be_chosen(kang):
    for tension in (1.0, 6.0):
        found = allocate(kang, np.full(6, 8.0), ActuationMode.HYBRID, tension)
        assert abs(found.inputs[6:] - tension).max() <= STEP * AREA / 2 + 1e-9
        assert found.error < 1e-12


@pytest.mark.parametrize(
    ("mode", "force", "missed"),
    [(ActuationMode.PRESSURE, -1.0, 1.0), (ActuationMode.HYBRID, -7.5, 0.5), (ActuationMode.HYBRID, 30.0, 30 - 111 * STEP * AREA)],
)
def test_forces_out_of_range_are_missed_by_what_is_said(kang, mode, force, missed):
    found = allocate(kang, np.array([force, 1, 2, 3, 4, 5.0]), mode)
    assert found.error == pytest.approx(missed, abs=1e-9)
    assert abs(axial_forces(kang, found.inputs)[1:] - [1, 2, 3, 4, 5]).max() < 1e-9  # the others are met
    assert kang.check_inputs(found.inputs) is not None


@given(st.lists(st.floats(0, 1), min_size=12, max_size=12))
def test_rounding_stays_in_range_and_is_idempotent(kang, parts):
    u = np.array(parts) * kang.input_max
    rounded = kang.robot.actuation.on_grid(u)
    assert (rounded >= 0).all()
    assert (rounded <= kang.input_max * (1 + 1e-12)).all()
    assert (abs(rounded - u) <= kang.input_step * (1 + 1e-9)).all()
    np.testing.assert_array_equal(kang.robot.actuation.on_grid(rounded), rounded)


def test_small_forces_leave_a_dead_zone(dead_zone):
    """1 mN is 20 Pa a step, 30 kPa have to be crossed: steps that nothing answers double."""
    forces = np.array([1e-3, 2e-3, 5e-4, 1e-3, 3e-3, 1e-2])
    found = allocate(dead_zone, forces, ActuationMode.PRESSURE)
    assert found.error < 1e-9
    np.testing.assert_allclose(axial_forces(dead_zone, found.inputs), forces, rtol=0, atol=1e-9)
