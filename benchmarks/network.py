"""The whole network as one SX expression, as a CasADi user would write it: independent of the package's segment kernels."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from tepm_opt.models.model import Model


@dataclass(frozen=True)
class WholeNetwork:
    """Symbols and expressions of a robot with three actuators and crossed bracing; base frame except for the tip.

    Attributes:
        x: coordinates of the free nodes, level by level.
        force: axial forces F_a, module-major.
        energy: potential Π in J.
        residual: its gradient by x in N.
        tip: tip in G.
        lengths: actuator lengths L_hj, module-major.
        v: velocities of the free nodes.
        acceleration: of the free nodes under springs, dampers, actuators and gravity.
    """

    x: ca.SX
    force: ca.SX
    energy: ca.SX
    residual: ca.SX
    tip: ca.SX
    lengths: ca.SX
    v: ca.SX
    acceleration: ca.SX


def _length(vector: ca.SX) -> ca.SX:
    return ca.sqrt(ca.sumsqr(vector))


def write_whole_network(model: Model) -> WholeNetwork:
    """Potential Π of SPEC section 2 for all segments at once, and half the power its dampers take."""
    robot, value = model.robot, model.values
    if robot.actuators != 3 or robot.geometry.bracing != "crossed":
        raise ValueError("the benchmark's network has three actuators a module and crossed bracing")
    per_module, modules = robot.geometry.segments_per_module, robot.modules
    levels, height = per_module * modules, value["L_0"] / per_module
    x, v, force = ca.SX.sym("x", 9 * levels), ca.SX.sym("v", 9 * levels), ca.SX.sym("force", 3 * modules)
    ring = [ca.DM([value["r"] * np.cos(angle), value["r"] * np.sin(angle), 0]) for angle in robot.angles]
    nodes = [ring] + [[x[9 * level + 3 * i : 9 * level + 3 * i + 3] for i in range(3)] for level in range(levels)]
    stiffness, damping, mass = per_module * value["K_a"], per_module * value["c_a"], value["m_d"] / (3 * per_module)
    side = value["r"] * np.sqrt(3)
    diagonal = np.hypot(side, height)
    energy, lengths = ca.SX(0), [ca.SX(0) for _ in range(3 * modules)]
    spans: list[ca.SX] = []
    dampers: list[float] = []
    gravity = robot.mount.rotation.T @ np.array(robot.mount.gravity_m_per_s2)
    for level in range(levels):
        lower, upper = nodes[level], nodes[level + 1]
        for i, j in ((0, 1), (1, 2), (2, 0)):
            actuator, span = 3 * (level // per_module) + i, _length(upper[i] - lower[i])
            lengths[actuator] += span
            ring_span, crossed = _length(upper[i] - upper[j]), [_length(upper[b] - lower[a]) for a, b in ((i, j), (j, i))]
            energy += stiffness / 2 * (span - height) ** 2 - force[actuator] * span
            energy += value["alpha_1"] * stiffness / 2 * (ring_span - side) ** 2
            for diagonal_span in crossed:
                energy += value["alpha_2"] * stiffness / 2 * (diagonal_span - diagonal) ** 2
            energy -= mass * ca.dot(ca.DM(gravity), upper[i])
            spans += [span, ring_span, *crossed]
            dampers += [damping, value["beta_1"] * damping, *2 * [value["beta_2"] * damping]]
    tip = ca.mtimes(ca.DM(robot.mount.rotation), sum(nodes[-1]) / 3) + ca.DM(list(robot.mount.base_position_m))
    residual, rates = ca.gradient(energy, x), ca.jtimes(ca.vertcat(*spans), x, v)
    drag = ca.gradient(ca.dot(ca.DM(dampers), rates**2) / 2, v)
    return WholeNetwork(x, force, energy, residual, tip, ca.vertcat(*lengths), v, -(residual + drag) / mass)
