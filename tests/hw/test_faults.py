"""What can go wrong, on the emulated board: for each fault the safe state that follows, and the time until it is there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.protocol import ACK, ARM, CLEAR, CONFIG, ESTOP, HELLO, SET, Fault, Key, ResetCause, Result, State
from tests.hw.conftest import PRESSURE_MAX
from tests.hw.emulator import BROWN_OUT, HZ, PIN, POWER_ON, Board
from tests.hw.emulator.host import ALL, LIMITS_CHECK, ZERO, Host

RAMP = 4096 / 0.9 * 1.0
"""DAC codes in a second, when the board gives up."""
FAR = [ZERO + 20000] * 6
PRESSURES = [1500] * 6


@pytest.fixture
def busy(armed: Host) -> Host:
    """A bare host on a board whose motors are in full motion, under pressure."""
    armed.hold(0.15, tendons=FAR, pressures=PRESSURES)
    assert armed.board.step_counts.min() > 900
    assert armed.board.enabled == ALL
    assert armed.board.dac.min() > 500
    return armed


def until(host: Host, reached: Callable[[], bool], most: float, slice_s: float = 0.0005) -> float:
    """Time in s until something is so, without the host sending anything."""
    begin = host.board.time
    while not reached():
        assert host.board.time - begin < most, f"not within {most} s"
        host.run(slice_s, slice_s)
    return host.board.time - begin


def is_off(host: Host) -> Callable[[], bool]:
    return lambda: host.board.enabled == 0


def is_safe(host: Host) -> Callable[[], bool]:
    return lambda: host.board.safe


def no_more_steps(host: Host, duration: float = 0.05) -> None:
    """Nothing moves and nothing is switched on for some time."""
    before = host.board.step_counts
    for _ in range(round(duration / 0.005)):
        host.run(0.005)
        assert host.board.enabled == 0
    assert np.array_equal(host.board.step_counts, before)


def pressure_goes(host: Host, begin: np.ndarray) -> None:
    """To zero with the ramp: neither at once nor later than it takes."""
    took = until(host, is_safe(host), 1.0)
    assert begin.max() / RAMP - 0.01 <= took <= begin.max() / RAMP + 0.01


def back_to_work(host: Host) -> None:
    """ARM alone is refused; CLEAR and then ARM lead back, and the motors count from 0."""
    assert host.arm()["result"] == Result.WRONG_STATE
    assert host.clear() | {"id": 0} == {
        **{"id": 0, "request": CLEAR.code, "result": 0, "channel": 0},
        **{"state": State.IDLE, "session": host.session},
    }
    assert host.board.enabled == 0
    assert host.arm()["result"] == Result.DONE
    host.hold(0.03)
    assert host.state is State.ARMED
    assert host.board.enabled == ALL


def test_host_silent(busy: Host) -> None:
    """Motors off 100 ms after the last set point, pressure to zero with its ramp from then on."""
    took = until(busy, is_off(busy), 0.2) + 0.005  # `hold` ends 5 ms after its last set point
    print(f"motors off after {1e3 * took:.1f} ms")
    assert 0.09 <= took <= 0.11
    pressure_goes(busy, busy.board.dac)
    assert busy.state is State.HOST_TIMEOUT
    assert busy.fault is Fault.NONE
    no_more_steps(busy)
    back_to_work(busy)


def test_cable_cut_and_replugged(busy: Host) -> None:
    """Nothing arrives any more: as if the host were silent. Plugging in resets the board: it is idle, as everything was off already."""
    busy.set(tendons=FAR)
    busy.board.cut()
    assert until(busy, is_off(busy), 0.2) <= 0.11
    until(busy, is_safe(busy), 1.0)
    session = busy.session
    busy.board.reset(PIN)
    assert busy.board.safe
    busy.run(0.1)
    assert (busy.state, busy.fault) == (State.IDLE, Fault.NONE)
    assert busy.session != session
    no_more_steps(busy)
    assert busy.arm()["result"] == Result.DONE


@pytest.mark.parametrize(("cause", "bit"), [(PIN, ResetCause.RESET_PIN), (BROWN_OUT, ResetCause.BROWN_OUT)], ids=["pin", "brown-out"])
def test_reset_in_motion(busy: Host, cause: int, bit: ResetCause) -> None:
    """A reset switches everything off within the instruction, and the board knows afterwards that the robot was armed."""
    before, session = busy.board.step_counts, busy.session
    busy.board.dac_changes()
    busy.board.reset(cause)
    assert busy.board.safe
    busy.sequence = 0
    busy.hold(0.1, tendons=FAR, pressures=PRESSURES)  # a host that did not notice
    assert busy.board.safe
    assert not busy.board.dac_changes()[:, 2].any()
    assert np.array_equal(busy.board.step_counts, before)
    assert (busy.state, busy.fault) == (State.FAULT, Fault.RESET_WHILE_ARMED)
    assert next(values for _, kind, values in reversed(busy.heard) if kind is HELLO)["reset_cause"] == bit
    assert busy.session != session
    back_to_work(busy)


@pytest.mark.parametrize("seed", range(1, 5))
def test_power_lost(board_factory: Callable[..., Board], seed: int) -> None:
    """Memory is random afterwards: the board is idle, whatever it finds there."""
    host = Host(board_factory(seed=seed))
    host.ready()
    host.hold(0.05, tendons=FAR, pressures=PRESSURES)
    before = host.board.step_counts
    assert before.min() > 0
    host.board.reset(POWER_ON)
    assert host.board.safe
    host.run(0.1)
    assert (host.state, host.fault) == (State.IDLE, Fault.NONE)
    assert host.board.safe
    assert np.array_equal(host.board.step_counts, before)
    assert next(values for _, kind, values in reversed(host.heard) if kind is HELLO)["reset_cause"] == ResetCause.POWER_ON


@pytest.mark.parametrize("moment", [0.0, 0.00037, 0.00071], ids=lambda moment: f"{1e6 * moment:.0f} us")
def test_hung_main_loop(busy: Host, moment: float) -> None:
    """No motor makes more than 5 steps from when the loop hangs, in whichever part of a pass; the interrupt has switched everything off
    within 1 ms; the watchdog resets within 150 ms, and the board says that the robot was armed.
    """
    board = busy.board
    board.run(moment)
    board.run_to("loop")
    before, begin = board.step_counts, board.time
    board.hang()
    took = until(busy, is_safe(busy), 0.001, 0.00001)
    assert not board.outputs
    after = board.step_counts - before
    print(f"{after.max()} steps, off after {1e6 * took:.0f} us")
    assert after.max() <= 5
    board.run_to("__vectors", 0.2)
    took = board.time - begin
    print(f"watchdog after {1e3 * took:.1f} ms")
    assert 0.1 <= took <= 0.15
    assert np.array_equal(board.step_counts - before, after)
    assert board.safe
    board.mend()
    busy.run(0.05)
    assert (busy.state, busy.fault) == (State.FAULT, Fault.RESET_WHILE_ARMED)
    no_more_steps(busy)
    assert board.safe
    back_to_work(busy)


@pytest.mark.parametrize("pause", [0.0006, 0.003, 0.05])
def test_main_loop_pauses(busy: Host, pause: float) -> None:
    """A loop that goes on before the watchdog bites finds everything switched off, reports it, and brings nothing back by itself.

    Switching on again begins at no pressure, even at once.
    """
    board = busy.board
    busy.set(tendons=FAR, pressures=PRESSURES)  # is read just when the loop goes on
    busy.set(tendons=FAR, pressures=PRESSURES, enabled=0x15)
    board.run_to("loop")
    before = board.step_counts
    board.hang()
    busy.run(pause)
    assert board.safe
    board.dac_changes()
    board.mend()
    for _ in range(40):
        busy.run(0.0005, 0.0005)
        assert board.enabled == 0
    assert np.all(board.step_counts - before <= 5)
    assert not board.outputs
    assert (busy.state, busy.fault) == (State.FAULT, Fault.LOOP_HUNG)
    back_to_work(busy)
    assert board.outputs
    assert not board.dac_changes()[:, 2].any()


@pytest.mark.parametrize(("channel", "counts"), [(0, 60_000), (5, -60_000)], ids=["open", "shorted"])
def test_dynamometer(busy: Host, channel: int, counts: int) -> None:
    """An open or shorted dynamometer: motors off within 8 ms, pressure to zero; and no arming as long as it is so."""
    busy.board.dynamometer(channel, counts)
    took = until(busy, is_off(busy), 0.02)
    print(f"off after {1e3 * took:.1f} ms")
    assert 0.004 <= took <= 0.008
    pressure_goes(busy, busy.board.dac)
    assert (busy.state, busy.fault, busy.status["channel"]) == (State.FAULT, Fault.DYNAMOMETER, channel)
    busy.clear()
    refused = busy.arm()
    assert (refused["result"], refused["channel"]) == (Result.DYNAMOMETER, channel)
    no_more_steps(busy)
    busy.board.dynamometer(channel, ZERO)
    busy.run(0.01)
    assert busy.arm()["result"] == Result.DONE


@pytest.mark.parametrize("channel", [0, 3])
def test_tension_too_high(armed: Host, channel: int) -> None:
    """7.35 N are allowed, a count more for 2 ms is not: motors off within 4 ms. A single sample does nothing."""
    board, trip = armed.board, 27361
    board.follow(False)
    for k in range(6):
        board.monitor(k, 1.0)
    board.dynamometer(channel, trip)
    armed.hold(0.1)
    board.dynamometer(channel, trip + 1)
    armed.run(0.001, 0.001)
    board.dynamometer(channel, trip)
    armed.hold(0.05)
    assert armed.state is State.ARMED
    assert board.enabled == ALL
    board.dynamometer(channel, trip + 1)
    took = until(armed, is_off(armed), 0.02)
    print(f"off after {1e3 * took:.1f} ms")
    assert took <= 0.004
    armed.run(0.02)
    assert (armed.state, armed.fault, armed.status["channel"]) == (State.FAULT, Fault.TENSION_TOO_HIGH, channel)
    no_more_steps(armed)


def test_tension_that_leaves_the_range(armed: Host) -> None:
    """A tension that swings about the end of the dynamometer's range is too high as well, though neither case comes twice in a row."""
    board = armed.board
    board.follow(False)
    armed.hold(0.02)
    begin = board.time
    while board.enabled:
        board.dynamometer(2, 32000 if round((board.time - begin) / 0.001) % 2 else 30000)
        armed.run(0.001, 0.001)
        assert board.time - begin < 0.01
    armed.run(0.02)
    assert (armed.state, armed.fault, armed.status["channel"]) == (State.FAULT, Fault.TENSION_TOO_HIGH, 2)


@pytest.mark.slow
@pytest.mark.parametrize(("code", "volts"), [(1500, 1.0), (0, 1.6)], ids=["low", "high"])
def test_stuck_regulator(armed: Host, code: int, volts: float) -> None:
    """A monitor that is 0.1 MPa off for 1.5 s: motors off, pressure to zero. One that is 0.09 MPa off is not stuck."""
    board = armed.board
    board.follow(False)
    for k in range(6):
        board.monitor(k, 1.0 + 4 * code / 4096 + (0.4 if k % 2 else -0.4))
    armed.hold(0.3, pressures=[code] * 6)
    begin = board.time
    board.monitor(4, volts)
    while board.enabled:
        armed.hold(0.01, pressures=[code] * 6)
        assert board.time - begin < 1.6
    took = board.time - begin
    print(f"off after {took:.2f} s")
    assert 1.45 <= took <= 1.55
    armed.run(0.02)
    assert (armed.state, armed.fault, armed.status["channel"]) == (State.FAULT, Fault.REGULATOR, 4)
    if code:
        pressure_goes(armed, board.dac)


def test_estop_button(busy: Host) -> None:
    """The button, or its broken wire: everything off within 2 ms, outputs too; and no way back while it is pressed."""
    board = busy.board
    board.estop(True)
    took = until(busy, is_safe(busy), 0.01, 0.0001)
    print(f"safe after {1e3 * took:.1f} ms")
    assert took <= 0.002
    assert not board.outputs
    busy.run(0.02)
    assert busy.state is State.ESTOP
    no_more_steps(busy)
    assert busy.clear()["result"] == Result.ESTOP_PRESSED
    assert busy.arm()["result"] == Result.ESTOP_PRESSED
    assert not board.outputs
    board.estop(False)
    busy.run(0.05)
    assert busy.state is State.ESTOP
    board.dac_changes()
    back_to_work(busy)
    assert not board.dac_changes()[:, 2].any()


def test_estop_frame(busy: Host) -> None:
    """ESTOP over the line: everything off within 3 ms of being sent; CLEAR brings no pressure back, and is refused while there is some."""
    board = busy.board
    board.dac_changes()
    busy.send(ESTOP, id=200)
    busy.send(CLEAR, id=201, session=busy.session + 1)
    took = until(busy, is_safe(busy), 0.01, 0.0001)
    print(f"safe after {1e3 * took:.1f} ms")
    assert took <= 0.003
    changes = board.dac_changes()
    busy.run(0.03)
    assert busy.heard[-1][2]["session"] == busy.session
    assert [heard["result"] for _, kind, heard in busy.heard if kind is ACK][-2:] == [Result.DONE, Result.MONITOR]
    assert busy.clear()["result"] == Result.DONE
    for k in range(6):
        codes = changes[changes[:, 1] == k, 2]
        assert np.all(np.diff(codes[codes.argmin() :]) == 0)  # once at zero it stays there
    assert not board.dac_changes()[:, 2].any()


def test_estop_pressed_at_power_on(board: Board) -> None:
    """A button that is pressed, or not connected, when the board starts."""
    board.estop(True)
    host = Host(board)
    host.run(0.05)
    assert host.state is State.ESTOP
    assert host.arm()["result"] == Result.ESTOP_PRESSED
    assert host.clear()["result"] == Result.ESTOP_PRESSED
    assert not board.outputs


def test_disarm(busy: Host) -> None:
    """DISARM: motors off within 3 ms, pressure to zero with its ramp; ARM alone leads back."""
    busy.send(protocol.DISARM, id=77)
    assert until(busy, is_off(busy), 0.01, 0.0001) <= 0.003
    pressure_goes(busy, busy.board.dac)
    assert busy.state is State.IDLE
    no_more_steps(busy)
    assert busy.arm()["result"] == Result.DONE


def drop(data: bytes, rng: np.random.Generator) -> bytes:
    return bytes(byte for byte in data if rng.random() >= 0.002)


def flip(data: bytes, rng: np.random.Generator) -> bytes:
    return bytes(byte ^ (1 << rng.integers(8)) if rng.random() < 0.002 else byte for byte in data)


@pytest.mark.slow
@pytest.mark.parametrize("damage", [drop, flip])
def test_bad_line(armed: Host, damage: Callable[[bytes, np.random.Generator], bytes]) -> None:
    """Of 500 bytes one is lost, or has a bit turned round: the robot stays armed and follows; 2 s of it are as good as none.

    About every sixteenth set point does not arrive; the robot would stop after twenty in a row. No damaged one is acted on: neither refused
    set points, which a wrong one would be in nearly all cases, nor a motor that is not where the last set point wants it.
    """
    board, rng = armed.board, np.random.default_rng(5)
    board.counts_per_step(0)
    behind = []
    for k in range(400):
        goal = [1000 + 4 * k] * 6
        armed.sequence += 1
        data = protocol.frame(
            SET.pack(session=armed.session, sequence=armed.sequence, enabled=ALL | protocol.POSITION_MODE, pressures=[k] * 6, tendons=goal)
        )
        board.send(damage(data, rng))
        armed.run(0.005)
        if k:
            behind.append(armed.sequence - armed.status["sequence"])
    armed.hold(0.05, tendons=goal, steps=True, pressures=[k] * 6)
    print(f"{armed.status['bad']} frames damaged, at most {max(behind)} set points behind")
    assert armed.status["bad"] >= 15
    assert all(status["state"] == State.ARMED for status in armed.statuses[10:])
    assert max(behind) <= 6
    assert armed.status["refused"] == 0
    assert board.positions.tolist() == goal
    assert board.dac.tolist() == [k] * 6


@pytest.mark.parametrize("kind", ["random", "zeros", "ones", "endless"])
def test_garbage_flood(busy: Host, kind: str) -> None:
    """A line full of garbage: the robot stops after 100 ms as if nothing came, the main loop keeps time, and afterwards at the latest the
    second good frame is understood.
    """
    board, rng = busy.board, np.random.default_rng(6)
    late = busy.status["late"]
    count = 25 * 250
    data = {
        "random": rng.integers(0, 256, count, dtype=np.uint8).tobytes(),
        "zeros": bytes(count),
        "ones": b"\xff" * count,
        "endless": rng.integers(1, 256, count, dtype=np.uint8).tobytes(),
    }[kind]
    board.send(data)
    board.watch()
    took = until(busy, is_off(busy), 0.2) + 0.005
    print(f"off after {1e3 * took:.1f} ms, worst gap {1e6 * board.worst_gap:.0f} us")
    assert 0.09 <= took <= 0.11
    busy.run(0.25 - took + 0.03)
    assert (busy.state, busy.fault) == (State.HOST_TIMEOUT, Fault.NONE)
    assert busy.status["late"] == late
    assert board.worst_gap <= 200e-6
    stale = busy.status["stale"]
    for _ in range(2):
        busy.set()
        busy.run(0.005)
    busy.run(0.015)
    assert busy.status["stale"] - stale in (1, 2)
    back_to_work(busy)


def test_truncated_at_each_byte(armed: Host) -> None:
    """A frame that ends early, wherever: the second good frame after it is understood at the latest, and nothing wrong before."""
    host = armed
    good = protocol.frame(SET.pack(session=host.session, sequence=99_999, enabled=ALL, pressures=PRESSURES, tendons=FAR))
    for length in range(len(good)):
        host.board.send(good[:length])
        host.set()
        host.run(0.005)
        host.set()
        host.run(0.015)
        assert host.status["sequence"] == host.sequence
    assert host.status["refused"] == 0
    assert host.status["good"] >= len(good) + 1  # after none of a frame both are understood


def test_replayed_requests(host: Host) -> None:
    """ARM and CLEAR of an earlier session are refused, also when they are the last request that the board saw."""
    host.run(0.05)
    arm = host.send(ARM, id=50, session=host.session, limits=LIMITS_CHECK)
    host.run(0.03)
    assert host.state is State.ARMED
    host.run(0.15)
    assert host.state is State.HOST_TIMEOUT
    host.board.send(arm)
    host.run(0.03)
    assert host.state is State.HOST_TIMEOUT
    clear = host.send(CLEAR, id=51, session=host.session)
    host.run(0.03)
    assert host.state is State.IDLE
    for replayed in (arm, clear, arm):
        host.board.send(replayed)
        host.run(0.03)
        assert host.state is State.IDLE
        assert host.heard[-1][2]["state"] == State.IDLE
    results = [values["result"] for _, kind, values in host.heard if kind is ACK]
    assert results == [Result.DONE, Result.DONE, Result.DONE, Result.WRONG_SESSION, Result.WRONG_SESSION, Result.WRONG_SESSION]
    host.estop()
    for replayed in (clear, arm):
        host.board.send(replayed)
        host.run(0.03)
        assert host.state is State.ESTOP


def test_new_request_with_an_old_id(host: Host) -> None:
    """A host that starts anew counts its requests from the beginning: they are done, though their ids were used before."""
    host.run(0.05)
    for _ in range(2):
        host.send(ARM, id=1, session=host.session, limits=LIMITS_CHECK)
        host.run(0.03)
        assert host.state is State.ARMED
        host.run(0.15)
        assert host.state is State.HOST_TIMEOUT
        host.board.reset(PIN)
        host.run(0.05)
    host.send(CONFIG, id=9, session=host.session, key=Key.STATUS_PERIOD_MS, value=10)
    host.run(0.03)
    host.send(CONFIG, id=9, session=host.session, key=Key.STATUS_PERIOD_MS, value=50)
    host.run(0.1)
    before = len(host.statuses)
    host.run(0.5)
    assert len(host.statuses) - before == 10


def test_requests_sent_twice(host: Host) -> None:
    """ARM, CLEAR, ESTOP and CONFIG whose answer was lost are sent again: answered the same, done once."""

    def twice(kind: protocol.Message, **values: int) -> list[dict[str, int]]:
        before = len(host.heard)
        host.send(kind, **values)
        host.run(0.015)
        host.set(enabled=0)
        host.send(kind, **values)
        host.run(0.025)
        answers = [heard for _, what, heard in host.heard[before:] if what is ACK]
        assert len(answers) == 2
        assert answers[0]["id"] == answers[1]["id"] == values["id"]
        assert answers[0]["result"] == answers[1]["result"]
        return answers

    host.run(0.05)
    first, second = twice(ARM, id=1, session=host.session, limits=LIMITS_CHECK)
    assert (first["result"], second["state"], second["session"]) == (Result.DONE, State.ARMED, first["session"])
    assert host.status["sequence"] == host.sequence  # not set back by the second
    for _ in range(2):
        assert twice(CONFIG, id=2, session=host.session, key=Key.STATUS_PERIOD_MS, value=5)[1]["result"] == Result.DONE
    session = host.session
    first, second = twice(ESTOP, id=3)
    assert (first["result"], second["state"], second["session"]) == (Result.DONE, State.ESTOP, session + 1)
    first, second = twice(CLEAR, id=4, session=host.session)
    assert (first["result"], second["state"], second["session"]) == (Result.DONE, State.IDLE, session + 2)
    assert first["session"] == second["session"]


def resampled(data: bytes, sent: float, read: float) -> bytes:
    """What a serial port at `read` bits/s makes of bytes sent at `sent` bits/s, one right after the other; it does not mind a stop bit."""
    bits = np.concatenate([[1] * 20, *([0, *(byte >> k & 1 for k in range(8)), 1] for byte in data), [1] * 40])

    def level(time: float) -> int:
        return int(bits[min(int(time * sent), len(bits) - 1)])

    edges = (np.flatnonzero(np.diff(bits) == -1) + 1) / sent
    found, free = [], 0.0
    for edge in edges:
        if edge < free:
            continue
        found.append(sum(level(edge + (1.5 + k) / read) << k for k in range(8)))
        free = edge + 9.5 / read
    return bytes(found)


def test_resampling_at_the_same_speed() -> None:
    """The receiver of the next test reads what was sent where both speeds agree, even by 2 %."""
    data = np.random.default_rng(0).integers(0, 256, 1000, dtype=np.uint8).tobytes()
    assert resampled(data, 115200, 115200) == data
    assert resampled(data, 115200, 117647) == data


def test_baud_mismatch(host: Host) -> None:
    """A host at 115,200 baud to a board at 250,000: nothing is understood, the board stays idle, and the host understands nothing."""
    host.run(0.05)
    good = host.status["good"]
    for k in range(60):
        frames = [
            protocol.frame(protocol.ASK.pack(id=k)),
            protocol.frame(ARM.pack(id=k, session=host.session, limits=LIMITS_CHECK)),
            protocol.frame(
                SET.pack(session=host.session, sequence=k + 1, enabled=ALL, pressures=[17 * k] * 6, tendons=[ZERO + 100 * k] * 6)
            ),
        ]
        host.board.send(resampled(b"".join(frames), 115200, host.board.baud))
        host.run(0.01)
    assert host.status["good"] == good
    assert host.status["bad"] > 20
    assert (host.state, host.status["sequence"], host.status["refused"]) == (State.IDLE, 0, 0)
    assert host.board.safe
    assert not host.board.step_counts.any()
    there = protocol.Decoder(protocol.TO_HOST)
    answers = b"".join(protocol.frame(kind.pack(**values)) for _, kind, values in host.heard)
    assert there.feed(resampled(answers, 250000, 115200)) == []


@pytest.mark.slow
def test_endless_winding(armed: Host) -> None:
    """A motor whose tendon is not fixed pulls at nothing: it stops after 30,000 steps."""
    board = armed.board
    board.counts_per_step(0)
    begin = board.time
    while board.enabled or board.time - begin < 0.1:
        armed.hold(0.01, tendons=[ZERO, ZERO, ZERO + 3000, ZERO, ZERO, ZERO])
        assert board.time - begin < 3.6
    armed.run(0.02)
    assert (armed.state, armed.fault, armed.status["channel"]) == (State.FAULT, Fault.TRAVEL, 2)
    assert 29_980 <= board.positions[2] <= 30_001  # the steps that were planned when it noticed are not made


def test_limits_of_this_file() -> None:
    """Times are measured on a processor of 16 MHz, and set points here are within the limits."""
    assert HZ == 16_000_000
    assert max(PRESSURES) < PRESSURE_MAX
