"""Small motions about an equilibrium, against SPEC's check values and the independent network."""

import numpy as np
import pytest

from tepm_opt.solvers.linear.modes import poles, state_matrix
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.mechanics.step_limit import rk4_step_limit
from tepm_opt.solvers.numerics.matrices import expand_band
from tests.independent import Network


@pytest.fixture(scope="module")
def at_rest(kang):
    return poles(solve_statics(kang, np.zeros(12)))


def test_check_values_at_rest(at_rest):
    sway, next_ = at_rest[:4], at_rest[4]
    np.testing.assert_allclose(sway.real, -0.245, atol=5e-4)
    np.testing.assert_allclose(abs(sway.imag), 5.642, atol=5e-4)
    assert next_.real == pytest.approx(-4.077, abs=5e-4)
    assert abs(next_.imag) == pytest.approx(33.07, abs=5e-3)
    assert at_rest[-1].real == pytest.approx(-6726, abs=0.5)
    assert abs(at_rest[-1].imag) < 1e-9
    assert len(at_rest) == 2 * 108
    assert at_rest.real.max() < 0
    assert (np.diff(abs(at_rest)) >= 0).all()


def test_largest_stable_step_of_runge_kutta(at_rest):
    """|R(h lambda)| <= 1 exactly; SPEC's 0.413 ms is the customary 2.78 / |lambda|."""
    limit = rk4_step_limit(at_rest)
    assert 1e3 * limit == pytest.approx(0.4141, abs=5e-5)
    assert 1e3 * 2.78 / abs(at_rest).max() == pytest.approx(0.413, abs=5e-4)
    at, above = (abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24).max() for z in (limit * at_rest, 1.00001 * limit * at_rest))
    assert at <= 1 + 1e-9
    assert above > 1 + 1e-5


def test_step_limit_of_an_oscillator():
    """On the imaginary axis the scheme is stable up to 2 sqrt 2; a real pole that is faster takes over."""
    assert rk4_step_limit(np.array([-0.01 + 1j, -0.01 - 1j])) == pytest.approx(2 * np.sqrt(2), rel=0.03)
    assert rk4_step_limit(np.array([1j, -1j, -5.0])) == pytest.approx(2.7853 / 5, rel=1e-4)


@pytest.mark.parametrize("u", [np.zeros(12), np.array([1e5, 0, 2e5, 3e5, 1e5, 0, 1, 2, 3, 4, 5, 6.0])], ids=["rest", "bent"])
def test_state_matrix_is_that_of_the_independent_network(kang, u):
    held = solve_statics(kang, u)
    other = Network()
    x = held.nodes[1:].ravel()
    stiffness = other.potential(x, other.push(u), other.loads())[2]
    nodes = held.nodes.reshape(-1, 3)
    other.rest = np.linalg.norm(nodes[other.ends[:, 1]] - nodes[other.ends[:, 0]], axis=1).reshape(12, -1)
    other.stiffness = np.full((12, 12), 15.50)  # springs at their rest length have the matrix of dashpots
    damping = other.potential(x, np.zeros((12, 3)), other.loads())[2]
    mass = 0.22 / 18
    expected = np.block([[np.zeros((108, 108)), np.eye(108)], [-stiffness / mass, -damping / mass]])
    found = state_matrix(held)
    assert abs(found - expected).max() < 1e-10 * abs(expected).max()


def test_full_matrix_from_its_band():
    band = np.array([[1.0, 2, 3], [4, 5, 0]])
    np.testing.assert_array_equal(expand_band(band), [[1, 4, 0], [4, 2, 5], [0, 5, 3]])
