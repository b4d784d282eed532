"""A board that speaks the protocol and keeps the host's rules: sessions, limits, the timeout of a silent host. It is not the firmware."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from tepm_opt.hw.board.calibration import Calibration
from tepm_opt.hw.board.limits import Limits
from tepm_opt.hw.board.protocol import (
    ACK,
    ARM,
    ASK,
    CHANNELS,
    CLEAR,
    CONFIG,
    DISARM,
    ESTOP,
    HELLO,
    LIMITS,
    POSITION_MODE,
    SET,
    STATUS,
    TO_BOARD,
    VERSION,
    Decoder,
    Message,
    ResetCause,
    Result,
    State,
    frame,
)  # fmt: skip
from tepm_opt.hw.rig import Command
from tepm_opt.models.robot import Robot

TIMEOUT_S = 0.1
"""A host silent for longer is gone, as in the firmware's `config.h`."""
FALL_PA_PER_S = 1e6
"""Rate at which pressure falls after a stop."""


class EmulatedBoard:
    """Answers requests, acts on set points of its session within its limits, and stops by itself where the host is silent.

    Args:
        robot: with `[hardware]`, whose limits and calibration it has.
        now: time of its start in s.

    Attributes:
        state: as STATUS tells it.

    Raises:
        InputError: as for `Limits.from_robot`.
    """

    def __init__(self, robot: Robot, now: float = 0.0) -> None:
        self._limits, self._calibration, self._starts = Limits.from_robot(robot), Calibration.from_robot(robot), 0
        self._robot, self._count = robot, robot.modules * robot.actuators
        self._gauges = np.zeros(self._count), np.zeros(self._count)
        self.reset(now)

    def reset(self, now: float) -> None:
        """Start anew, as an Arduino does when its port is opened."""
        self._starts += 1
        self._session, self._sequence, self._began, self._heard = self._starts << 16 | 1, 0, now, now
        self.state, self._decoder, self._told = State.IDLE, Decoder(TO_BOARD), 0
        self._refused = self._stale = 0
        self._switch_off()
        self._pressures = np.zeros(self._count)

    def _switch_off(self) -> None:
        """Motors off; pressure falls in `outputs`."""
        self._goal, self._tensions, self._enabled = np.zeros(self._count), np.zeros(self._count), np.zeros(self._count, dtype=bool)

    def _enter(self, state: State) -> None:
        """Another state, and with it another session."""
        self.state, self._sequence = state, 0
        self._session = self._session & 0xFFFF0000 | self._session + 1 & 0xFFFF
        self._switch_off()

    def receive(self, data: bytes, now: float) -> bytes:
        """Take bytes of the host at a time in s, and give what the board answers at once."""
        answers = b""
        for kind, values in self._decoder.feed(data):
            if kind is SET:
                self._take(values, now)
            elif kind is ASK:
                answers += self._hello()
            else:
                result = self._request(kind, values, now)
                told = {"state": int(self.state), "session": self._session}
                answers += frame(ACK.pack(id=values["id"], request=kind.code, result=int(result), channel=0, **told))
        return answers

    def outputs(self, now: float, passed: float) -> Command:
        """Pressures and tensions that it gives out at a time in s, `passed` s after the last call."""
        if self.state is State.ARMED and now - self._heard > TIMEOUT_S:
            self._enter(State.HOST_TIMEOUT)
        falling = self.state is not State.ARMED
        self._pressures = np.maximum(self._pressures - FALL_PA_PER_S * passed, 0.0) if falling else self._goal.copy()
        return Command(self._pressures.copy(), self._tensions.copy(), self._enabled.copy())

    def sense(self, pressures: np.ndarray, tensions: np.ndarray) -> None:
        """Set what the monitors and dynamometers read, each (actuators of all modules,) in Pa and N."""
        self._gauges = pressures, tensions

    def status(self, now: float) -> bytes:
        """The next STATUS at a time in s."""
        self._told = (self._told + 1) % 256
        lines, (pressures, tensions) = self._calibration, self._gauges
        values: dict[str, Any] = {name: 0 for name, _ in STATUS.fields}
        values |= {"sequence": self._sequence % 0x10000, "count": self._told, "session": self._session, "state": int(self.state)}
        values |= {"enabled": sum(1 << k for k in range(self._count) if self._enabled[k]), "time_ms": round(1e3 * (now - self._began))}
        values |= {"refused": self._refused, "stale": self._stale, "good": self._decoder.good % 0x10000, "bad": self._decoder.bad % 0x10000}
        values["dynamometers"] = _to_counts(lines.counts_zero + lines.counts * tensions, 0xFFFF)
        values["monitors"] = _to_counts(lines.monitor_zero + lines.monitor * pressures, 0xFFFF)
        values["positions"] = _to_counts(lines.steps * self._tensions, 0x7FFF)
        return frame(STATUS.pack(**values))

    def _hello(self) -> bytes:
        values = {"version": VERSION, "channels": CHANNELS, "monitors": CHANNELS, "reset_cause": int(ResetCause.RESET_PIN), "build": 0}
        values |= {"state": int(self.state), "session": self._session, "limits": self._limits.check, "timeout_ms": round(1e3 * TIMEOUT_S)}
        return frame(HELLO.pack(**values)) + frame(LIMITS.pack(**asdict(self._limits)))

    def _request(self, kind: Message, values: dict[str, Any], now: float) -> Result:
        if kind in (ARM, CLEAR, CONFIG) and values["session"] != self._session:
            return Result.WRONG_SESSION
        if kind is ARM and self.state is not State.IDLE:
            return Result.WRONG_STATE
        if kind is ARM and values["limits"] != self._limits.check:
            return Result.WRONG_LIMITS
        if kind is CLEAR and self.state is State.ARMED:
            return Result.WRONG_STATE
        if kind in (ARM, CLEAR, ESTOP) or (kind is DISARM and self.state is State.ARMED):
            self._enter({ARM: State.ARMED, ESTOP: State.ESTOP}.get(kind, State.IDLE))
            self._heard = now
        return Result.DONE

    def _take(self, values: dict[str, Any], now: float) -> None:
        """Act on a set point, unless it is old, of another session, or beyond the limits."""
        if self.state is not State.ARMED or values["session"] != self._session or values["sequence"] <= self._sequence:
            self._stale = (self._stale + 1) % 256
            return
        by_steps = bool(values["enabled"] & POSITION_MODE)
        most = self._limits.position_max if by_steps else self._limits.tension_max
        if max(values["pressures"]) > self._limits.pressure_max or not 0 <= min(values["tendons"]) <= max(values["tendons"]) <= most:
            self._refused = (self._refused + 1) % 256
            return
        lines, highest, half = self._calibration, self._robot.input_max, self._count
        pressures, tendons = (np.array(values[name][:half], dtype=float) for name in ("pressures", "tendons"))
        tensions = tendons / lines.steps if by_steps else (tendons - lines.counts_zero) / lines.counts
        self._enabled = np.array([bool(values["enabled"] >> k & 1) for k in range(half)])
        self._goal = np.clip((pressures - lines.codes_zero) / lines.codes, 0.0, highest[:half])
        self._tensions = np.where(self._enabled, np.clip(tensions, 0.0, highest[half:]), 0.0)
        self._sequence, self._heard = values["sequence"], now


def _to_counts(values: np.ndarray, most: int) -> tuple[int, ...]:
    """Counts for all channels of a board."""
    return (*(int(value) for value in np.clip(np.round(values), 0, most)), *[0] * (CHANNELS - len(values)))
