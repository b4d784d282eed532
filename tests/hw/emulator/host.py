"""A bare host for tests of the firmware: it speaks the protocol and nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.limits import Limits
from tepm_opt.hw.board.protocol import ACK, ARM, CLEAR, CONFIG, DISARM, ESTOP, HELLO, SET, STATUS, Key, Message
from tepm_opt.models.robot import load_robot
from tests.hw.emulator import Board

ALL = 0x3F
ZERO = 3277
"""Counts of a dynamometer without tension."""
LIMITS_CHECK = Limits.from_robot(load_robot("kang2017")).check


class Host:
    """Drives an emulated board, frame by frame.

    Attributes:
        heard: every message from the board with the time at which it was taken: (time in s, kind, values).
    """

    def __init__(self, board: Board) -> None:
        self.board = board
        self.decoder = protocol.Decoder(protocol.TO_HOST)
        self.heard: list[tuple[float, Message, dict[str, Any]]] = []
        self.sequence = 0
        self._id = 0

    def run(self, duration: float, step: float = 0.005) -> None:
        """Let time pass and listen, without sending."""
        end = self.board.time + duration
        while self.board.time < end - 1e-9:
            self.board.run(min(step, end - self.board.time))
            self.heard += [(self.board.time, *message) for message in self.decoder.feed(self.board.take())]

    def send(self, kind: Message, **values: int | list[int]) -> bytes:
        """A frame onto the line."""
        data = protocol.frame(kind.pack(**values))
        self.board.send(data)
        return data

    def set(
        self, pressures: Sequence[int] = (0,) * 6, tendons: Sequence[int] = (ZERO,) * 6, enabled: int = ALL, steps: bool = False
    ) -> bytes:
        """A set point of the session that the board told last, with the next sequence number."""
        self.sequence += 1
        bits = enabled | (protocol.POSITION_MODE if steps else 0)
        return self.send(SET, session=self.session, sequence=self.sequence, enabled=bits, pressures=list(pressures), tendons=list(tendons))

    def hold(self, duration: float, period: float = 0.005, **setpoints: Any) -> None:
        """Send the same set point again and again."""
        end = self.board.time + duration
        while self.board.time < end - 1e-9:
            self.set(**setpoints)
            self.run(min(period, end - self.board.time))

    def request(self, kind: Message, wait: float = 0.03, **values: int) -> dict[str, Any]:
        """A request and its answer, sent once."""
        self._id = (self._id + 1) % 256
        before = len(self.heard)
        self.send(kind, id=self._id, **values)
        self.run(wait)
        answers = [values for _, kind, values in self.heard[before:] if kind is ACK and values["id"] == self._id]
        return answers[-1] if answers else {}

    def arm(self) -> dict[str, Any]:
        """ARM with the session that the board told last."""
        return self.request(ARM, session=self.session, limits=LIMITS_CHECK)

    def clear(self) -> dict[str, Any]:
        """CLEAR with the session that the board told last."""
        return self.request(CLEAR, session=self.session)

    def disarm(self) -> dict[str, Any]:
        """DISARM."""
        return self.request(DISARM)

    def estop(self) -> dict[str, Any]:
        """ESTOP."""
        return self.request(ESTOP)

    def config(self, key: Key, value: int) -> dict[str, Any]:
        """CONFIG in the session that the board told last."""
        return self.request(CONFIG, session=self.session, key=int(key), value=value)

    def ready(self) -> None:
        """From power-on to ARMED."""
        self.run(0.05)
        self.arm()

    @property
    def statuses(self) -> list[dict[str, Any]]:
        """All STATUS so far."""
        return [values for _, kind, values in self.heard if kind is STATUS]

    @property
    def status(self) -> dict[str, Any]:
        """The last STATUS."""
        return next(values for _, kind, values in reversed(self.heard) if kind is STATUS)

    @property
    def state(self) -> protocol.State:
        """As the last STATUS told it."""
        return protocol.State(self.status["state"])

    @property
    def fault(self) -> protocol.Fault:
        """As the last STATUS told it."""
        return protocol.Fault(self.status["fault"])

    @property
    def faults(self) -> set[protocol.Fault]:
        """All that the last STATUS told."""
        return {fault for fault in protocol.Fault if self.status["faults"] & fault.bit}

    @property
    def session(self) -> int:
        """As the last message told it that has it."""
        return next((values["session"] for _, kind, values in reversed(self.heard) if kind in (STATUS, ACK, HELLO)), 0)
