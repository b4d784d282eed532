"""Lines in virtual time: to the emulated board, on which things happen at given times, and to one that is only its messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from tepm_opt.hw.board.limits import Limits
from tepm_opt.hw.board.protocol import (
    ACK,
    ARM,
    ASK,
    CONFIG,
    ESTOP,
    HELLO,
    LIMITS,
    SET,
    STATUS,
    TO_BOARD,
    VERSION,
    Decoder,
    Message,
    Result,
    State,
    frame,
)
from tepm_opt.hw.service.line import Line
from tepm_opt.models.robot import Robot
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


class FakeBoard:
    """A line to a board that is only its messages, in virtual time, and says whatever it is told to say.

    Attributes:
        time: in s.
        hello, status: fields of these messages; those of STATUS that count go on by themselves.
        limits: of the robot that its firmware is made for.
        heard: messages that were sent to it.
        obeys: whether it acts on set points.
        answers: results of requests by their kind, one after the other; DONE where there is none.
        silent: whether it sends no STATUS.
        period: between two STATUS in s.
    """

    def __init__(self, robot: Robot) -> None:
        self.time, self.period, self._due = 0.0, 0.005, 0.005
        self.hello = {name: 0 for name, _ in HELLO.fields} | {"version": VERSION, "channels": 6, "monitors": 6, "timeout_ms": 100}
        self.limits = Limits.from_robot(robot)
        self.hello["limits"] = self.limits.check
        self.status: dict[str, Any] = {name: 0 for name, _ in STATUS.fields} | {"session": 0x10001}
        self.status |= {"dynamometers": (3277,) * 6, "monitors": (6554,) * 6, "positions": (0,) * 6}
        self.heard: list[tuple[Message, dict[str, Any]]] = []
        self.obeys, self.silent = True, False
        self.answers: dict[Message, list[Result]] = {}
        self._decoder, self._waiting = Decoder(TO_BOARD), b""

    def clock(self) -> float:
        """The time in s."""
        return self.time

    def tell(self, kind: Message, **values: Any) -> None:
        """Send a message to the host."""
        self._waiting += frame(kind.pack(**values))

    def tell_status(self, **values: Any) -> None:
        """Send a STATUS a period after the last one; `values` stay."""
        after = {"count": (self.status["count"] + 1) % 256, "time_ms": (self.status["time_ms"] + round(1e3 * self.period)) % 2**32}
        self.status |= after | values
        self.tell(STATUS, **self.status)

    def read(self, timeout: float) -> bytes:
        """As `Port.read`."""
        end = self.time + timeout
        while not self._waiting and self.time < end - 1e-9:
            self.time = min(end, max(self._due, self.time))
            if self.time >= self._due - 1e-9:
                self._due += self.period
                if not self.silent:
                    self.tell_status()
        data, self._waiting = self._waiting, b""
        return data

    def write(self, data: bytes) -> None:
        """As `Port.write`: the board does it at once and answers."""
        for kind, values in self._decoder.feed(data):
            self.heard.append((kind, values))
            if kind is ASK:
                self.tell(HELLO, **self.hello)
                self.tell(LIMITS, **asdict(self.limits))
            elif kind is not SET:
                self._answer(kind, values["id"])
            elif self.obeys:
                self.status["sequence"] = values["sequence"] % 0x10000

    def close(self) -> None:
        """Nothing to close."""

    def _answer(self, kind: Message, number: int) -> None:
        result = self.answers[kind].pop(0) if self.answers.get(kind) else Result.DONE
        if result is Result.DONE and kind is not CONFIG:
            state = {ARM: State.ARMED, ESTOP: State.ESTOP}.get(kind, State.IDLE)
            self.status |= {"state": int(state), "sequence": 0, "session": self.status["session"] + 1}
        told = {"state": self.status["state"], "session": self.status["session"]}
        self.tell(ACK, id=number, request=kind.code, result=int(result), channel=3, **told)
