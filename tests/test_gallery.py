"""The gallery's robots: set points and G against the other engine at rest, a while on the simulated rig, the chain without data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tepm_opt.hw.registry import open_rig
from tepm_opt.hw.rig import Command
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import compile_model
from tepm_opt.models.robot import builtin_robots, load_robot
from tepm_opt.solvers.kinematics.ik import solve_ik
from tepm_opt.solvers.linear.gain import solve_gain
from tepm_opt.solvers.linear.modes import modes
from tepm_opt.solvers.linear.state_space import linearise
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.planning.scaled_paths import path_for
from tests.study_gallery import GALLERY, steered


def rested(rig: str, name: str, inputs: np.ndarray) -> np.ndarray:
    """True tip in m where a rig rests under inputs."""
    found = open_rig(rig, load_robot(name))
    found.apply(Command.from_inputs(inputs))
    assert found.simulated is not None
    return found.simulated.true_points[-1]


@pytest.mark.slow
@pytest.mark.parametrize("name", GALLERY)
def test_set_points_and_gain_hold_on_the_other_engine(name: str) -> None:
    """MuJoCo's network, which shares nothing with the model, rests on the circle under the set points, and moves as G says."""
    model = compile_model(name, "python")
    target = path_for(model, "circle", points=3).positions[1]
    found = solve_ik(model, target)
    assert found.solved
    inputs = found.allocation.inputs
    assert rested("sim:perfect@mujoco", name, inputs) == pytest.approx(target, abs=1e-6)
    change = np.zeros(len(inputs))
    change[-1] = 0.01 * model.input_max[-1] * (1 if inputs[-1] < 0.5 * model.input_max[-1] else -1)
    moved = rested("sim:perfect@mujoco", name, inputs + change) - target
    foreseen = solve_gain(solve_statics(model, inputs)).matrix @ change
    assert np.linalg.norm(moved - foreseen) < 0.05 * np.linalg.norm(foreseen)


@pytest.mark.slow
@pytest.mark.parametrize("name", GALLERY)
def test_a_while_on_the_simulated_rig(name: str) -> None:
    """The prototype of the robot moves under a quarter of the pressure of one muscle and stays where an arm of its length can be."""
    robot = load_robot(name)
    rig = open_rig("sim@mujoco", robot)
    half = robot.modules * robot.actuators
    before = rig.read().points[-1]
    rig.apply(Command.from_inputs(np.append(0.25 * robot.actuation.pressure_max_Pa * np.eye(half)[0], np.zeros(half))))
    sample = [rig.read() for _ in range(60)][-1]
    assert (rig.robot.name, len(sample.points)) == (name, 2 * robot.modules)
    assert 0.02 < np.linalg.norm(sample.points[-1] - before) / (robot.modules * robot.parameters.L_0) < 1.5


@pytest.mark.slow
def test_quickness_follows_the_sway() -> None:
    """What the check of data allows of speed goes by a rough formula: within a factor of two of what the linearised network says."""
    sway = {}
    for name in builtin_robots():
        model = compile_model(name, "python")
        sway[name] = next(
            mode.frequency for mode in modes(linearise(solve_statics(model, np.zeros(model.layout.inputs)))) if mode.oscillates
        )
    for name, frequency in sway.items():
        assert channels_of(load_robot(name)).quickness == pytest.approx(frequency / sway["kang2017"], rel=1.0), name
    assert channels_of(load_robot("one_module")).quickness > 5


@pytest.mark.slow
@pytest.mark.parametrize("name", GALLERY)
def test_the_chain_without_data(name: str, tmp_path: Path) -> None:
    """Every point in reach, a plan, and the closed loop within a hundredth of the arm's length."""
    told, robot = steered(name, tmp_path), load_robot(name)
    assert told["solved"] == "32 of 32"
    assert 0.05 < told["plan"] < 3.0
    assert max(told["mpc"].values()) < 10 * robot.modules * robot.parameters.L_0
