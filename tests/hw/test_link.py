"""The conversation with a board that does not do its part: it is silent, ignores set points, says what nobody knows, counts for weeks."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tepm_opt.cli.hw.monitor import _View
from tepm_opt.control.loop import LoopRecord, close_loop
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.errors import LinkError, RefusedError
from tepm_opt.hw.board.link import Link
from tepm_opt.hw.board.protocol import ACK, ARM, CLEAR, CONFIG, DISARM, ESTOP, HELLO, SET, STATUS, Fault, Key, Message, Result, State
from tepm_opt.hw.board.rig import SerialRig
from tepm_opt.hw.rig import Command
from tepm_opt.hw.service.line import Line
from tepm_opt.hw.service.monitor import Monitor
from tepm_opt.jobs.play import play
from tepm_opt.jobs.record import RigSource, record
from tepm_opt.models.robot import load_robot
from tepm_opt.recording.plan import PlannedRun, RecordingPlan
from tests.hw.emulator.world import LockstepPort, World
from tests.hw.lines import FakeBoard

ROBOT = load_robot("kang2017")
INPUTS = np.repeat([2e5, 1.0], 6)
COMMAND = Command.from_inputs(INPUTS)


@pytest.fixture
def fake() -> FakeBoard:
    return FakeBoard(ROBOT)


def opened(fake: FakeBoard) -> SerialRig:
    return SerialRig(fake, ROBOT, clock=fake.clock, threaded=False)


def hold(rig: SerialRig, seconds: float) -> None:
    end = rig.time + seconds
    while rig.time < end - 1e-9:
        rig.apply(COMMAND)
        rig.read()


def mute(fake: FakeBoard) -> None:
    """It sends nothing any more, and acts on everything."""
    fake.silent = True
    fake.tell = lambda kind, **values: None  # type: ignore[method-assign]


WRONG: dict[str, tuple[Callable[[FakeBoard], Any], str, float, list[Message]]] = {
    "no STATUS": (lambda fake: setattr(fake, "silent", True), "has said nothing for 0.2", 0.2, [DISARM]),
    "nothing at all": (mute, "has said nothing for 0.2", 0.2, [DISARM, ESTOP]),
    "acts on nothing": (lambda fake: setattr(fake, "obeys", False), "has acted on no set point for 0.2", 0.2, [DISARM]),
    "refuses": (lambda fake: fake.status.update(refused=7), "refuses set points: they are beyond its limits", 0.0, [DISARM]),
    "ignores": (lambda fake: fake.status.update(stale=255), "ignores set points: they are old", 0.0, [DISARM]),
    "another session": (lambda fake: fake.status.update(session=0x1FFFF), "armed by somebody else", 0.0, [DISARM]),
    "stopped": (lambda fake: fake.status.update(state=2), "the board stopped the robot: HOST_TIMEOUT", 0.0, [DISARM]),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_board_that_cannot_be_relied_on_is_left(fake: FakeBoard, name: str) -> None:
    """No more set points, DISARM once, ESTOP once where that is not answered, and the reason; and nothing more when the rig is closed."""
    do, says, after, last = WRONG[name]
    fake.status |= {"refused": 250, "stale": 3}  # from before
    rig = opened(fake)
    hold(rig, 0.3)
    do(fake)
    begin = fake.time
    with pytest.raises(LinkError, match=says):
        hold(rig, 5.0)
    assert fake.time - begin <= after + 0.12
    assert [kind for kind, _ in fake.heard[-len(last) :]] == last
    assert fake.heard[-len(last) - 1][0] is SET
    heard = len(fake.heard)
    with pytest.raises(LinkError, match="the rig was stopped"):
        rig.apply(COMMAND)
    rig.close()
    assert len(fake.heard) == heard


@pytest.mark.slow
def test_a_line_in_order_is_not_left(fake: FakeBoard) -> None:
    """Half a minute, a STATUS every 100 ms, and counters that had risen before."""
    fake.status |= {"refused": 250, "stale": 3}
    fake.period = 0.1
    rig = opened(fake)
    hold(rig, 30.0)
    assert rig.board.state is State.ARMED
    assert len(rig.link.statistics.latencies) > 250
    rig.close()


def test_armed_in_the_answer_only(fake: FakeBoard) -> None:
    """ARM is DONE, but the board is in another state: no set point is sent."""
    rig, answer = opened(fake), fake._answer

    def confused(kind: Message, number: int) -> None:
        fake.status["state"] = int(State.ESTOP)
        fake.tell(ACK, id=number, request=kind.code, result=0, channel=0, state=3, session=9) if kind is ARM else answer(kind, number)

    fake._answer = confused  # type: ignore[method-assign]
    with pytest.raises(LinkError, match="was armed and left that at once: it is ESTOP"):
        rig.apply(COMMAND)
    assert SET not in [kind for kind, _ in fake.heard]
    assert fake.heard[-1][0] is DISARM
    fake.status["state"] = int(State.IDLE)
    rig.read()
    with pytest.raises(LinkError, match="the board is not armed"):
        rig.link.set(0, [0] * 6, [0] * 6)


class OneWay(LockstepPort):
    """A line that from a time on loses what goes in one direction.

    Attributes:
        sent: kinds of the messages that were sent, with their times.
    """

    def __init__(self, world: World, lost: str, since: float) -> None:
        super().__init__(world)
        self.lost, self.since = lost, since
        self.sent: list[tuple[float, Message]] = []

    def read(self, timeout: float) -> bytes:
        data = super().read(timeout)
        return b"" if self.lost == "answers" and self.world.time > self.since else data

    def write(self, data: bytes) -> None:
        self.sent.append((self.world.time, protocol.Decoder(protocol.TO_BOARD).feed(data)[0][0]))
        super().write(b"" if self.lost == "set points" and self.world.time > self.since else data)


SETPOINTS = SetPoints(np.array([0.0, 2.0]), np.repeat([INPUTS], 2, axis=0), np.zeros((2, 3)))


def by_hand(rig: SerialRig, folder: Path) -> None:
    with rig:
        hold(rig, 5.0)


def played(rig: SerialRig, folder: Path) -> None:
    play(rig, SETPOINTS, ROBOT, folder / "out.csv")


def recorded(rig: SerialRig, folder: Path) -> None:
    plan = RecordingPlan("one", ROBOT, "kang2017", 50.0, None, (PlannedRun("one.csv", "validation", SETPOINTS),))
    record(plan, folder / "set", RigSource("serial:x", lambda seed: rig))


def closed_loop(rig: SerialRig, folder: Path) -> None:
    reference: Any = SimpleNamespace(equilibria=[SimpleNamespace(points=np.zeros((4, 3)))])
    controller: Any = SimpleNamespace(reference=reference, start=lambda: COMMAND)
    close_loop(rig, controller, ROBOT, keep=LoopRecord(reference))


@pytest.mark.slow
@pytest.mark.sample(3)
@pytest.mark.parametrize(
    ("lost", "says"),
    [("answers", "the board has said nothing for 0.2"), ("set points", "HOST_TIMEOUT")],
)
@pytest.mark.parametrize("drive", [by_hand, played, recorded, closed_loop])
def test_a_line_that_only_sends_or_only_receives(
    world: World, drive: Callable[[SerialRig, Path], None], lost: str, says: str, tmp_path: Path
) -> None:
    """Whoever drives the robot stops within a quarter of a second, says why, and the robot rests."""
    port = OneWay(world, lost, since=0.7)
    with pytest.raises(LinkError, match=says):
        drive(SerialRig(port, ROBOT, clock=world.clock, threaded=False), tmp_path)
    setpoints = [at for at, kind in port.sent if kind is SET]
    assert setpoints[0] < 0.5
    assert setpoints[-1] <= 0.7 + 0.22
    after = [kind for at, kind in port.sent if at >= setpoints[-1]]
    assert after[-2:] == [DISARM, ESTOP]
    assert len(after) <= 3
    world.advance(0.6)
    assert world.board.safe


# ---------------------------------------------------------------- what nobody knows


@pytest.mark.parametrize(
    ("kind", "values", "says"),
    [
        (STATUS, {"state": 77}, "the board tells state 77, which this program does not know; flash"),
        (STATUS, {"fault": 99, "state": 4}, "the board tells fault 99, which this program does not know; flash"),
        (HELLO, {"state": 9}, "the board tells state 9"),
    ],
)
def test_states_of_another_firmware(fake: FakeBoard, kind: Message, values: dict[str, int], says: str) -> None:
    """Everybody who asks hears of it; DISARM and ESTOP are sent all the same."""
    rig = opened(fake)
    hold(rig, 0.1)
    fake.tell(kind, **{**(fake.status if kind is STATUS else fake.hello), **values})
    for use in (lambda: hold(rig, 1.0), rig.read, rig.link.hello):
        with pytest.raises(LinkError, match=says):
            use()
    assert [kind for kind, _ in fake.heard if kind is not SET][-3:-1] == [DISARM, ESTOP]


def test_an_answer_in_an_unknown_state(fake: FakeBoard) -> None:
    rig = opened(fake)
    fake.status["state"] = 50
    with pytest.raises(LinkError, match="state 50"):
        rig.link.request(CONFIG, session=1, key=1, value=5)


class RealTime:
    """A fake board whose time is the real one, for a link with a thread."""

    def __init__(self, fake: FakeBoard) -> None:
        self.fake, self.lock, self.bytes = fake, threading.Lock(), b""

    def read(self, timeout: float) -> bytes:
        time.sleep(0.002)
        with self.lock:
            return self.fake.read(0.005)

    def write(self, data: bytes) -> None:
        for k in range(0, len(data), 7):  # as a port may: in pieces
            with self.lock:
                self.bytes += data[k : k + 7]
            time.sleep(0)
        with self.lock:
            self.fake.write(data)

    def close(self) -> None:
        pass


def test_a_board_that_tells_its_state_but_was_never_armed(fake: FakeBoard) -> None:
    """It is heard, and acts on no set points: that is said."""
    link = Link(RealTime(fake), time.monotonic)
    link.hello()
    link.wait(lambda: link.status is not None, 60.0)
    with pytest.raises(LinkError, match="the board is not armed"):
        link.confirm()


@pytest.mark.parametrize("trouble", [{"state": 77}, None])
def test_the_listener_never_dies_in_silence(fake: FakeBoard, trouble: dict[str, int] | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever goes wrong in its thread: those who wait, and those who send set points, hear of it at once."""
    link = Link(RealTime(fake), time.monotonic)
    link.hello()
    link.wait(lambda: link.status is not None, 1.0)
    link.arm(0)
    if trouble is None:
        monkeypatch.setattr(link, "_take_status", lambda now, values: 1 / 0)
    else:
        fake.status |= trouble
    with pytest.raises(LinkError, match="state 77" if trouble else "cannot be understood: ZeroDivisionError"):
        link.wait(lambda: False, 60.0)
    with pytest.raises(LinkError, match="state 77" if trouble else "cannot be understood"):
        link.confirm()
    link.close()


def test_several_threads_send(fake: FakeBoard) -> None:
    """Frames do not mix, ids do not come twice, sequence numbers only grow on the line."""
    port = RealTime(fake)
    link = Link(port, time.monotonic)
    link.hello()
    link.wait(lambda: link.status is not None, 1.0)
    link.arm(0)
    answers: list[int] = []

    def set_points() -> None:
        for _ in range(100):
            link.set(0, [0] * 6, [0] * 6)

    def requests() -> None:
        for _ in range(10):
            answers.append(link.request(CONFIG, session=0, key=1, value=5)["id"])

    threads = [threading.Thread(target=work) for work in (set_points, requests) * 3]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    link.close()
    decoder = protocol.Decoder(protocol.TO_BOARD)
    found = decoder.feed(port.bytes)
    assert decoder.bad == 0
    assert [values["sequence"] for kind, values in found if kind is SET] == list(range(1, 301))
    assert len(set(answers)) == len(answers) == 30


def test_nothing_is_kept_for_ever(fake: FakeBoard) -> None:
    """Answers that nobody waits for, requests that are never answered, set points that are never acknowledged."""
    rig = opened(fake)
    rig.apply(COMMAND)
    for number in range(256):
        fake.tell(ACK, id=number, request=DISARM.code, result=0, channel=0, state=0, session=fake.status["session"])
    rig.link.listen()
    assert not rig.link._answers
    fake.obeys = False
    for _ in range(20_000):
        rig.link.set(0, [0] * 6, [0] * 6)
    assert len(rig.link._unconfirmed) <= 4096
    mute(fake)
    with pytest.raises(LinkError, match="does not answer DISARM"):
        rig.link.request(DISARM)
    assert not rig.link._answers


@pytest.mark.parametrize("value", [-1, 65536, 1.5])
def test_values_that_no_message_holds(fake: FakeBoard, value: Any) -> None:
    rig = opened(fake)
    with pytest.raises(InputError, match=rf"message CONFIG to the board with id = \d+, .*value = {value}"):
        rig.link.configure(Key.STEP_RATE, value)
    assert CONFIG not in [kind for kind, _ in fake.heard]


# ---------------------------------------------------------------- the board's clock, and what was lost


def test_the_boards_clock_wraps(fake: FakeBoard) -> None:
    """After 49.7 days it begins at 0 again: times of samples go on, and nothing counts as lost but what was."""
    fake.status["time_ms"] = 2**32 - 500
    rig = opened(fake)
    times, samples = [], 0
    while samples < 150:
        times.append(rig.read().extra["board_time_s"])
        samples += 1
    assert fake.status["time_ms"] < 2000
    assert np.diff(times) == pytest.approx(0.01, abs=0.006)
    assert times[-1] > 2**32 / 1000
    assert rig.link.statistics.lost == 0
    fake.status["count"] = (fake.status["count"] + 3) % 256
    rig.read()
    assert rig.link.statistics.lost == 3


@pytest.mark.parametrize("up", [60_000, 2**32 - 20])
def test_a_reset_is_no_wrap(fake: FakeBoard, up: int) -> None:
    """The board starts anew, also shortly before its clock would have wrapped: its time begins at 0, and nothing counts as lost."""
    fake.status["time_ms"] = up
    rig = opened(fake)
    for _ in range(3):
        rig.read()
    fake.status |= {"time_ms": 0, "count": 0, "session": 0x2BEEF}
    rig.read()
    assert rig.board.time_ms == rig.board.uptime_ms < 50
    assert rig.read().extra["board_time_s"] < 0.1
    assert rig.link.statistics.lost == 0


# ---------------------------------------------------------------- CLEAR, faults, boards without monitors


@pytest.mark.parametrize("refusals", [1, 10])
def test_clear_waits_for_pressure_to_go(fake: FakeBoard, refusals: int) -> None:
    """A second or so; other reasons for a refusal are told at once."""
    fake.status["state"] = int(State.HOST_TIMEOUT)
    rig = opened(fake)
    fake.answers[CLEAR] = [Result.MONITOR] * refusals
    rig.clear()
    assert 0.1 * refusals <= rig.time <= 0.15 * refusals + 0.1
    assert rig.board.state is State.IDLE


def test_clear_gives_up(fake: FakeBoard) -> None:
    fake.status["state"] = int(State.FAULT)
    rig = opened(fake)
    fake.answers[CLEAR] = [Result.MONITOR] * 100
    with pytest.raises(RefusedError, match=r"monitor of regulator 4 does not show what the regulator was told \(it is FAULT\)"):
        rig.clear()
    assert 2.0 <= rig.time <= 2.3
    fake.answers[CLEAR] = [Result.ESTOP_PRESSED] * 100
    begin = rig.time
    with pytest.raises(RefusedError, match="the emergency stop is pressed"):
        rig.clear()
    assert rig.time - begin < 0.1


@pytest.mark.slow
def test_clear_under_pressure(world: World) -> None:
    """The emulated board after HOST_TIMEOUT, its regulators slower than their ramps: CLEAR succeeds once they have vented."""
    with SerialRig(world.port, ROBOT, clock=world.clock, threaded=False) as rig:
        hold(rig, 0.5)
        world.board.follow(False)
        for k in range(6):
            world.board.monitor(k, 1.0 + 4 / 0.9 * 0.2)
            world.board.dynamometer(k, 3277)
        world.advance(0.35)
        assert rig.board.state is State.HOST_TIMEOUT
        world.board.monitor(0, 1.0 + 4 / 0.9 * 0.2)
        begin, advance = world.time, world.advance

        def vent(duration: float) -> None:
            advance(duration)
            for k in range(6):
                world.board.monitor(k, 1.0 + 4 / 0.9 * 0.2 * max(0.0, 1 - (world.time - begin) / 0.6))

        world.advance = vent  # type: ignore[method-assign]
        rig.clear()
        assert 0.25 < world.time - begin < 0.6
        assert rig.board.state is State.IDLE
        hold(rig, 0.1)
        assert rig.board.state is State.ARMED


def test_all_faults_are_named(fake: FakeBoard) -> None:
    """The gravest first; also where the emergency stop came on top."""
    found = [Fault.TRAVEL, Fault.REGULATOR, Fault.RESET_WHILE_ARMED]
    fake.status |= {"state": 4, "fault": int(Fault.REGULATOR), "channel": 1, "faults": sum(fault.bit for fault in found)}
    rig = opened(fake)
    assert rig.board.describe() == "FAULT: regulator 2 does not follow its set point; also TRAVEL, RESET_WHILE_ARMED"
    with pytest.raises(LinkError, match="does not follow its set point; also TRAVEL, RESET_WHILE_ARMED; see to it, then clear it"):
        rig.apply(COMMAND)
    fake.status["state"] = int(State.ESTOP)
    rig.read()
    assert rig.board.describe().endswith("release the button; found: REGULATOR, TRAVEL, RESET_WHILE_ARMED")
    fake.status |= {"faults": 0, "fault": 0}
    rig.read()
    assert rig.board.describe().endswith("release the button")


def test_boards_without_monitors(fake: FakeBoard) -> None:
    """An Uno measures no pressures: there are none, not zeros."""
    fake.hello["monitors"] = 0
    fake.status["monitors"] = (0,) * 6
    sample = opened(fake).read()
    assert sample.pressures is None
    assert sample.tensions is not None
    reading = next(iter(Monitor(lambda: Line(fake, fake.clock, threaded=False))))
    assert "kPa 11:– 12:– 13:– 21:– 22:– 23:–; N 11:0.00 " in _View(ROBOT).line(reading)
    fake.hello["monitors"] = 6
    reading = next(iter(Monitor(lambda: Line(fake, fake.clock, threaded=False))))
    assert "kPa 11:-225.0 " in _View(ROBOT).line(reading)
