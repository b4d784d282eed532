"""The robot in a world that is not ours: bodies, cables, actuators, dry friction, stops, contacts and the integrator are MuJoCo's.

Only the geometry, masses and springs of the network are the same. A muscle is one cable through its nodes that two actuators act on: the
bladder pushes its ends apart, the motor pulls them together. Semi-implicit Euler moves the bodies, as MuJoCo solves constraints in it.
"""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.equilibrium import find_equilibrium
from tepm_opt.hw.simulation.mujoco_network import network_xml
from tepm_opt.models.robot import Robot
from tepm_opt.studies.blind.causes import MUSCLES
from tepm_opt.studies.blind.machine import Deviation
from tepm_opt.studies.blind.world import World

SETTLING = 4.0  # s for friction, stops and contacts before a run


def load_mujoco() -> Any:
    """The package `mujoco`, whose stubs lack most of its names; loaded only where a trial needs it.

    Raises:
        InputError: it is too old for delays of actuators or polynomial stiffness.
    """
    import mujoco

    if not all(hasattr(mujoco.MjModel, name) for name in ("actuator_delay", "tendon_stiffnesspoly")):  # type: ignore[attr-defined]
        raise InputError(f"family 'engine': mujoco {version('mujoco')} has no delays of actuators; valid: 4.0 and newer")
    return mujoco


class MujocoWorld(World):
    """A robot in MuJoCo, with changes of its document.

    Args:
        robot: as its file says.
        machine: factors of the parameters, and what changes MuJoCo's document.

    Attributes:
        model, data: MuJoCo's own.
    """

    name = "MuJoCo"
    step = 1e-4  # s; Euler's method bears 0.13 ms but not 0.17 ms, and at this step errs by less than 0.01 mm
    tick = 40  # 4 ms

    def __init__(self, robot: Robot, machine: Deviation) -> None:
        super().__init__(robot, machine)
        self._engine = mujoco = load_mujoco()
        mujoco.set_mju_user_warning(lambda text: None)
        spec = mujoco.MjSpec.from_string(network_xml(self.body, self.step))
        self._equip(spec)
        if machine.build is not None:
            machine.build(spec, self.body)
        self.model = spec.compile()
        self.data: Any = mujoco.MjData(self.model)
        layout = self.body.layout
        self._rest = layout.rest_positions(self.body.robot.parameters.r, self.body.robot.parameters.L_0)
        self._tip = [spec.body(f"b{layout.levels}_{i}").id for i in range(layout.actuators)]
        self._free = 3 * layout.levels * layout.actuators

    def _equip(self, spec: Any) -> None:
        """Replace the network's motors by a bladder and a tendon's motor a muscle, and let MuJoCo solve constraints."""
        engine, layout = self._engine, self.body.layout
        spec.option.integrator = engine.mjtIntegrator.mjINT_EULER
        spec.option.disableflags = int(engine.mjtDisableBit.mjDSBL_AUTORESET)
        for actuator in list(spec.actuators):
            spec.delete(actuator)
        for site in spec.sites:
            if not site.name.startswith("n0_"):
                site.parent.name = f"b{site.name[1:]}"
        area = self.body.robot.parameters.A
        for k, name in enumerate(MUSCLES):
            module, node = divmod(k, layout.actuators)
            cable = spec.add_tendon(name=f"muscle_{name}")
            for level in range(layout.segments + 1):
                cable.wrap_site(f"n{module * layout.segments + level}_{node}")
        for kind, gain in (("pressure", area), ("tension", -1.0)):
            for name in MUSCLES:
                spec.add_actuator(
                    name=f"{kind}_{name}",
                    target=f"muscle_{name}",
                    trntype=engine.mjtTrn.mjTRN_TENDON,
                    gaintype=engine.mjtGain.mjGAIN_FIXED,
                    gainprm=[gain] + [0.0] * 9,
                    biastype=engine.mjtBias.mjBIAS_AFFINE,
                )

    def settle(self, inputs: np.ndarray, force: np.ndarray) -> None:
        """Come to rest under constant inputs (12,) in Pa and N and a tip force (3,) in N: without friction first, then with it."""
        engine, model, data = self._engine, self.model, self.data
        engine.mj_resetData(model, data)
        self._command(inputs, force)
        self._fill(inputs)

        def forces(positions: np.ndarray) -> np.ndarray:
            found = np.empty((len(positions), self._free))
            for row, position in zip(found, positions, strict=True):
                data.qpos[: self._free] = position
                data.qvel[:] = 0.0
                engine.mj_forward(model, data)
                row[:] = data.qfrc_smooth[: self._free]
            return found

        position = find_equilibrium(forces, np.zeros(self._free))
        forces(position[None])
        if data.nefc > data.nf or model.nv > self._free:  # stops, contacts and further bodies have an equilibrium of their own
            self._advance(round(SETTLING / self.step))
            data.time = 0.0

    def _fill(self, inputs: np.ndarray) -> None:
        """Let filters and delays of actuators stand at their inputs."""
        for k, at in enumerate(self.model.actuator_actadr):
            if at >= 0:
                self.data.act[at] = inputs[k]
            if self.model.actuator_delay[k] > 0:
                count = self.model.actuator_history[k, 0]
                times = -self.model.opt.timestep * np.arange(count, 0, -1.0)
                self._engine.mj_initCtrlHistory(self.model, self.data, k, times, np.full(count, inputs[k]))

    def _command(self, inputs: np.ndarray, force: np.ndarray) -> None:
        self.data.ctrl[:] = inputs
        self.data.xfrc_applied[self._tip, :3] = (force + self.body.load[-1]) @ self.body.robot.mount.rotation / len(self._tip)

    def _advance(self, steps: int) -> None:
        self._engine.mj_step(self.model, self.data, steps)

    def _measure_reach(self) -> float:
        return float(np.abs(self.data.qpos).max())

    def _locate_points(self) -> np.ndarray:
        layout, mount = self.body.layout, self.body.robot.mount
        nodes = self._rest.copy()
        nodes[1:] += self.data.qpos[: self._free].reshape(layout.levels, layout.actuators, 3)
        return layout.point_weights @ nodes.mean(axis=1) @ mount.rotation.T + np.array(mount.base_position_m)
