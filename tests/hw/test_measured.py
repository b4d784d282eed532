"""What the board measures itself, on the emulated board: pressures, tensions that are too high, loose contacts, fault on fault."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tepm_opt.hw.board.protocol import Fault, Result, State
from tests.hw.emulator import PIN, Board
from tests.hw.emulator.host import ALL, ZERO, Host

TRIP = 27361
"""Counts of 7.35 N."""
DEAD = -60_000
"""A dynamometer whose wire is broken reads 0 through its pull-down."""


def volts(pressure_MPa: float) -> float:
    """What a monitor shows."""
    return 1 + 4 * pressure_MPa / 0.9


def alone(board: Board, code: int = 0) -> None:
    """From now on sensors show what they are set to: no tension, and the pressure of a DAC code."""
    board.follow(False)
    for k in range(6):
        board.monitor(k, 1 + 4 * code / 4096)
        board.dynamometer(k, ZERO)


def off_after(host: Host, most: float, off: Callable[[], bool] | None = None, **setpoints: object) -> float:
    """Time in s until the outputs are off (or what is asked for), the host sending on all the time."""
    reached, begin = off or (lambda: not host.board.outputs), host.board.time
    while not reached():
        assert host.board.time - begin < most, f"not within {most} s"
        host.set(**setpoints)
        for _ in range(5):
            if not reached():
                host.run(0.001, 0.001)
    return host.board.time - begin


FIRST = {
    Fault.RESET_WHILE_ARMED: lambda host: host.board.reset(PIN),
    Fault.DYNAMOMETER: lambda host: host.board.dynamometer(1, DEAD),
    Fault.TENSION_TOO_HIGH: lambda host: host.board.dynamometer(1, TRIP + 1),
}


@pytest.mark.slow
@pytest.mark.parametrize("first", FIRST, ids=lambda fault: fault.name)
def test_a_graver_fault_acts_after_another(armed: Host, first: Fault) -> None:
    """A regulator that stays at 0.4 MPa drops the outputs, though the board is in FAULT already; both are told, the graver one first."""
    board = armed.board
    alone(board)
    armed.hold(0.02)
    FIRST[first](armed)
    armed.run(0.05)
    assert (armed.state, armed.fault, armed.faults) == (State.FAULT, first, {first})
    assert board.outputs
    board.monitor(4, volts(0.4))
    took = off_after(armed, 1.6)
    assert took >= 1.45
    armed.run(0.02)
    assert (armed.state, armed.fault, armed.status["channel"]) == (State.FAULT, Fault.REGULATOR, 4)
    assert armed.faults == {first, Fault.REGULATOR}


@pytest.mark.slow
@pytest.mark.parametrize("stopped", ["idle", "host silent", "button"])
def test_a_regulator_is_watched_in_every_state(armed: Host, stopped: str) -> None:
    """Whether or not the board is armed: a regulator that gives 0.4 MPa unasked switches the outputs off, or they are off already."""
    board = armed.board
    alone(board)
    if stopped == "idle":
        armed.disarm()
    elif stopped == "button":
        board.estop(True)
    armed.run(0.15)
    assert armed.state is {"idle": State.IDLE, "host silent": State.HOST_TIMEOUT, "button": State.ESTOP}[stopped]
    board.monitor(2, volts(0.4))
    armed.run(1.6)
    assert not board.outputs
    assert armed.state is (State.ESTOP if stopped == "button" else State.FAULT)
    assert armed.faults == {Fault.REGULATOR}


def test_a_lesser_fault_does_not_hide_a_graver_one(armed: Host) -> None:
    """Nor does one that comes later take its place."""
    board = armed.board
    alone(board)
    board.monitor(0, volts(0.6))
    armed.hold(0.1)
    assert armed.fault is Fault.PRESSURE_TOO_HIGH
    board.monitor(3, 0.0)
    armed.run(0.1)
    assert (armed.fault, armed.status["channel"]) == (Fault.PRESSURE_TOO_HIGH, 0)
    assert armed.faults == {Fault.PRESSURE_TOO_HIGH, Fault.MONITOR}
    alone(board)
    armed.run(0.03)
    assert armed.clear()["result"] == Result.DONE
    armed.run(0.01)
    assert (armed.fault, armed.faults) == (Fault.NONE, set())


@pytest.mark.parametrize("state", [State.ARMED, State.IDLE])
@pytest.mark.parametrize("channel", [0, 5])
def test_measured_pressure_trips(armed: Host, state: State, channel: int) -> None:
    """0.59 MPa measured for 50 ms: everything off, armed or not, also where the set point is 0.5 MPa. 0.54 MPa are allowed."""
    board, code = armed.board, 2275 * (state is State.ARMED)
    alone(board, code)
    armed.hold(0.3, pressures=[code] * 6)
    if state is State.IDLE:
        armed.disarm()
    board.monitor(channel, volts(0.54 if code else 0.09))
    armed.hold(0.3, pressures=[code] * 6)
    assert armed.state is state
    board.monitor(channel, volts(0.59))
    took = off_after(armed, 0.1, pressures=[code] * 6)
    print(f"outputs off after {1e3 * took:.0f} ms")
    assert 0.045 <= took <= 0.07
    armed.run(0.02)
    assert (armed.state, armed.fault, armed.status["channel"]) == (State.FAULT, Fault.PRESSURE_TOO_HIGH, channel)
    assert board.safe


def test_pressure_that_is_too_high_now_and_then(armed: Host) -> None:
    """30 ms too high, 30 ms not, again and again: each good sample takes back only a part of what a bad one added."""
    board = armed.board
    alone(board, 2275)
    armed.hold(0.3, pressures=[2275] * 6)
    begin = board.time
    while board.outputs:
        for pressure in (0.6, 0.5):
            board.monitor(1, volts(pressure))
            armed.hold(0.03, pressures=[2275] * 6)
        assert board.time - begin < 0.25
    armed.run(0.02)
    assert armed.fault is Fault.PRESSURE_TOO_HIGH


@pytest.mark.slow
def test_a_regulator_that_follows_for_a_moment(armed: Host) -> None:
    """1.4 s off its set point, 20 ms right, and off again: one good sample does not make up for the time before."""
    board = armed.board
    alone(board, 1000)
    armed.hold(0.3, pressures=[1000] * 6)
    board.monitor(3, volts(0.45))
    armed.hold(1.4, pressures=[1000] * 6)
    board.monitor(3, 1 + 4 * 1000 / 4096)
    armed.hold(0.02, pressures=[1000] * 6)
    assert armed.state is State.ARMED
    board.monitor(3, volts(0.45))
    assert off_after(armed, 0.15, pressures=[1000] * 6) >= 0.05
    armed.run(0.02)
    assert (armed.fault, armed.status["channel"]) == (Fault.REGULATOR, 3)


@pytest.mark.parametrize("state", [State.ARMED, State.IDLE])
def test_broken_wire_of_a_monitor(armed: Host, state: State) -> None:
    """Through its pull-down the input shows 0 V: MONITOR after 50 ms, armed or not. 0.6 V are allowed."""
    board = armed.board
    alone(board)
    if state is State.IDLE:
        armed.disarm()
    board.monitor(5, 0.6)
    armed.hold(0.3)
    assert armed.state is state
    board.monitor(5, 0.3)
    took = off_after(armed, 0.1)
    assert 0.045 <= took <= 0.07
    armed.run(0.02)
    assert (armed.state, armed.fault, armed.status["channel"]) == (State.FAULT, Fault.MONITOR, 5)


@pytest.mark.parametrize("value", [volts(0.15), volts(0.58), 0.0], ids=["off", "high", "broken"])
def test_no_way_back_while_a_monitor_disagrees(armed: Host, value: float) -> None:
    """CLEAR is refused and says which regulator; so is ARM, before it is a fault."""
    board = armed.board
    alone(board)
    armed.estop()
    board.monitor(2, value)
    armed.run(0.03)
    refused = armed.clear()
    assert (refused["result"], refused["channel"], refused["state"]) == (Result.MONITOR, 2, State.ESTOP)
    assert not board.outputs
    board.monitor(2, 1.0)
    armed.run(0.03)
    assert armed.clear()["result"] == Result.DONE
    board.monitor(2, value)
    armed.run(0.02)
    refused = armed.arm()
    assert (refused["result"], refused["channel"]) == (Result.MONITOR, 2)
    assert refused["state"] in (State.IDLE, State.FAULT)
    assert board.enabled == 0


@pytest.mark.parametrize("contact", ["+-", "+--", "+---", "++--", "+++---"])
def test_loose_contact_of_a_dynamometer(armed: Host, contact: str) -> None:
    """A contact that is lost (-) ms by ms and found again: the tendon is not pulled harder than asked; off within 20 ms."""
    board, goal = armed.board, ZERO + round(6 * 3276.8)
    most = 0
    begin, number = board.time, 0
    while board.enabled or number < 10:
        armed.set(tendons=[goal] * 6)
        for _ in range(5):
            board.dynamometer(1, ZERO if contact[number % len(contact)] == "+" else DEAD)
            number += 1
            armed.run(0.001, 0.001)
            most = max(most, board.positions[1])
        assert board.time - begin < 0.05
    armed.run(0.02)
    assert (armed.state, armed.fault, armed.status["channel"]) == (State.FAULT, Fault.DYNAMOMETER, 1)
    assert most * 1.05e-3 <= 6.01


@pytest.mark.slow
def test_a_contact_that_is_hardly_ever_lost(armed: Host) -> None:
    """One sample of four does not stop the robot, and does not wind the tendon either: the loop waits for a sample that is right."""
    board, goal = armed.board, ZERO + round(6 * 3276.8)
    for number in range(1000):
        if number % 5 == 0:
            armed.set(tendons=[goal] * 6)
        board.dynamometer(1, DEAD if number % 4 == 0 else ZERO)
        armed.run(0.001, 0.001)
        assert board.positions[1] * 1.05e-3 <= 6.01
    assert armed.state is State.ARMED
    assert abs(board.positions[1] * 1.05e-3 - 6) <= 0.01


@pytest.mark.parametrize(
    ("readings", "fault"),
    [((8.46, 7.33), Fault.TENSION_TOO_HIGH), ((7.6, 7.2), Fault.TENSION_TOO_HIGH), ((6.0, 3.0), Fault.DYNAMOMETER), ((6.0, 5.5), None)],
    ids=["8.46/7.33 N", "7.6/7.2 N", "6/3 N", "6/5.5 N"],
)
def test_readings_that_alternate(armed: Host, readings: tuple[float, float], fault: Fault | None) -> None:
    """The trip looks at what the loop uses, the mean of two samples; jumps that no arm can make are a loose contact."""
    board = armed.board
    alone(board)
    armed.hold(0.02)
    begin = board.time
    while board.time - begin < 0.02 and board.enabled:
        for reading in readings:
            board.dynamometer(3, ZERO + round(3276.8 * reading))
            armed.run(0.001, 0.001)
        if round((board.time - begin) / 0.002) % 2:
            armed.set(tendons=[ZERO] * 6)
    armed.run(0.01)
    if fault is None:
        assert armed.state is State.ARMED
        return
    assert board.time - begin <= 0.021
    assert (armed.state, armed.fault, armed.status["channel"]) == (State.FAULT, fault, 3)


@pytest.mark.parametrize("sign", [1, -1], ids=["pulls", "unwinds"])
def test_travel_either_way(armed: Host, sign: int) -> None:
    """A motor further than 30,000 steps from where its ENA came on: FAULT. One step less is allowed."""
    board = armed.board
    board.counts_per_step(0)
    armed.hold(0.02, tendons=[ZERO] * 6)
    at = board.symbol("position_") & 0xFFFF
    board.write(at + 2 * 4, (29_999 * sign).to_bytes(2, "little", signed=True))
    armed.hold(0.02)
    assert armed.state is State.ARMED
    board.write(at + 2 * 4, (30_001 * sign).to_bytes(2, "little", signed=True))
    armed.hold(0.02)
    assert (armed.state, armed.fault, armed.status["channel"]) == (State.FAULT, Fault.TRAVEL, 4)
    assert board.enabled == 0


@pytest.mark.slow
def test_all_is_well(armed: Host) -> None:
    """With everything in order, at the limits, nothing trips in 3 s, whichever way set points jump."""
    board = armed.board
    rng = np.random.default_rng(8)
    for _ in range(6):
        armed.hold(0.5, pressures=rng.choice([0, 2275], 6).tolist(), tendons=rng.choice([ZERO, ZERO + 22937], 6).tolist())
    assert armed.state is State.ARMED
    assert armed.faults == set()
    assert board.enabled == ALL
