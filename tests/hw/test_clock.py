"""Every time limit is one of the clock, on the emulated board: a main loop that is late does not make the robot less safe."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.hw.board.protocol import Fault, State
from tests.hw.conftest import PRESSURE_MAX
from tests.hw.emulator.host import ALL, ZERO, Host

SLOW = 0.4
"""Share of the processor's time that is gone: passes take up to 1.6 ms instead of 1."""


def hold(host: Host, duration: float, code: int) -> None:
    """Send set points that keep all motors busy, 100 times a second: a late main loop reads no more than that."""
    goals = (0, 6000)
    for number in range(round(duration / 0.01)):
        host.set(pressures=[code] * 6, tendons=[goals[number // 30 % 2]] * 6, steps=True)
        host.run(0.01)


@pytest.fixture
def late(armed: Host) -> Host:
    """A bare host on a board under full pressure whose main loop is late in most passes."""
    armed.board.counts_per_step(0)
    armed.board.slow(SLOW)
    hold(armed, 0.4, PRESSURE_MAX)
    assert armed.state is State.ARMED
    assert armed.board.enabled == ALL
    assert armed.board.dac.tolist() == [PRESSURE_MAX] * 6
    before, begin = armed.status["late"], armed.board.time
    hold(armed, 0.1, PRESSURE_MAX)
    assert (armed.status["late"] - before) % 256 >= 20, f"not late by {armed.board.time - begin:.2f} s"
    return armed


def time_until(host: Host, most: float, name: str) -> float:
    """Seconds until the motors, the outputs or the pressures are off."""
    board, begin = host.board, host.board.time
    on = {"motors": lambda: board.enabled, "outputs": lambda: board.outputs, "pressures": lambda: board.dac.any()}[name]
    while on():
        host.run(0.0005, 0.0005)
        assert board.time - begin < most
    return board.time - begin


def test_silent_host(late: Host) -> None:
    """Motors off within 110 ms of the last frame, pressures at zero 0.6 s later."""
    took = time_until(late, 0.2, "motors") + 0.01  # `hold` ends 10 ms after the last set point
    ramp = time_until(late, 1.0, "pressures")
    print(f"motors off after {1e3 * took:.1f} ms, no pressure {ramp:.3f} s later")
    assert 0.095 <= took <= 0.108
    assert 0.45 <= ramp <= 0.55


def test_measured_pressure(late: Host) -> None:
    """Too high a pressure for 50 ms."""
    board = late.board
    board.follow(False)
    for k in range(6):
        board.monitor(k, 1 + 4 * 0.5 / 0.9)
        board.dynamometer(k, ZERO)
    hold(late, 0.05, PRESSURE_MAX)
    board.monitor(2, 1 + 4 * 0.6 / 0.9)
    took = time_until(late, 0.1, "outputs")
    assert 0.045 <= took <= 0.075
    late.run(0.03)
    assert late.fault is Fault.PRESSURE_TOO_HIGH


@pytest.mark.slow
def test_regulator(late: Host) -> None:
    """A regulator that does not follow for 1.5 s, the host being silent from the beginning."""
    board = late.board
    board.follow(False)
    for k in range(6):
        board.monitor(k, 1.0 + 4 * 0.3 / 0.9 * (k == 4))
        board.dynamometer(k, ZERO)
    late.run(1.0)
    assert board.outputs
    took = 1.0 + time_until(late, 1.3, "outputs")
    print(f"outputs off after {took:.2f} s")
    assert 1.45 <= took <= 2.2  # the set point was 0.5 MPa at first, and went to zero within 0.6 s
    late.run(0.03)
    assert (late.fault, late.status["channel"]) == (Fault.REGULATOR, 4)


def test_slew_of_set_points(late: Host) -> None:
    """Pressure rises and falls no faster than 2.5 MPa/s, and no slower."""
    board = late.board
    board.dac_changes()
    hold(late, 0.3, 0)
    changes = board.dac_changes()
    for k in range(6):
        time, code = changes[changes[:, 1] == k][:, [0, 2]].T
        moving = np.flatnonzero(np.diff(code))
        took = time[moving[-1] + 1] - time[moving[0]]
        assert 0.9 <= took / (PRESSURE_MAX / (4096 / 0.9 * 2.5)) <= 1.1
