"""A robot that an engine moves which is not ours: runs are played and recorded in the same way, whatever the engine."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.hw.simulation.imperfections.base import Body
from tepm_opt.hw.simulation.machine import Diverged
from tepm_opt.models.robot import Robot
from tepm_opt.studies.blind.excitation import COUNT, Excitation
from tepm_opt.studies.blind.machine import Deviation

BOUND = 20.0  # m, from which a simulation has diverged


class World(ABC):
    """A robot in an engine.

    Args:
        robot: as its file says.
        machine: factors of the parameters; a subclass lets it change the engine's document.

    Attributes:
        name: of the engine, for messages.
        step: of the engine in s.
        tick: steps in which the controls stay.
        body: the network in numbers.
    """

    name: ClassVar[str]
    step: ClassVar[float]
    tick: ClassVar[int]

    def __init__(self, robot: Robot, machine: Deviation) -> None:
        values = robot.parameters.model_dump()
        changed = {name: values[name] * factor for name, factor in machine.factors.items()}
        self.body = Body.from_robot(robot.model_copy(update={"parameters": robot.parameters.model_copy(update=changed)}))

    @abstractmethod
    def settle(self, inputs: np.ndarray, force: np.ndarray) -> None:
        """Come to rest under constant inputs (12,) in Pa and N and a tip force (3,) in N."""

    @abstractmethod
    def _command(self, inputs: np.ndarray, force: np.ndarray) -> None:
        """Set inputs and tip force of the coming tick, see `settle`."""

    @abstractmethod
    def _advance(self, steps: int) -> None:
        """Move on by whole steps."""

    @abstractmethod
    def _locate_points(self) -> np.ndarray:
        """Reference points in G, (points, 3) in m."""

    @abstractmethod
    def _measure_reach(self) -> float:
        """Largest coordinate in m, NaN where the simulation has diverged."""

    def record(self, asked: SetPoints) -> np.ndarray:
        """Points without noise while inputs and tip force follow set points linearly, (rows, points, 3) in m.

        Raises:
            NoEquilibriumError, Diverged: the machine does not bear it.
        """
        levels = np.hstack([asked.inputs, asked.tip_force])
        self.settle(levels[0, : 2 * COUNT], levels[0, 2 * COUNT :])
        found = [self._locate_points()]
        for end, seconds, before, after in zip(asked.time[1:], np.diff(asked.time), levels[:-1], levels[1:], strict=True):
            ticks = max(round(seconds / (self.tick * self.step)), 1)
            for part in (np.arange(ticks) + 0.5) / ticks:
                level = before + part * (after - before)
                self._command(level[: 2 * COUNT], level[2 * COUNT :])
                self._advance(self.tick)
            found.append(self._locate_points())
            if not self._measure_reach() < BOUND:
                raise Diverged(f"{self.name}'s simulation diverged before {end:.2f} s")
        return np.array(found)


def record_runs(world: World, machine: Deviation, runs: Sequence[Excitation]) -> list[np.ndarray]:
    """Points of runs without noise as a tracker sees them, each (rows, points, 3) in m.

    Raises:
        NoEquilibriumError, Diverged: the machine does not bear it.
    """
    found = []
    for run in runs:
        points = world.record(run.setpoints)
        found.append(points if machine.after is None else machine.after(run.began + run.setpoints.time, points))
    return found
