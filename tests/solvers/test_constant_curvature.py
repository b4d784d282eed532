"""Constant-curvature kinematics in closed form, both ways."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tepm_opt.models.compile import compile_model
from tepm_opt.solvers.kinematics.constant_curvature import arc_from_lengths, lengths_from_arc, lengths_from_tip, tip_from_lengths, transform
from tepm_opt.solvers.mechanics.statics import solve_statics
from tests.tools import variant

RADIUS = 0.04
THREE = np.deg2rad([90.0, 210.0, 330.0])
FOUR = np.deg2rad([0.0, 90.0, 180.0, 270.0])


@given(
    st.lists(st.floats(0.15, 0.27), min_size=3, max_size=3),
    st.sampled_from([1, 2, 3]),
)
def test_lengths_to_tip_and_back(lengths, modules):
    lengths = np.tile(lengths, (modules, 1))
    s, kappa, _ = arc_from_lengths(lengths[0], RADIUS, THREE)
    assume(kappa * s * modules < 6)  # beyond a full turn another, shorter arc ends at the same tip
    tip = tip_from_lengths(lengths, RADIUS, THREE)
    np.testing.assert_allclose(lengths_from_tip(tip, modules, RADIUS, THREE), lengths, rtol=0, atol=1e-12)


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.05, 0.5), st.sampled_from([1, 2, 3]), st.sampled_from([THREE, FOUR]))
def test_tip_to_lengths_and_back(x, y, z, modules, angles):
    lengths = lengths_from_tip([x, y, z], modules, RADIUS, angles)
    assert lengths.shape == (modules, len(angles))
    assert np.ptp(lengths, axis=0).max() == 0
    np.testing.assert_allclose(tip_from_lengths(lengths, RADIUS, angles), [x, y, z], rtol=0, atol=1e-12)


@given(st.floats(0.1, 0.3), st.floats(1e-3, 10), st.floats(-np.pi, np.pi))
def test_arc_to_lengths_and_back(s, kappa, phi):
    for angles in (THREE, FOUR):
        back = arc_from_lengths(lengths_from_arc((s, kappa, phi), RADIUS, angles), RADIUS, angles)
        np.testing.assert_allclose(back[:2], (s, kappa), rtol=1e-10)
        assert abs(np.exp(1j * back[2]) - np.exp(1j * phi)) < 1e-10


def test_a_quarter_turn_towards_x():
    rotation, position = transform((0.2, np.pi / 2 / 0.2, 0.0))
    radius = 0.2 / (np.pi / 2)
    np.testing.assert_allclose(position, [radius, 0, radius], atol=1e-15)
    np.testing.assert_allclose(rotation @ [0, 0, 1], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(rotation @ [0, 1, 0], [0, 1, 0], atol=1e-15)


def test_a_longer_muscle_bends_away_from_itself():
    """Actuator 1 is on +y."""
    tip = tip_from_lengths(np.array([[0.21, 0.2, 0.2]]), RADIUS, THREE)
    assert tip[1] < -0.01
    assert abs(tip[0]) < 1e-15


@pytest.mark.parametrize("bend", [0.0, 1e-15, 1e-12, 1e-9])
def test_the_straight_limit(bend):
    """No division by the curvature: tiny bends move the tip by bend / 2 times the length."""
    rotation, position = transform((0.2, bend / 0.2, 0.0))
    np.testing.assert_allclose(position, [0.1 * bend, 0, 0.2], rtol=1e-12, atol=1e-25)
    np.testing.assert_allclose(rotation, np.eye(3), atol=1.1e-9)
    np.testing.assert_array_equal(lengths_from_tip([0, 0, 0.4], 2, RADIUS, THREE), np.full((2, 3), 0.2))


def test_no_arc_ends_at_the_base():
    for tip in ([0, 0, 0], [0, 0, -0.1]):
        with pytest.raises(ValueError, match="no arc from the base ends at"):
            lengths_from_tip(tip, 2, RADIUS, THREE)


@pytest.fixture(scope="module")
def without_gravity():
    return compile_model(variant(mount={"gravity_m_per_s2": (0.0, 0.0, 0.0)}), backend="python")


@pytest.mark.parametrize("u", [[1e5, 1e5, 1e5], [3e5, 2e5, 2e5], [1e5, 2e5, 3e5]])
def test_without_gravity_the_network_is_nearly_an_arc(u, without_gravity):
    """Plane triangles of three stiff rods in crossed bracing: the arc through the same lengths ends within 0.2 % of the bend."""
    held = solve_statics(without_gravity, [*u, *u, 0, 0, 0, 0, 0, 0])
    expected = tip_from_lengths(held.lengths, RADIUS, THREE) + np.array([0, 0, -0.05])
    bend = np.linalg.norm(held.tip[:2])
    assert np.linalg.norm(held.tip - expected) < max(0.002 * bend, 1e-7)
