"""The machine by the compiled engine, which steps the devices and the network together."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Sequence

import numpy as np

from tepm_opt.hw.simulation.engine import KINDS, CompiledNetwork
from tepm_opt.hw.simulation.imperfections.base import Numbers
from tepm_opt.hw.simulation.machine import Frames, Machine
from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.hw.simulation.timeline import Timeline


class Unknown(LookupError):  # noqa: N818  it says what it is
    """A stage that the compiled engine does not have."""


class CompiledMachine(Machine):
    """See `Machine`; `network` is a `CompiledNetwork`. The Python stages settle and then hand over their numbers.

    Raises:
        Unknown: a stage is of a kind that C does not have.
    """

    network: CompiledNetwork

    def __init__(self, file: RigFile, built: ctypes.CDLL) -> None:
        self._library = built
        super().__init__(file)
        self._stages()

    def _network(self) -> CompiledNetwork:
        return CompiledNetwork(self.body, self.step, self._library)

    def _stages(self) -> list[list[Numbers]]:
        actuation = self.actuation
        return [_numbers(group) for group in (actuation.regulators, actuation.muscles, actuation.tendons, self.edges)]

    def settle(self, command: np.ndarray, forces: np.ndarray) -> None:
        """See `Machine`."""
        super().settle(command, forces)
        actuation = self.actuation
        self.network.equip(
            self._stages(), tick=self.tick, ticks=self.ticks, follows_shape=self.follows_shape, area=actuation.area,
            pressure_grid=actuation.grids[0], tension_grid=actuation.grids[1], winding=actuation.rate, now=self.now,
        )  # fmt: skip
        self.network.monitors(actuation.pressure, actuation.tension)

    def record(self, at: Sequence[int], commands: Timeline, forces: Timeline) -> Frames:
        """See `Machine`."""
        done, arrays = self.network.record(np.array(at, dtype=np.int64), commands, forces)
        self.now = self.network.rig.now
        if done == 0:
            raise self.diverged(at[0])
        return Frames(*arrays) if done == len(at) else Frames(*(each[:done] for each in arrays))


def _numbers(stages: Iterable[object]) -> list[Numbers]:
    """What the stages hand over.

    Raises:
        Unknown: one has nothing to hand over, or C does not know it.
    """
    found = []
    for stage in stages:
        tell = getattr(stage, "numbers", None)
        if tell is None or (numbers := tell()).kind not in KINDS:
            raise Unknown(f"{type(stage).__name__} has no counterpart in C")
        found.append(numbers)
    return found
