"""The machine of a simulated rig: MuJoCo's network driven through its imperfect actuation."""

from __future__ import annotations

from functools import reduce

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.actuation import ActuationDynamics
from tepm_opt.hw.simulation.equilibrium import find_equilibrium
from tepm_opt.hw.simulation.imperfections.base import Body
from tepm_opt.hw.simulation.mujoco_network import MujocoNetwork
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.hw.simulation.timeline import Timeline


class Diverged(RuntimeError):  # noqa: N818  it says what happened
    """Failure of a simulation whose numbers have left all bounds."""


class Machine:
    """A robot that carries out a timeline of commands and loads, in whole steps.

    Attributes:
        robot: with its true parameters.
        imperfections: those that do something, by name.
        network, actuation: its parts.
        tick: steps between updates of the states of actuators and frictions.
        now: steps since the start.
    """

    def __init__(self, file: RigFile) -> None:
        self.robot = file.true_robot
        self.step = file.simulation.step_s
        self.imperfections = file.imperfections.active
        body = Body.of(self.robot, file.seed)
        for imperfection in self.imperfections.values():
            imperfection.change_body(body)
        self.tick = self._tick(file.simulation.tick_s, body)
        self._edges = [stage for item in self.imperfections.values() if (stage := item.edge_stage(body)) is not None]
        self.network = MujocoNetwork(body, self.step)
        self.actuation = ActuationDynamics(file, self.robot)
        self._ticks = bool(self._edges) or not self.actuation.direct
        self._follows_shape = bool(self._edges) or self.actuation.uses_lengths
        self.now = 0

    def _tick(self, wanted: float, body: Body) -> int:
        """Steps in a tick: as wanted (in s), or fewer where an imperfection is too stiff for that.

        Raises:
            InputError: one is too stiff even for a tick of one step.
        """
        for name, imperfection in self.imperfections.items():
            longest = imperfection.longest_tick(body)
            if longest < self.step:
                need = f"it needs steps of {longest:.2g} s, simulation.step_s is {self.step:g} s"
                raise InputError(f"imperfections: {name} is too stiff for the damping of the muscles: {need}")
            wanted = min(wanted, longest)
        return max(1, int(wanted / self.step + 1e-9))

    def settle(self, command: np.ndarray, forces: np.ndarray) -> None:
        """Come to rest under a constant command (3 · actuators,) and forces on the points in G, (points, 3) in N.

        Starts from the rest geometry. Lags and delays are over, creep is relaxed, dry friction is zero, hysteresis as if filled from zero.

        Raises:
            NoEquilibriumError: there is no stable equilibrium to be found.
        """
        self.actuation.settle(command)
        self.network.load(forces)

        def force(position: np.ndarray) -> np.ndarray:
            self.network.data.qpos[:] = position
            return self.network.force_at_rest(position, *self._at_rest())

        position = find_equilibrium(force, np.zeros(self.network.model.nv))
        self.network.data.qpos[:] = position
        self.network.force_at_rest(position, *self._at_rest())

    def _at_rest(self) -> tuple[np.ndarray, np.ndarray | None]:
        lengths, _ = self.network.verticals()
        axial = self.actuation.force_at_rest(self.network.of_actuators(lengths))
        return axial, reduce(np.add, (stage.settle(lengths) for stage in self._edges)) if self._edges else None

    def advance(self, until: int, commands: Timeline, forces: Timeline) -> None:
        """Advance the simulation to a step.

        Args:
            until: step to stop at.
            commands: (3 · actuators,) in Pa, N and 0 or 1.
            forces: on the points in G, (points, 3) in N.

        Raises:
            Diverged: the positions left all bounds.
        """
        empty = np.empty(0)
        while self.now < until:
            end = min(commands.next_knot(self.now, until), forces.next_knot(self.now, until), until)
            if self._ticks or not forces.constant(self.now):
                end = min(end, self.now + self.tick)
            duration = (end - self.now) * self.step
            lengths, rates = self.network.verticals() if self._follows_shape else (empty, empty)
            edges = reduce(np.add, (stage.step(lengths, rates, duration) for stage in self._edges)) if self._edges else None
            if self.actuation.uses_lengths:
                lengths, rates = self.network.of_actuators(lengths), self.network.of_actuators(rates)
            axial = self.actuation.step(commands.between(self.now, end), lengths, rates, duration)
            self.network.drive(axial, edges, duration)
            force = forces.between(self.now, end)
            self.network.load((force[0] + force[1]) / 2)
            self.network.advance(end - self.now)
            self.now = end
        if not self.network.finite:
            raise Diverged(f"the simulation diverged before {self.now * self.step:.3f} s; a smaller step_s may help (now {self.step:g} s)")
