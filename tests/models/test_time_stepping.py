"""Motion: the same in C and in Python, the order of the scheme, and an independent integrator."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.models.compile import compile_model
from tepm_opt.solvers.mechanics.simulate import Directions, simulate
from tests.independent import Network
from tests.models.test_backends import MODELS
from tests.tools import relative


def gentle(model, duration=0.4, samples=21, part=0.3, force=0.2):
    """Smooth inputs that all move, and a tip force."""
    time = np.linspace(0, duration, samples)
    rng = np.random.default_rng(5)
    turns = rng.uniform(0.5, 2, model.layout.inputs)
    inputs = part * model.input_max * np.sin(np.outer(time / duration, turns)) ** 2
    return SetPoints(time, inputs, force * np.column_stack([np.sin(3 * time / duration), time / duration, 0 * time]))


@pytest.fixture(scope="module", params=[pytest.param(name, marks=() if name == "kang2017" else pytest.mark.slow) for name in MODELS])
def pair(request, compiler):
    model = MODELS[request.param]()
    return compile_model(model, backend="c"), compile_model(model, backend="python")


@pytest.mark.parametrize("hold", [False, True])
def test_both_backends_step_alike(pair, hold):
    c, python = pair
    setpoints = gentle(c, 0.1, 6, 0.1)
    directions = Directions.from_names(c, [*c.network.parameter_names], ["pressure_11", "tension_11"])
    first, second = (simulate(m, setpoints, step=0.01, hold=hold, directions=directions, tolerance=1e-10) for m in (c, python))
    np.testing.assert_allclose(first.levels, second.levels, rtol=0, atol=1e-10)
    np.testing.assert_allclose(first.velocities, second.velocities, rtol=0, atol=1e-8)
    np.testing.assert_allclose(first.lengths, second.lengths, rtol=0, atol=1e-10)
    for name, a, b in zip(directions.names, first.sensitivities, second.sensitivities, strict=True):
        assert abs(a - b).max() <= 1e-7 * abs(a).max() + 1e-14, name
    assert (first.effort.steps, first.effort.halvings) == (second.effort.steps, second.effort.halvings)


@pytest.mark.slow
@pytest.mark.parametrize("hold", [False, True])
def test_both_backends_adapt_alike(pair, hold):
    c, python = pair
    setpoints = gentle(c, 0.1, 6, 0.1)
    directions = Directions.from_names(c, ["K_a", "m_d"], ["pressure_11"])
    first, second = (simulate(m, setpoints, hold=hold, directions=directions, error=1e-3) for m in (c, python))
    np.testing.assert_allclose(first.levels, second.levels, rtol=0, atol=1e-9)
    np.testing.assert_allclose(first.velocities, second.velocities, rtol=0, atol=1e-7)
    assert abs(first.sensitivities - second.sensitivities).max() <= 1e-6 * abs(first.sensitivities).max()
    assert first.error == pytest.approx(second.error, rel=1e-6)
    assert first.step == pytest.approx(second.step, rel=1e-6)
    assert (first.effort.steps, first.effort.halvings) == (second.effort.steps, second.effort.halvings)


def test_both_backends_halve_alike(kang, kang_python, compiler):
    """Everything jumps at once, in steps that are too long for it."""
    first, second = (simulate(m, gentle(m, 0.1, 3, 1.0), hold=True, step=0.05) for m in (kang, kang_python))
    np.testing.assert_allclose(first.levels, second.levels, rtol=0, atol=1e-12)
    assert (first.effort.steps, first.effort.halvings) == (second.effort.steps, second.effort.halvings)
    assert first.effort.halvings > 3


def test_both_backends_do_rk4_alike(pair):
    c, python = pair
    setpoints = gentle(c, 0.02, 3, 0.02)
    first, second = (simulate(m, setpoints, "rk4") for m in (c, python))
    np.testing.assert_allclose(first.levels, second.levels, rtol=0, atol=1e-12)


def test_implicit_steps_are_of_third_order(kang):
    setpoints = gentle(kang, 0.8, 9)
    exact = simulate(kang, setpoints, step=0.0005, tolerance=1e-11).levels
    errors = [abs(simulate(kang, setpoints, step=step, tolerance=1e-11).levels - exact).max() for step in (0.01, 0.005, 0.0025)]
    assert errors[0] / errors[1] > 6
    assert errors[1] / errors[2] > 6


@pytest.mark.slow
def test_against_an_integrator_that_shares_nothing(kang):
    """SciPy's eighth-order Runge-Kutta on the independent network with dampers of its own."""
    setpoints = gentle(kang, 0.3, 7)
    network = Network()
    ends, n = network.ends, network.levels
    c_a, factor = 15.5 / 6, np.array([1.0] * 3 + [1.0] * 3 + [1.0] * 6)  # beta_1 = beta_2 = 1
    damping = np.tile(factor * 6 * c_a, n)
    mass = np.repeat(network.mass, 3)[:, None]
    start = simulate(kang, setpoints).start.nodes.copy()

    def acceleration(t, x, v):
        u = np.array([np.interp(t, setpoints.time, column) for column in setpoints.inputs.T])
        force = np.array([np.interp(t, setpoints.time, column) for column in setpoints.tip_force.T])
        span, rate = x[ends[:, 1]] - x[ends[:, 0]], v[ends[:, 1]] - v[ends[:, 0]]
        length = np.linalg.norm(span, axis=1)
        along = span / length[:, None]
        pull = network.stiffness.ravel() * (length - network.rest.ravel()) + damping * (along * rate).sum(axis=1)
        pull.reshape(n, -1)[:, :3] -= network.push(u)
        total = np.zeros_like(x)
        np.add.at(total, ends[:, 0], pull[:, None] * along)
        np.add.at(total, ends[:, 1], -pull[:, None] * along)
        total[3:] += mass * [0, 0, -9.81]
        total[-3:] += force / 3
        return total[3:] / mass

    def rates(t, s):
        x, v = s.reshape(2, -1, 3)
        x = np.concatenate([start[0], x])
        return np.concatenate([v.ravel(), acceleration(t, x, np.concatenate([np.zeros((3, 3)), v])).ravel()])

    state = np.concatenate([start[1:].ravel(), np.zeros(start[1:].size)])
    found = solve_ivp(rates, (0, 0.3), state, "DOP853", setpoints.time, rtol=1e-8, atol=1e-10, max_step=1e-3)
    expected = found.y[: start[1:].size].T.reshape(len(setpoints.time), n, -1)
    assert abs(expected - expected[0]).max() > 0.02
    allowed = ({"method": "rk4"}, 1e-6), ({"step": 0.002}, 1e-6), ({"step": 0.01}, 3e-5), ({}, 1e-4), ({"error": 1e-6}, 1e-6)
    for settings, close in allowed:
        assert abs(simulate(kang, setpoints, **settings).levels[:, 1:] - expected).max() < close


@pytest.mark.slow
def test_sensitivities_without_c(kang_python):
    """The reference, too, agrees with differences."""
    setpoints = gentle(kang_python, 0.06, 4, 0.1)
    directions = Directions.from_names(kang_python, ["m_d"])
    found = simulate(kang_python, setpoints, step=0.01, directions=directions, tolerance=1e-11).sensitivities[0]

    def at(change):
        theta = kang_python.theta.copy()
        theta[kang_python.network.parameter_names.index("m_d")] += change
        return simulate(kang_python.with_theta(theta), setpoints, step=0.01, tolerance=1e-11).points

    assert relative(found, (at(1e-4) - at(-1e-4)) / 2e-4) < 1e-5
