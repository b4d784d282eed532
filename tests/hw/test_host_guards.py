"""What the host does where the line or the board does not do its part: nothing stale is given as fresh, and stopping does not give up."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.calibration import Calibration
from tepm_opt.hw.board.errors import LinkError
from tepm_opt.hw.board.link import Link
from tepm_opt.hw.board.protocol import ARM, CLEAR, DISARM, ESTOP, Message, State
from tepm_opt.hw.board.rig import SerialRig
from tepm_opt.hw.rig import Command
from tepm_opt.models.robot import load_robot
from tests.hw.emulator.world import LockstepPort, World

ROBOT = load_robot("kang2017")
ON = np.ones(6, dtype=bool)


class Lossy(LockstepPort):
    """A line that loses frames of some kinds on their way to the board, or all that comes from it.

    Attributes:
        lost: how many frames of each kind are still to be lost.
        mute: whether nothing comes from the board.
        sent: kinds of the messages that were sent, lost or not; `last` is the content of the last one.
        foreign: bytes that come with the board's.
    """

    def __init__(self, world: World) -> None:
        super().__init__(world)
        self.lost: dict[Message, int] = {}
        self.mute = False
        self.sent: list[Message] = []
        self.last: protocol.Values = {}
        self.foreign = b""

    def read(self, timeout: float) -> bytes:
        data = super().read(timeout)
        foreign, self.foreign = self.foreign, b""
        return b"" if self.mute else data + foreign

    def write(self, data: bytes) -> None:
        kind, self.last = protocol.Decoder(protocol.TO_BOARD).feed(data)[0]
        self.sent.append(kind)
        if self.lost.get(kind, 0):
            self.lost[kind] -= 1
            data = b""
        super().write(data)


@pytest.fixture
def line(world: World) -> Lossy:
    return Lossy(world)


@pytest.fixture
def rig(world: World, line: Lossy) -> SerialRig:
    """An armed rig under pressure and tension; nothing closes it."""
    rig = SerialRig(line, ROBOT, clock=world.clock, threaded=False)
    hold(rig, 20)
    assert world.board.enabled == 0x3F
    return rig


def hold(rig: SerialRig, samples: int) -> None:
    for _ in range(samples):
        rig.apply(Command(np.full(6, 1e5), np.full(6, 1.0), ON))
        rig.read()


def test_measurements_get_old(rig: SerialRig, line: Lossy, world: World) -> None:
    """What the board measured is given for 50 ms; then samples say that it is silent and have no pressures and tensions."""
    line.mute = True
    ages = []
    for _ in range(12):
        sample = rig.read()
        assert (sample.pressures is None) == (sample.tensions is None) == ("board silent" in sample.status)
        ages.append((world.time - rig.board.time, sample.pressures is not None))
    assert all(given == (age <= 0.05) for age, given in ages)
    assert {given for _, given in ages} == {True, False}
    line.mute = False
    rig.read()
    assert rig.read().pressures is not None


def test_stopping_goes_on_where_disarm_is_lost(rig: SerialRig, line: Lossy, world: World) -> None:
    """ESTOP follows where DISARM is not answered."""
    line.lost[DISARM] = 100
    rig.stop()
    assert line.sent[-1] is ESTOP
    world.advance(0.02)
    assert rig.board.state is State.ESTOP
    assert world.board.safe
    with pytest.raises(LinkError, match="was stopped"):
        hold(rig, 1)


def test_stopping_tries_both_on_a_dead_line(rig: SerialRig, line: Lossy, world: World) -> None:
    """Where nothing gets through both were sent, the caller hears of it, and the board stops by itself."""
    line.lost = {DISARM: 100, ESTOP: 100}
    with pytest.raises(LinkError, match="does not answer ESTOP"):
        rig.stop()
    assert {DISARM, ESTOP} <= set(line.sent)
    world.advance(0.11)
    assert world.board.enabled == 0


def test_requests_are_sent_again(world: World, line: Lossy) -> None:
    """ARM, ESTOP and CLEAR that are lost three times get through at the fourth."""
    line.lost = {ARM: 3, ESTOP: 3, CLEAR: 3}
    rig = SerialRig(line, ROBOT, clock=world.clock, threaded=False)
    hold(rig, 3)
    assert rig.board.state is State.ARMED
    rig.emergency_stop()
    world.advance(0.02)
    assert rig.board.state is State.ESTOP
    rig.clear()
    assert rig.board.state is State.IDLE
    assert not any(line.lost.values())


def test_a_refusal_is_told(world: World, line: Lossy) -> None:
    """The reason for it is the board's, and nothing counts as armed."""
    rig = SerialRig(line, ROBOT, clock=world.clock, threaded=False)
    world.board.dynamometer(3, 0)
    world.advance(0.01)
    with pytest.raises(LinkError, match="refuses ARM: dynamometer 4 is open"):
        hold(rig, 1)
    sent = len(line.sent)
    rig.close()
    assert len(line.sent) == sent
    assert protocol.SET not in line.sent


def test_a_stopped_rig_stays_so(rig: SerialRig, line: Lossy) -> None:
    """Stopping again sends nothing; set points are refused until it is cleared."""
    rig.stop()
    sent = len(line.sent)
    rig.stop()
    rig.close()
    assert len(line.sent) == sent
    for _ in range(2):
        with pytest.raises(LinkError, match="was stopped"):
            hold(rig, 1)
    assert len(line.sent) == sent


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("index", [0, 5, 6, 11])
def test_no_number_is_sent_that_is_none(rig: SerialRig, line: Lossy, index: int, value: float) -> None:
    inputs = np.r_[np.full(6, 1e5), np.full(6, 1.0)]
    inputs[index] = value
    sent = len(line.sent)
    with pytest.raises(InputError, match="command: "):
        rig.apply(Command(*np.split(inputs, 2), ON))
    assert len(line.sent) == sent


def test_set_points_are_for_one_arming(rig: SerialRig, line: Lossy) -> None:
    """They bear the session in which this rig armed, also once the board has told another one in an answer to somebody else."""
    session = line.last["session"]
    values = {"id": 200, "request": ARM.code, "result": 0, "channel": 0, "state": State.ARMED, "session": session + 1}
    line.foreign = b"\0" + protocol.frame(protocol.ACK.pack(**values))  # the zero ends a frame that has come only in part
    rig.link.listen()
    assert not line.foreign
    rig.link.set(0x3F, [0] * 6, [3277] * 6)
    assert (line.sent[-1], line.last["session"]) == (protocol.SET, session)


@pytest.mark.parametrize(
    ("kind", "per_unit", "zero"), [("to_codes", 4096 / 0.9e6, 0), ("to_counts", 3276.8, 3277), ("to_steps", 952.38, 0)]
)
def test_beyond_the_limit_of_the_board(kind: str, per_unit: float, zero: int) -> None:
    """Set points that exceed it by more than rounding are refused, not cut off in silence; the actuator is named."""
    convert, most = getattr(Calibration.from_robot(ROBOT), kind), 2000 + zero
    values = np.full(6, 1000 / per_unit)
    values[4] = (2000 + 0.9) / per_unit
    assert convert(values, most) == [1000 + zero] * 4 + [most, 1000 + zero]
    values[4] = (2000 + 2.1) / per_unit
    with pytest.raises(InputError, match=r"actuator 5 = .* exceeds the limit that is compiled into the firmware"):
        convert(values, most)


def test_the_real_line_is_listened_to_by_a_thread() -> None:
    """Where nothing else is said: measurements and stops come in also while the caller is busy."""
    for kind in (SerialRig, Link):
        assert inspect.signature(kind).parameters["threaded"].default is True
