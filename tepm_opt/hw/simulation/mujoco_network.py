"""The network of SPEC section 2 in MuJoCo: point masses on slide joints, spatial tendons, RK4.

MuJoCo's implicit integrators take the tendons' damping without its geometry and so change the sway (measured: 1.10 s becomes 1.40 s), which
is why RK4 is the only choice here. A motor on every vertical tendon pushes its ends apart. The motors integrate their control, so a force
that is linear in time costs one call however many steps it lasts.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from tepm_opt.hw.simulation.imperfections.base import Body
from tepm_opt.models.layout import HORIZONTAL, VERTICAL

_COLOURS = {VERTICAL: "0.16 0.38 0.62 1", HORIZONTAL: "0.45 0.45 0.45 1"}
_OTHER = "0.75 0.75 0.75 0.6"
_AXES = ("1 0 0", "0 1 0", "0 0 1")


class MujocoNetwork:
    """A network that moves; base frame, SI.

    Args:
        body: the network in numbers.
        step: of RK4 in s.

    Attributes:
        model, data: MuJoCo's own.
        rest: nodes at rest, (n + 1, actuators, 3) in m.
    """

    def __init__(self, body: Body, step: float) -> None:
        import mujoco

        self._engine: Any = mujoco
        self.body, self.layout = body, body.layout
        self.rest = body.layout.rest_positions(body.robot.parameters.r, body.robot.parameters.L_0)
        self.model: Any = self._engine.MjModel.from_xml_string(network_xml(body, step))
        self.data: Any = self._engine.MjData(self.model)
        self.count = self.layout.modules * self.layout.actuators
        self._weights = body.layout.point_weights[:, 1:] / body.layout.actuators
        muscles = np.arange(self.count).reshape(self.layout.modules, 1, -1)
        self._muscle = np.repeat(muscles, self.layout.segments, axis=1).ravel()
        self._loaded = np.full((self.layout.points, 3), np.nan)
        self._rest_spans = np.diff(self.rest, axis=0)
        self._turn = body.robot.mount.rotation
        self._base = np.array(body.robot.mount.base_position_m, dtype=float)

    def advance(self, steps: int) -> None:
        """Move on by whole steps; the motors' forces change at their slopes."""
        self._engine.mj_step(self.model, self.data, steps)

    def drive(self, axial: np.ndarray, edges: np.ndarray | None, duration: float) -> None:
        """Forces for the coming steps, linear in time.

        Args:
            axial: F_a of the actuators at the start and the end, (2, modules · actuators) in N.
            edges: forces that push the vertical edges apart, (2, n, actuators) in N.
            duration: between start and end in s.
        """
        push = self._push(axial, edges)
        self.data.act[:] = push[0]
        self.data.ctrl[:] = (push[1] - push[0]) / duration

    def _push(self, axial: np.ndarray, edges: np.ndarray | None) -> np.ndarray:
        """Force of every motor, level by level, (…, n · actuators) in N."""
        push = axial[..., self._muscle]
        return push if edges is None else push + edges.reshape(push.shape)

    def load(self, forces: np.ndarray) -> None:
        """Set the forces on the reference points in G, (points, 3) in N; the body's constant load is added.

        The nodes of a point's levels share its force; the base takes what falls on level 0.
        """
        if np.array_equal(forces, self._loaded):
            return
        self._loaded = forces
        levels = self._weights.T @ (forces + self.body.load) @ self._turn
        self.data.qfrc_applied[:] = np.repeat(levels[:, None], self.layout.actuators, axis=1).ravel()

    @property
    def finite(self) -> bool:
        """Whether the simulation has not diverged."""
        return bool(np.isfinite(self.data.qpos).all() and np.abs(self.data.qpos).max() < 100 * self.body.robot.parameters.L_0)

    @property
    def nodes(self) -> np.ndarray:
        """All nodes, (n + 1, actuators, 3) in m."""
        nodes = self.rest.copy()
        nodes[1:] += self.data.qpos.reshape(self.layout.levels, self.layout.actuators, 3)
        return nodes

    def points(self, nodes: np.ndarray) -> np.ndarray:
        """Reference points in the frame G of nodes in the base frame, (points, 3) in m."""
        return self.in_tracker_frame(self.layout.point_weights @ nodes.mean(axis=1))

    def in_tracker_frame(self, positions: np.ndarray) -> np.ndarray:
        """Positions (…, 3) in m from the base frame to G."""
        return positions @ self._turn.T + self._base

    def verticals(self) -> tuple[np.ndarray, np.ndarray]:
        """Lengths and rates of the vertical edges, (n, actuators) each in m and m/s."""
        shape = (self.layout.levels, self.layout.actuators, 3)
        span, motion = self.data.qpos.reshape(shape).copy(), self.data.qvel.reshape(shape).copy()
        span[1:] -= span[:-1].copy()
        motion[1:] -= motion[:-1].copy()
        span += self._rest_spans
        length = np.sqrt(np.einsum("jik,jik->ji", span, span))
        return length, np.einsum("jik,jik->ji", span, motion) / length

    def of_actuators(self, edges: np.ndarray) -> np.ndarray:
        """Sums over the vertical edges (n, actuators) of each actuator, (modules · actuators,)."""
        return edges.reshape(self.layout.modules, self.layout.segments, -1).sum(axis=1).ravel()

    def force_at_rest(self, position: np.ndarray, axial: np.ndarray, edges: np.ndarray | None) -> np.ndarray:
        """Net force on all free coordinates, (3 n actuators,) in N, of a network that stands still, as MuJoCo computes it.

        Args:
            position: displacements from the rest geometry, (3 n actuators,) in m.
            axial, edges: forces of the motors as in `drive`, without the first axis.
        """
        self.data.qpos[:] = position
        self.data.qvel[:] = 0.0
        self.data.act[:] = self._push(axial, edges)
        self.data.ctrl[:] = 0.0
        self._engine.mj_forward(self.model, self.data)
        return self.data.qfrc_smooth.copy()


def network_xml(body: Body, step: float) -> str:
    """The network as an MJCF document; sizes of spheres and lines are for rendering only."""
    return "\n".join(_lines(body, step))


def _lines(body: Body, step: float) -> Iterator[str]:
    layout, value = body.layout, body.robot.parameters
    nodes = layout.rest_positions(value.r, value.L_0)
    size = 0.1 * value.r
    yield '<mujoco model="tepm">'
    yield f'<option timestep="{step!r}" gravity="{_text(body.gravity)}" integrator="RK4" jacobian="sparse">'
    yield '<flag contact="disable" constraint="disable" autoreset="disable"/></option>'
    yield f'<default><site type="sphere" size="{size!r}" rgba="0.2 0.2 0.2 1"/></default>'
    yield '<visual><global offwidth="1280" offheight="960"/><headlight ambient="0.5 0.5 0.5"/></visual>'
    yield '<asset><texture type="skybox" builtin="flat" rgb1="1 1 1" width="8" height="8"/></asset>'
    yield "<worldbody>"
    for i, position in enumerate(nodes[0]):
        yield f'<site name="n0_{i}" pos="{_text(position)}"/>'
    for j in range(1, layout.levels + 1):
        for i, position in enumerate(nodes[j]):
            slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in _AXES)
            inertia = f'<inertial pos="0 0 0" mass="{float(body.mass[j - 1, i])!r}" diaginertia="1e-6 1e-6 1e-6"/>'
            yield f'<body pos="{_text(position)}">{inertia}{slides}<site name="n{j}_{i}"/></body>'
    yield "</worldbody>"
    yield "<tendon>"
    yield from _springs(body)
    yield "</tendon>"
    yield "<actuator>"
    for j in range(1, layout.levels + 1):
        for i in range(layout.actuators):
            yield f'<general tendon="e{j}_{i}" dyntype="integrator" gaintype="fixed" gainprm="1" biastype="none"/>'
    yield "</actuator>"
    yield "</mujoco>"


def _springs(body: Body) -> Iterator[str]:
    width = 0.03 * body.robot.parameters.r
    for j in range(1, body.layout.levels + 1):
        for k, edge in enumerate(body.layout.edges):
            stiffness, damping, rest = (float(of[j - 1, k]) for of in (body.stiffness, body.damping, body.rest))
            colour = _COLOURS.get(edge.kind, _OTHER)
            law = f'stiffness="{stiffness!r}" damping="{damping!r}" springlength="{rest!r}"'
            thick = width * (3 if edge.kind == VERTICAL else 1)
            sites = "".join(f'<site site="n{j - 1 + level}_{node}"/>' for level, node in (edge.a, edge.b))
            yield f'<spatial name="e{j}_{k}" {law} width="{thick!r}" rgba="{colour}">{sites}</spatial>'


def _text(vector: np.ndarray) -> str:
    return " ".join(repr(float(component)) for component in vector)
