"""What was recorded, repeated or held up does nothing, on the emulated board: sessions, sequence numbers, limits and CRC."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from cobs import cobs

from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.protocol import ARM, CLEAR, CONFIG, SET, Key, Result, State
from tests.hw.emulator import BROWN_OUT, PIN, POWER_ON, Board
from tests.hw.emulator.frames import Frames
from tests.hw.emulator.host import ALL, LIMITS_CHECK, ZERO, Host

FAR = [ZERO + 9000] * 6
PRESSURES = [1500] * 6


def times_out(host: Host, replay: Callable[[int], bytes]) -> None:
    """A dead host's board stops after 100 ms, whatever is replayed to it every 5 ms, and nothing goes on rising."""
    board, begin, number = host.board, host.board.time, 0
    while board.enabled:
        board.send(replay(number))
        number += 1
        host.run(0.005)
        assert board.time - begin <= 0.11
    board.dac_changes()
    for _ in range(20):
        board.send(replay(number))
        number += 1
        host.run(0.005)
        assert board.enabled == 0
    for k in range(6):
        codes = board.dac_changes()
        assert np.all(np.diff(codes[codes[:, 1] == k, 2]) <= 0)
    assert host.state is State.HOST_TIMEOUT


@pytest.mark.parametrize("length", [1, 2, 256, pytest.param(130, marks=pytest.mark.slow), pytest.param(300, marks=pytest.mark.slow)])
def test_looped_recording(armed: Host, length: int) -> None:
    """The last frames of a dead host, over and over, however many: none is a sign of life, none is acted on."""
    recorded = []
    for _ in range(length):
        recorded.append(armed.set(tendons=FAR, pressures=PRESSURES))
        armed.run(0.005)
    times_out(armed, lambda k: recorded[k % length])


@pytest.mark.parametrize("age", [1, 127, 130, 255, 256, 65_536, 70_000])
def test_an_old_set_point(armed: Host, age: int) -> None:
    """However old: it moves nothing, and is counted as stale."""
    board = armed.board
    board.counts_per_step(0)
    old = armed.set(tendons=[5000] * 6, pressures=PRESSURES, steps=True)
    armed.sequence += age - 1
    armed.hold(0.3, tendons=[0] * 6, steps=True)
    at, stale = board.positions, armed.status["stale"]
    assert not board.dac.any()
    board.send(old)
    armed.hold(0.05, tendons=[0] * 6, steps=True)
    assert np.array_equal(board.positions, at)
    assert not board.dac.any()
    assert armed.status["stale"] == stale + 1
    assert armed.state is State.ARMED


def test_a_repeated_set_point_is_no_sign_of_life(armed: Host) -> None:
    """The newest one again and again, bit by bit the same."""
    last = armed.set(tendons=FAR, pressures=PRESSURES)
    armed.run(0.005)
    times_out(armed, lambda k: last)


@pytest.mark.parametrize("change", [{"session": -1}, {"session": 1}, {"sequence": 0}], ids=str)
def test_set_points_of_another_session(armed: Host, change: dict[str, int]) -> None:
    """Whatever their sequence number: only those of this arming count."""
    armed.hold(0.02)

    def other(number: int) -> bytes:
        session = armed.session + change.get("session", 0)
        sequence = armed.sequence + number + 1 if "session" in change else 0
        return protocol.frame(SET.pack(session=session, sequence=sequence, enabled=ALL, pressures=PRESSURES, tendons=FAR))

    times_out(armed, other)


@pytest.mark.parametrize("cause", [POWER_ON, PIN, BROWN_OUT], ids=["power", "pin", "brown-out"])
def test_recording_from_before_a_restart(host: Host, cause: int) -> None:
    """ARM, CLEAR and the set points after them do nothing once the board was started anew."""
    host.run(0.05)
    recorded = [
        host.send(CLEAR, id=1, session=host.session),
        host.send(ARM, id=2, session=host.session + 1, limits=LIMITS_CHECK),
    ]
    host.run(0.03)
    assert host.state is State.ARMED
    for _ in range(20):
        recorded.append(host.set(tendons=FAR, pressures=PRESSURES))
        host.run(0.005)
    assert host.board.enabled == ALL
    host.disarm()
    host.run(0.4)
    board = host.board
    for _ in range(3):
        board.reset(cause)
        before = board.step_counts
        host.run(0.05)
        for frame in recorded:
            board.send(frame)
            host.run(0.005)
            assert board.safe
        assert host.state is State.IDLE
        assert np.array_equal(board.step_counts, before)


def session_of(host: Host) -> int:
    """As the board tells it now."""
    before = len(host.heard)
    host.run(0.1)
    assert len(host.heard) > before
    return host.session


@pytest.mark.slow
def test_sessions_never_come_twice(host: Host) -> None:
    """Over 60 starts of every kind, with arming and clearing in between: all different, thanks to the counter in the EEPROM.

    A reset by the pin leaves the memory as it is, so the noise in it is no help there.
    """
    seen = [session_of(host)]
    for number in range(60):
        host.arm()
        seen.append(host.session)
        host.disarm()
        seen.append(host.session)
        host.clear()
        seen.append(host.session)
        host.board.reset((PIN, POWER_ON, BROWN_OUT)[number % 3])
        seen.append(session_of(host))
    assert len(set(seen)) == len(seen) == 241


def test_sessions_of_boards_without_a_counter(board_factory: Callable[..., Board]) -> None:
    """Where the EEPROM was erased the noise of the memory at power-on tells two starts apart."""
    sessions = {session_of(Host(board_factory(seed=seed))) for seed in range(1, 9)}
    assert len(sessions) == 8
    assert len({session & 0xFFFF for session in sessions}) == 8


@pytest.mark.slow
@pytest.mark.parametrize("torn", [0, 1, 2, 3])
def test_a_torn_write_of_the_counter(host: Host, torn: int) -> None:
    """Power is lost while the counter is written: what is half written does not count, and no session comes twice."""
    board, seen = host.board, {session_of(host)}
    for _ in range(20):
        board.reset(PIN)
        board.run(0.0015 + torn * 0.0036)  # a byte takes 3.4 ms
        board.reset(PIN)
        session = session_of(host)
        assert session not in seen
        seen.add(session)


def test_limits_have_to_be_known(host: Host) -> None:
    """ARM of a host whose robot file says something else is refused."""
    host.run(0.05)
    for wrong in (LIMITS_CHECK ^ 1, 0, 0xFFFF):
        assert host.request(ARM, session=host.session, limits=wrong)["result"] == Result.WRONG_LIMITS
        assert host.state is State.IDLE
    assert host.arm()["result"] == Result.DONE


@pytest.mark.parametrize("offset", [-1, 1, 65_536])
def test_requests_of_another_session(host: Host, offset: int) -> None:
    """ARM, CLEAR and CONFIG are refused."""
    host.run(0.05)
    session = host.session + offset
    assert host.request(ARM, session=session, limits=LIMITS_CHECK)["result"] == Result.WRONG_SESSION
    assert host.request(CLEAR, session=session)["result"] == Result.WRONG_SESSION
    assert host.request(CONFIG, session=session, key=Key.STEP_RATE, value=9000)["result"] == Result.WRONG_SESSION
    assert host.state is State.IDLE


def test_clear_while_armed(armed: Host) -> None:
    """Is refused and changes nothing."""
    armed.hold(0.05, tendons=FAR, pressures=PRESSURES)
    session = armed.session
    refused = armed.clear()
    assert (refused["result"], refused["state"], refused["session"]) == (Result.WRONG_STATE, State.ARMED, session)
    armed.hold(0.05, tendons=FAR, pressures=PRESSURES)
    assert armed.state is State.ARMED
    assert armed.board.enabled == ALL


def test_zeros_do_not_hide_in_a_frame(frames: Frames) -> None:
    """The CRC of a message with zeros before or behind it is wrong."""
    for payload in (protocol.ASK.pack(id=7), ARM.pack(id=0, session=0, limits=0)):
        content = payload + protocol.crc(payload).to_bytes(2, "big")
        assert found(frames, content) == (1, 1)
        for zeros in range(1, 5):
            assert found(frames, bytes(zeros) + content) == (0, 0)
            assert found(frames, content + bytes(zeros)) == (0, 0)
    assert found(frames, bytes(6)) == (0, 0)


def found(frames: Frames, content: bytes) -> tuple[int, int]:
    """Frames with a right CRC that the board's decoder and the host's find in one with this content."""
    data = cobs.encode(content) + b"\0"
    host = protocol.Decoder(protocol.TO_BOARD)
    return len(frames.decoder().feed(data).at), len(host.feed(data))


def test_the_crc_is_the_one_that_the_guide_names() -> None:
    """CRC-16/GENIBUS of "123456789" is 0xD64E (Koopman and Chakravarty 2004 call the polynomial 0x8810)."""
    assert protocol.crc(b"123456789") == 0xD64E
