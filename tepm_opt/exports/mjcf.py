"""A model for MuJoCo: point masses on slide joints in the tracker's frame G, edges and muscles as spatial tendons.

A muscle is one tendon through its nodes: what pulls it together or pushes it apart acts alike on all its segments, as the model has it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree as Xml

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from tepm_opt.data.files import write_atomically
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.effect import Effect
from tepm_opt.models.effects import find_effect
from tepm_opt.models.layout import VERTICAL, Layout
from tepm_opt.models.model import Model
from tepm_opt.models.network import write_network
from tepm_opt.models.symbols import RAIL, SOFT, Writer
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.mechanics.step_limit import stable_step

STEP = 0.6
"""Time step over the largest at which RK4 is stable at rest: more pressure makes the robot stiffer."""
SAME = 1e-9
"""Relative difference of numbers that count as the same."""
REASONS: Mapping[str, str] = {
    "tendon_energy": "tendons that are springs themselves",
    "edge_drag": "edges with another damping than a linear one", "edge_memory": "edges that remember",
    "point_energy": "forces that depend on where a point is", "point_drag": "forces that depend on how a point moves",
    "pressure_memory": "pressures that remember", "tension_memory": "tensions that remember",
    "delay": "commands that act late", "outputs": "what the tracker shows, not what the robot does",
}  # fmt: skip
"""Reasons why MuJoCo's tendons, joints and motors cannot express an effect, by its hook."""
NO_SPRING, NOT_AFFINE = "edges that are no linear springs", "forces that are not a factor and an offset of their own inputs"
CHANGES = "what changes during a session"
_COLOURS = {VERTICAL: "0.16 0.38 0.62 1"}
_OTHER = "0.6 0.6 0.6 0.6"


@dataclass(frozen=True, eq=False)
class _Body:
    """A network in numbers, SI, base frame.

    Attributes:
        layout: its geometry.
        rows: properties by name, (rows, n), without inputs.
        by_inputs: what pressures and tensions add to the axial forces, (2, modules · actuators) in m² and 1.
    """

    layout: Layout
    rows: Mapping[str, np.ndarray]
    by_inputs: np.ndarray


def export_mjcf(model: CompiledModel, path: str | Path) -> dict[str, str]:
    """Write a model for MuJoCo; the effects that it does not have, by their labels, with the reason.

    Args:
        model: with its effects and parameters, which become numbers.
        path: of the file.

    Raises:
        InputError: the file cannot be written.
    """
    text, left_out = mjcf(model)
    write_atomically(path, text)
    return left_out


def mjcf(model: CompiledModel) -> tuple[str, dict[str, str]]:
    """A model as an MJCF document, and the effects that it does not have, by their labels, with the reason.

    Controls are u: pressures in Pa, then tensions in N. World is the tracker's frame G; nodes are the sites n<level>_<node>. A number
    array for each reference point holds the weights of the levels' centres in it.
    """
    kept, left_out = in_mujoco(model.model)
    body = _body(kept)
    assert isinstance(body, _Body)
    root = _document(model, body, left_out)
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode") + "\n", left_out


def in_mujoco(model: Model) -> tuple[Model, dict[str, str]]:
    """The part of a model that MuJoCo can express, and the effects that it cannot, by their labels, with the reason."""
    nominal, left_out = replace(model, effects=()), {}
    for effect in model.effects:
        reason = _reason(find_effect(effect.name), replace(nominal, effects=(effect,)))
        if reason is not None:
            left_out[effect.label] = reason
    kept = replace(model, effects=tuple(effect for effect in model.effects if effect.label not in left_out))
    together = _body(kept)
    if isinstance(together, str):  # each alone would do
        return nominal, left_out | {effect.label: together for effect in kept.effects}
    return kept, left_out


def _reason(kind: Effect, alone: Model) -> str | None:
    """Explain why MuJoCo cannot express an effect; None where it can."""
    for hook, reason in REASONS.items():
        if kind.has(hook):
            return reason
    if kind.timed:
        return CHANGES
    body = _body(alone)
    return body if isinstance(body, str) else None


def _body(model: Model) -> _Body | str:
    """The network in numbers; where properties, axial forces or springs are not as MuJoCo has them, why."""
    network, writer = write_network(model), Writer(model)
    layout, rows, levels = network.layout, network.property_rows, network.layout.levels
    theta = np.array([model.values.get(name, 0.0) for name in network.parameter_names])
    u = ca.SX.sym("u", layout.inputs)
    a = network.functions["input_map"](u, theta)
    columns = network.functions["properties"](a, np.zeros((3, layout.points)), theta)[0]
    if not ca.is_linear(ca.vec(columns), u):
        return NOT_AFFINE
    value, slope = (found.full() for found in ca.Function("at_rest", [u], [columns, ca.jacobian(ca.vec(columns), u)])(0))
    own = _of_muscles(slope.reshape(levels, -1, layout.inputs), rows["axial"], layout)  # CasADi counts column by column
    if own is None:
        return NOT_AFFINE
    springs, length, column = [], ca.SX.sym("length"), ca.SX.sym("column", len(value))
    for index, edge in enumerate(layout.edges):
        pull = ca.substitute(writer.edge_law(index, edge, column)(length)[1], column[rows["axial"]], ca.SX.zeros(layout.actuators))
        if not ca.is_linear(pull, length):
            return NO_SPRING
        springs.append(ca.vertcat(ca.jacobian(pull, length), ca.substitute(pull, length, 0)))
    found = ca.Function("springs", [column, writer.theta], [ca.horzcat(*springs)]).map(levels)(value, np.tile(theta[:, None], levels))
    stiffness, pull = np.moveaxis(found.full().reshape(2, levels, -1), -1, 1)
    if ((stiffness < 0) | ((stiffness == 0) & (pull != 0))).any():
        return NO_SPRING
    named = {name: value[of] for name, of in rows.items()}
    rest = np.where(stiffness > 0, -pull / np.where(stiffness > 0, stiffness, 1), named["rest"])
    return _Body(layout, {**named, "stiffness": stiffness, "rest": rest}, own)


def _of_muscles(slope: np.ndarray, axial: slice, layout: Layout) -> np.ndarray | None:
    """Extract slopes of axial forces by pressure and tension of their own muscle, (2, modules · actuators); None if others matter, too.

    Args:
        slope: of the properties by the inputs, (n, rows, inputs).
        axial: which rows are axial forces.
        layout: the network's geometry.
    """
    count, level, j = layout.inputs // 2, np.arange(layout.levels)[:, None], np.arange(layout.actuators)[None]
    expected, own = np.zeros_like(slope), np.zeros((2, count))
    for k in range(2):
        muscle = level // layout.segments * layout.actuators + j
        own[k, muscle] = slope[level, axial.start + j, k * count + muscle]
        expected[level, axial.start + j, k * count + muscle] = own[k, muscle]
    return own if np.allclose(slope, expected, rtol=SAME, atol=0) else None


def _document(model: CompiledModel, body: _Body, left_out: Mapping[str, str]) -> Xml.Element:
    mount, layout = model.robot.mount, body.layout
    root = Xml.Element("mujoco", model=model.robot.name)
    about = "".join(f"; without {label}: {reason}" for label, reason in left_out.items())
    root.append(Xml.Comment(f" Written by tepm_opt. SI units, world is the tracker's frame G{about} ".replace("--", "- -")))
    step = float(f"{STEP * stable_step(solve_statics(model, np.zeros(layout.inputs))):.2g}")
    option = _add(root, "option", timestep=step, gravity=mount.gravity_m_per_s2, integrator="RK4", jacobian="sparse")
    _add(option, "flag", contact="disable", constraint="disable")
    radius = model.values["r"]
    _add(_add(root, "default"), "site", size=0.1 * radius, rgba="0.2 0.2 0.2 1")
    custom = _add(root, "custom")
    for name, weights in zip(layout.point_names, layout.point_weights, strict=True):
        _add(custom, "numeric", name=name, data=weights)
    world = _add(root, "worldbody")
    _add(world, "light", pos="0 0 3")
    turn = Rotation.from_matrix(mount.rotation).as_quat(scalar_first=True)
    _nodes(_add(world, "body", name="base", pos=mount.base_position_m, quat=turn), model, body)
    tendons, motors = _add(root, "tendon"), _add(root, "actuator")
    _edges(tendons, body, 0.03 * radius)
    _muscles(tendons, motors, model, body)
    _loads(motors, model, body)
    return root


def _nodes(base: Xml.Element, model: CompiledModel, body: _Body) -> None:
    """Level 0 as sites of the base, all others as point masses that slide."""
    layout, values = body.layout, model.values
    rest = layout.rest_positions(values["r"], values["L_0"])
    rail = {"stiffness": RAIL * layout.segments * (values["K_a"] + SOFT), "damping": RAIL * layout.segments * values["c_a"]}
    for i, place in enumerate(rest[0]):
        _add(base, "site", name=f"n0_{i}", pos=place)
    for j in range(1, layout.levels + 1):
        mass = float(body.rows["mass"][0, j - 1])
        for i, place in enumerate(rest[j]):
            node = _add(base, "body", name=f"n{j}_{i}", pos=place)
            _add(node, "inertial", pos="0 0 0", mass=mass, diaginertia="1e-6 1e-6 1e-6")
            for axis, direction in zip("xyz", np.eye(3), strict=True):
                held = rail if layout.guided and axis != "z" else {}
                _add(node, "joint", name=f"n{j}_{i}_{axis}", type="slide", axis=direction, **held)
            _add(node, "site", name=f"n{j}_{i}")


def _edges(tendons: Xml.Element, body: _Body, width: float) -> None:
    """Springs and dampers."""
    for j in range(body.layout.levels):
        for k, edge in enumerate(body.layout.edges):
            stiffness, damping, rest = (float(body.rows[name][k, j]) for name in ("stiffness", "damping", "rest"))
            spring = _add(
                tendons, "spatial", name=f"e{j + 1}_{k}", stiffness=stiffness, damping=damping, springlength=rest, width=width,
                rgba=_COLOURS.get(edge.kind, _OTHER),
            )  # fmt: skip
            for level, node in (edge.a, edge.b):
                _add(spring, "site", site=f"n{j + level}_{node}")


def _muscles(tendons: Xml.Element, motors: Xml.Element, model: CompiledModel, body: _Body) -> None:
    """A tendon along every muscle, and its pressure and tension as motors; what pushes without inputs is the pressure's bias."""
    layout = body.layout
    for at, name in enumerate(layout.actuator_names):
        h, j = divmod(at, layout.actuators)
        muscle = _add(tendons, "spatial", name=f"muscle_{name}", width=1e-4)
        for level in range(h * layout.segments, (h + 1) * layout.segments + 1):
            _add(muscle, "site", site=f"n{level}_{j}")
    for which, kind in enumerate(("pressure", "tension")):
        for at, name in enumerate(layout.actuator_names):
            h, j = divmod(at, layout.actuators)
            push = float(body.rows["axial"][j, h * layout.segments]) if kind == "pressure" else 0.0
            highest = float(model.input_max[at + which * len(layout.actuator_names)])
            _add(
                motors, "general", name=f"{kind}_{name}", tendon=f"muscle_{name}", ctrllimited="true", ctrlrange=(0.0, highest),
                gainprm=float(body.by_inputs[which, at]), biastype="affine", biasprm=(push, 0.0, 0.0),
            )  # fmt: skip


def _loads(motors: Xml.Element, model: CompiledModel, body: _Body) -> None:
    """Constant forces on nodes beside their weight, as motors that ask for no control: behind all others."""
    mount, load, mass = model.robot.mount, body.rows["load"], body.rows["mass"]
    weight = np.outer(mount.rotation.T @ np.array(mount.gravity_m_per_s2), mass)
    for j, (force, heavy) in enumerate(zip((load - weight).T, np.abs(weight).max(axis=0), strict=True), start=1):
        for axis, component in zip("xyz", force, strict=True):
            if abs(component) <= SAME * max(heavy, 1e-6):
                continue
            for i in range(body.layout.actuators):
                joint = f"n{j}_{i}_{axis}"
                bias = (float(component), 0.0, 0.0)
                _add(motors, "general", name=f"load_{joint}", joint=joint, gainprm=0.0, biastype="affine", biasprm=bias)


def _add(parent: Xml.Element, tag: str, **attributes: str | float | Iterable[float]) -> Xml.Element:
    """A child with these attributes; numbers are written so that they read back equal."""
    return Xml.SubElement(parent, tag, {name: _text(value) for name, value in attributes.items()})


def _text(value: str | float | Iterable[float]) -> str:
    if isinstance(value, str):
        return value
    return repr(float(value)) if isinstance(value, int | float) else " ".join(repr(float(part)) for part in value)
