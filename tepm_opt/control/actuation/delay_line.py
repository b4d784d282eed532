"""Commands on their way from a controller to the actuators."""

from __future__ import annotations

from collections import deque

import numpy as np

from tepm_opt.hw.rig import Command

SLACK = 0.05  # of a period, by which a delay may be short of a whole one
MOST_LATE = 8  # periods by which commands may act later than the robot file says


def whole_periods(late: float, period: float) -> int:
    """Whole control periods in a delay, both in s. A part is left out: half a period too many costs more than one too few."""
    return int(late / period + SLACK)


class CommandDelayLine:
    """Commands that were sent, from when on each acts, and how many periods that is after its sample.

    Args:
        first: command under which the robot rests.
        period: of control in s.
        ahead: periods from a sample to when its command acts, as declared.

    Attributes:
        ahead: the same as far as is known, 1 … declared + `MOST_LATE`.
        last: the command sent last, whether it acts yet or not.
    """

    def __init__(self, first: Command, period: float, ahead: int) -> None:
        self._period, self._declared = period, ahead
        self.ahead, self.last = ahead, first
        self._zero: float | None = None
        self._entries: deque[tuple[float, Command]] = deque([(-np.inf, first)])

    @property
    def late(self) -> float:
        """Time in s by which commands act later than declared."""
        return (self.ahead - self._declared) * self._period

    def take_time(self, time: float) -> int:
        """Take a sample's time in s, the first of which is that of row 0; its row of the reference."""
        self._zero = time if self._zero is None else self._zero
        return round((time - self._zero) / self._period)

    def command_at(self, row: int) -> Command:
        """The command in force at the middle of a row's period; the oldest one that is known where none was yet."""
        start = (self._zero or 0.0) + row * self._period
        middle = (start + (start + self._period)) / 2
        return next((command for at, command in reversed(self._entries) if at <= middle), self._entries[0][1])

    def send(self, time: float, command: Command) -> None:
        """Add the command for a sample of a time in s, and drop those that no look back needs."""
        self.last = command
        self._entries.append((time + self.ahead * self._period, command))
        before = time - MOST_LATE * self._period
        while len(self._entries) > 1 and self._entries[1][0] <= before:
            self._entries.popleft()

    def postpone(self, periods: int) -> None:
        """Let all commands, sent and to come, act some periods later than was thought; sooner where negative."""
        before, self.ahead = self.ahead, min(max(self.ahead + periods, 1), self._declared + MOST_LATE)
        later = (self.ahead - before) * self._period
        self._entries = deque((at + later, command) for at, command in self._entries)
