"""DACs on the two-wire bus (MCP4728), on the emulated board: set points arrive, and a bus or chip that is gone is noticed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.hw.board.protocol import Fault, Result, State
from tests.hw.conftest import PRESSURE_MAX
from tests.hw.emulator import PIN, Board
from tests.hw.emulator.host import ALL, Host

OPTIONS = "-DDAC=DAC_MCP4728"
SLEW = 4096 / 0.9 * 2.5
WRONG = {"line held low": {"hung": True}, "first chip": {"absent": 1}, "second chip": {"absent": 2}, "both": {"absent": 3}}


@pytest.fixture
def two_wire(board_factory: Callable[..., Board], build: Callable[[str, str], Path]) -> Host:
    """A bare host on a board with DACs on the two-wire bus, at power-on, whose own memory says full pressure."""
    board = board_factory(build("mega", OPTIONS))
    board.dac_memory(0x0FFF)
    return Host(board)


@pytest.mark.slow
def test_set_points_arrive(two_wire: Host) -> None:
    """Codes come out as they are, an output at least every 6 ms, and never one that nobody asked for."""
    host, rng = two_wire, np.random.default_rng(1)
    host.ready()
    assert host.state is State.ARMED
    assert not host.board.dac_peak.any()
    before = np.zeros(6)
    for codes in rng.integers(0, PRESSURE_MAX + 1, (6, 6)):
        host.board.dac_changes()
        host.hold(0.22, pressures=codes.tolist())
        assert host.board.dac.tolist() == codes.tolist()
        changes = host.board.dac_changes()
        for k in range(6):
            own = changes[changes[:, 1] == k]
            low, high = sorted((before[k], codes[k]))
            assert own[:, 2].min() >= low
            assert own[:, 2].max() <= high
            assert np.diff(own[:, 0]).max() <= 0.0065
            assert np.abs(np.diff(own[:, 2])).max() <= np.ceil(SLEW * 0.0065)
        before = codes


@pytest.mark.slow
@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_a_bus_that_is_gone(two_wire: Host, wrong: dict[str, int]) -> None:
    """Motors and outputs off within 30 ms; CLEAR is refused until all DACs answer, and then begins at no pressure."""
    host, board = two_wire, two_wire.board
    host.ready()
    host.hold(0.25, pressures=[1500] * 6)
    assert board.enabled == ALL
    board.two_wire(**wrong)
    begin = board.time
    while board.enabled or board.outputs:
        host.set(pressures=[1500] * 6)
        for _ in range(5):
            host.run(0.001, 0.001)
        assert board.time - begin < 0.035
    host.run(0.02)
    assert (host.state, host.fault) == (State.FAULT, Fault.BUS)
    host.run(0.5)
    assert host.clear()["result"] == Result.BUS
    assert not board.outputs
    board.two_wire()
    host.run(0.1)
    board.dac_changes()
    assert host.clear()["result"] == Result.DONE
    assert board.outputs
    host.run(0.05)
    assert not board.dac_changes()[:, 2].any()
    assert host.arm()["result"] == Result.DONE
    host.hold(0.25, pressures=[1500] * 6)
    assert board.dac.tolist() == [1500] * 6


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_a_bus_that_is_gone_at_the_start(two_wire: Host, wrong: dict[str, int]) -> None:
    """What the DACs' own memory says does not get out: the outputs stay off."""
    host, board = two_wire, two_wire.board
    board.two_wire(**wrong)
    board.reset(PIN)
    board.dac_memory(0x0FFF)
    board.dac_changes()
    host.run(0.3)
    assert (host.state, host.fault) == (State.FAULT, Fault.BUS)
    assert not board.outputs
    assert host.arm()["result"] == Result.WRONG_STATE
    assert not board.dac_changes()[:, 2].any()


def test_a_bus_that_stutters(two_wire: Host) -> None:
    """Held low for 8 ms now and then, as a disturbance may do: writes begin anew and the robot goes on."""
    host = two_wire
    host.ready()
    for _ in range(5):
        host.board.two_wire(hung=True)
        host.hold(0.008, pressures=[800] * 6)
        host.board.two_wire()
        host.hold(0.1, pressures=[800] * 6)
    assert host.state is State.ARMED
    assert host.board.dac.tolist() == [800] * 6


def test_a_main_loop_that_hung_says_nothing_about_the_bus(two_wire: Host) -> None:
    """Nobody wrote meanwhile: LOOP_HUNG alone, and CLEAR leads back."""
    host, board = two_wire, two_wire.board
    host.ready()
    host.hold(0.1, pressures=[800] * 6)
    board.run_to("loop")
    board.hang()
    host.run(0.06)
    board.mend()
    host.run(0.05)
    assert host.faults == {Fault.LOOP_HUNG}
    assert host.clear()["result"] == Result.DONE


@pytest.mark.parametrize("stuck", [1, 9])
def test_a_chip_that_a_reset_caught_in_its_answer(two_wire: Host, stuck: int) -> None:
    """It holds SDA low until it has been clocked through: the firmware does that at the start, and where it happens later."""
    host, board = two_wire, two_wire.board
    board.two_wire(stuck=stuck)
    board.reset(PIN)
    host.run(0.1)
    assert (host.state, host.faults) == (State.IDLE, set())
    assert host.arm()["result"] == Result.DONE
    host.hold(0.1, pressures=[300] * 6)
    board.two_wire(stuck=stuck)
    host.hold(0.1, pressures=[800] * 6)
    assert host.state is State.ARMED
    assert board.dac.tolist() == [800] * 6
