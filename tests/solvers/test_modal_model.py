"""Slow motion about an equilibrium beside the whole linear model, and from a neighbour beside the exact modes."""

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.ik import solve_trajectory
from tepm_opt.solvers.linear.modal_model import modal_model
from tepm_opt.solvers.linear.state_space import linearise
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.planning.trajectories import circle
from tests.tools import random_inputs, relative, variant

FREQUENCIES = np.logspace(-1, np.log10(20), 12)  # Hz
FAST = 20.0  # Hz, above which modes do not matter
ROBOTS = {
    "kang2017": lambda: Model.from_robot("kang2017"),
    "one module of four actuators": lambda: Model.from_robot(
        variant(geometry={"modules": 1, "segments_per_module": 5, "actuator_angles_deg": (0.0, 90.0, 180.0, 270.0)})
    ),
}


@pytest.fixture(scope="module")
def along(kang):
    """Equilibria along a circle of 8 s, 10 ms apart, of its first 2 s."""
    tips = circle(800, 8.0).positions[:200]
    return [found.equilibrium for found in solve_trajectory(kang, tips, ActuationMode.HYBRID)]


@pytest.fixture(scope="module", params=ROBOTS)
def equilibria(request):
    """Rest, random inputs, and a load on the tip."""
    model = compile_model(ROBOTS[request.param]())
    inputs = np.vstack([np.zeros(model.layout.inputs), random_inputs(model, 3, 1, 0, 0.6)])
    loads = [None, None, None, (0.05, -0.02, -0.03)]
    return [solve_statics(model, u, load) for u, load in zip(inputs, loads, strict=True)]


def frequencies(local):
    return np.sqrt(local.stiffness) / (2 * np.pi)


def response(local, by):
    """Of q by what enters as `by`, (frequencies, modes, inputs)."""
    s = 2j * np.pi * FREQUENCIES[:, None, None]
    return np.linalg.solve(s**2 * np.eye(len(local.stiffness)) + s * local.damping + np.diag(local.stiffness), by[None])


@pytest.mark.slow
def test_frequency_response(equilibria):
    """By axial forces and by forces on the points, errors beside the largest response; at rest axial forces have none."""
    for at in equilibria:
        local, whole = modal_model(at), linearise(at, actuators=False)
        points, area = list(at.model.layout.point_names), at.model.values["A"]
        by_pressure, by_tension, by_force = (
            whole.select(kind, points).response(FREQUENCIES) for kind in ("pressure", "tension", "force")
        )  # fmt: skip
        by_axial = local.observe @ response(local, local.drive) + local.residual
        for found, expected in (
            (by_axial, by_pressure / area),
            (-by_axial, by_tension),
            (local.observe @ response(local, local.push), by_force),
        ):
            error = np.linalg.norm(found - expected, 2, axis=(1, 2)) / np.linalg.norm(expected, 2, axis=(1, 2)).max()
            assert error.max() < 1e-2
            assert error[FREQUENCIES < 5].max() < 3e-3
        static = whole.select("pressure", points).gain() / area
        np.testing.assert_allclose(local.gain, static, atol=1e-9 * abs(static).max())
        forces = np.linspace(-1, 1, static.shape[1])
        at_rest = local.observe @ local.static(forces) + local.residual @ forces
        np.testing.assert_allclose(at_rest, local.gain @ forces, atol=1e-9 * abs(static).max())


def test_modes_are_those_of_the_whole_model(equilibria):
    """Undamped to rounding, damped to what the modes left out take part; all that swing below 20 Hz are there."""
    for at in equilibria:
        local, whole = modal_model(at), linearise(at, actuators=False)
        size, count = whole.coordinates, len(local.stiffness)
        squares = np.sort(np.linalg.eigvals(-whole.A[size : 2 * size, :size]).real)
        np.testing.assert_allclose(local.stiffness, squares[:count], rtol=1e-7)
        assert np.sqrt(squares[count]) > 2 * np.pi * FAST
        np.testing.assert_allclose(local.weights @ local.shapes, np.eye(count), atol=1e-9)
        np.testing.assert_allclose(local.damping, local.damping.T, atol=1e-10)
        A = np.block([[np.zeros((count, count)), np.eye(count)], [-np.diag(local.stiffness), -local.damping]])
        found, expected = np.linalg.eigvals(A), np.linalg.eigvals(whole.A)
        for value in expected[(abs(expected) < 2 * np.pi * FAST) & (expected.imag > 0)]:
            assert abs(found - value).min() < 2e-3 * abs(value)


def test_from_a_neighbour(along):
    """The modes found from one neighbour after another stay the exact ones, and the exact ones span the same motions."""
    local = modal_model(along[0])
    for at in along[1:]:
        local = modal_model(at, local)
    for at, start in ((along[-1], local), (along[-1], modal_model(along[0]))):
        warm, exact = modal_model(at, start), modal_model(at)
        assert warm.equilibrium is at
        np.testing.assert_allclose(frequencies(warm), frequencies(exact), rtol=1e-3)
        np.testing.assert_array_equal(warm.gain, exact.gain)
        shared = np.linalg.svd(warm.weights @ exact.shapes, compute_uv=False)
        assert shared.min() > 1 - 1e-3
        np.testing.assert_allclose(warm.weights @ warm.shapes, np.eye(len(shared)), atol=1e-9)
        found, expected = (one.observe @ response(one, one.drive) + one.residual for one in (warm, exact))
        assert relative(found, expected) < 1e-3


def test_frequencies_along_a_circle(along):
    local = modal_model(along[0])
    for k, at in enumerate(along[1:]):
        local = modal_model(at, local)
        if k % 20 == 0:
            np.testing.assert_allclose(frequencies(local), frequencies(modal_model(at)), rtol=1e-5)


def test_from_far_away(equilibria):
    """What is no neighbour costs more but leads to the same modes."""
    start = modal_model(equilibria[0])
    for at in equilibria:
        np.testing.assert_allclose(frequencies(modal_model(at, start)), frequencies(modal_model(at)), rtol=1e-3)


def test_coordinates(along):
    """Levels nearby as q and back; what moves them there at rest are the forces between them."""
    model, here, there = modal_model(along[0]), along[0], along[1]
    change = there.x[1:].ravel() - model.levels
    q = model.weights @ change
    assert relative(model.shapes @ q, change) < 0.02
    area, half = here.model.values["A"], here.model.layout.inputs // 2
    pressures, tensions = np.split(there.inputs - here.inputs, [half])
    forces = area * pressures - tensions
    assert relative(model.static(forces), q) < 0.02
    assert relative(model.gain @ forces, (there.points - here.points).ravel()) < 0.02


def test_python_backend(kang, kang_python, compiler):
    inputs = random_inputs(kang, 1, 3, 0, 0.5)[0]
    c, python = (modal_model(solve_statics(model, inputs)) for model in (kang, kang_python))
    np.testing.assert_allclose(c.stiffness, python.stiffness, rtol=1e-6)
    np.testing.assert_allclose(c.gain, python.gain, atol=1e-9 * abs(c.gain).max())


@pytest.mark.slow
def test_every_mode_of_a_small_robot():
    model = compile_model(variant(geometry={"modules": 1, "segments_per_module": 1}))
    rest = solve_statics(model, np.zeros(model.layout.inputs))
    local = modal_model(rest, modes=9)
    assert local.shapes.shape == (9, 9)
    assert abs(local.residual).max() < 1e-9 * abs(local.gain).max()
    np.testing.assert_allclose(modal_model(rest, local, 9).stiffness, local.stiffness, rtol=1e-6)
    with pytest.raises(InputError, match="valid: 1 … 9"):
        modal_model(rest, modes=10)


def test_wrong_input(kang, along):
    local = modal_model(along[0])
    with pytest.raises(InputError, match="number of modes"):
        modal_model(along[1], local, modes=8)
    with pytest.raises(InputError, match="another model"):
        modal_model(solve_statics(kang.with_theta(kang.theta), np.zeros(12)), local)
    with pytest.raises(InputError, match="no stable equilibrium"):
        modal_model(solve_statics(kang, np.zeros(12), (0, 0, -3.0)))
    with pytest.raises(InputError, match="modes: 0"):
        modal_model(along[0], modes=0)
