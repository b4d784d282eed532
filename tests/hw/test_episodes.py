"""Random sequences of what a host does, what goes wrong and what is mended, on the emulated board.

Each episode begins at power-on and ends back at work. What must hold on the way is in `emulator/episode.py` (from pins, sensors and clocks
alone) and `emulator/belief.py` (a model of the board that has to allow everything that is seen of it).
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import pytest
from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis import strategies as st
from hypothesis.internal.conjecture import providers
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule, run_state_machine_as_test

from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.protocol import ASK, DISARM, ESTOP, Key, State
from tests.hw.emulator import BROWN_OUT, FIRMWARE, PIN, POWER_ON, Board, build_firmware
from tests.hw.emulator.belief import CHECK
from tests.hw.emulator.causes import LIMITS
from tests.hw.emulator.episode import ALL, Episode, Sensor, Setpoint

DURATIONS = st.sampled_from([0, 1, 1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 100, 104, 150])
STEPS = 10
ARMED = st.sampled_from([True, True, False])
LONG = st.sampled_from([0, 3, 9, 15, 40, 60, 88, 125])
CHANNEL = st.integers(0, 5)
ENABLES = st.sampled_from([ALL, ALL, ALL, 0, 1, 0x15, 0x2A, 0x20])
NEAR = st.sampled_from([0, 0, 0, 0, 0, 0, -1, 1, -2, 2, 0x10000, -0x10000])
"""What a session is off by."""


def six(values: st.SearchStrategy[int]) -> st.SearchStrategy[list[int]]:
    return st.one_of(values.map(lambda value: [value] * 6), st.lists(values, min_size=6, max_size=6))


PRESSURES = six(st.one_of(st.sampled_from([0, 300, 1500, LIMITS.pressure_max]), st.integers(0, LIMITS.pressure_max)))
TENSIONS = six(st.one_of(st.sampled_from([0, LIMITS.tension_zero, 6000, LIMITS.tension_max]), st.integers(LIMITS.tension_zero, 20000)))
POSITIONS = six(st.one_of(st.sampled_from([0, 500, LIMITS.position_max]), st.integers(0, LIMITS.position_max)))
SETPOINTS = st.one_of(
    st.builds(Setpoint, PRESSURES, TENSIONS, ENABLES), st.builds(lambda p, t, e: Setpoint(p, t, e, True), PRESSURES, POSITIONS, ENABLES)
)
FLOODS = st.builds(lambda byte, count: bytes([byte]) * count, st.sampled_from([0, 1, 0x55, 0xFF]), st.sampled_from([130, 400, 700]))
BEYOND = st.sampled_from(
    [
        Setpoint(pressures=[LIMITS.pressure_max + 1] + [0] * 5),
        Setpoint(pressures=[0] * 5 + [0xFFFF]),
        Setpoint(tendons=[LIMITS.tension_max + 1] + [4000] * 5),
        Setpoint(tendons=[4000] * 5 + [-1]),
        Setpoint(tendons=[LIMITS.position_max + 1] + [0] * 5, steps=True),
        Setpoint(tendons=[0] * 5 + [-1], steps=True),
        Setpoint(enabled=0x7F),
    ]
)
DYNAMOMETERS = st.sampled_from(
    [
        Sensor(60_000),  # open
        Sensor(-60_000),  # shorted
        Sensor(0),
        Sensor(60_000, 1, 1),  # loose
        Sensor(0, 2, 1),
        Sensor(60_000, 1, 7),
        Sensor(15_000, 1, 3),
        Sensor(LIMITS.tension_trip + 500),  # too high
        Sensor(30_000, 2, 2),
        Sensor(LIMITS.tension_zero),  # frozen
        Sensor(9_000),
    ]
)
MONITORS = st.sampled_from(
    [
        Sensor(0.0),  # broken
        Sensor(0.0, 15, 15),  # loose
        Sensor(0.0, 3, 60),
        Sensor(5.0),  # shorted
        Sensor(4.0),  # too high
        Sensor(4.0, 40, 40),
        Sensor(1.0),  # a regulator that does not follow
        Sensor(2.3),
        Sensor(1.2),
    ]
)


class Machine(RuleBasedStateMachine):
    """Whatever somebody or something may do to the board. `make` gives a board at power-on."""

    make: Callable[..., Board]
    two_wire = False

    @initialize(noise=st.integers(1, 1 << 30), phase=st.integers(0, 999), ready=ARMED)
    def power_on(self, noise: int, phase: int, ready: bool) -> None:
        self.episode = Episode(type(self).make(seed=noise), two_wire=self.two_wire)
        self.waited = False
        self.episode.board.run(1e-6 * phase)
        self.episode.advance(40)
        if ready:
            self.episode.arm()
            self.episode.advance(6)

    def begin(self, armed: bool) -> None:
        """What comes next meets a robot at work, or whatever there is."""
        episode = self.episode
        if armed and episode.state != State.ARMED:
            if episode.state != State.IDLE:
                episode.clear()
                episode.advance(12)
            episode.arm()
            episode.advance(12)

    @rule(what=st.sampled_from(["nothing", "silence", "cut", "restart"]), ms=DURATIONS)
    def time_passes(self, what: str, ms: int) -> None:
        """With a host that goes on or is silent, a line that loses what is on it, a host that starts anew."""
        if what == "silence":
            self.episode.setpoint = None
        elif what == "cut":
            self.episode.trace.cut()
        elif what == "restart":
            self.episode.restart_host()
        self.episode.advance(ms)

    @rule(setpoint=SETPOINTS, period=st.sampled_from([3, 5, 5, 10, 50, 99, 130]), ms=DURATIONS)
    def talk(self, setpoint: Setpoint, period: int, ms: int) -> None:
        self.episode.setpoint, self.episode.period = setpoint, period
        self.episode.advance(ms)

    @rule(setpoint=SETPOINTS, ms=DURATIONS)
    def work(self, setpoint: Setpoint, ms: int) -> None:
        """As a host that knows what it does: CLEAR where it is needed, ARM, set points."""
        self.episode.setpoint = None
        self.begin(True)
        self.episode.setpoint, self.episode.period = setpoint, 5
        self.episode.advance(ms)

    @rule(beyond=BEYOND, times=st.integers(1, 4), ms=DURATIONS, armed=ARMED)
    def set_beyond_limits(self, beyond: Setpoint, times: int, ms: int, armed: bool) -> None:
        self.begin(armed)
        for _ in range(times):
            self.episode.set(beyond)
        self.episode.advance(ms)

    @rule(setpoint=SETPOINTS, session=NEAR, ahead=st.sampled_from([0, 1, -1, -5, 1000, 0x7FFFFFFF]), ms=DURATIONS, armed=ARMED)
    def set_out_of_turn(self, setpoint: Setpoint, session: int, ahead: int, ms: int, armed: bool) -> None:
        """Of another session, or with a number that does not follow."""
        self.begin(armed)
        number = min(max(self.episode.sequence + ahead, 0), 0xFFFFFFFF)
        self.episode.set(setpoint, session=self.episode.session + session, sequence=number)
        self.episode.advance(ms)

    @precondition(lambda self: self.episode.recorded)
    @rule(data=st.data(), ms=DURATIONS, armed=ARMED)
    def replay(self, data: st.DataObject, ms: int, armed: bool) -> None:
        """Frames that were sent before, one or a stretch of them."""
        self.begin(armed)
        recorded = self.episode.recorded
        first = data.draw(st.integers(0, len(recorded) - 1))
        count = data.draw(st.sampled_from([1, 1, 2, 5, 12]))
        for frame in recorded[first : first + count]:
            self.episode.send(frame, record=False)
        self.episode.advance(ms)

    @precondition(lambda self: self.episode.recorded)
    @rule(back=st.integers(1, 3), times=st.integers(1, 3), ms=DURATIONS, armed=ARMED)
    def repeat(self, back: int, times: int, ms: int, armed: bool) -> None:
        """A frame that was sent a moment ago, again."""
        self.begin(armed)
        frame = self.episode.recorded[-back:][0]
        for _ in range(times):
            self.episode.send(frame, record=False)
        self.episode.advance(ms)

    @rule(session=NEAR, limits=st.sampled_from([CHECK, CHECK, CHECK ^ 1, 0]), ms=DURATIONS, idle=ARMED)
    def arm(self, session: int, limits: int, ms: int, idle: bool) -> None:
        if idle and self.episode.state != State.IDLE:
            self.episode.request(DISARM)
            self.episode.clear(self.episode.session + (self.episode.state == State.ARMED))
            self.episode.advance(12)
        self.episode.arm(self.episode.session + session, limits)
        self.episode.advance(ms)

    @rule(session=NEAR, ms=DURATIONS)
    def clear(self, session: int, ms: int) -> None:
        self.episode.clear(self.episode.session + session)
        self.episode.advance(ms)

    @rule(kind=st.sampled_from([DISARM, ESTOP, ASK]), ms=DURATIONS, armed=ARMED)
    def request(self, kind: protocol.Message, ms: int, armed: bool) -> None:
        self.begin(armed)
        self.episode.request(kind)
        self.episode.advance(ms)

    @rule(
        key=st.sampled_from([*map(int, Key), 0, 77]),
        value=st.sampled_from([0, 1, 4, 5, 20, 100, 101, 291, 900, 901, 2912, 2913, 9524, 9525, 65535]),
        session=NEAR,
        ms=DURATIONS,
    )
    def configure(self, key: int, value: int, session: int, ms: int) -> None:
        self.episode.config(key, value, self.episode.session + session)
        self.episode.advance(ms)

    @rule(ahead=st.sampled_from([1, 2, 3]), ms=DURATIONS)
    def plan_ahead(self, ahead: int, ms: int) -> None:
        """A host that does not wait for answers: CLEAR, ARM and a set point of the sessions to come."""
        episode, session = self.episode, self.episode.session
        if ahead > 1:
            episode.clear(session)
            session += 1
        episode.arm(session)
        if ahead > 2:
            episode.set(Setpoint(pressures=[800] * 6), session=session + 1)
        episode.advance(ms)

    @rule(data=st.one_of(st.binary(min_size=1, max_size=90), FLOODS), ms=DURATIONS)
    def garbage(self, data: bytes, ms: int) -> None:
        self.episode.send(data, record=False)
        self.episode.advance(ms)

    @precondition(lambda self: self.episode.recorded)
    @rule(data=st.data(), ms=DURATIONS)
    def damage(self, data: st.DataObject, ms: int) -> None:
        """A frame with a bit turned round, or one that ends early."""
        frame = data.draw(st.sampled_from(self.episode.recorded[-8:]))
        at = data.draw(st.integers(0, len(frame) - 1))
        cut = data.draw(st.booleans())
        mask = 1 << data.draw(st.integers(0, 7))
        self.episode.send(frame[:at] if cut else frame[:at] + bytes([frame[at] ^ mask]) + frame[at + 1 :], record=False)
        self.episode.advance(ms)

    @rule(pressed=st.booleans(), ms=DURATIONS, armed=ARMED)
    def button(self, pressed: bool, ms: int, armed: bool) -> None:
        self.begin(armed)
        self.episode.button(pressed)
        self.episode.advance(ms)

    @rule(cause=st.sampled_from([PIN, BROWN_OUT, POWER_ON]), ms=DURATIONS, armed=ARMED)
    def reset(self, cause: int, ms: int, armed: bool) -> None:
        self.begin(armed)
        self.episode.reset(cause)
        self.episode.advance(ms)

    @rule(hung=st.sampled_from([1, 2, 8, 60, 110, 140]), ms=DURATIONS, armed=ARMED)
    def hang(self, hung: int, ms: int, armed: bool) -> None:
        """Until it goes on by itself or, after 120 ms, the watchdog bites."""
        self.begin(armed)
        board = self.episode.board
        self.episode.hang()
        before = board.step_counts
        self.episode.advance(hung)
        if hung > 1 and self.episode.hung:
            assert board.safe, "something is on though the main loop hangs"
        if self.episode.hung:
            assert max(board.step_counts - before) <= 15, "the motors go on though the main loop hangs"
        self.episode.mend()
        self.episode.advance(ms)

    @rule(channel=CHANNEL, sensor=DYNAMOMETERS, ms=LONG, armed=ARMED)
    def dynamometer(self, channel: int, sensor: Sensor, ms: int, armed: bool) -> None:
        self.begin(armed)
        self.episode.dynamometers[channel] = sensor
        self.episode.advance(ms)

    @rule(channel=CHANNEL, sensor=MONITORS, ms=LONG, armed=ARMED)
    def monitor(self, channel: int, sensor: Sensor, ms: int, armed: bool) -> None:
        self.begin(armed)
        self.episode.monitors[channel] = sensor
        self.episode.advance(ms)

    @rule(ms=DURATIONS)
    def heal(self, ms: int) -> None:
        self.episode.heal()
        self.episode.advance(ms)

    @precondition(lambda self: self.episode.monitors and not self.waited)
    @rule()
    def wait_for_regulators(self) -> None:
        """As long as a regulator has to follow; once in an episode, and not in most."""
        self.waited = True
        self.episode.advance(1700)

    @precondition(lambda self: self.two_wire)
    @rule(hung=st.booleans(), absent=st.integers(0, 3), ms=DURATIONS, armed=ARMED)
    def two_wire_bus(self, hung: bool, absent: int, ms: int, armed: bool) -> None:
        self.begin(armed)
        self.episode.bus(hung, absent)
        self.episode.advance(ms)

    def teardown(self) -> None:
        if hasattr(self, "episode"):
            self.episode.back_to_work()


def run_episodes(
    make: Callable[..., Board], number: int, count: int, steps: int = STEPS, two_wire: bool = False, shrink: bool = True
) -> None:
    """So many episodes; which ones is decided by the number, and not by what else is loaded (hypothesis likes to draw numbers that stand in
    any module that is).

    Args:
        make: a board at power-on, with a seed for the noise in its memory.
        number: two with the same number are the same.
        count: episodes.
        steps: in each, at most.
        two_wire: whether the board's DACs are on the two-wire bus.
        shrink: whether one that fails is made as short as possible.
    """
    machine = seed(number)(type(f"Machine{number}", (Machine,), {"make": staticmethod(make), "two_wire": two_wire}))
    with mock.patch.multiple(providers, _get_local_constants=providers.Constants, CONSTANTS_CACHE=type(providers.CONSTANTS_CACHE)(1024)):
        run_state_machine_as_test(
            machine,
            settings=settings(
                max_examples=count,
                stateful_step_count=steps,
                deadline=None,
                database=None,
                print_blob=False,
                report_multiple_bugs=False,
                suppress_health_check=list(HealthCheck),
                phases=[Phase.generate, Phase.shrink] if shrink else [Phase.generate],
            ),
        )


@dataclass(frozen=True)
class Sabotage:
    """A line of the firmware that is wrong on purpose."""

    file: str
    line: str
    wrong: str

    def build(self, folder: Path) -> Path:
        """The firmware with it."""
        source = folder / "source"
        shutil.copytree(FIRMWARE, source)
        text = (source / self.file).read_text()
        assert text.count(self.line) == 1
        (source / self.file).write_text(text.replace(self.line, self.wrong))
        return build_firmware(folder, source=source)


SABOTAGES = {
    "time-out is doubled": Sabotage("config.h", "TIMEOUT_MS = 100;", "TIMEOUT_MS = 200;"),
    "old set points are signs of life": Sabotage("board.cpp", "    ++stale_;\n", "    ++stale_;\n    heard = now;\n"),
    "set points of any session": Sabotage("board.cpp", "message.session != memory::session() || message.sequence", "message.sequence"),
    "repeated set points": Sabotage("board.cpp", " || message.sequence <= sequence_)", ")"),
    "set points beyond the limits": Sabotage("board.cpp", "  if (!allowed) {", "  if (!allowed && !message.enabled) {"),
    "ARM of any session": Sabotage("board.cpp", "  if (message.session != memory::session()) return Result::WRONG_SESSION;\n", ""),
    "ARM with any limits": Sabotage("board.cpp", "  if (message.limits != limits_check) return Result::WRONG_LIMITS;\n", ""),
    "sessions go on after stops": Sabotage("board.cpp", "  if (state_ == State::ARMED) new_session();\n", ""),
    "sessions repeat after resets": Sabotage("memory.cpp", "  eeprom_write_block(&last", "  if (number & 1) eeprom_write_block(&last"),
    "requests are done twice": Sabotage("link.cpp", "if (!memcmp(last, &message, sizeof message)) return true;", ""),
    "motors stay on after stops": Sabotage("board.cpp", "  motors::enable(0);\n", ""),
    "no trip": Sabotage("board.cpp", "if (++trips[k] >= TRIP_SAMPLES)", "if (++trips[k] >= 200)"),
    "dead dynamometers": Sabotage("board.cpp", "if (dead[k] >= DEAD_SAMPLES)", "if (dead[k] >= 200)"),
    "pressure too high": Sabotage("board.cpp", "over[k].reaches(4 * MONITOR_MS", "over[k].reaches(8 * MONITOR_MS"),
    "regulators that do not follow": Sabotage("board.cpp", "stuck[k].reaches(REGULATOR_MS", "stuck[k].reaches(2 * REGULATOR_MS"),
    "fault on fault": Sabotage("board.cpp", "  if (faults_ & bit) return;", "  if (faults_) return;"),
    "outputs stay on": Sabotage("board.cpp", "  if (fault >= Fault::MONITOR) outputs_off();\n", ""),
    "button is ignored": Sabotage("board.cpp", "  if (estop_pressed() && state_ != State::ESTOP) stop();\n", ""),
    "CLEAR while the button is pressed": Sabotage(
        "board.cpp", "  if (estop_pressed()) return Result::ESTOP_PRESSED;\n  if (dac::hung())", "  if (dac::hung())"
    ),
    "a hung main loop goes on": Sabotage("config.h", "PATIENCE = 8;", "PATIENCE = 80;"),
    "pressure stays after stops": Sabotage("board.cpp", "wanted_pressure[k] = 0;", "wanted_pressure[k] /= 2;"),
}


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_some_episodes(firmware: Path, library: Path, number: int) -> None:
    run_episodes(lambda **options: Board(library, firmware, **options), number, 30, steps=4)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(100, 120))
def test_many_episodes(firmware: Path, library: Path, number: int) -> None:
    run_episodes(lambda **options: Board(library, firmware, **options), number, 90)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(200, 206))
def test_many_episodes_with_a_two_wire_bus(build: Callable[[str, str], Path], library: Path, number: int) -> None:
    firmware = build("mega", "-DDAC=DAC_MCP4728")
    run_episodes(lambda **options: Board(library, firmware, **options), number, 50, two_wire=True)


@pytest.mark.study
@pytest.mark.parametrize("name", SABOTAGES)
def test_sabotage_is_noticed(library: Path, tmp_path: Path, name: str) -> None:
    """Whatever is taken from the firmware, episodes miss it: the rarest, a trip, in one episode of 300."""
    firmware = SABOTAGES[name].build(tmp_path)
    with pytest.raises(AssertionError) as caught:
        run_episodes(lambda **options: Board(library, firmware, **options), 300, 1500, shrink=False)
    print(str(caught.value).partition("\n")[0])
