"""Looking at a board and a tracker without ever arming: what they told last, again and again, also after the cable was out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from tepm_opt.errors import InputError
from tepm_opt.hw.board.errors import LinkError, NoBoardError
from tepm_opt.hw.board.link import Link
from tepm_opt.hw.board.status import BoardStatus
from tepm_opt.hw.service.line import Line
from tepm_opt.hw.trackers import Tracker
from tepm_opt.hw.trackers.frames import Frame

PERIOD, RETRY = 0.1, 0.5
"""Seconds between two readings, and between two attempts to open a line that is gone."""
SILENT, BOOTING = 0.5, 3.0
"""Seconds after which a board is called silent, and in which one that has just got power may not answer yet."""


@dataclass(frozen=True, eq=False)
class MonitorReading:
    """Readings of board and tracker at one time.

    Attributes:
        time: since the start in s.
        words: the state in words, or what is wrong with the line.
        status: the board's last, None where the line is gone or nothing came yet.
        rate: STATUS a second over the last second.
        lost, bad: STATUS that never came and damaged frames since the line was opened.
        frame: the tracker's last, None before the first.
        tracker: the tracker in words; empty where there is none.
        monitored: whether the board has inputs for pressure monitors, as far as it said.
    """

    time: float
    words: str
    status: BoardStatus | None
    rate: float
    lost: int
    bad: int
    frame: Frame | None
    tracker: str
    monitored: bool = True

    def __repr__(self) -> str:
        return f"MonitorReading({self.time:.1f} s, {self.words}, {self.rate:.0f} STATUS a second)"


class Monitor:
    """Readings, one every `PERIOD`; ends where a recording ends.

    Args:
        opens: opens the line, again where it was gone.
        tracker: of the robot, None without one. It is the caller's to close.
        pause: lets time pass where there is no line.

    Raises:
        InputError: when it is made: the line cannot be opened.
    """

    def __init__(self, opens: Callable[[], Line], tracker: Tracker | None = None, pause: Callable[[float], None] = time.sleep) -> None:
        self._opens, self._tracker, self._pause = opens, tracker, pause
        self._line = opens()
        self._link: Link | None = self._line.link()
        self._time, self._gone = 0.0, ""
        self._frame: Frame | None = None
        self._no_board: NoBoardError | None = None
        self._seen: list[tuple[float, int]] = []
        self._torn: int | None = None  # frames damaged before the first STATUS: opening a port cuts into one

    @property
    def recorded(self) -> bool:
        """Whether this is a recording."""
        return self._line.recorded

    def __iter__(self) -> Iterator[MonitorReading]:
        """Read until the caller has seen enough."""
        greeted = self._line.recorded
        while True:
            if self._link is None:
                greeted = self._reopen()
            else:
                try:
                    begin = self._line.clock()
                    if not greeted:
                        greeted = self._greet(self._link)
                    self._link.wait(lambda: False, PERIOD)
                    self._time += self._line.clock() - begin
                except EOFError:
                    return
                except LinkError as error:
                    self.close()
                    self._gone = str(error)
            yield self._read_all()

    def close(self) -> None:
        """Give the line free."""
        if self._link is not None:
            self._link.close()
            self._link = None

    def _greet(self, link: Link) -> bool:
        """Ask the board who it is, which is what makes it talk to a host; whether it answered."""
        if link.status is None:
            try:
                link.hello(PERIOD)
            except NoBoardError as error:
                self._no_board = error
        return link.status is not None

    def _reopen(self) -> bool:
        self._pause(RETRY)
        self._time += RETRY
        try:
            self._line = self._opens()
        except InputError:
            return False
        self._link, self._gone = self._line.link(), ""
        self._seen.clear()
        self._torn = None
        return False

    def _read_all(self) -> MonitorReading:
        status = None if self._link is None else self._link.status
        while self._tracker is not None and (frame := self._tracker.read(0.0)) is not None:
            self._frame = frame
        statistics = None if self._link is None else self._link.statistics
        if statistics is not None and status is not None and self._torn is None:
            self._torn = statistics.bad
        lost, bad = (statistics.lost, statistics.bad - (self._torn or 0)) if statistics else (0, 0)
        monitored = self._link is None or self._link.monitored
        words = self._words(status), self._tracker_words()
        return MonitorReading(self._time, words[0], status, self._rate(), lost, bad, self._frame, words[1], monitored)

    def _rate(self) -> float:
        if self._link is None:
            return 0.0
        self._seen = [(at, count) for at, count in self._seen if at > self._time - 1.05]
        self._seen.append((self._time, self._link.statistics.received))
        (first, before), (last, after) = self._seen[0], self._seen[-1]
        return (after - before) / (last - first) if last > first else 0.0

    def _words(self, status: BoardStatus | None) -> str:
        if self._gone:
            return f"{self._gone}; trying to open it again"
        if status is None:
            if self._no_board is None or self._time < BOOTING:
                return "no answer from the board yet"
            return str(NoBoardError(self._no_board.overheard, round(self._time)))  # what came instead is heard all the time
        silent = self._line.clock() - status.time
        return f"the board is silent for {silent:.1f} s; before: {status.describe()}" if silent > SILENT else status.describe()

    def _tracker_words(self) -> str:
        if self._tracker is None:
            return ""
        said = self._tracker.status
        if said != "ok" or self._frame is None:
            return said if said != "ok" else "tracker: no pose yet"
        return self._frame.status
