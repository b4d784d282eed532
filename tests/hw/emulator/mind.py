"""A state that the board may be in, and what moves it to another: from docs/how-to/hardware.md, not from the firmware."""

from __future__ import annotations

from typing import Any, NamedTuple

from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.protocol import Fault, Key, Result, State
from tests.hw.emulator.causes import LIMITS

NOBODY = frozenset([0])
"""What an answer that is about no actuator says about which it is."""
RANGES = {Key.STATUS_PERIOD_MS: (5, 100), Key.PRESSURE_SLEW: (1, 2912), Key.STEP_RATE: (1, 9524), Key.STEPS_PER_1000_COUNTS: (1, 900)}


class Mind(NamedTuple):
    """A state that the board may be in.

    Attributes:
        state, session, sequence, faults, enabled, outputs: as the firmware would tell; session -1: not told yet.
        heard: its clock at the last sign of life.
        armed: record in which it was armed.
        goal: index of the last set point that was taken in this arming; -1: none.
        good, bad, refused, stale: counters; -1: not known, after bytes that may have been lost.
        last, result, channels: the last request and its answer.
        pending: record of the request that is not answered yet; -1: none.
        frame, answer: the next frame to be read, the next ACK to be given.
        hung: whether the step interrupt has switched everything off.
    """

    frame: int
    answer: int
    state: State = State.IDLE
    session: int = -1
    sequence: int = 0
    faults: int = 0
    enabled: int = 0
    outputs: bool = True
    heard: int = 0
    armed: int = 0
    goal: int = -1
    good: int = 0
    bad: int = 0
    refused: int = 0
    stale: int = 0
    last: bytes = b""
    result: int = 0
    channels: frozenset[int] = NOBODY
    pending: int = -1
    hung: bool = False

    def counted(self, torn: bool, **names: int) -> Mind:
        """With counters one up; unknown after frames of which some may have been lost."""
        if torn:
            return self._replace(good=-1, bad=-1, refused=-1, stale=-1)
        return self._replace(**{name: value + 1 if value >= 0 else -1 for name, value in ((n, getattr(self, n)) for n in names)})

    def renewed(self) -> Mind:
        """In a new session."""
        session = -1 if self.session < 0 else (self.session & 0xFFFF0000) | (self.session + 1 & 0xFFFF)
        return self._replace(session=session, sequence=0)

    def left(self, to: State) -> Mind:
        """Out of ARMED, or from one stop to another."""
        mind = self.renewed() if self.state == State.ARMED else self
        return mind._replace(state=to, enabled=0, goal=-1)

    def stopped(self) -> Mind:
        """After the emergency stop."""
        return self.left(State.ESTOP)._replace(outputs=False)

    def failed(self, fault: Fault) -> Mind:
        """With a fault."""
        if self.faults & fault.bit:
            return self
        mind = self if self.state == State.ESTOP else self.left(State.FAULT)
        return mind._replace(faults=self.faults | fault.bit, outputs=self.outputs and fault < Fault.MONITOR)


def allowed(values: dict[str, Any]) -> bool:
    """Whether a set point is within the limits."""
    steps = values["enabled"] & protocol.POSITION_MODE
    most = LIMITS.position_max if steps else LIMITS.tension_max
    return (
        not values["enabled"] & 0x40
        and all(value <= LIMITS.pressure_max for value in values["pressures"])
        and all(0 <= value <= most for value in values["tendons"])
    )


def configured(values: dict[str, Any], session: int) -> Result:
    """The answer to CONFIG in a session."""
    if values["session"] != session:
        return Result.WRONG_SESSION
    if values["key"] not in list(Key):
        return Result.UNKNOWN_KEY
    low, high = RANGES[Key(values["key"])]
    return Result.DONE if low <= values["value"] <= high else Result.OUT_OF_RANGE
