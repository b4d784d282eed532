"""The machine by the compiled engine, which steps the devices and the network together."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np

from tepm_opt.hw.simulation.engine import EDGE, PRESSURE, TENSION, TIP, CompiledNetwork
from tepm_opt.hw.simulation.imperfections.base import Numbers, Stage
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
        pressures = (actuation.regulators, PRESSURE), (actuation.muscles, PRESSURE)
        groups = *pressures, (actuation.tendons, TENSION), (self.edges, EDGE), (self.around, TIP)
        return [[_numbers(stage, kinds) for stage in group] for group, kinds in groups]

    def settle(self, command: np.ndarray, forces: np.ndarray) -> None:
        """See `Machine`."""
        super().settle(command, forces)
        actuation = self.actuation
        self.network.equip(
            self._stages(),
            tick=self.tick,
            ticks=self.ticks,
            follows_shape=self.follows_shape,
            area=actuation.area,
            pressure_grid=actuation.grids[0],
            tension_grid=actuation.grids[1],
            winding=actuation.rate,
            now=self.now,
        )
        self.network.shake(self.shaking, self.began)  # fmt: skip
        self.network.monitors(actuation.pressure, actuation.tension)

    def record(self, at: Sequence[int], commands: Timeline, forces: Timeline) -> Frames:
        """See `Machine`."""
        done, arrays = self.network.record(np.array(at, dtype=np.int64), commands, forces)
        self.now = self.network.rig.now
        if done == 0:
            raise self.make_divergence_error(at[0])
        return Frames(*arrays) if done == len(at) else Frames(*(each[:done] for each in arrays))


def _numbers(stage: Stage, kinds: tuple[str, ...]) -> Numbers:
    """Get the numbers that a stage hands over to the compiled engine.

    Raises:
        Unknown: it has nothing to hand over, C does not know it in its place, or it inherits its numbers but not its steps.
    """
    names = "numbers", "force" if kinds is TIP else "step"
    numbers_of, steps_of = (next((owner for owner in type(stage).__mro__ if name in vars(owner)), None) for name in names)
    own = numbers_of is not None and steps_of is not None and issubclass(numbers_of, steps_of)
    if not own or (numbers := stage.numbers()).kind not in kinds:
        raise Unknown(f"{type(stage).__name__} has no counterpart in C")
    return numbers
