"""The robot as one Cosserat rod that PyElastica moves, so that neither the body nor the integrator is ours.

The rod has the network's properties per length: inertia of its nodes, elasticity of its unit cell, and muscles at their places in the
section. A first element below the base is held; the others reach from ring to ring.
"""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from tepm_opt.hw.simulation.equilibrium import NoEquilibriumError
from tepm_opt.hw.trackers.receiver import require_package
from tepm_opt.models.robot import Robot
from tepm_opt.studies.blind import rod_kernel
from tepm_opt.studies.blind.excitation import COUNT
from tepm_opt.studies.blind.machine import Deviation
from tepm_opt.studies.blind.rod_design import ActuatorLine, RodDesign
from tepm_opt.studies.blind.rod_kernel import Material, RodArrays
from tepm_opt.studies.blind.rod_section import UnitCell
from tepm_opt.studies.blind.world import World

SLOWER = 0.99  # of all velocities every ten steps while the rod comes to rest, which damps its sway about critically
RESTING = 1e-6  # m/s, from which it is at rest, less than 1 µm from where it goes
ROUNDS = 6000  # of ten steps until it has to be at rest
WALL = {"k": 2e3, "nu": 2.0}  # N/m and N s/m of a node


@cache
def load_elastica() -> SimpleNamespace:
    """PyElastica (`package`), a class of its simulators (`simulator`) and the functions of `rod_kernel`, compiled (`kernels`).

    Raises:
        InputError: PyElastica is not installed.
    """
    package, numba = (require_package(name, "rod", "family 'rod'") for name in ("elastica", "numba"))
    parts = (package.BaseSystemCollection, package.Forcing, package.Constraints, package.Contact)
    kernels = (rod_kernel.find_active_stress, rod_kernel.set_element_law, rod_kernel.set_node_law)
    return SimpleNamespace(package=package, simulator=type("Simulator", parts, {}), kernels=tuple(map(numba.njit, kernels)))


class RodWorld(World):
    """A robot in PyElastica, with changes of its design.

    Args:
        robot: as its file says.
        machine: factors of the parameters, and what changes the design.

    Attributes:
        design: what was built.
        rod: PyElastica's own.
    """

    name = "PyElastica"
    step = 1.25e-4  # s; damping is explicit: with most of it the rod bears 0.17 ms but not 0.2 ms
    tick = 32  # 4 ms

    def __init__(self, robot: Robot, machine: Deviation) -> None:
        super().__init__(robot, machine)
        self._engine = load_elastica()
        levels = self.body.layout.levels
        self.design = RodDesign(share=np.ones(levels + 1))
        if machine.build is not None:
            machine.build(self.design, self.body)
        self._line = ActuatorLine(self.design, self.tick * self.step)
        self.rod: Any = self._make_rod(UnitCell.from_body(self.body))
        self._active, self._last = np.zeros((6, levels + 1)), (np.zeros((3, levels + 1)), np.zeros((3, levels)))
        self._force, self._tip = np.zeros((self.body.layout.modules, self.body.layout.actuators)), np.zeros(3)
        self._simulator, self._stepper, self._time = self._assemble(), self._engine.package.PositionVerlet(), 0.0

    def _make_rod(self, cell: UnitCell) -> Any:
        """Make the straight rod; its material is that of a unit cell."""
        layout, value, height = self.body.layout, self.body.robot.parameters, cell.height
        axes, count = np.eye(3), layout.levels
        rod = self._engine.package.CosseratRod.straight_rod(
            count + 1, -height * axes[2], axes[2], axes[0].copy(), (count + 1) * height, value.r, 1.0, youngs_modulus=1.0
        )
        rings = self.body.mass.sum(axis=1)
        rod.mass[:] = np.concatenate([rings[:1], rings[:1], rings])  # the two below are held
        rod.mass[-1] += self.design.tip_mass
        rod.shear_matrix[:] = rod.bend_matrix[:] = 0.0
        law = cell.fit_law()
        self._material = Material(
            stiffness=law.stiffness,
            third=law.third,
            share=self.design.share,
            curvature=self.design.curvature,
            inertia=rings[0] * value.r**2 * np.array([0.5, 0.5, 1.0]),
            places=np.ascontiguousarray(cell.ring[:, :2]),
            module=np.maximum(np.arange(count + 1) - 1, 0) // layout.segments,
            chord=height**2 / 12,
            cubic=self.design.cubic,
            base=2 / (1 - 0.5 / count),  # half an element bends; the rest is trapezoid rule against midpoint rule, for a tip force
            damping=value.c_a / value.K_a / self.step,
        )
        return rod

    def _assemble(self) -> Any:
        """Put rod, base, weight, medium, wall and muscles together."""
        package, simulator = self._engine.package, self._engine.simulator()
        world = self

        class Muscles(package.NoForces):
            """Material and muscles of the rod, and the force at its tip, with which the internal forces are computed again."""

            def apply_forces(self, system: Any, time: float = 0.0) -> None:
                world._set_material()
                system.compute_internal_forces_and_torques(time)
                system.external_forces[:, -1] += world._tip

        simulator.append(self.rod)
        simulator.constrain(self.rod).using(package.FixedConstraint, constrained_position_idx=(0, 1), constrained_director_idx=(0,))
        simulator.add_forcing_to(self.rod).using(Muscles)
        simulator.add_forcing_to(self.rod).using(package.GravityForces, acc_gravity=self.body.gravity)
        if self.design.viscosity:
            simulator.add_forcing_to(self.rod).using(package.SlenderBodyTheory, dynamic_viscosity=self.design.viscosity)
        if self.design.wall is not None:
            away, toward = self.design.wall
            plane = package.Plane(away * toward, -toward)
            simulator.append(plane)
            simulator.detect_contact_between(self.rod, plane).using(package.RodPlaneContact, **WALL)
        simulator.finalize()
        rod = self.rod
        self._arrays = RodArrays(
            rod.sigma, rod.kappa, rod.dilatation, rod.voronoi_dilatation, rod.shear_matrix, rod.bend_matrix, rod.rest_sigma,
            rod.rest_kappa, rod.mass_second_moment_of_inertia, rod.inv_mass_second_moment_of_inertia,
        )  # fmt: skip
        self._set_material()
        return simulator

    def _set_material(self) -> None:
        stress, elements, nodes = self._engine.kernels
        stress(self._arrays, self._material, self._force, self._active)
        elements(self._arrays, self._material, self._active, self._last[0])
        nodes(self._arrays, self._material, self._active, self._last[1])

    def settle(self, inputs: np.ndarray, force: np.ndarray) -> None:
        """Come to rest under constant inputs (12,) in Pa and N and a tip force (3,) in N: as it moves, with its sway damped.

        Raises:
            NoEquilibriumError: it does not come to rest.
        """
        self._act(self._line.settle(inputs), force)
        velocities = (self.rod.velocity_collection, self.rod.omega_collection)
        for count in range(ROUNDS):
            self._advance(10)
            for each in velocities:
                each *= SLOWER
            if count > 20 and np.abs(velocities[0]).max() < RESTING:
                break
        else:
            raise NoEquilibriumError(f"the rod still moves by {np.abs(velocities[0]).max():.3g} m/s after {10 * ROUNDS} steps")
        for each in velocities:
            each[:] = 0.0

    def _command(self, inputs: np.ndarray, force: np.ndarray) -> None:
        self._act(self._line.advance(inputs), force)

    def _act(self, inputs: np.ndarray, force: np.ndarray) -> None:
        """Let inputs (12,) in Pa and N act, and a tip force (3,) in N besides the constant one."""
        self._force[:] = (inputs[:COUNT] * self.body.robot.parameters.A - inputs[COUNT:]).reshape(self._force.shape)
        self._tip = (force + self.body.load[-1]) @ self.body.robot.mount.rotation

    def _advance(self, steps: int) -> None:
        for _ in range(steps):
            self._time = self._stepper.step(self._simulator, self._time, self.step)

    def _measure_reach(self) -> float:
        return float(np.abs(self.rod.position_collection).max())

    def _locate_points(self) -> np.ndarray:
        mount, rings = self.body.robot.mount, self.rod.position_collection.T[1:]
        return self.body.layout.point_weights @ rings @ mount.rotation.T + np.array(mount.base_position_m)
