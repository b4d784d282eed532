"""The firmware on the emulated board: set points reach their outputs exactly and on time, and nothing else does."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.protocol import CONFIG, HELLO, SET, STATUS, Fault, Key, Result, State
from tests.hw.conftest import PRESSURE_MAX
from tests.hw.emulator import HZ, Board
from tests.hw.emulator.host import ALL, LIMITS_CHECK, ZERO, Host

TENSION_MAX, POSITION_MAX = 26215, 6667
COUNTS_PER_STEP = 3.44
TICK = 50e-6
SLEW, RAMP = 4096 / 0.9 * 2.5, 4096 / 0.9 * 1.0
"""DAC codes in a second: 2.5 MPa/s while armed, 1 MPa/s where the board gives up."""
SLOW = "-DBAUD=115200L"


def test_idle_at_power_on(host: Host) -> None:
    """A board that nobody talks to says who it is, reports, and does nothing."""
    host.run(0.5)
    hello = next(values for _, kind, values in host.heard if kind is HELLO)
    assert (hello["version"], hello["channels"], hello["reset_cause"]) == (protocol.VERSION, 6, protocol.ResetCause.POWER_ON)
    assert (hello["monitors"], hello["limits"], hello["timeout_ms"]) == (6, LIMITS_CHECK, 100)
    assert host.state is State.IDLE
    assert host.board.safe
    assert host.decoder.bad == 0
    assert not host.board.step_counts.any()


def follow_pressures(host: Host, sequences: np.ndarray) -> None:
    """Six sequences of codes, one of each in 7 ms (a regulator is written every 6 ms): each channel gives exactly its own."""
    host.ready()
    host.board.dac_changes()
    given: list[list[int]] = [[] for _ in range(6)]
    for codes in sequences:
        host.set(pressures=codes.tolist())
        host.run(0.007)
        for _, channel, code in host.board.dac_changes():
            if not given[int(channel)] or given[int(channel)][-1] != code:
                given[int(channel)].append(int(code))
    host.run(0.01)
    assert host.state is State.ARMED
    for k in range(6):
        missing = set(sequences[:-2, k].tolist()) - set(given[k])
        assert not missing
    assert np.array_equal(host.board.dac, sequences[-1])


def sweep(step: int) -> np.ndarray:
    """Up and down again in small steps, each channel with codes of its own."""
    up = np.arange(0, PRESSURE_MAX + 1, step)[:, None] + np.arange(6)[None] * step // 6
    return np.clip(np.concatenate([up, np.full((3, 6), PRESSURE_MAX), up[::-1]]), 0, PRESSURE_MAX)


def test_pressure_set_points(host: Host) -> None:
    """Codes over the whole range, both ends included, come out of the DACs as they are: 0 counts of error on all six channels."""
    follow_pressures(host, sweep(60))


@pytest.mark.slow
def test_every_pressure_set_point(host: Host) -> None:
    """All 2276 codes on all six channels."""
    follow_pressures(host, sweep(1))


def test_pressure_slew(armed: Host) -> None:
    """While armed pressure changes with 2.5 MPa/s at the most; when the board gives up it goes to zero with 1 MPa/s, and no slower."""
    board = armed.board
    board.dac_changes()
    armed.hold(0.25, pressures=[PRESSURE_MAX] * 6)
    assert np.all(board.dac == PRESSURE_MAX)
    rise = board.dac_changes()
    armed.run(0.75)
    assert armed.state is State.HOST_TIMEOUT
    assert np.all(board.dac == 0)
    fall = board.dac_changes()
    for events, rate, most in ((rise, SLEW, PRESSURE_MAX / SLEW), (fall, RAMP, PRESSURE_MAX / RAMP)):
        for k in range(6):
            time, code = events[events[:, 1] == k][:, [0, 2]].T
            change = np.abs(np.diff(code))
            assert change.max() <= np.ceil(rate * 0.006)  # the regulators are written in turn, every 6 ms
            moving = time[1:][change > 0]
            assert most - 0.006 <= moving[-1] - moving[0] + 0.006 <= 1.01 * most + 0.006


def test_slower_pressure_slew(armed: Host) -> None:
    """CONFIG makes it slower, not faster."""
    assert armed.config(Key.PRESSURE_SLEW, 2913)["result"] == Result.OUT_OF_RANGE
    armed.hold(0.05)
    assert armed.config(Key.PRESSURE_SLEW, 291)["result"] == Result.DONE
    armed.hold(0.1, pressures=[2000] * 6)
    assert np.all(armed.board.dac <= 0.1 * SLEW * 0.1 + 7)
    assert np.all(armed.board.dac >= 0.1 * SLEW * 0.08)


@pytest.mark.slow
def test_tension_set_points(armed: Host) -> None:
    """Tensions over the whole range on all six channels: measured within one step of the motor (3.4 counts), whichever way they came."""
    armed.hold(0.05)
    rng = np.random.default_rng(3)
    worst, before = 0.0, np.full(6, ZERO)
    for goal in [np.full(6, TENSION_MAX), *rng.integers(ZERO, TENSION_MAX + 1, (2, 6)), np.full(6, ZERO)]:
        armed.hold(0.25 + np.abs(goal - before).max() / COUNTS_PER_STEP / 9524, tendons=goal.tolist())
        before = goal
        worst = max(worst, np.abs(np.array(armed.status["dynamometers"]) - goal).max())
        assert armed.state is State.ARMED
    print(f"worst error of tension {worst} counts")
    assert worst <= COUNTS_PER_STEP


@pytest.mark.slow
def test_small_tension_steps(armed: Host) -> None:
    """Steps of tension of a few counts arrive within one step as well, and a motor that is there rests."""
    for level in range(0, 60, 4):
        goal = [ZERO + 9000 + level + k for k in range(6)]
        armed.hold(0.6 if level == 0 else 0.06, tendons=goal)
        assert np.abs(np.array(armed.status["dynamometers"]) - goal).max() <= COUNTS_PER_STEP
    before = armed.board.step_counts
    armed.hold(0.2, tendons=goal)
    assert np.array_equal(armed.board.step_counts, before)


@pytest.mark.slow
def test_position_set_points(armed: Host) -> None:
    """In position mode every motor goes exactly to its step, over the whole range and by single steps."""
    armed.board.counts_per_step(0)
    rng = np.random.default_rng(4)
    goals = [np.full(6, POSITION_MAX), np.arange(6), *(np.arange(6) + k for k in range(1, 4)), *rng.integers(0, POSITION_MAX + 1, (1, 6))]
    before = np.zeros(6)
    for goal in goals:
        armed.hold(0.25 + np.abs(goal - before).max() / 9524, tendons=goal.tolist(), steps=True)
        before = goal
        assert np.array_equal(armed.board.positions, goal)
        assert armed.status["positions"] == tuple(goal)
    before = armed.board.step_counts
    armed.hold(0.1, tendons=goal.tolist(), steps=True)
    assert np.array_equal(armed.board.step_counts, before)


@pytest.mark.slow
def test_step_timing(armed: Host) -> None:
    """10^5 steps at full rate, back and forth, all six motors at once, while the host sends 200 set points a second.

    Every step is on the 50 us grid but for the interrupt's latency; two steps of a motor are at least 100 us apart (less that latency); the
    direction line has been still for 50 us at least before a step and stays for 50 us after it; no step is lost or added; the main loop has
    time left and gives signs of life at least twice as often as it has to.
    """
    board = armed.board
    board.counts_per_step(0)
    late = armed.status["late"]
    board.steps()
    board.direction_changes()
    board.watch()
    steps, directions = [], []
    for k in range(4):
        goal = [POSITION_MAX - 100 * motor if k % 2 == 0 else 17 * motor for motor in range(6)]
        armed.hold(0.9, tendons=goal, steps=True)
        steps.append(board.steps())
        directions.append(board.direction_changes())
        assert np.array_equal(board.positions, goal)
    steps, directions = np.concatenate(steps), np.concatenate(directions)
    assert len(steps) == board.step_counts.sum()
    assert len(steps) > 100_000

    cycle = np.round(steps[:, 0] * HZ).astype(int)
    phase = (cycle + 400 - int(np.median(cycle % 800))) % 800 - 400
    jitter = (phase.max() - phase.min()) / HZ
    apart, before, after = [], [], []
    for motor in range(6):
        own = cycle[steps[:, 1] == motor]
        apart.append(np.diff(own).min() / HZ)
        turns = np.round(directions[directions[:, 1] == motor, 0] * HZ).astype(int)
        assert len(turns) >= 3
        at = np.searchsorted(own, turns)
        before.append((turns[at > 0] - own[at[at > 0] - 1]).min() / HZ)
        after.append((own[at[at < len(own)]] - turns[at < len(own)]).min() / HZ)
    rate = 1 / np.diff(np.sort(cycle[steps[:, 1] == 0])).astype(float)
    print(
        f"{len(steps)} steps, jitter {1e6 * jitter:.2f} us, {1e6 * min(apart):.2f} us apart at least, direction still "
        f"{1e6 * min(after):.1f} us before and {1e6 * min(before):.1f} us after a step, worst gap {1e6 * board.worst_gap:.0f} us, "
        f"{100 * board.idle:.0f} % idle, longest pass {1e6 * board.longest_pass:.0f} us"
    )
    assert jitter <= 12e-6
    assert min(apart) >= 2 * TICK - jitter - 0.5 / HZ
    assert np.median(rate) * HZ >= 9000
    assert min(after) >= TICK
    assert min(before) >= TICK
    assert board.worst_gap <= 200e-6
    assert board.longest_pass <= 1e-3
    assert board.idle >= 0.1
    assert armed.status["late"] == late


def test_busy_board_keeps_time(armed: Host) -> None:
    """All six motors at full rate, 200 set points a second that switch motors on and off, and damaged frames as fast as the board reads.

    The main loop is never late, and its signs of life come at least twice as often as the interrupt needs them (400 us).
    """
    board, rng = armed.board, np.random.default_rng(2)
    board.counts_per_step(0)
    late = armed.status["late"]
    board.watch()
    for k in range(200):
        armed.set(tendons=[POSITION_MAX * (k // 100 % 2 == 0)] * 6, steps=True, enabled=ALL if k % 20 else 0x15)
        garbage = [bytes(rng.integers(1, 256, n, dtype=np.uint8)) for n in (13, 8)]
        board.send(b"\0" + garbage[0] + b"\0" + garbage[1] + b"\0")
        armed.run(0.005)
    print(
        f"worst gap {1e6 * board.worst_gap:.0f} us, {100 * board.idle:.0f} % idle, longest pass {1e6 * board.longest_pass:.0f} us, "
        f"{board.step_counts.sum()} steps"
    )
    assert armed.state is State.ARMED
    assert armed.status["bad"] > 300
    assert board.step_counts[0::2].min() > 5000
    assert armed.status["late"] == late
    assert board.worst_gap <= 200e-6


def test_disabled_motors_stop_at_once(armed: Host) -> None:
    """A motor that is switched off in full motion makes no step after its ENA, while the others go on; on again it counts from 0."""
    board = armed.board
    board.counts_per_step(0)
    for period in (0.2, 0.2003, 0.2007):  # in different places of a pass
        armed.hold(period, tendons=[5000] * 6, steps=True)
        moved = board.step_counts
        armed.hold(0.02, tendons=[5000] * 6, steps=True, enabled=0x2A)
        after = board.step_counts
        assert board.enabled == 0x2A
        assert np.all(after[1::2] > moved[1::2] + 100)
        assert np.all(after[0::2] <= moved[0::2] + 60)  # two frames and three passes later
        armed.run(0.001)
        assert np.array_equal(board.step_counts[0::2], after[0::2])
        at = board.positions
        armed.hold(0.02, tendons=[0] * 6, steps=True, enabled=ALL)
        assert np.array_equal(np.array(armed.status["positions"])[0::2], (board.positions - at)[0::2])
        armed.hold(0.02, tendons=[0] * 6, steps=True, enabled=0)
        assert board.idle_steps == 0


@pytest.mark.slow
def test_position_mode_from_far_away(armed: Host) -> None:
    """A motor that wound backwards by nearly the whole travel finds the way to the other end: no overflow turns it round."""
    board = armed.board
    board.counts_per_step(0)
    armed.hold(3.0, period=0.01, tendons=[ZERO - 2000] * 6)
    assert armed.state is State.ARMED
    at = np.array(armed.status["positions"])
    assert np.all(at < 6667 - 2**15)
    armed.hold(0.4, period=0.01, tendons=[POSITION_MAX] * 6, steps=True)
    assert armed.state is State.ARMED
    assert np.all(np.array(armed.status["positions"]) > at + 100)


def test_step_rate(armed: Host) -> None:
    """CONFIG makes the motors slower, not faster."""
    board = armed.board
    board.counts_per_step(0)
    assert armed.config(Key.STEP_RATE, 9525)["result"] == Result.OUT_OF_RANGE
    armed.hold(0.02)
    assert armed.config(Key.STEP_RATE, 2000)["result"] == Result.DONE
    armed.hold(0.3, tendons=[POSITION_MAX] * 6, steps=True)
    assert np.all(board.step_counts <= 600)
    assert np.all(board.step_counts >= 540)


def test_config(host: Host) -> None:
    """Unknown settings and values out of range are refused; the period of STATUS is what it is set to."""
    host.run(0.05)
    assert host.config(Key.STATUS_PERIOD_MS, 0)["result"] == Result.OUT_OF_RANGE
    assert host.config(Key.STATUS_PERIOD_MS, 101)["result"] == Result.OUT_OF_RANGE
    assert host.config(Key.STEPS_PER_1000_COUNTS, 901)["result"] == Result.OUT_OF_RANGE
    assert host.request(CONFIG, session=host.session, key=99, value=1)["result"] == Result.UNKNOWN_KEY
    assert host.config(Key.STATUS_PERIOD_MS, 20)["result"] == Result.DONE
    host.run(0.05)
    before = len(host.statuses)
    host.run(0.2)
    assert len(host.statuses) - before == 10


def converse(host: Host, duration: float, period: float) -> None:
    """Set points at a steady rate: every STATUS comes, in order, at its time, and acknowledges a recent one; the board is never late."""
    host.ready()
    host.run(0.05)
    late, count = host.status["late"], len(host.statuses)
    behind, sets = [], round(duration / period)
    good = host.status["good"]
    for k in range(sets):
        host.set(pressures=[k % 500] * 6, tendons=[ZERO + 3000 + 5 * (k % 200)] * 6)
        host.run(period)
        if k:
            behind.append(host.sequence - host.status["sequence"])
        host.board.steps()
    host.run(2 * period)
    statuses = host.statuses[count:]
    counts, times = (np.array([status[name] for status in statuses]) for name in ("count", "time_ms"))
    assert len(statuses) in range(sets - 1, sets + 4)
    assert np.all(np.diff(counts) % 256 == 1)
    assert np.all(np.diff(times) == round(1e3 * period))
    print(f"{sets} set points, {len(statuses)} STATUS, at most {max(behind)} behind")
    assert max(behind) <= 3
    assert host.status["sequence"] == host.sequence
    assert (host.status["good"] - good) % 2**16 == sets
    assert host.status["bad"] == 0
    assert host.decoder.bad == 0
    assert host.status["refused"] == 0
    assert host.status["late"] == late
    assert host.state is State.ARMED


@pytest.mark.slow
def test_200_hz(host: Host) -> None:
    """Set points and STATUS 200 times a second at 250,000 baud, for 2 s: more of them than there are sequence numbers."""
    converse(host, 2, 0.005)


@pytest.mark.slow
def test_200_hz_for_a_minute(host: Host) -> None:
    """The same for 60 s."""
    converse(host, 60, 0.005)


def slow_line(board_factory: Callable[..., Board], build: Callable[[str, str], Path]) -> Host:
    board = board_factory(build("mega", SLOW))
    board.line(115200)
    return Host(board)


@pytest.mark.slow
def test_100_hz(board_factory: Callable[..., Board], build: Callable[[str, str], Path]) -> None:
    """Set points and STATUS 100 times a second at 115,200 baud, for 3 s: more of them than there are sequence numbers."""
    host = slow_line(board_factory, build)
    converse(host, 3, 0.01)
    assert host.board.baud == 16_000_000 // 17 // 8  # 117,647: 2.1 % off, as near as 16 MHz come


@pytest.mark.slow
def test_100_hz_for_a_minute(board_factory: Callable[..., Board], build: Callable[[str, str], Path]) -> None:
    """The same for 60 s."""
    converse(slow_line(board_factory, build), 60, 0.01)


def test_requests_do_not_shift_status(armed: Host) -> None:
    """A STATUS that has to wait for an answer is late by less than a period, and those after it are on their old grid again."""
    for _ in range(4):
        armed.hold(0.05)
        armed.set()
        armed.config(Key.STEP_RATE, 9000)
    armed.hold(0.1)
    times = np.array([status["time_ms"] for status in armed.statuses[5:]])
    counts = np.array([status["count"] for status in armed.statuses[5:]])
    assert np.all(np.diff(counts) % 256 == 1)
    assert np.diff(times).max() <= 10
    assert len(set(times[-10:] % 5)) == 1
    assert times[-1] - times[0] == 5 * (len(times) - 1)


def test_refused_set_points(armed: Host) -> None:
    """Beyond a limit, negative, or for what is not there: refused as a whole and counted; nothing moves and the host counts as silent."""
    bad = [
        {"pressures": [PRESSURE_MAX + 1, 0, 0, 0, 0, 0]},
        {"pressures": [0, 0, 0, 0, 0, 65535]},
        {"tendons": [TENSION_MAX + 1, *[ZERO] * 5]},
        {"tendons": [*[ZERO] * 5, -1]},
        {"tendons": [POSITION_MAX + 1, 0, 0, 0, 0, 0], "steps": True},
        {"tendons": [0, 0, -32768, 0, 0, 0], "steps": True},
        {"enabled": ALL | 0x40},
    ]
    for values in bad:
        armed.set(**{"pressures": [500] * 6, "tendons": [ZERO] * 6, **values})
        armed.run(0.005)
        armed.sequence -= 1  # it was not taken
    armed.run(0.04)
    assert armed.status["refused"] == len(bad)
    assert armed.status["sequence"] == 0
    assert armed.state is State.ARMED
    assert armed.board.safe
    armed.run(0.05)
    assert armed.state is State.HOST_TIMEOUT
    assert not armed.board.step_counts.any()
    assert not armed.board.dac_peak.any()


@pytest.mark.parametrize("position", [False, True], ids=["tension", "position"])
def test_limits_themselves_are_allowed(armed: Host, position: bool) -> None:
    """The largest set points are accepted."""
    armed.set(pressures=[PRESSURE_MAX] * 6, tendons=[POSITION_MAX if position else TENSION_MAX] * 6, steps=position)
    armed.run(0.02)
    assert (armed.status["refused"], armed.status["sequence"]) == (0, 1)
    assert armed.status["enabled"] == ALL | protocol.POSITION_MODE * position


def test_only_armed_moves(host: Host) -> None:
    """Set points to a board that is not armed are read and change nothing."""
    host.run(0.05)
    host.hold(0.1, pressures=[2000] * 6, tendons=[ZERO + 5000] * 6)
    host.run(0.02)
    assert host.status["stale"] == host.sequence
    assert host.board.safe
    assert not host.board.step_counts.any()


@pytest.mark.slow
def test_uno(board_factory: Callable[..., Board], build: Callable[[str, str], Path]) -> None:
    """Firmware for an Uno, built without warnings: three regulators, three motors, the processor's own converter."""
    host = Host(board_factory(build("uno", ""), mcu="atmega328p"))
    host.ready()
    hello = next(values for _, kind, values in host.heard if kind is HELLO)
    assert hello["channels"] == 3
    goal = [ZERO + 6000, ZERO + 9000, ZERO + 12000]
    host.hold(1.0, pressures=[300, 1000, PRESSURE_MAX, 0, 0, 0], tendons=[*goal, 0, 0, 0], enabled=7)
    assert host.state is State.ARMED
    assert host.board.dac.tolist() == [300, 1000, PRESSURE_MAX, 0, 0, 0]
    assert np.abs(np.array(host.status["dynamometers"][:3]) - goal).max() <= RESOLUTION
    for values in ({"tendons": [ZERO] * 4 + [0, 0]}, {"pressures": [0, 0, 0, 1, 0, 0]}, {"enabled": 8}):
        host.set(**{"tendons": [*goal, 0, 0, 0], "enabled": 7, **values})
        host.sequence -= 1
    host.run(0.03)
    assert host.status["refused"] == 3
    assert host.board.outputs
    host.board.estop(True)
    host.run(0.02)
    assert host.state is State.ESTOP
    assert host.board.safe
    assert not host.board.outputs


RESOLUTION = 0.003 / 5 * 32768
"""3 mV in counts: what the processor's own converter and the tension loop reach."""


@pytest.mark.slow
def test_other_parts(board_factory: Callable[..., Board], build: Callable[[str, str], Path]) -> None:
    """Firmware for a slow line, DACs on the two-wire bus and the processor's own converter, built without warnings.

    What the DACs' own memory says at power-on does not get out.
    """
    board = board_factory(build("mega", f"{SLOW} -DDAC=DAC_MCP4728 -DADC_TENSION=ADC_INTERNAL"))
    board.line(115200)
    board.dac_memory(0x0FFF)
    host = Host(board)
    host.ready()
    assert not board.dac_peak.any()
    goal, pressures = [ZERO + 3000 * k for k in range(1, 7)], [0, 300, 1000, 1700, PRESSURE_MAX, 7]
    host.hold(1.4, period=0.01, pressures=pressures, tendons=goal)
    assert host.state is State.ARMED
    assert board.dac.tolist() == pressures
    worst = 0
    for _ in range(20):
        host.hold(0.01, period=0.01, pressures=pressures, tendons=goal)
        worst = max(worst, np.abs(ZERO + board.positions * 3276.8 * 1.05e-3 - goal).max())
    print(f"worst error of tension {worst:.1f} counts")
    assert worst <= RESOLUTION
    board.estop(True)
    host.run(0.03)
    assert host.state is State.ESTOP
    assert board.safe


def test_status_and_set_are_what_this_file_thinks() -> None:
    """Frames of 65 and 38 bytes: 200 Hz need 52 % of the line from the board at 250,000 baud, 100 Hz 56 % at 115,200."""
    assert len(protocol.frame(STATUS.pack(**{name: [1] * 6 if code[0] == "6" else 1 for name, code in STATUS.fields}))) == 65
    assert len(protocol.frame(SET.pack(session=1, sequence=1, enabled=1, pressures=[1] * 6, tendons=[1] * 6))) == 38
    assert Fault.NONE == 0
