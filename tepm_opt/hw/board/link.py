"""The conversation with a board: requests and answers, set points, and what is known of the board's state."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.limits import Limits, told
from tepm_opt.hw.board.linklog import RECEIVED, SENT, LinkLog
from tepm_opt.hw.board.ports import Clock, Port
from tepm_opt.hw.board.protocol import ACK, ASK, HELLO, LIMITS, REQUESTS, SET, STATUS, Fault, Message, ResetCause, Result, State

TRIES, PATIENCE = 5, 0.05
"""How often a request is sent, and seconds until it is sent again."""


class LinkError(RuntimeError):
    """The board does not answer, refuses, or the line to it is gone."""


@dataclass(frozen=True)
class Hello:
    """What a board says about itself.

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
    """What a board told with one STATUS.

    Attributes:
        time: on the host's clock, when it came, in s.
        state: of the board.
        faults: bits of all faults since CLEAR.
        fault, channel: the gravest of them, and the actuator (from 0) that it is about.
        session: another one after each start, ARM, stop and CLEAR.
        sequence: of the set point that it acts on, modulo 65,536.
        count: of STATUS messages.
        enabled: bits of the motors that are on.
        good, bad: frames that it understood and not.
        refused: set points beyond its limits.
        stale: set points that were old, of another session, or came while it was not armed.
        late: passes of its main loop that took too long.
        time_ms: the board's own clock.
        dynamometers, monitors: counts, (6,).
        positions: of the motors in steps, (6,).
    """

    time: float
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

    def describe(self) -> str:
        """The state in words."""
        if self.state is State.FAULT:
            return f"FAULT: {FAULTS[self.fault].format(actuator=self.channel + 1)}"
        return STATES[self.state]


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


@dataclass
class LinkStatistics:
    """What went over the line so far.

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


class Link:
    """A line to a board, listened to by a thread, or — where time is virtual — whenever something is waited for.

    Args:
        port: the line.
        clock: tells the time in s.
        log: notes every byte.
        threaded: False where `port.read` lets virtual time pass.

    Attributes:
        status: the last one, None before the first.
        statistics: what went over the line.
    """

    def __init__(self, port: Port, clock: Clock, log: LinkLog | None = None, threaded: bool = True) -> None:
        self._port, self._clock, self._log = port, clock, log
        self.status: BoardStatus | None = None
        self.statistics = LinkStatistics()
        self._decoder = protocol.Decoder(protocol.TO_HOST)
        self._hello: Hello | None = None
        self._limits: Limits | None = None
        self._acks: dict[int, dict[str, Any]] = {}
        self._sent_at: dict[int, float] = {}
        self._sequence = self._id = self._session = self._armed_session = 0
        self._failure: Exception | None = None
        self._news = threading.Condition(threading.RLock())
        self._closed = False
        self._thread = threading.Thread(target=self._listen, name="board", daemon=True) if threaded else None
        if self._thread:
            self._thread.start()

    def hello(self, timeout: float = 5.0) -> Hello:
        """What the board says about itself; it may be starting.

        Raises:
            LinkError: it says nothing in time, or speaks another protocol.
        """
        self._hello = None
        end = self._clock() + timeout
        while self._hello is None:
            if self._clock() >= end:
                raise LinkError(f"no answer from the board within {timeout:g} s: is the firmware on it, and is the baud rate its own?")
            self.send(ASK, id=self._next_id())
            self.wait(lambda: self._hello is not None, 0.25)
        if self._hello.version != protocol.VERSION:
            raise LinkError(
                f"the board speaks version {self._hello.version} of the protocol, this program version {protocol.VERSION}; "
                "flash the firmware that comes with this program"
            )
        return self._hello

    def limits(self, timeout: float = 1.0) -> Limits:
        """What the board was compiled with.

        Raises:
            LinkError: it does not say so in time.
        """
        end = self._clock() + timeout
        while self._limits is None:
            if self._clock() >= end:
                raise LinkError(f"the board does not tell its limits within {timeout:g} s")
            self.send(ASK, id=self._next_id())
            self.wait(lambda: self._limits is not None, 0.25)
        return self._limits

    def request(self, kind: Message, **values: int) -> protocol.Values:
        """Ask for something, wait until it is done, and give the answer.

        Raises:
            LinkError: it was refused, or there is no answer.
        """
        number = self._next_id()
        for _ in range(TRIES):
            self.send(kind, id=number, **values)
            if self.wait(lambda: number in self._acks, PATIENCE):
                break
        else:
            raise LinkError(f"the board does not answer {kind.name}; it stops by itself when nothing comes")
        answer = self._acks.pop(number)
        if answer["result"] != Result.DONE:
            reason = REASONS.get(answer["result"], "it says why in a way that this program does not know").format(
                actuator=answer["channel"] + 1
            )
            raise LinkError(f"the board refuses {kind.name}: {reason} (it is {State(answer['state']).name})")
        return answer

    def arm(self, limits: int) -> None:
        """Arm the board, which has to be IDLE.

        Args:
            limits: CRC of the limits and calibration that the robot file asks for.

        Raises:
            LinkError: as for `request`.
        """
        self._sequence = 0
        self._sent_at.clear()
        self._armed_session = self.request(protocol.ARM, session=self._session, limits=limits)["session"]

    def clear(self) -> None:
        """Lead the board from a stop or fault to IDLE.

        Raises:
            LinkError: as for `request`.
        """
        self.request(protocol.CLEAR, session=self._session)
        asked = self._clock()
        self.wait(lambda: self.status is not None and self.status.time > asked, 0.5)

    def configure(self, key: protocol.Key, value: int) -> None:
        """Change a setting of the board until it is reset.

        Raises:
            LinkError: as for `request`.
        """
        self.request(protocol.CONFIG, session=self._session, key=int(key), value=value)

    def set(self, enabled: int, pressures: list[int], tendons: list[int]) -> None:
        """Send a set point; the newest wins."""
        self._sequence += 1
        self._sent_at[self._sequence % 65536] = self._clock()
        self.send(SET, session=self._armed_session, sequence=self._sequence, enabled=enabled, pressures=pressures, tendons=tendons)

    def send(self, kind: Message, **values: int | list[int]) -> None:
        """Send a message.

        Raises:
            LinkError: the line is gone.
        """
        data = protocol.frame(kind.pack(**values))
        if self._log:
            self._log(SENT, data)
        try:
            self._port.write(data)
        except OSError as error:
            raise self._gone(error) from error
        self.statistics.sent += 1

    def wait(self, until: Callable[[], bool], timeout: float) -> bool:
        """Wait for news until something is true, at most `timeout` s; whether it is.

        Raises:
            LinkError: the line is gone.
        """
        end = self._clock() + timeout
        with self._news:
            while not until():
                left = end - self._clock()
                if self._failure is not None:
                    raise self._gone(self._failure)
                if left <= 1e-9:
                    return False
                if self._thread:
                    self._news.wait(min(left, 0.1))
                else:
                    self.listen(left)
        return True

    def listen(self, timeout: float = 0.0) -> None:
        """Take what has come; where no thread does that, and waiting at most so long for it.

        Raises:
            LinkError: the line is gone.
        """
        if self._failure is not None:
            raise self._gone(self._failure)
        if self._thread:
            return
        try:
            self._take(self._port.read(timeout))
        except OSError as error:
            raise self._gone(error) from error

    def close(self) -> None:
        """Stop listening and give the line free."""
        self._closed = True
        if self._thread and self._thread is not threading.current_thread():
            self._thread.join(timeout=1.0)
        self._port.close()
        if self._log:
            self._log.close()

    def _next_id(self) -> int:
        self._id = (self._id + 1) % 256
        self._acks.pop(self._id, None)
        return self._id

    def _gone(self, error: Exception) -> LinkError:
        return LinkError(f"the line to the board is gone: {error}")

    def _listen(self) -> None:
        while not self._closed:
            try:
                data = self._port.read(0.02)
                with self._news:
                    self._take(data)
                    self._news.notify_all()
            except (OSError, TypeError, AttributeError, EOFError, ValueError) as error:  # the port was closed; or a state nobody knows
                with self._news:
                    self._failure = error
                    self._news.notify_all()
                return

    def _take(self, data: bytes) -> None:
        if self._log:
            self._log(RECEIVED, data)
        now = self._clock()
        for kind, values in self._decoder.feed(data):
            self.statistics.received += 1
            if kind is LIMITS:
                self._limits = told(values)
                continue
            self._session = values["session"]
            if kind is STATUS:
                self._take_status(now, values)
            elif kind is HELLO:
                self._hello = Hello(**{**values, "state": State(values["state"])})
            elif kind is ACK and values["request"] in {request.code for request in REQUESTS}:
                self._acks[values["id"]] = values
        self.statistics.bad = self._decoder.bad

    def _take_status(self, now: float, values: dict[str, Any]) -> None:
        last = self.status
        self.status = BoardStatus(now, **{**values, "state": State(values["state"]), "fault": Fault(values["fault"])})
        if last is not None and self.status.time_ms > last.time_ms:
            self.statistics.lost += (self.status.count - last.count - 1) % 256
        sent = self._sent_at.pop(self.status.sequence, None)
        if sent is not None:
            self.statistics.latencies.append(now - sent)
