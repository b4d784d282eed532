"""The conversation with a board: requests and answers, set points, and what is known of the board's state."""

from __future__ import annotations

import struct
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TypeVar

from tepm_opt.errors import InputError
from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.errors import FLASH, LinkError, NoBoardError, RefusedError
from tepm_opt.hw.board.limits import Limits
from tepm_opt.hw.board.linklog import RECEIVED, SENT, LinkLog
from tepm_opt.hw.board.ports import Clock, Port
from tepm_opt.hw.board.protocol import ACK, ARM, ASK, CLEAR, CONFIG, HELLO, LIMITS, SET, STATUS, Fault, Message, Result, State
from tepm_opt.hw.board.status import REASONS, BoardStatus, Hello, LinkStatistics
from tepm_opt.hw.board.strangers import Overheard

TRIES, PATIENCE = 5, 0.05
"""Number of times that a request is sent, and seconds until it is sent again."""
SILENT = 0.2
"""Seconds without STATUS, or without one that acknowledges set points, after which none is sent any more."""
VENTING, AGAIN = 2.0, 0.1
"""Seconds for which CLEAR is tried while monitors still show pressure, and between two tries."""


@dataclass(frozen=True)
class _Arming:
    """Since when the board is armed, in which session, and what it had counted before."""

    time: float
    session: int
    refused: int
    stale: int


class Link:
    """A line to a board, listened to by a thread, or — where time is virtual — whenever something is waited for.

    Several threads may send.

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
        self._overheard = Overheard()
        self._hello: Hello | None = None
        self._limits: Limits | None = None
        self._answers: dict[tuple[int, int], protocol.Values | None] = {}  # of the requests that wait for one, by id and code
        self._unconfirmed: deque[tuple[int, float]] = deque(maxlen=4096)  # set points and when they were sent, oldest first
        self._sequence = self._id = self._session = 0
        self._arming: _Arming | None = None
        self._failure: LinkError | None = None
        self._news = threading.Condition(threading.RLock())
        self._sending = threading.RLock()  # taken before that of the news, never while holding it
        self._closed = False
        self._thread = threading.Thread(target=self._listen, name="board", daemon=True) if threaded else None
        if self._thread:
            self._thread.start()

    def hello(self, timeout: float = 5.0) -> Hello:
        """Ask the board about itself; it may be starting.

        Raises:
            NoBoardError: nothing answers in time, or something else does.
            LinkError: it speaks another protocol.
        """
        self._hello = None
        end = self._clock() + timeout
        while self._hello is None:
            if self._clock() >= end:
                raise NoBoardError(self._overheard, timeout)
            self.send(ASK, id=self._next_id())
            self.wait(lambda: self._hello is not None, 0.25)
        if self._hello.version != protocol.VERSION:
            raise LinkError(
                f"the board speaks version {self._hello.version} of the protocol, this program version {protocol.VERSION}; {FLASH}"
            )
        return self._hello

    @property
    def monitored(self) -> bool:
        """Whether the board has inputs for pressure monitors; taken for granted until it says so."""
        return self._hello is None or self._hello.monitors > 0

    def limits(self, timeout: float = 1.0) -> Limits:
        """Ask for the limits that the board was compiled with.

        Raises:
            LinkError: it does not say so in time, or not what its CRC in HELLO is of.
        """
        end = self._clock() + timeout
        while self._limits is None or self._hello is None:
            if self._clock() >= end:
                raise LinkError(f"the board does not tell its limits within {timeout:g} s")
            self.send(ASK, id=self._next_id())
            self.wait(lambda: self._limits is not None and self._hello is not None, 0.25)
        if self._limits.check != self._hello.limits:
            raise LinkError(f"the board's limits have the CRC {self._limits.check:04x}, it tells {self._hello.limits:04x}; {FLASH}")
        return self._limits

    def request(self, kind: Message, tries: int = TRIES, **values: int) -> protocol.Values:
        """Ask for something, wait until it is done, and give the answer.

        Args:
            kind: of the request.
            tries: how often it is sent while no answer comes.
            values: of its fields, but for `id`.

        Raises:
            LinkError: it was refused (`RefusedError`), or there is no answer.
        """
        number = self._next_id()
        key = number, kind.code
        self._answers[key] = None
        try:
            for _ in range(tries):
                self.send(kind, id=number, **values)
                if self.wait(lambda: self._answers[key] is not None, PATIENCE):
                    break
            answer = self._answers[key]
        finally:
            del self._answers[key]
        if answer is None:
            raise LinkError(f"the board does not answer {kind.name}; it stops by itself when nothing comes")
        state = _decode_member(State, answer["state"])
        if answer["result"] != Result.DONE:
            reason = REASONS.get(answer["result"], "it says why in a way that this program does not know")
            why = reason.format(actuator=answer["channel"] + 1)
            raise RefusedError(f"the board refuses {kind.name}: {why} (it is {state.name})", answer["result"])
        return answer

    def arm(self, limits: int) -> None:
        """Arm the board, which has to be IDLE and to have told its state.

        Args:
            limits: CRC of the limits and calibration that the robot file asks for.

        Raises:
            LinkError: as for `request`; or it acknowledges, but is not armed.
        """
        self._arming = None
        before = self.status
        if before is None:
            raise LinkError("the board has not told its state yet")
        answer = self.request(ARM, session=self._session, limits=limits)
        if answer["state"] != State.ARMED:
            raise LinkError(f"the board was armed and left that at once: it is {_decode_member(State, answer['state']).name}")
        with self._news:
            self._sequence = 0
            self._unconfirmed.clear()
            self._arming = _Arming(self._clock(), answer["session"], before.refused, before.stale)

    def confirm(self) -> None:
        """Raise unless the board is heard, is armed, and acts on the set points that it is sent.

        Raises:
            LinkError: it says nothing, has stopped the robot, or ignores set points; or the line is gone.
        """
        self.listen()
        with self._news:
            now, status, arming = self._clock(), self.status, self._arming
            if self._failure is not None:
                raise self._failure
            if status is None or arming is None:
                raise LinkError("the board is not armed")
            silent = now - max(status.time, arming.time)
            if silent > SILENT:
                raise LinkError(f"the board has said nothing for {silent:.2f} s; no set points are sent any more")
            if status.time > arming.time:
                if status.state is not State.ARMED:
                    raise LinkError(f"the board stopped the robot: {status.describe()}")
                if status.session != arming.session:
                    raise LinkError("the board was armed by somebody else")
                if status.refused != arming.refused:
                    raise LinkError("the board refuses set points: they are beyond its limits")
                if status.stale != arming.stale:
                    raise LinkError("the board ignores set points: they are old, or of another session. Does another program send?")
            waited = now - self._unconfirmed[0][1] if self._unconfirmed else 0.0
            if waited > SILENT and silent < SILENT / 2:
                raise LinkError(f"the board tells its state, but has acted on no set point for {waited:.2f} s; none is sent any more")

    def clear(self) -> None:
        """Lead the board from a stop or fault to IDLE. Where pressure has not gone yet that may take some time.

        Raises:
            LinkError: as for `request`.
        """
        end = self._clock() + VENTING
        while True:
            try:
                session = self.request(CLEAR, session=self._session)["session"]
                break
            except RefusedError as error:
                if error.result != Result.MONITOR or self._clock() >= end:
                    raise
            self.wait(lambda: False, AGAIN)
        self._arming = None
        self.wait(lambda: self.status is not None and self.status.session == session, 0.5)

    def configure(self, key: protocol.Key, value: int) -> None:
        """Change a setting of the board until it is reset.

        Raises:
            InputError: a value that the message cannot hold.
            LinkError: as for `request`.
        """
        self.request(CONFIG, session=self._session, key=int(key), value=value)

    def set(self, enabled: int, pressures: list[int], tendons: list[int]) -> None:
        """Send a set point; the newest wins.

        Raises:
            InputError: a value that the message cannot hold.
            LinkError: the board was not armed, or the line is gone.
        """
        with self._sending:
            arming = self._arming
            if arming is None:
                raise LinkError("the board is not armed")
            with self._news:
                self._sequence += 1
                self._unconfirmed.append((self._sequence, self._clock()))
            self.send(SET, session=arming.session, sequence=self._sequence, enabled=enabled, pressures=pressures, tendons=tendons)

    def send(self, kind: Message, **values: int | list[int]) -> None:
        """Send a message.

        Raises:
            InputError: a value that the message cannot hold.
            LinkError: the line is gone.
        """
        try:
            data = protocol.frame(kind.pack(**values))
        except struct.error as error:
            told = ", ".join(f"{name} = {value}" for name, value in values.items())
            raise InputError(f"message {kind.name} to the board with {told}: {error}") from error
        with self._sending:
            if self._log:
                self._log(SENT, data)
            try:
                self._port.write(data)
            except OSError as error:
                raise _convert_to_link_error(error) from error
            self.statistics.sent += 1

    def wait(self, until: Callable[[], bool], timeout: float) -> bool:
        """Wait for news until something is true, at most `timeout` s; whether it is.

        Raises:
            LinkError: the line is gone, or something came that nobody knows.
        """
        end = self._clock() + timeout
        with self._news:
            while not until():
                left = end - self._clock()
                if self._failure is not None:
                    raise self._failure
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
            LinkError: the line is gone, or something came that nobody knows.
        """
        if self._failure is not None:
            raise self._failure
        if self._thread:
            return
        try:
            self._take(self._port.read(timeout))
        except OSError as error:
            raise _convert_to_link_error(error) from error
        except LinkError as error:
            self._failure = error
            raise

    def close(self) -> None:
        """Stop listening and give the line free."""
        self._closed = True
        if self._thread and self._thread is not threading.current_thread():
            self._thread.join(timeout=1.0)
        self._port.close()
        if self._log:
            self._log.close()

    def _next_id(self) -> int:
        with self._sending:
            self._id = (self._id + 1) % 256
            return self._id

    def _listen(self) -> None:
        while not self._closed:
            try:
                data = self._port.read(0.02)
                with self._news:
                    self._take(data)
                    self._news.notify_all()
            except Exception as error:  # whatever ends this thread: those who wait, or want to send set points, have to hear of it
                with self._news:
                    self._failure = error if isinstance(error, LinkError) else _convert_to_link_error(error)
                    self._news.notify_all()
                return

    def _take(self, data: bytes) -> None:
        if self._log:
            self._log(RECEIVED, data)
        now = self._clock()
        if self._decoder.good == 0:
            self._overheard.take(data)
        for kind, values in self._decoder.feed(data):
            self.statistics.received += 1
            if kind is LIMITS:
                self._limits = Limits(**values)
                continue
            self._session = values["session"]
            if kind is STATUS:
                self._take_status(now, values)
            elif kind is HELLO:
                self._hello = Hello(**{**values, "state": _decode_member(State, values["state"])})
            elif kind is ACK and (key := (values["id"], values["request"])) in self._answers:
                self._answers[key] = values
        self.statistics.bad = self._decoder.bad

    def _take_status(self, now: float, values: dict[str, Any]) -> None:
        last, up = self.status, values["time_ms"]
        if last is not None and last.start == values["session"] >> 16:
            up = last.uptime_ms + (up - last.time_ms) % 2**32
            self.statistics.lost += (values["count"] - last.count - 1) % 256
        known = {"state": _decode_member(State, values["state"]), "fault": _decode_member(Fault, values["fault"])}
        self.status = BoardStatus(now, up, **{**values, **known})
        if self._arming is not None and self.status.session == self._arming.session:
            self._acknowledge(now, self.status.sequence)

    def _acknowledge(self, now: float, low: int) -> None:
        """Strike off the set points up to the one whose number has these lower 16 bits."""
        while self._unconfirmed and (low - self._unconfirmed[0][0]) % 0x10000 < 0x8000:
            sequence, sent = self._unconfirmed.popleft()
            if sequence % 0x10000 == low:
                self.statistics.latencies.append(now - sent)


Known = TypeVar("Known", bound=IntEnum)


def _decode_member(kind: type[Known], value: int) -> Known:
    """Decode a value that a board told.

    Raises:
        LinkError: this program does not know it.
    """
    try:
        return kind(value)
    except ValueError as error:
        raise LinkError(f"the board tells {kind.__name__.lower()} {value}, which this program does not know; {FLASH}") from error


def _convert_to_link_error(error: Exception) -> LinkError:
    if isinstance(error, OSError | TypeError | AttributeError | EOFError):  # the second and third come from a port that was closed
        return LinkError(f"the line to the board is gone: {error}")
    return LinkError(f"what came from the board cannot be understood: {error!r}")
