"""The whole loop in virtual time: emulated board, simulated robot and tracker, and the line between board and host."""

from __future__ import annotations

from collections import deque

import numpy as np

from tepm_opt.hw.board.calibration import Calibration
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.trackers.frames import Frame
from tests.hw.emulator import Board

STEP = 1e-3
STALE = 0.05
"""Seconds after which nobody wants a frame any more."""


class World:
    """Everything but the host. Time passes only in `advance`, which port and tracker call while the host waits for them.

    Args:
        board: the emulated board.
        rig: gives the robot, its valves, sensors and tracker; None: a board with nothing on it whose sensors follow it.

    Attributes:
        time: in s.
        port, tracker: for a `SerialRig`.
    """

    def __init__(self, board: Board, rig: SimulatedRig | None = None) -> None:
        self.board, self.rig, self.time = board, rig, 0.0
        self.port, self.tracker = LockstepPort(self), LockstepTracker(self)
        self.frames: deque[tuple[float, Frame]] = deque()
        self._due = 0
        self._unwound = np.zeros(6, dtype=int)  # where each motor stood when its tendon last ran free
        if rig is not None:
            board.follow(False)
            self._calibration = Calibration.from_robot(rig.robot)
            rig.true_points  # noqa: B018  settles
            self._couple()

    def clock(self) -> float:
        """The time in s."""
        return self.time

    def advance(self, duration: float) -> None:
        """Let time pass, in steps of a millisecond."""
        end = self.time + duration
        while self.time < end - 1e-9:
            step = min(STEP, end - self.time)
            self.board.run(step)
            self.time += step
            if self.rig is not None:
                self._couple()

    def _couple(self) -> None:
        """The board's outputs move the robot, the robot's sensors reach the board and the tracker."""
        rig, board, calibration = self.rig, self.board, self._calibration
        machine = rig.machine
        now = round(self.time / machine.step)
        on = np.array([board.enabled >> k & 1 for k in range(6)], dtype=float)
        pressures = np.maximum(board.dac - calibration.codes_zero, 0) / calibration.codes
        self._unwound = np.where(on > 0, self._unwound, board.positions)
        tensions = np.maximum(board.positions - self._unwound, 0) / calibration.steps
        rig._commands.set(now, np.concatenate([pressures, tensions, on]))
        frames = machine.record([now], rig._commands, rig._forces)
        rig._present = (frames.nodes[0], frames.points[0])
        rig._commands.forget(now)
        measured = [
            values[0] for values in (rig._measure_pressures(frames.pressures), rig._measure_tensions(frames.tensions)) if values is not None
        ]
        for k, (pressure, tension) in enumerate(zip(*measured, strict=True)):
            board.monitor(k, (calibration.monitor_zero + calibration.monitor * pressure)[k] * 5 / 32768)
            board.dynamometer(k, round((calibration.counts_zero + calibration.counts * tension)[k]))
        tracker = rig.file.tracker
        if self.time >= self._due / tracker.rate_hz - 1e-9:
            self._due += 1
            points = rig._lens.look(rig._distort_points(frames, 0, self.time))
            lost = [f"s{k + 1}" for k in range(len(points)) if np.isnan(points[k]).any()]
            status = f"tracker lost {', '.join(lost)}" if lost else "ok"
            self.frames.append((self.time + tracker.latency_s, Frame(self.time, points, np.full((4, 4, 4), np.nan), status)))


class LockstepPort:
    """The line to the emulated board."""

    def __init__(self, world: World) -> None:
        self.world, self.cut, self.calls = world, False, 0

    def read(self, timeout: float) -> bytes:
        """As `Port.read`: time passes until something comes."""
        self._check()
        end = self.world.time + timeout
        while not (data := self.world.board.take()) and self.world.time < end - 1e-9:
            self.world.advance(min(STEP, end - self.world.time))
        return data

    def write(self, data: bytes) -> None:
        """As `Port.write`."""
        self._check()
        self.world.board.send(data)

    def close(self) -> None:
        """Nothing to close."""

    def _check(self) -> None:
        self.calls += 1
        if self.cut:
            raise OSError("the cable is out")


class LockstepTracker:
    """The tracker of the simulated robot."""

    status = "ok"

    def __init__(self, world: World) -> None:
        self.world = world

    def read(self, timeout: float) -> Frame | None:
        """As `Tracker.read`: time passes until a frame comes."""
        end = self.world.time + timeout
        while True:
            while self.world.frames and self.world.frames[0][0] < self.world.time - STALE:
                self.world.frames.popleft()
            if self.world.frames and self.world.frames[0][0] <= self.world.time + 1e-9:
                return self.world.frames.popleft()[1]
            if self.world.time >= end - 1e-9:
                return None
            self.world.advance(min(STEP, end - self.world.time))

    def close(self) -> None:
        """Nothing to close."""
