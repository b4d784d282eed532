"""The rig over the serial link, on the emulated board in virtual time: what is commanded arrives, and whatever happens, it stops."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.calibration import Calibration
from tepm_opt.hw.board.errors import LinkError
from tepm_opt.hw.board.link import Link
from tepm_opt.hw.board.linklog import RECEIVED, SENT, LinkLog, PlaybackPort, read_log
from tepm_opt.hw.board.protocol import DISARM, HELLO, SET, State
from tepm_opt.hw.board.rig import SerialRig
from tepm_opt.hw.rig import Command
from tepm_opt.hw.trackers.frames import Frame
from tepm_opt.models.robot import Robot, load_robot
from tests.hw.emulator import Board
from tests.hw.emulator.world import LockstepPort, World

ROBOT = load_robot("kang2017")
LIMITS = ROBOT.input_max
ON = np.ones(6, dtype=bool)


def open_on(world: World, log: LinkLog | None = None, **options: object) -> SerialRig:
    """A rig on that world's line."""
    tracker = world.tracker if world.rig is not None else None
    return SerialRig(world.port, ROBOT, tracker, clock=world.clock, log=log, threaded=False, **options)  # type: ignore[arg-type]


def hold(rig: SerialRig, inputs: np.ndarray, samples: int, enabled: np.ndarray = ON) -> None:
    for _ in range(samples):
        rig.apply(Command(*np.split(inputs, 2), enabled))
        rig.read()


def full_range(count: int) -> Iterator[np.ndarray]:
    """Both ends, the middle and random set points of all inputs, (12,)."""
    random = np.random.default_rng(2017)
    yield from (np.zeros(12), LIMITS, LIMITS / 2)
    for _ in range(count):
        yield random.uniform(0, LIMITS)


@pytest.mark.slow
@pytest.mark.parametrize("tendons", ["tension", "position"])
def test_set_points_arrive_within_a_count(world: World, tendons: str) -> None:
    with open_on(world, tendons=tendons) as rig:
        for inputs in full_range(1):
            hold(rig, inputs, 100)  # 7 N take 0.7 s at 10 N/s
            pressure = world.board.dac / 4096 * 0.9e6
            assert np.all(np.abs(pressure - inputs[:6]) <= 0.9e6 / 4096), pressure - inputs[:6]
            off = world.board.positions / 952.38 - inputs[6:]
            assert np.all(np.abs(off) <= 1.05e-3), off
            measured = rig.read()
            assert measured.pressures is not None
            assert measured.tensions is not None
            np.testing.assert_allclose(measured.pressures, inputs[:6], atol=1.2e3)  # the Mega's converter, 16 times: 1.1 kPa
            np.testing.assert_allclose(measured.tensions, inputs[6:], atol=1.4e-3)


def test_ena(world: World) -> None:
    some = np.array([True, False, True, False, True, False])
    with open_on(world) as rig:
        hold(rig, np.r_[np.zeros(6), np.full(6, 2.0)], 40)
        assert world.board.enabled == 0b111111
        hold(rig, np.r_[np.zeros(6), np.full(6, 2.0)], 40, some)
        assert world.board.enabled == 0b010101
    assert world.board.enabled == 0


@pytest.mark.parametrize(
    ("index", "value", "message"),
    [
        (0, np.nan, "pressure of actuator 11 = nan"),
        (2, 5.2e5, "pressure of actuator 13 = 520000 Pa; valid: 0 … 500000 Pa"),
        (7, -0.1, "tension of actuator 12 = -0.1 N"),
        (11, 7.1, "tension of actuator 23 = 7.1 N; valid: 0 … 7 N"),
    ],
)
def test_wrong_commands_are_not_sent(world: World, index: int, value: float, message: str) -> None:
    with open_on(world) as rig:
        hold(rig, np.full(12, 1.0), 5)
        sent = rig.link.statistics.sent
        inputs = np.full(12, 1.0)
        inputs[index] = value
        with pytest.raises(InputError, match=message):
            rig.apply(Command(*np.split(inputs, 2), ON))
        assert rig.link.statistics.sent == sent


@pytest.mark.slow
def test_leaving_stops(world: World) -> None:
    with open_on(world) as rig:
        hold(rig, np.r_[np.full(6, 3e5), np.full(6, 3.0)], 60)
        assert rig.board.state is State.ARMED
    assert world.board.enabled == 0
    world.advance(0.5)
    assert world.board.safe
    with pytest.raises(LinkError, match="was stopped"):
        rig.apply(Command(np.zeros(6), np.zeros(6), ON))


def test_silent_host(world: World) -> None:
    with open_on(world) as rig:
        hold(rig, np.r_[np.full(6, 3e5), np.full(6, 3.0)], 60)
        world.advance(0.15)
        assert world.board.enabled == 0
        assert "HOST_TIMEOUT" in rig.read().status
        with pytest.raises(LinkError, match="the board stopped the robot: HOST_TIMEOUT"):
            hold(rig, np.zeros(12), 3)
        with pytest.raises(LinkError, match="was stopped"):
            hold(rig, np.zeros(12), 1)
        rig.clear()
        hold(rig, np.zeros(12), 5)
        assert rig.board.state is State.ARMED


def pull_the_cable(world: World) -> None:
    with open_on(world) as rig:
        hold(rig, np.r_[np.full(6, 3e5), np.zeros(6)], 20)
        world.port.cut = True
        hold(rig, np.zeros(12), 5)


@pytest.mark.slow
def test_cable_out_and_in_again(world: World) -> None:
    with pytest.raises(LinkError, match="line to the board is gone: the cable is out"):
        pull_the_cable(world)
    world.advance(0.7)
    assert world.board.safe
    world.port.cut = False
    world.board.reset()  # what opening the port does
    world.advance(0.3)
    with open_on(world) as again:
        assert again.board.state is State.IDLE
        world.advance(0.5)
        assert again.board.state is State.IDLE  # nothing arms by itself


def test_reset_while_armed(world: World) -> None:
    with open_on(world) as rig:
        hold(rig, np.r_[np.full(6, 3e5), np.zeros(6)], 20)
        world.board.reset()
        world.advance(0.2)
        assert "reset while the robot was armed" in rig.read().status
    with open_on(world) as again:
        with pytest.raises(LinkError, match=r"FAULT: the board was reset while .* tepm hw check"):
            hold(again, np.zeros(12), 1)
        again.clear()
        hold(again, np.zeros(12), 3)
        assert again.board.state is State.ARMED


def test_emergency_stop(world: World) -> None:
    with open_on(world) as rig:
        hold(rig, np.r_[np.full(6, 3e5), np.full(6, 1.0)], 40)
        rig.emergency_stop()
        assert world.board.safe
        assert not world.board.outputs
        with pytest.raises(LinkError, match="was stopped"):
            hold(rig, np.zeros(12), 1)


@pytest.mark.slow
def test_stalled_reader(world: World) -> None:
    """A host that sends but does not read for two seconds: the robot goes on, and what is read then is the present."""
    with open_on(world) as rig:
        started = world.time - 1e-3 * rig.board.time_ms
        for _ in range(200):
            rig.apply(Command(np.full(6, 1e5), np.zeros(6), ON)) if rig._armed is None else rig.link.set(63, [455] * 6, [3277] * 6)
            world.advance(0.01)
        assert rig.board.state is State.ARMED
        assert 1e-3 * rig.board.time_ms == pytest.approx(world.time - started, abs=0.02)


def test_tracker_lost(robot_world: World) -> None:
    with open_on(robot_world) as rig:
        hold(rig, np.zeros(12), 5)
        assert np.isfinite(rig.read().points).all()
        assert rig.read().status == "ok"
        robot_world.frames.clear()
        robot_world._due = 10**9  # no more frames
        sample = rig.read()
        assert np.isnan(sample.points).all()
        assert sample.status == "tracker silent"
        assert sample.tensions is not None


class SlowTracker:
    """A tracker in a world's time that gives its frames at a rate, but for some of them.

    Attributes:
        lost: numbers of frames that do not come.
    """

    status = "ok"

    def __init__(self, world: World, rate: float, lost: Callable[[int], bool]) -> None:
        self.world, self.rate, self.lost = world, rate, lost
        self._next = 0

    def read(self, timeout: float) -> Frame | None:
        end = self.world.time + timeout
        self._next = max(self._next, int(self.world.time * self.rate) + 1)
        while (due := self._next / self.rate) <= end:
            self._next += 1
            if not self.lost(self._next - 1):
                self.world.advance(max(due - self.world.time, 0.0))
                return Frame(due, np.zeros((4, 3)), np.full((4, 4, 4), np.nan), "ok")
        self.world.advance(end - self.world.time)
        return None

    def close(self) -> None:
        """Nothing to close."""


def tracked_robot(rate: float) -> Robot:
    content = ROBOT.model_dump()
    content["hardware"]["tracker"] = {"devices": ("A", "B", "C", "D"), "rate_hz": rate}
    return Robot.model_validate(content)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [20, 25, 30, 100])
def test_slow_trackers_keep_the_board_alive(world: World, rate: float) -> None:
    """Frames that come, that are lost now and then, and that do not come any more; the controller takes 20 ms for each step."""
    tracker = SlowTracker(world, rate, lambda number: (number > rate and number % 3 == 0) or number > 2 * rate)
    with SerialRig(world.port, tracked_robot(rate), tracker, clock=world.clock, threaded=False) as rig:
        samples = []
        while world.time < 3.0:
            rig.apply(Command(np.full(6, 1e5), np.full(6, 1.0), ON))
            samples.append(rig.read())
            world.advance(0.02)
        assert rig.board.state is State.ARMED
        statuses = np.array([sample.status for sample in samples])
        times = np.array([sample.time for sample in samples])
        assert set(statuses) == {"ok", "tracker silent"}
        assert all(status == "ok" for status in statuses[times < 0.95])
        assert all(status == "tracker silent" for status in statuses[times > 2.1])
        assert all(sample.tensions is not None for sample in samples)


@pytest.mark.parametrize("rate", [10, 15, 19.5])
def test_trackers_that_are_too_slow(world: World, rate: float) -> None:
    """They are refused before anything moves; where there is no tracker its rate does not count."""
    robot, tracker = tracked_robot(rate), SlowTracker(world, rate, lambda number: False)
    with pytest.raises(InputError, match=rf"hardware.tracker.rate_hz = {rate}; valid: at least 20 Hz \(the board stops the robot"):
        SerialRig(world.port, robot, tracker, clock=world.clock, threaded=False)
    with SerialRig(world.port, robot, clock=world.clock, threaded=False) as rig:
        hold(rig, np.zeros(12), 50)
        assert rig.board.state is State.ARMED


class Tripwire(LockstepPort):
    """A line on which, at its n-th use, something happens to the host."""

    def __init__(self, world: World, at: int, error: type[BaseException]) -> None:
        super().__init__(world)
        self.at, self.error, self.written = at, error, b""

    def _trip(self) -> None:
        if self.calls == self.at:
            raise self.error("now")

    def read(self, timeout: float) -> bytes:
        data = super().read(timeout)
        self._trip()
        return data

    def write(self, data: bytes) -> None:
        super().write(data)
        self.written += data
        self._trip()


@pytest.mark.slow
@pytest.mark.parametrize("attempts", [7, pytest.param(25, marks=pytest.mark.slow)])
@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_interrupted_anywhere(board_factory: Callable[[], Board], tmp_path: Path, error: type[BaseException], attempts: int) -> None:
    """At random points, within sending, waiting or reading: disarmed in the end, everything in the log."""
    random = np.random.default_rng(7)
    armed = 0
    for attempt in range(attempts):
        world = World(board_factory())
        port = world.port = Tripwire(world, int(random.integers(3, 400)), error)
        log = LinkLog(tmp_path / f"{attempt}.log", world.clock)
        with pytest.raises(error, match="now"), open_on(world, log) as rig:
            hold(rig, np.r_[np.full(6, 2e5), np.full(6, 2.0)], 400)
        armed += SET in kinds(port.written)
        assert b"".join(data for _, direction, data in read_log(log.path) if direction == SENT) == port.written
        assert SET not in kinds(port.written) or kinds(port.written)[-1] is DISARM
        world.advance(0.11)
        assert world.board.enabled == 0
        world.advance(0.5)
        assert world.board.safe
    assert armed > 0.6 * attempts


def kinds(data: bytes) -> list[protocol.Message]:
    """Of the messages to a board in a stream without faults."""
    decoder = protocol.Decoder(protocol.TO_BOARD)
    found = [kind for kind, _ in decoder.feed(data)]
    assert decoder.bad == 0
    return found


def test_the_log_plays_back(world: World, tmp_path: Path) -> None:
    log = LinkLog(tmp_path / "link.log", world.clock)
    with open_on(world, log) as rig:
        hold(rig, np.r_[np.full(6, 2e5), np.full(6, 2.0)], 50)
        last = rig.board
    came = b"".join(data for _, direction, data in read_log(log.path) if direction == RECEIVED)
    assert protocol.Decoder(protocol.TO_HOST).feed(came)
    playback = PlaybackPort(log.path)
    link = Link(playback, playback.clock, threaded=False)
    seen = []
    with contextlib.suppress(EOFError):
        while True:
            link.listen(0.01)
            seen.append(link.status)
    times = {status.time_ms: status for status in seen if status is not None}
    assert times[last.time_ms].positions == last.positions
    assert times[last.time_ms].time == pytest.approx(last.time, abs=1e-5)


def test_torn_logs(tmp_path: Path) -> None:
    path = tmp_path / "link.log"
    path.write_text("0.1 > 0102\n0.2 < 03")
    assert list(read_log(path)) == [(0.1, ">", b"\1\2")]
    path.write_text("0.1 > 0102\nhello\n")
    with pytest.raises(InputError, match="line 2: 'hello'"):
        list(read_log(path))


class Speaker:
    """A board that says one thing whenever it is asked something."""

    def __init__(self, payload: bytes) -> None:
        self.answer, self.time, self.waiting = protocol.frame(payload), 0.0, b""

    def read(self, timeout: float) -> bytes:
        data, self.waiting = self.waiting, b""
        self.time += 0.0 if data else timeout
        return data

    def write(self, data: bytes) -> None:
        self.waiting += self.answer

    def close(self) -> None:
        pass


def hello(**changes: int) -> bytes:
    fields = {name: 0 for name, _ in HELLO.fields} | {"version": protocol.VERSION, "channels": 6}
    return HELLO.pack(**(fields | changes))


def test_another_protocol() -> None:
    port = Speaker(hello(version=protocol.VERSION + 1))
    with pytest.raises(LinkError, match=f"version {protocol.VERSION + 1} of the protocol, this program version {protocol.VERSION}; flash"):
        SerialRig(port, ROBOT, clock=lambda: port.time, threaded=False)


def test_too_few_channels() -> None:
    port = Speaker(hello(channels=3))
    with pytest.raises(LinkError, match="drives 3 actuators, robot kang2017 has 6"):
        SerialRig(port, ROBOT, clock=lambda: port.time, threaded=False)


def test_nobody_there() -> None:
    port = Speaker(b"")
    port.answer = b"noise\0"
    with pytest.raises(LinkError, match=r"text comes: 'noise.*right port"):
        SerialRig(port, ROBOT, clock=lambda: port.time, threaded=False)


def robot_with(**pressure: object) -> Robot:
    content = ROBOT.model_dump()
    content["hardware"]["pressure"].update(pressure)
    return Robot.model_validate(content)


def test_calibration() -> None:
    """Lines of its own for every actuator, there and back."""
    robot = robot_with(V_per_MPa=tuple(np.linspace(5, 6, 6)), zero_V=0.1, monitor_zero_V=tuple(np.linspace(0.9, 1.1, 6)))
    calibration = Calibration.from_robot(robot)
    pressures = np.linspace(1e5, 4e5, 6)
    codes = calibration.to_codes(pressures, 4095)
    volts = np.array(codes) * 5 / 4096
    np.testing.assert_allclose(volts, 0.1 + np.linspace(5, 6, 6) * pressures / 1e6, atol=0.7e-3)
    counts = (np.linspace(0.9, 1.1, 6) + 4 / 0.9 * pressures / 1e6) / 5 * 32768
    np.testing.assert_allclose(calibration.pressures(tuple(counts)), pressures)


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        (ROBOT.model_copy(update={"hardware": None}), r"no \[hardware\] part"),
        (robot_with(zero_V=(0.0, 0.1)), r"hardware.pressure.zero_V has 2 values; valid: one, or one for each of 6"),
        (
            ROBOT.model_copy(update={"geometry": ROBOT.geometry.model_copy(update={"modules": 3})}),
            "9 actuators; a board drives 6",
        ),
    ],
)
def test_robots_that_do_not_fit(robot: Robot, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Calibration.from_robot(robot)
