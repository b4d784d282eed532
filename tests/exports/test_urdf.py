"""The URDF, read by its own rules: at rest its links end where the network's reference points are, and at joint states where points are."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tepm_opt.exports.urdf import export_urdf
from tepm_opt.hw.ros.joints import RodChain
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import builtin_robots, load_robot
from tepm_opt.solvers.mechanics.statics import solve_statics


def numbers(element: Xml.Element | None, name: str) -> np.ndarray:
    """An attribute, (3,)."""
    assert element is not None
    return np.array(element.attrib[name].split(), dtype=float)


def places(root: Xml.Element, joints: dict[str, float]) -> dict[str, np.ndarray]:
    """Poses of all links in the root link's frame, (4, 4), by the rules of URDF: rpy about fixed axes, then the joint's motion."""
    found = {"tracker": np.eye(4)}
    for joint in root.iter("joint"):  # parents come first
        origin, parent, child, axis = (joint.find(tag) for tag in ("origin", "parent", "child", "axis"))
        assert parent is not None
        assert child is not None
        fixed, moved, value = np.eye(4), np.eye(4), joints.get(joint.attrib["name"], 0.0)
        roll, pitch, yaw = numbers(origin, "rpy")
        fixed[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        fixed[:3, 3] = numbers(origin, "xyz")
        if joint.attrib["type"] == "prismatic":
            moved[:3, 3] = value * numbers(axis, "xyz")
        elif joint.attrib["type"] == "revolute":
            moved[:3, :3] = Rotation.from_rotvec(value * numbers(axis, "xyz")).as_matrix()
        found[child.attrib["link"]] = found[parent.attrib["link"]] @ fixed @ moved
    return found


@pytest.mark.parametrize("name", builtin_robots())
def test_at_rest_links_end_at_the_reference_points(name: str, tmp_path: Path) -> None:
    """Joints at zero; each link is the child of one joint, and cylinders end at the next link."""
    robot, path = load_robot(name), tmp_path / "robot.urdf"
    export_urdf(robot, path)
    root, layout = Xml.parse(path).getroot(), Layout.from_robot(robot)
    nodes = layout.rest_positions(robot.parameters.r, robot.parameters.L_0) @ robot.mount.rotation.T + robot.mount.base_position_m
    rest = np.einsum("pl,lac->pc", layout.point_weights, nodes) / robot.actuators
    found = places(root, {})
    np.testing.assert_allclose([found[point][:3, 3] for point in layout.point_names], rest, atol=1e-9)
    children = [child.attrib["link"] for child in root.iter("child")]
    assert sorted([*children, "tracker"]) == sorted(link.attrib["name"] for link in root.iter("link"))
    lengths = [float(cylinder.attrib["length"]) for cylinder in root.iter("cylinder")]
    np.testing.assert_allclose(
        lengths, np.diff(rest @ robot.mount.rotation[:, 2], prepend=robot.mount.rotation[:, 2] @ robot.mount.base_position_m)
    )


def test_joint_states_put_links_at_the_points_of_a_bent_arm(kang: CompiledModel, tmp_path: Path) -> None:
    """An equilibrium far from rest, a straight arm turned over, and noise."""
    path, chain = tmp_path / "robot.urdf", RodChain(kang.robot)
    export_urdf(kang.robot, path)
    root = Xml.parse(path).getroot()
    bent = solve_statics(kang, np.array([2e5, 0, 0, 0, 1.5e5, 0, *np.zeros(6)])).points
    turned = np.asarray(kang.robot.mount.base_position_m) + np.array([[0, 0, 0.1], [0, 0, 0.2], [0.01, 0, 0.3], [0, 0.02, 0.4]])
    for points in (bent, turned, bent + 0.05 * np.random.default_rng(1).normal(size=bent.shape)):
        states = dict(zip(chain.joints, chain.positions(points).tolist(), strict=True))
        assert set(states) == {joint.attrib["name"] for joint in root.iter("joint") if joint.attrib["type"] != "fixed"}
        found = places(root, states)
        np.testing.assert_allclose([found[point][:3, 3] for point in chain.points], points, atol=1e-9)


def test_from_a_lost_point_on_joints_are_unknown(kang: CompiledModel) -> None:
    """Those before it are known."""
    points = np.ones((4, 3)) * np.arange(1, 5)[:, None]
    points[2] = np.nan
    found = RodChain(kang.robot).positions(points)
    assert np.isfinite(found[:6]).all()
    assert np.isnan(found[6:9]).all()
