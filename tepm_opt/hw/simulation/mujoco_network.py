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
from tepm_opt.hw.simulation.network import Network
from tepm_opt.models.layout import HORIZONTAL, VERTICAL

_COLOURS = {VERTICAL: "0.16 0.38 0.62 1", HORIZONTAL: "0.45 0.45 0.45 1"}
_OTHER = "0.75 0.75 0.75 0.6"
_AXES = ("1 0 0", "0 1 0", "0 0 1")


def _unwritten(text: str) -> None:
    """Keep a warning of MuJoCo's from being written to MUJOCO_LOG.TXT in the working folder: `finite` tells what it would say."""


class MujocoNetwork(Network):
    """A network that moves in MuJoCo; see `Network`.

    Attributes:
        model, data: MuJoCo's own.
    """

    def __init__(self, body: Body, step: float) -> None:
        import mujoco

        super().__init__(body, step)
        self._engine: Any = mujoco
        mujoco.set_mju_user_warning(_unwritten)  # type: ignore[attr-defined]
        self.model: Any = self._engine.MjModel.from_xml_string(network_xml(body, step))
        self.data: Any = self._engine.MjData(self.model)
        self._weights = body.layout.point_weights[:, 1:] / body.layout.actuators
        self._loaded = np.full((self.layout.points, 3), np.nan)

    def advance(self, steps: int) -> None:
        """Move on by whole steps; the motors' forces change at their slopes."""
        self._engine.mj_step(self.model, self.data, steps)

    def drive(self, push: np.ndarray, duration: float) -> None:
        """Set the motors' forces for the coming steps, linear in time.

        Args:
            push: at the start and the end, (2, n, actuators) in N.
            duration: between start and end in s.
        """
        self.data.act[:] = push[0].ravel()
        self.data.ctrl[:] = ((push[1] - push[0]) / duration).ravel()

    def load(self, forces: np.ndarray) -> None:
        """See `Network`."""
        if np.array_equal(forces, self._loaded):
            return
        self._loaded = forces
        levels = self._weights.T @ (forces + self.body.load) @ self.turn
        self.data.qfrc_applied[:] = np.repeat(levels[:, None], self.layout.actuators, axis=1).ravel()

    def fall(self, gravity: np.ndarray) -> None:
        """Set the acceleration of what is free, (3,) in m/s²."""
        self.model.opt.gravity[:] = gravity

    @property
    def finite(self) -> bool:
        """Whether the simulation has not diverged."""
        return bool(np.abs(self.data.qpos).max() < self.bound)  # no where it is not a number

    @property
    def nodes(self) -> np.ndarray:
        """See `Network`."""
        nodes = self.rest.copy()
        nodes[1:] += self.data.qpos.reshape(self.layout.levels, self.layout.actuators, 3)
        return nodes

    @property
    def velocities(self) -> np.ndarray:
        """See `Network`."""
        velocities = np.zeros_like(self.rest)
        velocities[1:] = self.data.qvel.reshape(self.layout.levels, self.layout.actuators, 3)
        return velocities

    def place(self, position: np.ndarray) -> None:
        """See `Network`."""
        self.data.qpos[:], self.data.qvel[:] = position, 0.0
        self._engine.mj_forward(self.model, self.data)

    def forces_at_rest(self, positions: np.ndarray, push: np.ndarray) -> np.ndarray:
        """See `Network`; as MuJoCo computes them."""
        forces = np.empty_like(positions)
        self.data.ctrl[:] = 0.0
        for force, position, motors in zip(forces, positions, push, strict=True):
            self.data.act[:] = motors.ravel()
            self.place(position)
            force[:] = self.data.qfrc_smooth
        return forces


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
