"""The machine of a simulated rig: a network driven through its imperfect actuation, by either of two engines."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from math import ceil
from typing import Protocol, runtime_checkable

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.actuation import ActuationDynamics
from tepm_opt.hw.simulation.equilibrium import find_equilibrium
from tepm_opt.hw.simulation.imperfections.base import Body
from tepm_opt.hw.simulation.network import Network
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.hw.simulation.stability import longest_step
from tepm_opt.hw.simulation.timeline import Timeline

SHORTEST = 1e-6  # s, of a step


class Diverged(RuntimeError):  # noqa: N818  it says what happened
    """Failure of a simulation whose numbers have left all bounds."""


@dataclass(frozen=True, eq=False)
class Frames:
    """Places, pressures and tensions at some steps, one after the other.

    Attributes:
        nodes: all nodes in the base frame, (frames, n + 1, actuators, 3) in m.
        points: reference points in G, (frames, points, 3) in m.
        pressures: behind the regulators, (frames, modules · actuators) in Pa.
        tensions: at the motors, (frames, modules · actuators) in N.
    """

    nodes: np.ndarray
    points: np.ndarray
    pressures: np.ndarray
    tensions: np.ndarray


@runtime_checkable
class Clocked(Protocol):
    """A stage that asks what time it is in the session."""

    clock: float


class Machine(ABC):
    """A robot that carries out a timeline of commands and loads, in whole steps.

    Attributes:
        robot: with its true parameters.
        body: the network in numbers.
        imperfections: those that do something, by name.
        limit: the longest step in s that the robot bears at rest: its stiffest motion, and what is stiff beside a damper.
        step: of RK4 in s: the rig file's, or less where the limit is.
        tick: steps between updates of the states of actuators and frictions.
        actuation: from the commands to the axial forces.
        edges: stages of the forces along the vertical edges, in their order.
        around: stages of the forces that the tip meets, in their order.
        shaking: sines of the base's motion, (sines, 5) as by `Imperfection.base_motion`.
        network: the moving parts.
        now: steps since the start.
        began: time in the session in s at the start.
    """

    def __init__(self, file: RigFile) -> None:
        self.robot = file.true_robot
        self.imperfections = file.imperfections.active
        self.body = Body.from_robot(self.robot, file.seed)
        for imperfection in self.imperfections.values():
            imperfection.change_body(self.body)
        self.limit = self._limit()
        self.step = _step(file, self.limit)
        self.tick = self._tick(file.simulation.tick_s)
        self.edges = [stage for item in self.imperfections.values() if (stage := item.edge_stage(self.body)) is not None]
        self.around = [stage for item in self.imperfections.values() if (stage := item.tip_stage(self.robot)) is not None]
        self.actuation = ActuationDynamics(file, self.robot)
        moves = [rows for item in self.imperfections.values() if (rows := item.base_motion(self.body)) is not None]
        self.shaking = np.concatenate([np.zeros((0, 5)), *moves])
        self.ticks = bool(self.edges or self.around or moves) or not self.actuation.direct
        self.follows_shape = bool(self.edges) or self.actuation.uses_lengths
        self.network = self._network()
        self.now = 0
        self.began = 0.0

    @abstractmethod
    def _network(self) -> Network:
        """The moving parts, of this engine."""

    def _limit(self) -> float:
        """The longest step in s.

        Raises:
            InputError: there is none that would end in sensible time.
        """
        longest = {name: item.longest_tick(self.body) for name, item in self.imperfections.items()}
        stiffest = min(longest, key=lambda name: longest[name], default="")
        if stiffest and longest[stiffest] < SHORTEST:
            need = f"it needs steps of {longest[stiffest]:.2g} s; valid: {SHORTEST:g} s and longer, with a softer one or c_a larger"
            raise InputError(f"imperfections: {stiffest} is too stiff for the damping of the muscles, c_a: {need}")
        return min(longest_step(self.body), *longest.values(), np.inf)

    def _tick(self, wanted: float) -> int:
        """Steps in a tick: as wanted (in s), or fewer where an imperfection is too stiff for that."""
        wanted = min([wanted, *(item.longest_tick(self.body) for item in self.imperfections.values())])
        return max(1, int(wanted / self.step + 1e-9))

    def settle(self, command: np.ndarray, forces: np.ndarray) -> None:
        """Come to rest under a constant command (3 · actuators,) and forces on the points in G, (points, 3) in N.

        Starts from the rest geometry. Lags and delays are over, creep is relaxed, dry friction is zero, hysteresis as if filled from zero.

        Raises:
            NoEquilibriumError: there is no stable equilibrium to be found.
        """
        for stage in (*self.edges, *self.actuation.tendons):
            if isinstance(stage, Clocked):
                stage.clock = self.began
        self.actuation.settle(command)
        self.network.load(forces)
        position = find_equilibrium(self._force, np.zeros(self.network.rest[1:].size))
        self._force(position[None])  # the stages settle at these lengths
        self.network.place(position)

    def _force(self, positions: np.ndarray) -> np.ndarray:
        """Net forces on all free coordinates (places, 3 n actuators) in N, settled at displacements (places, 3 n actuators) in m."""
        lengths = self.network.lengths(positions)
        axial = self.actuation.force_at_rest(self.network.of_actuators(lengths))
        edges = reduce(np.add, (stage.settle(lengths) for stage in self.edges)) if self.edges else None
        push = np.broadcast_to(self.network.push(axial, edges), lengths.shape)
        forces = self.network.forces_at_rest(positions, push)
        if self.around:
            tip = self.network.tip(self.network.place_nodes(positions))
            forces = forces + self.network.at_tip(self._sum_surrounding_forces(tip, np.zeros_like(tip)))
        return forces

    def _sum_surrounding_forces(self, place: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Sum the forces in G that the tip meets where it is, (…, 3) in N."""
        return reduce(np.add, (stage.force(place, velocity) for stage in self.around))

    @abstractmethod
    def record(self, at: Sequence[int], commands: Timeline, forces: Timeline) -> Frames:
        """Advance to each of some steps; what is there then. Fewer frames than steps where the simulation diverges before a later one.

        Args:
            at: steps that do not fall, at least one.
            commands: (3 · actuators,) in Pa, N and 0 or 1.
            forces: on the points in G, (points, 3) in N.

        Raises:
            Diverged: the positions left all bounds before the first of the steps.
        """

    def make_divergence_error(self, at: int) -> Diverged:
        """Make the error that says that the positions left all bounds before a step, and what can be done."""
        told = f"the simulation diverged before {at * self.step:.3f} s in steps of {self.step:.3g} s (at rest it bears {self.limit:.3g} s)"
        shorter = f"simulation.step_s is too long (try {self.step / 2:.2g} in a rig file)"
        return Diverged(f"{told}: inputs or loads are more than the robot bears, or {shorter}")


def _step(file: RigFile, longest: float) -> float:
    """The rig file's step in s, or a whole part of the tracker's period that is at most the longest one."""
    wanted, period = file.simulation.step_s, 1 / file.tracker.rate_hz
    return wanted if wanted <= longest else period / ceil(period / longest)
