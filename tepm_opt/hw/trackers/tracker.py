"""Trackers: kinds of them, and one that is read live."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol

from tepm_opt.data.documents import Section, validate
from tepm_opt.errors import InputError
from tepm_opt.hw.trackers.frames import STALE_PERIODS, Frame, FrameAssembler, TrackerStatistics
from tepm_opt.hw.trackers.receiver import Inbox, Receiver
from tepm_opt.models.hardware import TrackerLink


class Tracker(Protocol):
    """Whatever gives frames."""

    def read(self, timeout: float) -> Frame | None:
        """The next frame newer than the last one returned, waiting at most `timeout` in s; None if there is none."""

    def close(self) -> None:
        """Let go of the tracker."""

    @property
    def status(self) -> str:
        """ "ok", or "tracker silent for 0.52 s": what to say where `read` gives None."""
        ...


class NoOptions(Section):
    """Options of a tracker that has none."""


@dataclass(frozen=True)
class TrackerKind:
    """A kind of tracker: a file of `trackers.kinds`, or an entry point `tepm_opt.trackers` of an installed package.

    Attributes:
        name: as `kind` of `[hardware.tracker]` says it.
        description: in a few words.
        receive: begins to receive what a link names into an inbox; the second argument has the kind's options.
        server: what has to run at host and port, for messages: "an OpenIGTLink server (PlusServer)".
        options: type of `options` of `[hardware.tracker]`.
        port: default port.
        units_per_m: default units of its positions.
        needs: module of another package that it imports; empty: none.
        place: names where a link's tracker is, for messages; None where it has no other place than host and port.
    """

    name: str
    description: str
    receive: Callable[[TrackerLink, Section, Inbox], Receiver]
    server: str
    options: type[Section] = NoOptions
    port: int = 0
    units_per_m: float = 1.0
    needs: str = ""
    place: Callable[[TrackerLink], str | None] = lambda _: None

    def complete_link(self, link: TrackerLink) -> TrackerLink:
        """The link with this kind's defaults for what the robot file leaves open."""
        defaults = {"port": self.port or link.port, "units_per_m": self.units_per_m}
        return link.model_copy(update={name: value for name, value in defaults.items() if name not in link.model_fields_set})

    def read_options(self, link: TrackerLink) -> Section:
        """Options of a link.

        Raises:
            InputError: an option that there is not, or a wrong value.
        """
        return validate(self.options, link.options, f"hardware.tracker.options of {self.name}")


class LiveTracker:
    """The sensors of a link, received in a thread of its own; connects, and connects again, by itself.

    Args:
        link: kind and place of the server, the sensors' names, holders and units.
        kind: of the tracker.
        clock: the host's, in s.
        stale_periods: as for `FrameAssembler`.

    Raises:
        InputError: an option of the link is wrong, or the kind's package is not installed.
    """

    def __init__(
        self, link: TrackerLink, kind: TrackerKind, clock: Callable[[], float] = time.monotonic, stale_periods: float = STALE_PERIODS
    ) -> None:
        self.kind, self.link = kind, kind.complete_link(link)
        self._clock, self._since = clock, clock()
        self._frames, self._arrived = FrameAssembler(self.link, stale_periods), threading.Condition()
        self._receiver = kind.receive(self.link, kind.read_options(link), Inbox(self._frames, self._arrived, clock))

    def read(self, timeout: float) -> Frame | None:
        """The next frame newer than the last one returned and not stale, None if none comes within `timeout` in s. Frames come in order."""
        end = self._clock() + timeout
        with self._arrived:
            while True:
                now = self._clock()
                frame = self._frames.next(now)
                if frame or now >= end:
                    return frame
                self._arrived.wait(end - now)

    @property
    def place(self) -> str:
        """Camera, serial port, or host and port, for messages."""
        return self.kind.place(self.link) or f"{self.link.host}:{self.link.port}"

    def first(self, timeout: float = 5.0) -> Frame:
        """Wait for the first frame, at most `timeout` in s.

        Raises:
            InputError: nobody answers, nothing is sent, not by all devices, or markers are said to have holders.
        """
        end = self._clock() + timeout
        while (left := end - self._clock()) > 0:
            if (frame := self.read(left)) and self._frames.seen.issuperset(self.link.devices):
                self._check_holders()
                return frame
        with self._arrived:
            seen = sorted(self._frames.seen)
        named, trouble = self.kind.place(self.link), self._receiver.trouble
        where = f"tracker at {self.place}"
        if not self._receiver.connections:
            why = f" ({trouble})" if trouble else ""
            valid = self.kind.server if named else f"host and port of {self.kind.server}"
            raise InputError(f"{where}: nothing {'is' if named else 'listens'} there{why}; valid: {valid}")
        if missing := [name for name in self.link.devices if name not in seen]:
            ended = f"; the connection ended: {trouble}" if trouble else ""
            heard = ", ".join(seen) or "none is sent"
            raise InputError(f"{where}: no poses of {', '.join(missing)} within {timeout:g} s; valid: {heard}{ended}")
        raise InputError(f"{where}: poses come, but none with a new time stamp within {timeout:g} s; valid: stamps that go on")

    def _check_holders(self) -> None:
        markers = sorted(self._frames.markers.intersection(self.link.devices))
        if markers and self.link.holders_m is not None:
            raise InputError(f"hardware.tracker.holders_m: {', '.join(markers)} are markers without a rotation; valid: leave holders_m out")

    @property
    def silent_for(self) -> float:
        """Time since the newest frame arrived, in s; before the first one, since the start."""
        return self._clock() - max(self._since, self._frames.arrival)

    @property
    def status(self) -> str:
        """ "ok", or "tracker silent for 0.52 s (closed by the server)": what to say where `read` gives None."""
        silent, trouble = self.silent_for, self._receiver.trouble
        return "ok" if silent <= self._frames.stale else f"tracker silent for {silent:.2f} s" + (f" ({trouble})" if trouble else "")

    @property
    def statistics(self) -> TrackerStatistics:
        """Counts of all that came in so far."""
        with self._arrived:
            counts, offset = dict(self._frames.counts), self._frames.clock.offset
        return TrackerStatistics(**counts, reconnects=max(self._receiver.connections - 1, 0), clock_offset=float(offset))

    def close(self) -> None:
        """Close the connection; a second time does nothing."""
        self._receiver.stop()

    def __enter__(self) -> LiveTracker:
        """The tracker itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close."""
        self.close()
