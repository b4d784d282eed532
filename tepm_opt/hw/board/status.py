"""Status of a board, and its decoding."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from statistics import median

from tepm_opt.hw.board.protocol import Fault, ResetCause, Result, State

STATES = {
    State.IDLE: "IDLE",
    State.ARMED: "ARMED",
    State.HOST_TIMEOUT: "HOST_TIMEOUT: the host was silent; motors are off and pressure went to zero",
    State.ESTOP: "ESTOP: the emergency stop was used; release the button",
    State.FAULT: "FAULT",
}
FAULTS = {
    Fault.NONE: "none",
    Fault.RESET_WHILE_ARMED: "the board was reset while the robot was armed",
    Fault.TRAVEL: "motor {actuator} winds without end: is its tendon fixed?",
    Fault.DYNAMOMETER: "dynamometer {actuator} is open or shorted, or has a loose contact",
    Fault.TENSION_TOO_HIGH: "tendon {actuator} was pulled harder than allowed",
    Fault.MONITOR: "the pressure monitor of regulator {actuator} is open or shorted",
    Fault.REGULATOR: "regulator {actuator} does not follow its set point",
    Fault.PRESSURE_TOO_HIGH: "regulator {actuator} gives more pressure than allowed",
    Fault.BUS: "a DAC does not answer on the two-wire bus",
    Fault.LOOP_HUNG: "the firmware's main loop hung",
}
REASONS = {
    Result.WRONG_STATE: "not in this state",
    Result.WRONG_SESSION: "something happened since it told its state last; try again",
    Result.ESTOP_PRESSED: "the emergency stop is pressed, or its wire is broken",
    Result.DYNAMOMETER: "dynamometer {actuator} is open or shorted",
    Result.UNKNOWN_KEY: "it does not know this setting",
    Result.OUT_OF_RANGE: "the value is out of its range",
    Result.MONITOR: "the pressure monitor of regulator {actuator} does not show what the regulator was told",
    Result.WRONG_LIMITS: "its limits or calibration are not those of the robot file",
    Result.BUS: "a DAC does not answer on the two-wire bus",
}


@dataclass(frozen=True)
class Hello:
    """Description that a board gives of itself.

    Attributes:
        version: of the protocol that it speaks.
        channels: actuators that it drives.
        monitors: pressure monitors that it has inputs for.
        reset_cause: why it started last; a boot loader may hide that.
        state, session: when it said so.
        build: identifies the firmware.
        limits: CRC of the limits and calibration that it was compiled with.
        timeout_ms: of a silent host.
    """

    version: int
    channels: int
    monitors: int
    reset_cause: int
    state: State
    session: int
    build: int
    limits: int
    timeout_ms: int

    def __repr__(self) -> str:
        return f"Hello({self.describe()})"

    def describe(self) -> str:
        """One line for people."""
        causes = ", ".join(cause.name.lower().replace("_", " ") for cause in ResetCause if self.reset_cause & cause) or "unknown"
        return f"firmware {self.build:08x}, protocol {self.version}, {self.channels} actuators, last reset: {causes}"


@dataclass(frozen=True)
class BoardStatus:
    """Content of one STATUS of a board.

    Attributes:
        time: on the host's clock, when it came, in s.
        uptime_ms: the board's own clock without its wraps: since its start, or since this program heard of it first if that was later.
        state: of the board.
        faults: bits of all faults since CLEAR.
        fault, channel: the gravest of them, and the actuator (from 0) that it is about.
        session: another one after each start, ARM, stop and CLEAR.
        sequence: of the set point that it acts on, modulo 65,536.
        count: of STATUS messages, modulo 256.
        enabled: bits of the motors that are on.
        good, bad: frames that it understood and not.
        refused: set points beyond its limits, modulo 256.
        stale: set points that were old, of another session, or came while it was not armed, modulo 256.
        late: passes of its main loop that took too long.
        time_ms: the board's own clock, modulo 2³².
        dynamometers, monitors: counts, (6,).
        positions: of the motors in steps, (6,).
    """

    time: float
    uptime_ms: int
    sequence: int
    count: int
    session: int
    state: State
    faults: int
    fault: Fault
    channel: int
    enabled: int
    good: int
    bad: int
    refused: int
    stale: int
    late: int
    time_ms: int
    dynamometers: tuple[int, ...]
    monitors: tuple[int, ...]
    positions: tuple[int, ...]

    def __repr__(self) -> str:
        return f"BoardStatus({self.time:.3f} s, {self.describe()}, set point {self.sequence})"

    @property
    def start(self) -> int:
        """Number of the board's start: half of the session's."""
        return self.session >> 16

    def describe(self) -> str:
        """The state in words, with all faults, the gravest first."""
        words = STATES[self.state]
        shown = Fault.NONE
        if self.state is State.FAULT:
            shown = self.fault
            words += f": {FAULTS[shown].format(actuator=self.channel + 1)}"
        others = [fault.name for fault in sorted(Fault, reverse=True) if self.faults & fault.bit and fault is not shown]
        return f"{words}; {'also ' if shown else 'found: '}{', '.join(others)}" if others else words


@dataclass
class LinkStatistics:
    """Counts of frames that went over the line so far.

    Attributes:
        sent, received: frames.
        bad: frames that came damaged.
        lost: STATUS messages that never came.
        latencies: of the last set points in s, from sending to the STATUS that acknowledges them.
    """

    sent: int = 0
    received: int = 0
    bad: int = 0
    lost: int = 0
    latencies: deque[float] = field(default_factory=lambda: deque(maxlen=1000))

    def __repr__(self) -> str:
        return f"LinkStatistics({self.describe()})"

    def describe(self) -> str:
        """One line for people."""
        latency = f"{1e3 * median(self.latencies):.1f} ms" if self.latencies else "unknown"
        return f"{self.sent} sent, {self.received} received, {self.bad} damaged, {self.lost} lost, latency {latency}"
