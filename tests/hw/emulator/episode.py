"""A board, a host that talks to it and a world in which things go wrong, for random sequences of all that; and what must hold throughout.

Time passes in milliseconds. What must hold is looked at twice: by the few rules in here, which know only pins, sensors and clocks, and by
a model of the board (`belief.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.protocol import ACK, ARM, ASK, CLEAR, CONFIG, DISARM, HELLO, SET, STATUS, Key, Message, ResetCause, State
from tests.hw.emulator import CHANNELS, RESET, Board
from tests.hw.emulator.belief import CHECK, Belief
from tests.hw.emulator.causes import DYNAMOMETER_HIGH, LIMITS, MONITOR_MS, NOISE, REGULATOR_MS, ROUND, Causes, run_lengths
from tests.hw.emulator.mind import allowed
from tests.hw.emulator.trace import MS, Trace

LAG_MS, LAG_RECORDS = 25, 25
"""What is said about a pass has been heard by then."""
DEAD_COUNTS, MONITOR_BROKEN_V = 60_000, 0.0
ALL = 0x3F


@dataclass
class Setpoint:
    """What the host asks for."""

    pressures: Sequence[int] = (0,) * CHANNELS
    tendons: Sequence[int] = (LIMITS.tension_zero,) * CHANNELS
    enabled: int = ALL
    steps: bool = False


@dataclass
class Sensor:
    """What is wrong with a sensor: it shows `value`; for `on` of `on + off` ms, where off is not 0."""

    value: float
    on: int = 1
    off: int = 0


@dataclass
class Episode:
    """A board at power-on and all around it.

    Args:
        board: at power-on.
        two_wire: whether its DACs are on the two-wire bus.

    Attributes:
        setpoint: sent every `period` ms; None: the host is silent.
        session: as the host believes.
    """

    board: Board
    two_wire: bool = False
    setpoint: Setpoint | None = None
    period: int = 5
    sequence: int = 0
    session: int = 0
    state: State = State.IDLE
    ms: int = 0
    dynamometers: dict[int, Sensor] = field(default_factory=dict)
    monitors: dict[int, Sensor] = field(default_factory=dict)
    recorded: list[bytes] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.delay = 14 if self.two_wire else 1
        self.board.tendons()
        self.trace, self.causes = Trace(self.board), Causes()
        self.belief = Belief(self.trace, self.causes, self.delay)
        self.rules = Rules(self)
        self.pressed = self.hung = False
        self._id = 0
        self._seen = 0
        self._prepared = 0

    # ---------------------------------------------------------------- time

    def advance(self, ms: int) -> None:
        """Let time pass: sensors that come and go, set points, answers."""
        for _ in range(ms):
            if self.dynamometers or self.monitors:
                self._show()
            if self.setpoint is not None and self.ms % self.period == 0:
                self.set(self.setpoint)
            self.ms += 1
            self.board.run(0.001)
            self.trace.listen()
            if self.hung:
                self._mend_after_reset()
            self._listen()
        self.check()

    @property
    def status(self) -> dict[str, int]:
        """The last STATUS."""
        return next(heard.values for heard in reversed(self.trace.heard) if heard.kind is STATUS)

    def _listen(self) -> None:
        for heard in self.trace.heard[self._seen :]:
            if heard.kind in (STATUS, ACK, HELLO):
                self.session, self.state = heard.values["session"], State(heard.values["state"])
        self._seen = len(self.trace.heard)

    def check(self) -> None:
        """Compare what happened with what may happen, as far as all is known about it."""
        trace = self.trace
        trace.update()
        while self._prepared < len(trace.records):
            begin = self._prepared
            if trace.records[begin]["kind"]:
                self.causes.skip()
                self._prepared += 1
                continue
            resets = np.flatnonzero(trace.records["kind"][begin:])
            self._prepared = begin + int(resets[0]) if len(resets) else len(trace.records)
            self.causes.add(trace.records[begin : self._prepared], self.delay)
        self.rules.check()
        known = int(np.searchsorted(trace.records["cycle"], max(0, self.board.cycle - LAG_MS * MS)))
        self.belief.advance(min(known, max(len(trace.records) - LAG_RECORDS, trace.boots[-1].begin + 1)))

    # ---------------------------------------------------------------- what the host does

    def send(self, data: bytes, record: bool = True) -> None:
        """Bytes onto the line."""
        if record:
            self.recorded.append(data)
        self.trace.send(data)

    def set(self, setpoint: Setpoint, session: int | None = None, sequence: int | None = None) -> bytes:
        """SET, by default with the session told last and the next sequence number."""
        if sequence is None:
            self.sequence += 1
        data = protocol.frame(
            SET.pack(
                session=self.session if session is None else session & 0xFFFFFFFF,
                sequence=self.sequence if sequence is None else sequence,
                enabled=setpoint.enabled | (protocol.POSITION_MODE if setpoint.steps else 0),
                pressures=list(setpoint.pressures),
                tendons=list(setpoint.tendons),
            )
        )
        self.send(data)
        return data

    def request(self, kind: Message, **values: int) -> bytes:
        """A request with the next id."""
        self._id = (self._id + 1) % 256
        data = protocol.frame(kind.pack(id=self._id, **values))
        self.send(data)
        return data

    def arm(self, session: int | None = None, limits: int = CHECK) -> None:
        """ARM."""
        self.request(ARM, session=self.session if session is None else session & 0xFFFFFFFF, limits=limits)

    def clear(self, session: int | None = None) -> None:
        """CLEAR."""
        self.request(CLEAR, session=self.session if session is None else session & 0xFFFFFFFF)

    def config(self, key: int, value: int, session: int | None = None) -> None:
        """CONFIG."""
        self.request(CONFIG, session=self.session if session is None else session & 0xFFFFFFFF, key=key, value=value)

    def restart_host(self) -> None:
        """A host that begins to count anew."""
        self.sequence = self._id = 0

    # ---------------------------------------------------------------- what happens to the board

    def button(self, pressed: bool) -> None:
        """The emergency stop button."""
        self.pressed = pressed
        self.board.estop(pressed)

    def reset(self, cause: int) -> None:
        """A reset from outside."""
        self.trace.causes[self.board.cycle] = ResetCause(cause)
        self.board.reset(cause)
        if self.hung:
            self.mend()

    def hang(self) -> None:
        """The main loop hangs."""
        if not self.hung:
            self.hung = True
            self.trace.hangs.append([self.board.cycle, None])
            self.board.hang()

    def mend(self) -> None:
        """It goes on."""
        if self.hung:
            self.hung = False
            self.trace.hangs[-1][1] = self.board.cycle
            self.board.mend()

    def _mend_after_reset(self) -> None:
        resets = len(self.trace.boots)
        self.trace.update()
        if len(self.trace.boots) > resets:
            self.mend()

    def bus(self, hung: bool = False, absent: int = 0) -> None:
        """The two-wire bus: held low, or without some chips; or in order."""
        wrong = bool(hung or absent)
        if self.trace.bus and self.trace.bus[-1][1] is None:
            if not wrong:
                self.trace.bus[-1][1] = self.board.cycle
        elif wrong:
            self.trace.bus.append([self.board.cycle, None])
        self.board.two_wire(hung, absent)

    def _show(self) -> None:
        """Sensors that are wrong show it, or not just now."""
        held = [0, 0]
        for at, sensors in enumerate((self.dynamometers, self.monitors)):
            for k, sensor in sensors.items():
                if not sensor.off or self.ms % (sensor.on + sensor.off) < sensor.on:
                    held[at] |= 1 << k
                    self._hold(at, k, sensor.value)
                else:
                    self._release(at, k)
        self.board.hold(*held)

    def _hold(self, at: int, k: int, value: float) -> None:
        if at:
            self.board.monitor(k, value)
        else:
            self.board.dynamometer(k, int(value))

    def _release(self, at: int, k: int) -> None:
        self._hold(at, k, 1.0 if at else LIMITS.tension_zero)

    def heal(self) -> None:
        """All sensors, the bus and the button are well again."""
        for at, sensors in enumerate((self.dynamometers, self.monitors)):
            for k in sensors:
                self._release(at, k)
            sensors.clear()
        self.board.hold()
        if self.two_wire:
            self.bus()
        self.button(False)
        self.mend()

    # ---------------------------------------------------------------- the end

    def back_to_work(self) -> None:
        """All well again: CLEAR and ARM lead back within half a second, and the board follows a set point. Nothing is locked up."""
        self.heal()
        self.setpoint, self.period = None, 5
        self.trace.cut()
        self.send(b"\0", record=False)
        self.request(ASK)
        self.advance(30)
        if self.state == State.ARMED:
            self.request(DISARM)
            self.advance(10)
        self._until(State.IDLE, self.clear)
        for key, value in ((Key.PRESSURE_SLEW, 2912), (Key.STEP_RATE, 9524), (Key.STEPS_PER_1000_COUNTS, 291), (Key.STATUS_PERIOD_MS, 5)):
            self.config(key, value)
        self.advance(8)
        self._until(State.ARMED, self.arm)
        goal = Setpoint([100] * CHANNELS, [LIMITS.tension_zero + 200] * CHANNELS)
        tensions = np.zeros(CHANNELS)
        self.setpoint = goal
        for _ in range(25):
            self.advance(15)
            tensions = self.trace.records["dynamometers"][-1].astype(int)
            if self.board.dac.tolist() == goal.pressures and np.abs(tensions - goal.tendons).max() <= 10:
                break
        assert self.state == State.ARMED, f"{self.state.name} after work began anew, {self.status}"
        assert self.board.enabled == ALL
        assert self.board.dac.tolist() == goal.pressures
        assert np.abs(tensions - goal.tendons).max() <= 10
        self.setpoint = None
        self.advance(LAG_MS + 3)

    def _until(self, state: State, request: Callable[[], None]) -> None:
        """Ask again until it is so."""
        for _ in range(12):
            if self.state == state:
                return
            request()
            self.advance(8)
            if self.state != state:
                self.advance(30)
        raise AssertionError(f"no way back to {state.name} from {self.state.name}")


class Rules:
    """What must hold whatever happens, looked at in each pass. It knows pins, sensors and clocks, and which frames could be valid.

    Args:
        episode: all that happened.
    """

    def __init__(self, episode: Episode) -> None:
        self.episode = episode
        self.done = 0
        self.frames = 0
        self.alive = 0  # cycle of the last frame that could be a sign of life
        self.sequences: dict[int, int] = {}
        self.runs: dict[str, np.ndarray] = {}
        self.pressed_since: int | None = None

    def check(self) -> None:
        """Look at what is new."""
        episode = self.episode
        records = episode.trace.records[self.done :]
        for at, record in enumerate(records, self.done):
            self._listen(at)
            if record["kind"] == RESET:
                self.alive, self.pressed_since = 0, None
                self.frames = next(boot.frame for boot in episode.trace.boots if boot.begin == at)
                assert not record["enabled"], "a motor is enabled in a reset"
                assert not record["outputs"], "OUTPUTS are on in a reset"
                self.runs.clear()
                continue
            self._silence(at, record)
            self._button(at, record)
        self._sensors(records)
        self.done = len(episode.trace.records)
        self._motors()
        assert episode.board.dac_peak.max() <= LIMITS.pressure_max, "a DAC beyond the limit"
        assert episode.board.idle_steps == 0, "a step of a motor that is not enabled"

    def _listen(self, at: int) -> None:
        """Frames that may have been signs of life by this record."""
        frames = self.episode.trace.frames
        while self.frames < len(frames) and frames[self.frames].early <= at:
            frame = frames[self.frames]
            self.frames += 1
            values, session = frame.values, frame.values.get("session", -1)
            record = min(frame.late, len(self.episode.trace.records) - 1)
            if frame.kind is ARM and values["limits"] == CHECK:
                self.sequences[session + 1] = 0
            elif frame.kind is SET and session in self.sequences and values["sequence"] > self.sequences[session] and allowed(values):
                self.sequences[session] = values["sequence"]
            else:
                continue
            self.alive = int(self.episode.trace.records[int(record)]["cycle"])

    def _silence(self, at: int, record: np.void) -> None:
        """After 110 ms without a sign of life no motor is on and no pressure rises; 0.6 s later there is none."""
        silent = (int(record["cycle"]) - self.alive) / MS
        if silent <= 110:
            return
        assert not record["enabled"], f"a motor is enabled {silent:.1f} ms after the last sign of life"
        before = self.episode.trace.records[at - 1]
        if at and not before["kind"] and silent > 110 + self.episode.delay:
            assert np.all(record["dac"] <= before["dac"]), f"a pressure rises {silent:.1f} ms after the last sign of life"
        if silent > 710:
            assert not record["dac"].any() or self.episode.two_wire, f"pressure {silent:.1f} ms after the last sign of life"

    def _button(self, at: int, record: np.void) -> None:
        cycle = int(record["cycle"])
        if not record["pressed"]:
            self.pressed_since = None
            return
        if self.pressed_since is None:
            self.pressed_since = cycle
        if cycle - self.pressed_since >= 2 * MS:
            assert not record["enabled"], "a motor is enabled though the button is pressed"
            assert not record["outputs"], "OUTPUTS are on though the button is pressed"
            assert not record["dac"].any(), "pressure though the button is pressed"

    def _motors(self) -> None:
        """No motor steps faster than it may."""
        steps = self.episode.board.steps()
        if not len(steps):
            return
        for motor in range(CHANNELS):
            times = steps[steps[:, 1] == motor, 0]
            if len(times) > 1:
                assert np.diff(times).min() > 90e-6, "two steps too close"
            if len(times) > 12:
                assert (times[12:] - times[:-12]).min() > 0.00105, "more than 12 steps in a millisecond"

    def _sensors(self, records: np.ndarray) -> None:
        """What was measured wrong for long enough has had its consequence."""
        records = records[records["kind"] != RESET]
        if not len(records):
            return
        on, outputs = records["enabled"][:, None] > 0, records["outputs"][:, None] > 0
        dyn, mon, dac = (records[name].astype(int) for name in ("dynamometers", "monitors", "dac"))
        off = np.abs(mon - LIMITS.monitor_zero - LIMITS.monitor_per_code / 256 * dac)
        for what, wrong, most in (
            ("dead", ((dyn < LIMITS.dynamometer_low) | (dyn > DYNAMOMETER_HIGH)) & on, 10),
            ("too high", (dyn > LIMITS.tension_trip) & on, 10),
            ("above its limit", (mon > LIMITS.monitor_trip + NOISE) & outputs, MONITOR_MS + ROUND),
            ("broken", (mon < LIMITS.monitor_low - NOISE) & outputs, MONITOR_MS + ROUND),
            ("off its set point", (off > LIMITS.regulator_band + NOISE) & outputs, REGULATOR_MS),
        ):
            runs = run_lengths(wrong, self.runs.get(what, np.zeros(CHANNELS, dtype=int)))
            self.runs[what] = runs[-1]
            assert runs.max() <= most, f"sensor {runs.max(axis=0).argmax()} is {what} for more than {most} ms"
