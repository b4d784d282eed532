"""The machine by MuJoCo's engine, with the devices in Python: the arbiter of the compiled one."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np

from tepm_opt.hw.simulation.imperfections.session import evaluate_shaking
from tepm_opt.hw.simulation.machine import Frames, Machine
from tepm_opt.hw.simulation.mujoco_network import MujocoNetwork
from tepm_opt.hw.simulation.timeline import Timeline


class MujocoMachine(Machine):
    """See `Machine`; `network` is a `MujocoNetwork`."""

    network: MujocoNetwork

    def _network(self) -> MujocoNetwork:
        return MujocoNetwork(self.body, self.step)

    def record(self, at: Sequence[int], commands: Timeline, forces: Timeline) -> Frames:
        """See `Machine`."""
        found = []
        for until in at:
            self._advance(until, commands, forces)
            if not self.network.finite:
                break
            nodes = self.network.nodes
            found.append((nodes, self.network.points(nodes), self.actuation.pressure.copy(), self.actuation.tension.copy()))
        if not found:
            raise self.make_divergence_error(at[0])
        return Frames(*(np.array(each) for each in zip(*found, strict=True)))

    def _advance(self, until: int, commands: Timeline, forces: Timeline) -> None:
        empty = np.empty(0)
        network = self.network
        while self.now < until:
            end = min(commands.next_knot(self.now, until), forces.next_knot(self.now, until), until)
            if self.ticks or not forces.constant(self.now):
                end = min(end, self.now + self.tick)
            duration = (end - self.now) * self.step
            lengths, rates = network.verticals() if self.follows_shape else (empty, empty)
            edges = reduce(np.add, (stage.step(lengths, rates, duration) for stage in self.edges)) if self.edges else None
            if self.actuation.uses_lengths:
                lengths, rates = network.of_actuators(lengths), network.of_actuators(rates)
            axial = self.actuation.step(commands.evaluate_between(self.now, end), lengths, rates, duration)
            network.drive(network.push(axial, edges), duration)
            force = np.mean(forces.evaluate_between(self.now, end), axis=0)
            if self.around:
                motion = network.tip(network.velocities) - network.base
                force[-1] += self._sum_surrounding_forces(network.tip(network.nodes), motion)
            network.load(force)
            if len(self.shaking):
                passed = (self.now + end) / 2 * self.step
                network.fall(self.body.gravity - evaluate_shaking(self.shaking, self.began + passed, passed))
            network.advance(end - self.now)
            self.now = end
