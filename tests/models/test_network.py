"""Energy, force, stiffness and damping of the network, against the independent one and against differences of each other."""

import numpy as np
import pytest

from tepm_opt.models.compile import compile_model
from tepm_opt.solvers.numerics.matrices import expand_band
from tests.independent import Network
from tests.tools import random_inputs, relative, slope, variant


@pytest.fixture(scope="module")
def point(kang):
    """Levels off any equilibrium, and the properties there."""
    rng = np.random.default_rng(1)
    x = kang.rest.copy()
    x[1:] += rng.normal(scale=2e-3, size=x[1:].shape)
    external = np.zeros(12)
    external[9:] = 0.3, -0.2, 0.5
    u = random_inputs(kang, 1, 2)[0]
    return x, u, external, kang.reference.prepare(u, False, external, kang.theta)[1]


def test_energy_force_and_stiffness_are_those_of_the_independent_network(kang, point):
    x, u, external, P = point
    other = Network()
    load = np.zeros((12, 3))
    load[:, 2] -= 9.81 * 0.22 / 18
    load[-1] += external[9:] / 3
    at = kang.reference.assemble(x, P, kang.theta)
    energy, force, stiffness = other.potential(x[1:].ravel(), other.push(u), load)
    assert kang.reference.energy(x, P, kang.theta) == pytest.approx(energy, rel=1e-13)
    assert at.energy == pytest.approx(energy, rel=1e-13)
    assert relative(at.force.ravel(), force) < 1e-13
    assert relative(expand_band(at.band), stiffness) < 1e-13


@pytest.mark.parametrize("seed", range(3))
def test_force_is_the_slope_of_the_energy_and_stiffness_that_of_the_force(kang, point, seed):
    x, _, _, P = point
    direction = np.random.default_rng(seed).normal(size=x.shape)
    direction[0] = 0
    at = kang.reference.assemble(x, P, kang.theta)
    rise = slope(lambda h: np.array([kang.reference.energy(x + h * direction, P, kang.theta)]), 1e-4)
    assert rise[0] == pytest.approx(float((at.force * direction[1:]).sum()), rel=1e-8)
    turn = slope(lambda h: kang.reference.assemble(x + h * direction, P, kang.theta).force.ravel(), 1e-4)
    assert relative(expand_band(at.band) @ direction[1:].ravel(), turn) < 1e-7


def test_the_convex_stand_in_is_positive_semidefinite_where_the_stiffness_is_not(kang):
    """Under a push from above the straight robot is past its buckling load."""
    P = kang.reference.prepare(np.zeros(12), False, np.array([0] * 11 + [-3.0]), kang.theta)[1]
    x = kang.rest.copy()
    x[1:, 2::3] *= 0.95
    smallest, convex = (np.linalg.eigvalsh(expand_band(kang.reference.assemble(x, P, kang.theta, flag).band))[0] for flag in (False, True))
    assert smallest < -0.1
    assert convex > -1e-9


def test_the_damping_is_that_of_dashpots_along_the_edges(kang, point):
    """c_v = 15.50 N s/m on every edge at n_e = 6 (beta = 1): a network of springs at their rest length has the same matrix."""
    x, _, _, P = point
    other = Network()
    nodes = x.reshape(-1, 3)
    other.rest = np.linalg.norm(nodes[other.ends[:, 1]] - nodes[other.ends[:, 0]], axis=1).reshape(12, -1)
    other.stiffness = np.full((12, 12), 15.50)
    expected = other.potential(x[1:].ravel(), np.zeros((12, 3)), np.zeros((12, 3)))[2]
    found = expand_band(kang.reference.assemble_damping(x, P, kang.theta))
    assert relative(found, expected) < 1e-12
    assert np.linalg.eigvalsh(found)[0] > -1e-10


@pytest.mark.parametrize("segments", [2, 6, 12])
def test_the_whole_robots_mass_and_damping_do_not_depend_on_the_segments(segments):
    model = compile_model(variant(geometry={"segments_per_module": segments}), backend="python")
    P = model.reference.prepare(np.zeros(12), False, np.zeros(12), model.theta)[1]
    rows = model.network.property_rows
    assert 3 * P[:, rows["mass"]].sum() == pytest.approx(2 * 0.22, rel=1e-12)
    assert 1 / (1 / P[:segments, rows["damping"]][:, 0]).sum() == pytest.approx(15.50 / 6, rel=1e-12)  # in series: one actuator's
    assert 1 / (1 / P[:segments, rows["stiffness"]][:, 0]).sum() == pytest.approx(358.86, rel=1e-12)
