"""What no other part of the firmware may be trusted with: the last instruction before a pin, and what interrupts and main loop share."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.protocol import SET, Fault, State
from tests.hw.conftest import PRESSURE_MAX
from tests.hw.emulator.host import ALL, ZERO, Host

ENA_PORT = 0x10B


def test_dacs_are_clamped_last(armed: Host) -> None:
    """A set point in memory that is beyond the limit, however it came there, does not reach the DACs."""
    board = armed.board
    armed.hold(0.25, pressures=[PRESSURE_MAX] * 6)
    assert np.all(board.dac == PRESSURE_MAX)
    for channel in range(6):
        board.poke("wanted_pressure", 4095, index=channel)
    armed.run(0.05)
    assert armed.state is State.ARMED
    assert board.dac.tolist() == [PRESSURE_MAX] * 6
    assert board.dac_peak.max() == PRESSURE_MAX


@pytest.mark.parametrize(("place", "length"), [("passed", 4), ("sums", 12), (ENA_PORT, 1)], ids=["time", "monitors", "ENA"])
def test_interrupts_cannot_come_between(armed: Host, place: str | int, length: int) -> None:
    """What an interrupt changes is read in one go: with interrupts off where that takes more than one instruction."""
    armed.hold(0.02)
    armed.board.share(place, length)
    for enabled in (ALL, 0x15, ALL):
        armed.hold(0.03, enabled=enabled, tendons=[ZERO + 2000] * 6)
    assert armed.state is State.ARMED
    assert armed.board.unguarded == 0


def test_reads_with_interrupts_on_are_counted(armed: Host) -> None:
    """What the test above counts: signs of the interrupt that are one byte are read with interrupts on."""
    armed.board.share("written", 1)
    armed.run(0.01)
    assert armed.board.unguarded >= 10


@pytest.mark.parametrize("pause", [0.0006, 0.002, 0.05])
def test_no_motor_comes_on_after_a_hang(armed: Host, pause: float) -> None:
    """A set point whose last byte is read right after the main loop hung, before the loop has noticed: its motors stay off."""
    board = armed.board
    armed.hold(0.05, tendons=[ZERO + 2000] * 6, enabled=0x15)
    values = {"pressures": [0] * 6, "tendons": [ZERO + 2000] * 6, "enabled": ALL}
    data = protocol.frame(SET.pack(session=armed.session, sequence=armed.sequence + 1, **values))
    board.send(data[:-1])
    armed.run(0.005)
    board.run_to("loop")
    board.hang()
    board.send(data[-1:])
    board.run(pause)
    assert board.safe
    board.mend()
    for _ in range(1000):
        board.run(2e-6)
        assert board.enabled == 0
    armed.run(0.02)
    assert (armed.state, armed.fault) == (State.FAULT, Fault.LOOP_HUNG)


@pytest.mark.slow
def test_steps_of_a_late_loop(armed: Host) -> None:
    """A pass that the main loop did not write in time has no steps: the motors are where the board thinks that they are."""
    board = armed.board
    board.counts_per_step(0)
    late = armed.status["late"]
    board.slow(0.4)
    for goal in (1500, 200, 1700, 0):
        armed.hold(0.25, period=0.01, tendons=[goal] * 6, steps=True)
    board.slow(0)
    armed.hold(0.3, tendons=[1000] * 6, steps=True)
    print((armed.status["late"] - late) % 256, board.positions)
    assert armed.state is State.ARMED
    assert (armed.status["late"] - late) % 256 >= 20
    assert board.positions.tolist() == [1000] * 6


def test_motors_brake_no_earlier_than_they_have_to(armed: Host) -> None:
    """1000 steps at 9524 steps a second take 105 ms; getting there from 8000 and back costs little more than a millisecond."""
    board = armed.board
    board.counts_per_step(0)
    armed.hold(0.05, tendons=[0] * 6, steps=True)
    board.steps()
    armed.hold(0.15, tendons=[1000] * 6, steps=True)
    steps = board.steps()
    took = [np.ptp(steps[steps[:, 1] == motor, 0]) for motor in range(6)]
    print(took)
    assert board.positions.tolist() == [1000] * 6
    assert max(took) <= 0.1066


@pytest.mark.slow
def test_motors_that_go_off_do_not_hold_up_the_others(armed: Host) -> None:
    """Whenever some go off, the steps of one at full rate stay 100 us apart but for what interrupts may be late."""
    board, rng = armed.board, np.random.default_rng(0)
    board.counts_per_step(0)
    board.steps()
    apart = []
    for goal in (6000, 0, 6000):
        end = board.time + 0.7
        while board.time < end:
            armed.set(tendons=[goal] * 6, steps=True, enabled=int(rng.choice([ALL, 1, 3])))
            armed.run(rng.uniform(0.002, 0.006), step=0.02)
        steps = board.steps()
        apart.append(np.diff(steps[steps[:, 1] == 0, 0]).min())
    print(apart)
    assert armed.state is State.ARMED
    assert board.idle_steps == 0
    assert min(apart) >= 91e-6
