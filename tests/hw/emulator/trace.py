"""What happened in an episode, pass by pass: what was on the pins, which frames reached the firmware when, what it answered.

Nothing in here knows what the firmware does, but how fast it reads: at most 13 bytes a pass, out of a buffer of 127.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.protocol import Message, ResetCause
from tests.hw.emulator import CLOCK, HZ, PASS, RESET, Board

MS = HZ // 1000
BYTE = HZ * 10 // 250_000
JITTER, LATE = MS // 50, MS * 2 // 5
READ, BUFFER, LONGEST = 13, 127, 64
LATENESS = 330
"""Cycles from when the clock is about to begin to a millisecond before the edge in a pass that has nothing to read, and fewer."""
NEVER = math.inf


@dataclass
class Arrival:
    """A frame on its way to the firmware.

    Attributes:
        end: bytes on the line up to its end.
        payload: what is in it; empty where it is damaged.
        kind, values: of the message; None where it is damaged.
        early, late: records in whose pass the firmware reads its last byte, at the earliest and at the latest.
        torn: some of it may have been lost, in a buffer that was full or in a reset.
    """

    end: int
    payload: bytes
    kind: Message | None
    values: dict[str, Any]
    early: float = NEVER
    late: float = NEVER
    torn: bool = False


@dataclass
class Boot:
    """From a reset to the next.

    Attributes:
        begin: record of the reset.
        cause: as HELLO has to tell it.
        cycle: of the reset.
        frame: the first frame after it.
        zero: cycle at which the firmware's clock began.
    """

    begin: int
    cause: ResetCause
    cycle: int
    frame: int = 0
    zero: int = 0


@dataclass
class Heard:
    """A message of the board, complete when `record` was the last pass that had begun."""

    record: int
    cycle: int
    kind: Message
    values: dict[str, Any]


@dataclass
class Trace:
    """Records of passes and resets, in order.

    Attributes:
        records: what `Board.passes` gave.
        clock: of each record, what the firmware's clock shows in ms.
        boot: of each record, index of its boot.
        late: records of passes that began in the middle of a millisecond, and may end in the next.
        frames: that have reached the board.
        hangs: when the main loop hung, in cycles: from, to (None: still).
        bus: when the two-wire bus was in disorder, in cycles.
    """

    board: Board
    stream: bytearray = field(default_factory=bytearray)
    records: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=PASS))
    clock: list[int] = field(default_factory=list)
    boot: list[int] = field(default_factory=list)
    late: set[int] = field(default_factory=set)
    boots: list[Boot] = field(default_factory=lambda: [Boot(-1, ResetCause.POWER_ON, 0)])
    frames: list[Arrival] = field(default_factory=list)
    heard: list[Heard] = field(default_factory=list)
    hangs: list[list[int | None]] = field(default_factory=list)
    bus: list[list[int | None]] = field(default_factory=list)
    causes: dict[int, ResetCause] = field(default_factory=dict)
    _decoder: protocol.Decoder = field(default_factory=lambda: protocol.Decoder(protocol.TO_HOST))
    _parsed: int = 0
    _begin: int = 0  # of the frame that is being parsed
    _fast: int = 0  # bytes that the firmware has read by now, at most and at least
    _slow: int = 0
    _sure: int = 0  # bytes that it has by now in any case
    _torn_from: int | None = 0  # bytes from here on may be lost: what comes before the first pass is
    _whole_from: int = -1  # what begins before may be torn, where it ends after what was lost
    _timed_early: int = 0
    _timed_late: int = 0

    def send(self, data: bytes) -> None:
        """Bytes onto the line."""
        self.stream += data
        self.board.send(data)

    def cut(self) -> None:
        """What is on the line is lost."""
        self.board.cut()
        del self.stream[self.board.delivered :]

    def listen(self) -> None:
        """Take what the board has sent by now."""
        for kind, values in self._decoder.feed(self.board.take()):
            self.heard.append(Heard(-1, self.board.cycle, kind, values))

    def update(self) -> None:
        """Take what has happened by now."""
        new = self.board.passes()
        self.records = np.concatenate([self.records, new[new["kind"] != CLOCK]])
        for record in new:
            if record["kind"] == CLOCK:
                self.boots[-1].zero = int(record["cycle"]) + LATENESS
            else:
                self._add(len(self.clock), record)
        cycles = self.records["cycle"]
        for heard in reversed(self.heard):
            if heard.record >= 0:
                break
            heard.record = int(np.searchsorted(cycles, heard.cycle, "right")) - 1
            if self.records[heard.record]["kind"] == RESET:
                heard.record -= 1  # its last byte was on the line already: before its first pass a board says nothing

    def _add(self, at: int, record: np.void) -> None:
        cycle, delivered = int(record["cycle"]), int(record["delivered"])
        self._parse(delivered)
        if record["kind"] == RESET:
            for arrival in self.frames[self._timed_early :]:  # in a pass that was not finished
                if arrival.end <= self._fast + READ:
                    arrival.early = at
            self._timed_early = self._timed_late = len(self.frames)  # what was not read by now is not read any more
            self.boots.append(Boot(at, self.causes.get(cycle, ResetCause.WATCHDOG), cycle, len(self.frames)))
            self._fast = self._slow = self._sure = self._torn_from = delivered
            self.clock.append(-1)
            self.boot.append(len(self.boots) - 1)
            return
        boot = self.boots[-1]
        clock, behind = divmod(cycle - boot.zero + JITTER, MS)
        self.clock.append(clock)
        self.boot.append(len(self.boots) - 1)
        if behind > LATE:  # the first after a hang
            self.late.add(at)
        sure = max(self._sure, delivered - math.ceil(behind / BYTE) - 2)
        self._sure = delivered
        if self._torn_from is None and delivered - self._slow >= BUFFER - 2:
            self._torn_from = self._slow + BUFFER - 2
        torn = self._torn_from is not None
        self._fast = delivered if torn else min(delivered, self._fast + READ)
        self._slow = min(sure, self._slow + READ)
        self._tear()
        if torn and self._slow >= sure:
            self._torn_from, self._whole_from = None, delivered
        while self._timed_early < len(self.frames) and self.frames[self._timed_early].end <= self._fast:
            self.frames[self._timed_early].early = at
            self._timed_early += 1
        while self._timed_late < self._timed_early and self.frames[self._timed_late].end <= self._slow:
            self.frames[self._timed_late].late = at
            self._timed_late += 1

    def _tear(self) -> None:
        if self._torn_from is None:
            return
        for arrival in reversed(self.frames):
            if arrival.end <= self._torn_from:
                break
            arrival.torn = True

    def _parse(self, delivered: int) -> None:
        """Frames that became complete with these bytes. One that is there where bytes were lost is torn: its beginning may be what was
        lost; or the zero at its end, and then the next zero ends it.
        """
        while (end := self.stream.find(0, self._parsed, delivered)) >= 0:
            torn = self._begin <= self._whole_from or (self._torn_from is not None and end >= self._torn_from)
            if end > self._begin or (torn and self.frames and self.frames[-1].end == end and self.frames[-1].torn):
                begins = [self._begin, *(range(max(self._begin, end - LONGEST), end) if torn else ())]
                found = next((found for begin in begins if (found := decoded(bytes(self.stream[begin : end + 1])))), None)
                if end == self._begin and (last := self.frames[-1]).kind is not None:  # the zero at its end was lost: this one ends it
                    found = last.kind, last.values
                kind, values = found or (None, {})
                self.frames.append(Arrival(end + 1, kind.pack(**values) if kind else b"", kind, values, torn=torn))
            self._parsed = self._begin = end + 1
        self._parsed = max(self._parsed, delivered)


def decoded(data: bytes) -> tuple[Message, dict[str, Any]] | None:
    """The message in a frame, if there is one."""
    found = protocol.Decoder(protocol.TO_BOARD).feed(data)
    return found[0] if found else None
