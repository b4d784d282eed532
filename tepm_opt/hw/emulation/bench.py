"""The emulated board behind a pseudo-terminal, the simulated arm that it moves, and a tracker that sees the arm, in real time."""

from __future__ import annotations

import contextlib
import os
import select
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Protocol

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.hw.emulation.board import EmulatedBoard
from tepm_opt.hw.emulation.openigtlink import PoseServer
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.models.hardware import TrackerLink

STATUS_S, BEHIND_S = 0.005, 0.5
"""Between two STATUS; a machine that is further behind does not catch up."""


class EmulatedBench:
    """Board, arm and tracker of a bench that is not there. `advance` lets it live for a moment; call it again and again.

    Args:
        rig: the arm; it is driven in real time.
        port: path at which the board's serial port appears; what is there must be a link that this class made.
        link: of the tracker, of the kind openigtlink or webcam.

    Attributes:
        board: for looking inside.

    Raises:
        InputError: no pseudo-terminals here, the path is taken, or the tracker's port is; OpenCV is not installed for a webcam.
    """

    def __init__(self, rig: SimulatedRig, port: Path, link: TrackerLink) -> None:
        if not hasattr(os, "openpty"):
            raise InputError("the emulated bench needs pseudo-terminals; valid: Linux or macOS")
        if port.exists() and not port.is_symlink():
            raise InputError(f"{port}: a file is there; valid: a path for the serial port that nothing has")
        self._rig, self._path = rig, port
        self.board, self._begin = EmulatedBoard(rig.robot, time.monotonic()), time.monotonic()
        self._status_due = self._frame_due = self._begin
        self._tracker = _tracker_of(link, rig)
        self._opened = False
        self._master = _open_terminal(port)

    def advance(self, most: float = 0.02) -> None:
        """Do what is due, waiting at most so many seconds for the host."""
        wait = max(min(self._status_due, self._frame_due) - time.monotonic(), 0.0)
        ready, _, _ = select.select([self._master] if self._is_open() else [], [], [], min(wait, most))
        if self._master in ready:
            with contextlib.suppress(OSError):
                self._write(self.board.receive(os.read(self._master, 4096), time.monotonic()))
        now = time.monotonic()
        if now >= self._status_due:
            self._status_due = self._next(self._status_due, STATUS_S, now)
            self._write(self.board.status(now))
        if now >= self._frame_due:
            period = 1 / self._rig.file.tracker.rate_hz
            self._frame_due = self._next(self._frame_due, period, now)
            self._move(now, period)

    def run(self, stop: Callable[[], bool]) -> None:
        """Live until `stop` says so."""
        while not stop():
            self.advance()

    def _next(self, due: float, period: float, now: float) -> float:
        return now + period if now - due > BEHIND_S else due + period

    def _is_open(self) -> bool:
        """Whether a program has the port open; the board restarts when one opens it."""
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        is_open = not any(event & select.POLLHUP for _, event in poll.poll(0))
        if is_open and not self._opened:
            self.board.reset(time.monotonic())
        self._opened = is_open
        return is_open

    def _write(self, data: bytes) -> None:
        if data and self._opened:
            with contextlib.suppress(OSError):  # a host that does not read loses what comes, as on a serial line
                os.write(self._master, data)

    def _move(self, now: float, period: float) -> None:
        """The board's outputs move the arm for a frame, its gauges reach the board and its points the tracker."""
        self._rig.apply(self.board.outputs(now, period))
        sample = self._rig.read()
        zeros = np.zeros(self._rig.layout.inputs // 2)
        self.board.sense(zeros if sample.pressures is None else sample.pressures, zeros if sample.tensions is None else sample.tensions)
        self._tracker.show(sample)

    def close(self) -> None:
        """Take port and tracker away; a second time does nothing."""
        self._tracker.close()
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
        if self._path.is_symlink():
            self._path.unlink()

    def __enter__(self) -> EmulatedBench:
        """The bench itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close."""
        self.close()


class _Tracker(Protocol):
    """Lets others see the arm."""

    def show(self, sample: Sample) -> None:
        """Send what a sample has, or what the arm looks like now."""
        ...

    def close(self) -> None:
        """End all connections; a second time does nothing."""
        ...


def _tracker_of(link: TrackerLink, rig: SimulatedRig) -> _Tracker:
    if link.kind != "webcam":
        return PoseServer(link)
    from tepm_opt.hw.emulation.camera import EmulatedCamera

    return EmulatedCamera(link, rig)


def _open_terminal(link: Path) -> int:
    """A raw pseudo-terminal; its other end appears at a path."""
    import tty

    master, slave = os.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    os.close(slave)
    os.set_blocking(master, False)
    if link.is_symlink():
        link.unlink()
    link.symlink_to(name)
    return master
