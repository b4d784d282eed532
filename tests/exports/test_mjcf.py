"""The robot in MuJoCo: where MuJoCo's own forces balance is where our statics say; effects are in it, or told."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from tepm_opt.exports.mjcf import export_mjcf, in_mujoco, mjcf
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.effects import effects
from tepm_opt.models.robot import robot_text
from tepm_opt.solvers.linear.modes import state_matrix
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_statics
from tepm_opt.solvers.mechanics.step_limit import rk4_step_limit


def settled(path: Path, at: Equilibrium, tip_force: np.ndarray) -> np.ndarray:
    """Reference points in G where MuJoCo's forces balance, (points, 3), by Newton's method with differences of these forces.

    Args:
        path: of the model.
        at: an equilibrium of ours, near which it begins.
        tip_force: in G.
    """
    model, layout = mujoco.MjModel.from_xml_path(str(path)), at.model.layout
    data = mujoco.MjData(model)
    data.ctrl[: layout.inputs] = at.inputs
    weights = layout.point_weights[-1, 1:] / layout.actuators
    for level, weight in enumerate(weights, start=1):
        for node in range(layout.actuators):
            data.body(f"n{level}_{node}").xfrc_applied[:3] = weight * tip_force

    def force(q: np.ndarray) -> np.ndarray:
        data.qpos[:], data.qvel[:] = q, 0.0
        mujoco.mj_forward(model, data)
        return data.qfrc_smooth.copy()

    rest = layout.rest_positions(at.model.values["r"], at.model.values["L_0"])
    q = (at.nodes - rest)[1:].ravel() + np.random.default_rng(0).normal(0, 1e-4, model.nq)
    for _ in range(20):
        slope = np.array([(force(q + 1e-6 * e) - force(q - 1e-6 * e)) / 2e-6 for e in np.eye(model.nq)]).T
        step = np.linalg.solve(slope, -force(q))
        q = q + step
        if np.abs(step).max() < 1e-11:
            break
    force(q)
    sites = np.array([[data.site(f"n{j}_{i}").xpos for i in range(layout.actuators)] for j in range(layout.levels + 1)])
    return np.array([model.numeric(name).data for name in layout.point_names]) @ sites.mean(axis=1)


def check(model: CompiledModel, path: Path, tip_force: list[float]) -> None:
    """Statics of a file against ours, to 1e-6."""
    assert export_mjcf(model, path) == {}
    inputs = 0.4 * np.random.default_rng(3).uniform(size=model.layout.inputs) * model.input_max
    at = solve_statics(model, inputs, tip_force)
    assert at.solved
    found = settled(path, at, np.array(tip_force))
    assert np.abs(found - at.points).max() < 1e-6 * np.abs(at.points).max()


def test_statics_of_the_robot(kang: CompiledModel, tmp_path: Path) -> None:
    check(kang, tmp_path / "robot.xml", [0.4, -0.2, 0.1])


@pytest.mark.slow
def test_statics_with_every_effect_that_is_in_it(kang: CompiledModel, tmp_path: Path) -> None:
    """At once; each of them moves the tip."""
    every = kang.model
    for effect in effects():
        every = every.with_effect(effect.name, {None: None, "actuator": "12", "point": "s2"}[effect.detail])
    chosen, left_out = in_mujoco(every)
    assert len(chosen.effects) >= 8
    assert len(left_out) == len(every.effects) - len(chosen.effects)
    check(compile_model(chosen, backend="python"), tmp_path / "robot.xml", [0.0, 0.1, 0.0])


def test_another_robot_on_a_slanted_mount(tmp_path: Path) -> None:
    """One module of three segments, hanging askew: reference points between levels, and frames that differ."""
    text = robot_text("kang2017").replace("modules = 2", "modules = 1").replace("segments_per_module = 6", "segments_per_module = 3")
    text = text.replace("base_rotation_deg = [0, 0, 0]", "base_rotation_deg = [150, 20, 10]")
    assert "[150, 20, 10]" in text
    (tmp_path / "lab.toml").write_text(text, encoding="utf-8")
    check(compile_model(tmp_path / "lab.toml", backend="python"), tmp_path / "robot.xml", [0.2, 0.0, 0.0])


@pytest.mark.slow
def test_what_mujoco_cannot_express_is_told(kang: CompiledModel) -> None:
    """Whatever acts on motion, time, the tracker or in another form is left out, and the file is as without it."""
    kinds = [effect for effect in effects() if any(effect.has(hook) for hook in ("edge_memory", "pressure_memory", "delay", "outputs"))]
    assert len(kinds) >= 8
    plain = mjcf(kang)[0]
    for kind in (kinds[0], kinds[-1], next(effect for effect in effects() if effect.timed)):
        detail = {None: None, "actuator": "12", "point": "s2"}[kind.detail]
        text, left_out = mjcf(compile_model(kang.model.with_effect(kind.name, detail), backend="python"))
        assert len(left_out) == 1
        assert next(iter(left_out)) in text
        without = [line for line in text.splitlines() if "Written by" not in line]
        assert without == [line for line in plain.splitlines() if "Written by" not in line]


@pytest.mark.slow
def test_the_motion_is_stable_and_swings_as_ours(kang: CompiledModel, tmp_path: Path) -> None:
    """Released 10 mm aside, the tip swings with the period of the slowest mode (SPEC section 2: 5.642 rad/s)."""
    export_mjcf(kang, tmp_path / "robot.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    data = mujoco.MjData(model)
    at, aside = solve_statics(kang, np.zeros(12)), solve_statics(kang, np.zeros(12), [0.015, 0, 0])
    assert model.opt.timestep < rk4_step_limit(np.linalg.eigvals(state_matrix(at)))
    rest = kang.layout.rest_positions(kang.values["r"], kang.values["L_0"])
    data.qpos[:] = (aside.nodes - rest)[1:].ravel()
    mujoco.mj_forward(model, data)
    tips = []
    for _ in range(int(1.5 * 2 * np.pi / 5.642 / model.opt.timestep)):
        mujoco.mj_step(model, data)
        tips.append(np.mean([data.site(f"n12_{i}").xpos[0] for i in range(3)]) - at.tip[0])
    signs = np.flatnonzero(np.diff(np.sign(tips)))
    assert (signs[1] - signs[0]) * model.opt.timestep == pytest.approx(np.pi / 5.642, rel=0.01)
