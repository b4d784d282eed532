"""Everything that went over a line to a board, in a text file that can be played back: `time_s > hex` was sent, `time_s < hex` came."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

from tepm_opt.errors import InputError
from tepm_opt.hw.board.ports import Clock

SENT, RECEIVED = ">", "<"
_FLUSH = 0.5
"""Seconds after which lines are on the disk at the latest."""


class LinkLog:
    """Writes such a file; safe to use from several threads.

    Raises:
        InputError: the file cannot be written.
    """

    def __init__(self, path: str | Path, clock: Clock) -> None:
        self.path, self._clock, self._lock = Path(path), clock, threading.Lock()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("w", encoding="ascii")
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from error
        self._start = self._flushed = clock()

    def __call__(self, direction: str, data: bytes) -> None:
        """Note bytes that were sent or came just now."""
        with self._lock:
            if self._file.closed or not data:
                return
            now = self._clock()
            self._file.write(f"{now - self._start:.6f} {direction} {data.hex()}\n")
            if now - self._flushed > _FLUSH:
                self._flushed = now
                self._file.flush()

    def close(self) -> None:
        """Write out all lines to the disk."""
        with self._lock:
            self._file.close()


def read_log(path: str | Path) -> Iterator[tuple[float, str, bytes]]:
    """Time in s since the log began, `>` or `<`, and bytes, line by line; a torn last line is left out.

    Raises:
        InputError: unreadable, or not such a file; names the line.
    """
    try:
        lines = Path(path).read_text(encoding="ascii").split("\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a log of a serial line") from error
    for number, line in enumerate(lines[:-1], start=1):
        try:
            time, direction, data = line.split(" ")
            if direction not in (SENT, RECEIVED):
                raise ValueError
            yield float(time), direction, bytes.fromhex(data)
        except ValueError as error:
            raise InputError(f"{path}: line {number}: {line[:40]!r}; valid: time, > or <, bytes in hex") from error


class PlaybackPort:
    """What came over a line, once more at the same times; what is sent is ignored. Its clock is virtual.

    Attributes:
        time: since the log began in s.
    """

    def __init__(self, path: str | Path) -> None:
        self._lines = [(time, data) for time, direction, data in read_log(path) if direction == RECEIVED]
        self._next, self.time = 0, 0.0

    def clock(self) -> float:
        """The time of the playback in s."""
        return self.time

    def read(self, timeout: float) -> bytes:
        """Read as `Port.read` does; lets the playback's time pass.

        Raises:
            EOFError: the log is over.
        """
        if self._next == len(self._lines):
            raise EOFError(f"the log ended at {self.time:.3f} s")
        time, data = self._lines[self._next]
        if time > self.time + timeout:
            self.time += timeout
            return b""
        self.time = max(self.time, time)
        self._next += 1
        return data

    def write(self, data: bytes) -> None:
        """Ignore what is sent: a recording does not answer."""

    def close(self) -> None:
        """Do nothing: a recording holds no port."""
