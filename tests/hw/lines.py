"""Lines to the emulated board in virtual time, on which things happen at given times."""

from __future__ import annotations

from collections.abc import Callable

from tepm_opt.hw.service.line import Line
from tests.hw.emulator.world import LockstepPort, World


class EventfulPort(LockstepPort):
    """Calls functions once the world's time has come; what they raise, reading and writing raise."""

    def __init__(self, world: World) -> None:
        super().__init__(world)
        self.events: list[tuple[float, Callable[[], object]]] = []

    def at(self, time: float, event: Callable[[], object]) -> None:
        """Have something happen at a time in s."""
        self.events.append((time, event))

    def _check(self) -> None:
        due = [event for event in self.events if event[0] <= self.world.time]
        for event in due:
            self.events.remove(event)
            event[1]()
        super()._check()


def line_of(world: World, port: LockstepPort | None = None) -> Line:
    """An open line to a world's board."""
    return Line(port or world.port, world.clock, threaded=False)
