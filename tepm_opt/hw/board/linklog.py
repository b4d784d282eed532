"""Everything that went over a line to a board, in a text file that can be played back: `time_s > hex` was sent, `time_s < hex` came.

A line that begins with `#` is a remark.
"""

from __future__ import annotations

import contextlib
import threading
import warnings
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path

from tepm_opt.errors import InputError
from tepm_opt.hw.board.ports import Clock

SENT, RECEIVED = ">", "<"
LIMIT, FOLDER_LIMIT, KEPT_FILES = 200_000_000, 1_000_000_000, 50
"""Bytes of a session's log at most (an hour or more), bytes and files of all logs in a folder."""
_REMARK, _BEFORE = "#", ".before.log"
_FLUSH = 0.5
"""Seconds after which lines are on the disk at the latest."""
_LONGEST = 1 << 24
"""Characters of a line at most; a serial line never gives so much at once."""


class LinkLog:
    """Writes such a file; safe to use from several threads. A disk that is full ends the log with a warning, not what it is a log of.

    A session that goes on keeps the newest lines, at least half of `limit`: they tell what led to a fault. The file then goes on in a new
    one of its name, the lines before stay in `NAME.before.log`, and the first line says so.

    Args:
        path: of the file.
        clock: tells the time in s.
        limit: bytes that both parts together take at most.

    Raises:
        InputError: the file cannot be written.
    """

    def __init__(self, path: str | Path, clock: Clock, limit: int = LIMIT) -> None:
        self.path, self._clock, self._lock = Path(path), clock, threading.Lock()
        self._part, self._size, self._before, self._dropped = limit // 2, 0, 0, 0
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("w", encoding="ascii", newline="\n")
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from error
        self._start = self._flushed = clock()

    def __call__(self, direction: str, data: bytes) -> None:
        """Note bytes that were sent or came just now."""
        with self._lock:
            if self._file.closed or not data:
                return
            now = self._clock()
            line = f"{now - self._start:.6f} {direction} {data.hex()}\n"
            try:
                if self._size + len(line) > self._part:
                    self._turn_over()
                self._size += self._file.write(line)
                if now - self._flushed > _FLUSH:
                    self._flushed = now
                    self._file.flush()
            except OSError as error:
                self._give_up(error)

    def close(self) -> None:
        """Write out all lines to the disk."""
        with self._lock:
            try:
                self._file.close()
            except OSError as error:
                self._give_up(error)

    def _turn_over(self) -> None:
        """Go on in a new file."""
        self._file.close()
        self.path.replace(before := _get_earlier_path(self.path))
        self._dropped, self._before = self._dropped + self._before, self._size
        self._file = self.path.open("w", encoding="ascii", newline="\n")
        self._size = self._file.write(f"{_REMARK} goes on from {before.name}; {self._dropped} bytes of lines before that were not kept\n")

    def _give_up(self, error: OSError) -> None:
        with contextlib.suppress(OSError):
            self._file.close()
        warnings.warn(f"{self.path}: the log of the line ends here: {error.strerror or error}", RuntimeWarning, stacklevel=3)


def new_log(folder: Path, clock: Clock) -> LinkLog:
    """A log for a session that begins now, in a folder where the oldest logs make room for it.

    Raises:
        InputError: the file cannot be written.
    """
    taken = LIMIT
    for count, log in enumerate(sorted(folder.glob("link-*.log"), key=_session, reverse=True), start=1):
        with contextlib.suppress(OSError):  # another program may be tidying up, too
            taken += log.stat().st_size
            if taken > FOLDER_LIMIT or count >= KEPT_FILES:
                log.unlink()
    return LinkLog(folder / f"link-{datetime.now(UTC):%Y%m%d-%H%M%S-%f}.log", clock)


def _get_earlier_path(path: Path) -> Path:
    return path.with_name(f"{path.stem}{_BEFORE}")


def _session(path: Path) -> tuple[str, bool]:
    """Key that sorts logs by age: the date in the name, and of one session's parts the older one first."""
    return path.name.removesuffix(_BEFORE).removesuffix(".log"), not path.name.endswith(_BEFORE)


def read_log(path: str | Path) -> Iterator[tuple[float, str, bytes]]:
    """Time in s since the log began, `>` or `<`, and bytes, line by line; a torn last line is left out.

    Where the log says that it goes on from another file beside it, that one's lines come first.

    Raises:
        InputError: unreadable, or not such a file; names the line.
    """
    path = Path(path)
    if not path.name.endswith(_BEFORE) and (before := _get_earlier_path(path)).is_file() and next(_lines(path), "").startswith(_REMARK):
        yield from _entries(before)
    yield from _entries(path)


def _entries(path: Path) -> Iterator[tuple[float, str, bytes]]:
    for number, line in enumerate(_lines(path), start=1):
        if line.startswith(_REMARK):
            continue
        try:
            time, direction, data = line.split(" ")
            if direction not in (SENT, RECEIVED):
                raise ValueError
            entry = float(time), direction, bytes.fromhex(data)
        except ValueError as error:
            raise InputError(f"{path}: line {number}: {line[:40]!r}; valid: time, > or <, bytes in hex") from error
        yield entry


def _lines(path: Path) -> Iterator[str]:
    """The whole lines of a file, one after the other: it may be large."""
    try:
        with path.open(encoding="ascii", newline="\n") as file:
            while (line := file.readline(_LONGEST)).endswith("\n"):
                yield line.rstrip("\r\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a log of a serial line") from error
    if len(line) == _LONGEST:
        raise InputError(f"{path}: is not a log of a serial line")


class PlaybackPort:
    """Port that plays back what came over a line at the same times; what is sent is ignored. Its clock is virtual.

    Attributes:
        time: since the log began in s; at first, that of the first line.
    """

    def __init__(self, path: str | Path) -> None:
        lines = read_log(path)
        first = next(lines, None)
        self.time = 0.0 if first is None else first[0]
        self._lines = ((time, data) for time, direction, data in chain([first] if first else [], lines) if direction == RECEIVED)
        self._next = next(self._lines, None)

    def clock(self) -> float:
        """The time of the playback in s."""
        return self.time

    def read(self, timeout: float) -> bytes:
        """Read as `Port.read` does; lets the playback's time pass.

        Raises:
            EOFError: the log is over.
            InputError: its next line is none.
        """
        if self._next is None:
            raise EOFError(f"the log ended at {self.time:.3f} s")
        time, data = self._next
        if time > self.time + timeout:
            self.time += timeout
            return b""
        self.time = max(self.time, time)
        self._next = next(self._lines, None)
        return data

    def write(self, data: bytes) -> None:
        """Ignore what is sent: a recording does not answer."""

    def close(self) -> None:
        """Do nothing: a recording holds no port."""
