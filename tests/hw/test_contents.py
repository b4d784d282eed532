"""What comes in good order and is wrong all the same: frames of another length, requests nobody knows, voltages below zero."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.protocol import ACK, ARM, ASK, CLEAR, CONFIG, DISARM, ESTOP, HELLO, SET, Fault, Key, State
from tests.hw.emulator.host import ALL, LIMITS_CHECK, ZERO, Host


def payload(host: Host, kind: protocol.Message) -> bytes:
    """A message that would be done at once."""
    values: dict[str, Any] = {"id": 9, "session": host.session, "limits": LIMITS_CHECK, "key": int(Key.STATUS_PERIOD_MS), "value": 50}
    values |= {"sequence": host.sequence + 1, "enabled": ALL, "pressures": [1000] * 6, "tendons": [ZERO + 4000] * 6}
    return kind.pack(**{name: values[name] for name, _ in kind.fields})


@pytest.mark.parametrize("kind", [SET, ARM, CLEAR, ESTOP, CONFIG, DISARM], ids=lambda kind: kind.name)
def test_frames_of_another_length(host: Host, kind: protocol.Message) -> None:
    """A message that lacks its last byte, or has one more, is bad, though its CRC is right: neither done nor answered."""
    host.run(0.05)
    if kind is not ARM:
        host.ready()
        host.hold(0.02)
        host.run(0.01)
    state, session = host.state, host.session
    whole = payload(host, kind)
    bad, good = host.status["bad"], host.status["good"]
    for wrong in (whole[:-1], whole[:1], whole + b"\0", whole + whole[-1:]):
        host.board.send(protocol.frame(wrong))
    heard = len(host.heard)
    host.run(0.03)
    assert (host.status["bad"] - bad, host.status["good"] - good) == (4, 0)
    assert not [kind for _, kind, _ in host.heard[heard:] if kind is ACK]
    assert (host.state, host.session) == (state, session)
    assert not host.board.dac.any()
    assert not host.board.step_counts.any()


def test_codes_that_nobody_knows(host: Host) -> None:
    """All 249 of them, alone and before the contents of an ARM: each a bad frame, and the board stays IDLE."""
    host.run(0.05)
    known = {message.code for message in protocol.TO_BOARD}
    arm, bad = payload(host, ARM), host.status["bad"]
    unknown = [code for code in range(256) if code not in known]
    for code in unknown:
        host.board.send(protocol.frame(bytes([code])) + protocol.frame(bytes([code]) + arm[1:]))
        host.run(0.002)
    host.run(0.02)
    assert host.status["bad"] - bad == 2 * len(unknown)
    assert host.state is State.IDLE


@pytest.mark.parametrize("counts", [-1, -1000, -10_000, -20_000, -32_768])
def test_voltages_below_zero(armed: Host, counts: int) -> None:
    """A dynamometer below 0 V shows 0, whatever is there: no tension that could be right, but a fault."""
    board = armed.board
    board.follow(False)
    for channel in range(6):
        board.monitor(channel, 1.0)
    board.dynamometer(4, counts)
    armed.run(0.02)
    assert armed.status["dynamometers"][4] == 0
    assert (armed.state, armed.fault, armed.status["channel"]) == (State.FAULT, Fault.DYNAMOMETER, 4)


def test_a_lost_dynamometer_winds_nothing(armed: Host) -> None:
    """A motor in full motion stops within two passes once its dynamometer is lost, before that is a fault; the others go on."""
    board = armed.board
    board.counts_per_step(0)
    armed.hold(0.05, tendons=[ZERO + 20_000] * 6)
    before = board.step_counts
    board.dynamometer(2, 40_000)
    armed.run(0.0045, 0.0005)
    assert board.enabled == ALL
    made = board.step_counts - before
    print(made)
    assert made[2] <= 30
    assert np.delete(made, 2).min() >= 40
    armed.run(0.01)
    assert board.step_counts[2] - before[2] == made[2]
    assert (armed.state, armed.fault, armed.status["channel"]) == (State.FAULT, Fault.DYNAMOMETER, 2)


@pytest.mark.slow
def test_hello_until_somebody_answers(host: Host) -> None:
    """Five times a second; one more answers the question, and none comes after it."""
    host.run(1.1)
    told = [time for time, kind, _ in host.heard if kind is HELLO]
    assert np.diff(told) == pytest.approx(0.2, abs=0.011)
    assert len(told) in (5, 6)
    host.send(ASK, id=1)
    host.run(1.0)
    assert sum(kind is HELLO for _, kind, _ in host.heard) == len(told) + 1
