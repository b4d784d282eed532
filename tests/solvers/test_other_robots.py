"""The solvers know no robot: other numbers of modules, actuators and segments, other bracing."""

import numpy as np
import pytest

from tepm_opt.models.compile import compile_model
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.ik import solve_ik
from tepm_opt.solvers.linear.gain import solve_gain
from tepm_opt.solvers.mechanics.statics import solve_statics
from tests.tools import PRECISE, random_inputs, relative, slope, variant

FOUR = (0.0, 90.0, 180.0, 270.0)
ROBOTS = {
    "1 module": {"geometry": {"modules": 1}},
    "3 light modules": {"geometry": {"modules": 3, "segments_per_module": 2}, "parameters": {"m_d": 0.05}},  # 0.22 kg buckle
    "4 actuators": {"geometry": {"actuator_angles_deg": FOUR, "segments_per_module": 3}},
    "1 module of 5 uneven actuators": {
        "geometry": {"modules": 1, "actuator_angles_deg": (0.0, 60.0, 150.0, 200.0, 300.0), "segments_per_module": 3}
    },
    "2 segments": {"geometry": {"segments_per_module": 2}},
    "5 segments": {"geometry": {"segments_per_module": 5}},
    "12 segments": {"geometry": {"segments_per_module": 12}},
    "single bracing": {"geometry": {"bracing": "single", "segments_per_module": 4}},
}


@pytest.fixture(scope="module", params=ROBOTS)
def model(request):
    return compile_model(variant(**ROBOTS[request.param]), backend="python")


@pytest.mark.sample(3)
def test_statics(model):
    for u in random_inputs(model, 5, 0):
        held = solve_statics(model, u, [0.1, 0.2, -0.1])
        assert held.solved
        assert held.residual < 1e-9
        assert held.smallest_eigenvalue > 0
        assert held.points.shape == (2 * model.layout.modules, 3)
        assert held.lengths.shape == (model.layout.modules, model.layout.actuators)
        assert (np.diff(np.linalg.norm(held.points - [0, 0, -0.05], axis=1)) > 0).all()  # reference points count upwards


def test_gain(model):
    u = random_inputs(model, 1, 1, 0.1, 0.9)[0]
    held = solve_statics(model, u, settings=PRECISE)
    found = solve_gain(held).normalise()
    half = len(u) // 2
    assert relative(found[:, half:] / 7, -found[:, :half] / (0.5e6 * 50.27e-6)) < 1e-12
    for number in (0, half - 1):

        def tip(h, number=number):
            part = np.zeros(len(u))
            part[number] = h
            return solve_statics(model, u + part * model.input_max, start=held, settings=PRECISE).tip

        assert relative(found[:, number], slope(tip, 1e-3)) < 1e-6


@pytest.mark.parametrize("mode", list(ActuationMode))
def test_inverse_kinematics(model, mode):
    """A little higher than at rest and aside: within reach of all of them."""
    target = solve_statics(model, np.zeros(model.layout.inputs)).tip + np.array([0.03, 0.02, 0.01])
    found = solve_ik(model, target, mode)
    assert found.solved, found.outcome.message
    held = solve_statics(model, found.allocation.inputs)
    assert np.linalg.norm(held.tip - target) < 1e-6
    assert abs(held.lengths - held.lengths[0]).max() < 1e-7


def test_redundant_forces_are_of_minimum_norm():
    """SPEC section 2: with four actuators, no other forces with the same tip have a smaller norm."""
    model = compile_model(variant(geometry={"modules": 1, "actuator_angles_deg": FOUR, "segments_per_module": 3}), backend="python")
    found = solve_ik(model, [0.01, 0.015, 0.17])
    assert found.solved
    half = model.layout.inputs // 2
    by_force = solve_gain(found.equilibrium).matrix[:, :half] / model.model.values["A"]
    null = np.linalg.svd(by_force)[2][3:]
    assert null.shape == (1, 4)
    assert abs(null @ found.forces).max() < 1e-6


def test_redundant_forces_keep_to_their_limits():
    """Least norm would pull on actuator 3; with pressure alone it is left at 0, which leaves one solution."""
    model = compile_model(variant(geometry={"modules": 1, "actuator_angles_deg": FOUR, "segments_per_module": 3}), backend="python")
    forces = np.array([11.0, 4.0, 0.0, 3.0])  # (10, 5, -1, 4), at right angles to the null space, and one step along (1, -1, 1, -1)
    target = solve_statics(model, [*forces / model.model.values["A"], 0, 0, 0, 0]).tip
    pressure, hybrid = (solve_ik(model, target, mode) for mode in ActuationMode)
    assert pressure.solved
    assert hybrid.solved
    np.testing.assert_allclose(pressure.forces, forces, atol=1e-4)
    assert pressure.limits == ("pressure_13 at 0",)
    assert hybrid.forces.argmin() == 2
    assert hybrid.forces[2] < -0.5
    assert np.linalg.norm(hybrid.forces) < np.linalg.norm(forces)
