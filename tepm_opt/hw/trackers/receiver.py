"""Receiving poses in a thread of its own, from any stream of them; a connection that ends is made anew."""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.hw.trackers.frames import WAIT_PERIODS, FrameAssembler

WATCHDOG_S, CONNECT_S, RETRY_S = 1.0, 1.0, 0.05
"""Without a usable pose for so long the connection is made anew; for how long that is tried; pause between two attempts."""


def require_package(module: str, extra: str, wanted: str) -> Any:
    """Import an optional package.

    Args:
        module: its name in Python.
        extra: of this package that installs it.
        wanted: the part that needs it, for the message: "tracker natnet", "--foxglove".

    Raises:
        InputError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(f"{wanted} needs {module}, which is not installed: pip install 'tepm-opt[{extra}]'") from error


@dataclass(frozen=True, eq=False)
class Pose:
    """A server's message about one sensor.

    Attributes:
        device: name of the sensor, rigid body or marker.
        pose: of it in the tracker's frame, (4, 4), or position of a marker, (3,), in the server's units; None where it is lost.
        stamp: when it was true on the server's clock in s; 0 where the server tells no time, then its arrival stands for it.
    """

    device: str
    pose: np.ndarray | None
    stamp: float = 0.0


class Stream(Protocol):
    """A connection to a server."""

    def poll(self, timeout: float) -> Sequence[Pose]:
        """Wait at most `timeout` in s for poses and return what came, oldest first; nothing is no error.

        Raises:
            Exception: the connection has ended.
        """
        ...


Connect = Callable[[], AbstractContextManager[Stream]]
"""Makes a connection; leaving it closes it. It fails within a second or so where nobody answers."""


@dataclass(frozen=True, eq=False)
class Inbox:
    """Place to which a receiver brings poses.

    Attributes:
        frames: make frames of them.
        arrived: held meanwhile, notified when a frame is ready.
        clock: the host's, in s.
    """

    frames: FrameAssembler
    arrived: threading.Condition
    clock: Callable[[], float]


class Receiver(Protocol):
    """Fills an inbox until it is stopped.

    Attributes:
        connections: made so far.
        trouble: why the last connection ended, or could not be made; empty once a pose has come.
    """

    connections: int
    trouble: str

    def stop(self) -> None:
        """Close the connection; a second time does nothing."""
        ...


class StreamReceiver:
    """Receives from a stream.

    Args:
        connect: makes a connection.
        inbox: takes the poses.

    Attributes:
        connections, trouble: see `Receiver`.
    """

    def __init__(self, connect: Connect, inbox: Inbox) -> None:
        self.connections, self.trouble = 0, ""
        self._connect, self._inbox, self._stopping = connect, inbox, threading.Event()
        self._thread = threading.Thread(target=self._run, name="tracker", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Close the connection; a second time does nothing."""
        self._stopping.set()
        self._thread.join(2 * CONNECT_S)  # a library that hangs ends with the process

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                with self._connect() as stream:
                    self._listen(stream)
            except Exception as error:  # whatever a library raises where its server is gone
                self.trouble = getattr(error, "strerror", None) or str(error) or type(error).__name__
                self._stopping.wait(RETRY_S)

    def _listen(self, stream: Stream) -> None:
        """Take poses until the connection ends.

        Raises:
            ConnectionError: no usable pose came for a second.
            Exception: as the stream does.
        """
        frames, clock = self._inbox.frames, self._inbox.clock
        with self._inbox.arrived:
            frames.restart(clock())
            self.connections += 1
        while not self._stopping.is_set():
            poses = stream.poll(WAIT_PERIODS * frames.period if frames.pending else RETRY_S)
            now = clock()
            with self._inbox.arrived:
                for each in poses:
                    frames.take(each.device, each.stamp, each.pose, now)
                frames.flush(now)
                if frames.ready:
                    self.trouble = ""
                    self._inbox.arrived.notify_all()
            if now - frames.progress > WATCHDOG_S:
                raise ConnectionError(f"no usable pose came for {WATCHDOG_S:g} s")
