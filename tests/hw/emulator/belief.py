"""A small model of what the board may do, written from docs/how-to/hardware.md: which states it can be in, given all that was seen of it.

What happens within a pass has an order; when something is noticed often has not. So there are several states that the board may be in, and
each answer, status and pin that is seen rules some out. An episode in which none is left is one that the model does not allow.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.protocol import ARM, ASK, CONFIG, DISARM, ESTOP, SET, Fault, ResetCause, Result, State
from tests.hw.emulator import CHANNELS
from tests.hw.emulator.causes import LIMITS, Causes
from tests.hw.emulator.mind import NOBODY, Mind, allowed, configured
from tests.hw.emulator.trace import MS, Arrival, Boot, Heard, Trace

CHECK = LIMITS.check
TIMEOUT_MS = 100
TRAVEL_MS = 3000
"""Nearly what a motor needs for 30,000 steps."""
ANSWER_WINDOW = 10
"""Passes from when an answer is put together until it has gone out; and until then from the request."""
LONG, FORMERLY = 40, -1000
"""Passes after which it does not matter any more since when the robot has been armed."""
RISE, LATE_WRITE = 70, 60
"""Codes by which a DAC may rise at once: 2.5 MPa/s in the 6 ms between two writes; ms between two writes while the bus is in disorder."""


class Belief:
    """All states that the board may be in, record by record.

    Args:
        trace: what happened.
        causes: what its sensors showed.
        delay: passes until a DAC has what the firmware wrote.
    """

    def __init__(self, trace: Trace, causes: Causes, delay: int = 1) -> None:
        self.trace, self.causes, self.delay = trace, causes, delay
        self.minds: set[Mind] = {Mind(0, 0)}
        self.done = 0
        self.sessions: set[int] = set()
        self.upper = -1
        self.story: list[str] = []
        self.could_arm: list[bool] = []
        self.goals: list[list[int]] = []
        self.suspects: dict[Fault, set[int]] = {}
        self._acks: list[Heard] = []
        self._statuses: dict[int, Heard] = {}
        self._others: dict[int, list[Heard]] = {}
        self._sorted = 0
        self._last_clear = -1000
        self._unfinished: set[State] = set()

    def _bus_wrong(self, cycle: int, ms: float) -> bool:
        """Whether the two-wire bus is in disorder, and has been for so long."""
        return any(begin + ms * MS <= cycle and (end is None or end >= cycle) for begin, end in self.trace.bus if begin is not None)

    def _bus_doubtful(self, cycle: int) -> bool:
        """Whether it may be found in disorder."""
        return any(begin is not None and begin <= cycle and (end is None or end + 60 * MS >= cycle) for begin, end in self.trace.bus)

    # ---------------------------------------------------------------- what was heard

    def _sort(self) -> None:
        trace = self.trace
        while self._sorted < len(trace.heard) and trace.heard[self._sorted].record >= 0:
            heard = trace.heard[self._sorted]
            self._sorted += 1
            if heard.kind is protocol.ACK:
                self._acks.append(heard)
            elif heard.kind is protocol.STATUS:
                at, told = heard.record, heard.values["time_ms"]
                while at >= 0 and trace.boot[at] == trace.boot[heard.record] and trace.clock[at] > told:
                    at -= 1
                if told - trace.clock[at] not in (0, int(at in trace.late)) or heard.record - at > 2 * ANSWER_WINDOW:
                    self._fail(at, f"STATUS of record {heard.record} told the clock {told}, which was {trace.clock[at]}")
                self._statuses[at] = heard
            else:
                self._others.setdefault(heard.record, []).append(heard)

    def _fail(self, at: int, what: str) -> None:
        time = (int(self.trace.records[at]["cycle"]) if at < len(self.trace.records) else 0) / MS
        raise AssertionError("\n".join([f"at {time:.2f} ms, record {at}: {what}", *self.story[-4:]]))

    # ---------------------------------------------------------------- frames

    def _receive(self, minds: set[Mind], at: int) -> set[Mind]:
        """What may be after the frames of a pass."""
        frames = self.trace.frames
        after: set[Mind] = set()
        waiting, seen = list(minds), set(minds)
        while waiting:
            mind = waiting.pop()
            if mind.frame == len(frames) or frames[mind.frame].early > at:
                after.add(mind)
                continue
            frame = frames[mind.frame]
            if frame.late > at:
                after.add(mind)
            then = {mind._replace(frame=mind.frame + 1) for mind in self._take(mind, frame, at)}
            if frame.torn:
                then.add(mind.counted(True)._replace(frame=mind.frame + 1))
            waiting += then - seen
            seen |= then
        return after

    def _take(self, mind: Mind, frame: Arrival, at: int) -> list[Mind]:
        kind, values = frame.kind, frame.values
        if kind is None:
            return [mind.counted(frame.torn, bad=1)]
        if mind.session < 0 and "session" in values:  # HELLO may have told the host what no STATUS has told yet
            known = mind._replace(session=values["session"])
            return [then for which in (known, mind) for then in self._done(which, frame, at)]
        return self._done(mind, frame, at)

    def _done(self, mind: Mind, frame: Arrival, at: int) -> list[Mind]:
        kind, values = frame.kind, frame.values
        mind = mind.counted(frame.torn, good=1)
        if kind is SET:
            return [self._set(mind, frame, at)]
        if kind is ASK:
            return [mind]
        if kind is ESTOP:
            return [mind.stopped()._replace(last=frame.payload, result=Result.DONE, channels=NOBODY, pending=at)]
        if kind is DISARM:
            mind = mind.left(State.IDLE) if mind.state == State.ARMED else mind
            return [mind._replace(last=frame.payload, result=Result.DONE, channels=NOBODY, pending=at)]
        if mind.last == frame.payload:
            return [mind._replace(pending=at)]
        mind = mind._replace(last=frame.payload, pending=at)
        if kind is CONFIG:
            return [mind._replace(result=configured(values, mind.session), channels=NOBODY)]
        answers = self._arm(mind, values, at) if kind is ARM else self._clear(mind, values, at)
        return [self._answered(mind, kind, at, result, channels) for result, channels in answers]

    def _set(self, mind: Mind, frame: Arrival, at: int) -> Mind:
        values = frame.values
        if mind.state != State.ARMED or values["session"] != mind.session or values["sequence"] <= mind.sequence:
            return mind.counted(frame.torn, stale=1)
        if not allowed(values):
            return mind.counted(frame.torn, refused=1)
        enabled = values["enabled"] & ~protocol.POSITION_MODE
        on = 0 if mind.hung else enabled
        return mind._replace(sequence=values["sequence"], heard=self._clock_before(at), enabled=on, goal=mind.frame)

    def _clock_before(self, at: int) -> int:
        """What the firmware's clock showed in the pass before."""
        return max(self.trace.clock[at - 1], 0) if at else 0

    def _pressed(self, at: int) -> set[bool]:
        records = self.trace.records
        return {bool(records[k]["pressed"]) for k in (at - 1, at) if 0 <= k < len(records)}

    def _arm(self, mind: Mind, values: dict[str, int], at: int) -> list[tuple[Result, frozenset[int]]]:
        if values["session"] != mind.session:
            return [(Result.WRONG_SESSION, NOBODY)]
        if values["limits"] != CHECK:
            return [(Result.WRONG_LIMITS, NOBODY)]
        found: list[tuple[Result, frozenset[int]]] = []
        pressed = self._pressed(at)
        if True in pressed:
            found.append((Result.ESTOP_PRESSED, NOBODY))
        if False in pressed:
            if mind.state != State.IDLE:
                found.append((Result.WRONG_STATE, NOBODY))
            else:
                found += self._well(at, self.causes.dead[at - 1])
        return found

    def _clear(self, mind: Mind, values: dict[str, int], at: int) -> list[tuple[Result, frozenset[int]]]:
        if values["session"] != mind.session:
            return [(Result.WRONG_SESSION, NOBODY)]
        if mind.state == State.ARMED:
            return [(Result.WRONG_STATE, NOBODY)]
        pressed = self._pressed(at)
        return [(Result.ESTOP_PRESSED, NOBODY)] * (True in pressed) + (self._well(at) if False in pressed else [])

    def _well(self, at: int, dead: np.ndarray | None = None) -> list[tuple[Result, frozenset[int]]]:
        """Answers to a request that asks for the bus, dynamometers (where `dead` says which are not) and regulators in order."""
        cycle = int(self.trace.records[at]["cycle"])
        if self._bus_wrong(cycle, 45):
            return [(Result.BUS, NOBODY)]
        doubtful = self._bus_doubtful(cycle)
        found = [(Result.BUS, NOBODY)] * doubtful
        if dead is not None and dead.any():
            return [*found, (Result.DYNAMOMETER, frozenset([int(dead.argmax())]))]
        fine, disordered = self.causes.fine[at], self.causes.disordered[at]
        channels = frozenset(range(CHANNELS))
        if not doubtful:
            first = int(disordered.argmax()) if disordered.any() else CHANNELS
            channels = frozenset(k for k in range(CHANNELS) if not fine[k] and k <= first)
        if channels:
            found = [*found, (Result.MONITOR, channels)]
        if doubtful or not disordered.any():
            found = [*found, (Result.DONE, NOBODY)]
        return found

    def _answered(self, mind: Mind, kind: protocol.Message, at: int, result: Result, channels: frozenset[int]) -> Mind:
        mind = mind._replace(result=result, channels=channels)
        if result != Result.DONE:
            return mind
        if kind is ARM:
            return mind.renewed()._replace(state=State.ARMED, heard=self._clock_before(at), armed=at, goal=-1)
        self._last_clear = at
        return mind.left(State.IDLE).renewed()._replace(faults=0, outputs=True, hung=False)

    # ---------------------------------------------------------------- a pass

    def advance(self, upto: int) -> None:
        """Take the records before `upto`, about which nothing more will be heard."""
        self._sort()
        while self.done < upto:
            at = self.done
            record = self.trace.records[at]
            before = self.minds
            self.minds = self._reset(at) if record["kind"] else self._pass(at)
            if len(self.minds) > 1:
                self.minds = {mind._replace(armed=FORMERLY) if 0 < mind.armed < at - LONG else mind for mind in self.minds}
            if not self.minds:
                seen = {name: record[name].tolist() for name in record.dtype.names}
                self._fail(at, "\n".join([f"nothing of what the board may do explains {seen}", *map(str, before)]))
            self.done += 1

    def _reset(self, at: int) -> set[Mind]:
        boot = next(boot for boot in self.trace.boots if boot.begin == at)
        if boot.cause == ResetCause.WATCHDOG and not self._hung(boot.cycle - 100 * MS, boot.cycle)[1]:
            self._fail(at, "the watchdog has bitten though the main loop did not hang")
        unfinished, self._unfinished = self._unfinished, set()
        ends = set(self.minds)
        ends |= self._receive(self.minds, at)
        was_armed = {mind.state == State.ARMED for mind in ends}
        if at:  # the last pass may not have come to its end
            was_armed |= {state == State.ARMED for state in unfinished}
        before = next(boot for boot in reversed(self.trace.boots) if boot.begin < at)
        if not before.zero:  # nor may the start, so that it is still remembered
            was_armed |= {bool(mind.faults & Fault.RESET_WHILE_ARMED.bit) for mind in ends}
        if boot.cause == ResetCause.POWER_ON:
            was_armed = {False}
        begin = Mind(boot.frame, self._answer_index(at))
        fresh = {begin.failed(Fault.RESET_WHILE_ARMED) if armed else begin for armed in was_armed}
        fresh = self._bus_at_start(boot, fresh)
        self.sessions |= {mind.session for mind in ends}
        self.story.append(f"{at}: reset by {boot.cause.name}")
        self.goals.append([0] * CHANNELS)
        self.could_arm.append(False)
        return fresh

    def _bus_at_start(self, boot: Boot, fresh: set[Mind]) -> set[Mind]:
        """What may be after a start that writes to the two-wire bus, once to each output."""
        end = max(boot.zero, boot.cycle)  # 0 where the start was not finished
        for begin, mended in self.trace.bus:
            if begin is not None and begin <= end and (mended is None or mended >= boot.cycle):
                failed = {mind.failed(Fault.BUS) for mind in fresh}
                throughout = begin <= boot.cycle < end and (mended is None or mended >= end)
                fresh = failed if throughout else fresh | failed
        return fresh

    def _answer_index(self, at: int) -> int:
        """The first ACK that comes after a reset."""
        return sum(ack.record < at for ack in self._acks)

    def _hung(self, begin: int, end: int) -> tuple[bool, bool]:
        """Whether the main loop may, and must, have been silent for too long between two cycles."""
        longest = 0
        for start, stop in self.trace.hangs:
            assert start is not None
            longest = max(longest, min(end, stop if stop is not None else end) - max(begin, start))
        return longest > 0.25 * MS, longest > MS

    def _pass(self, at: int) -> set[Mind]:
        trace = self.trace
        record = trace.records[at]
        enabled, outputs, pressed, clock = int(record["enabled"]), bool(record["outputs"]), bool(record["pressed"]), trace.clock[at]
        minds = self._after_hang(at)
        received: set[Mind] = set()
        for mind in self._receive(minds, at):
            on = mind.enabled if mind.state == State.ARMED and not mind.hung else 0
            if on == enabled and outputs == (mind.outputs and not mind.hung):
                received.add(mind)
        self._unfinished = {mind.state for mind in received}
        self._watch_dacs(at)
        minds = set()
        status, goals, armed = self._statuses.get(at), [0] * CHANNELS, False
        for mind in received:
            for then, driven in self._look(mind, at, pressed, clock):
                if status is not None:
                    then = self._told(then, status, at)
                    if then is None:
                        continue
                if driven:
                    armed = True
                    if mind.goal >= 0:
                        goals = [max(pair) for pair in zip(goals, trace.frames[mind.goal].values["pressures"], strict=True)]
                minds.update(self._send(then, at))
        self.goals.append(goals)
        self.could_arm.append(armed)
        if status is not None:
            self._note(at, status, minds)
        return minds

    def _after_hang(self, at: int) -> set[Mind]:
        if not self.trace.hangs or not at:
            return self.minds
        cycles = self.trace.records["cycle"]
        begin = max(int(cycles[at - 1]), self.trace.boots[self.trace.boot[at]].zero)  # nothing hangs before the clock begins
        may, must = self._hung(begin, int(cycles[at]))
        if not may:
            return self.minds
        return {mind._replace(hung=True) for mind in self.minds} | (set() if must else self.minds)

    def _look(self, mind: Mind, at: int, pressed: bool, clock: int) -> Iterator[tuple[Mind, bool]]:
        """What may be after a pass has looked at its inputs; whether it has driven the regulators as an armed robot's."""
        if pressed and mind.state != State.ESTOP:
            mind = mind.stopped()
        if mind.hung:
            mind = mind.failed(Fault.LOOP_HUNG)
        may, must = self.causes.may[at], self.causes.must[at]
        if clock > TRAVEL_MS:
            may = {**may, Fault.TRAVEL: set(range(CHANNELS))}
        minds = {mind}
        if self.delay > 1:
            cycle = int(self.trace.records[at]["cycle"])
            if self._bus_doubtful(cycle):
                minds |= {mind.failed(Fault.BUS) for mind in minds}
            if self._bus_wrong(cycle, 45):
                minds = {mind for mind in minds if mind.faults & Fault.BUS.bit}
        minds = {mind.left(State.HOST_TIMEOUT) if mind.state == State.ARMED and clock - mind.heard > TIMEOUT_MS else mind for mind in minds}
        for fault in may:
            if fault >= Fault.MONITOR:
                minds |= {mind.failed(fault) for mind in minds}
            self.suspects.setdefault(fault, set()).update(may[fault])
        for fault, longest in must.items():
            if at - self._last_clear >= longest:
                minds = {mind for mind in minds if mind.faults & fault.bit}
        tired = self.causes.armed[at]
        for mind in minds:
            driven = mind.state == State.ARMED
            if not (driven and tired and at - mind.armed >= tired):
                yield mind, driven
            if driven:
                found = {mind}
                for fault in may:
                    if fault < Fault.MONITOR:
                        found |= {then.failed(fault) for then in found if then.state == State.ARMED}
                for then in found - {mind}:
                    yield then, driven

    # ---------------------------------------------------------------- what is seen

    def _told(self, mind: Mind, status: Heard, at: int) -> Mind | None:
        """What a STATUS leaves of it."""
        values = status.values
        enabled = values["enabled"] & ~protocol.POSITION_MODE
        if (values["state"], values["faults"], values["sequence"]) != (mind.state, mind.faults, mind.sequence & 0xFFFF):
            return None
        if enabled != mind.enabled or mind.session not in (-1, values["session"]):
            return None
        counters = {"good": 0xFFFF, "bad": 0xFFFF, "refused": 0xFF, "stale": 0xFF}
        for name, mask in counters.items():
            known = getattr(mind, name)
            if known >= 0 and known & mask != values[name]:
                return None
        return mind._replace(session=values["session"], **{name: values[name] for name in counters if getattr(mind, name) < 0})

    def _note(self, at: int, status: Heard, minds: set[Mind]) -> None:
        values = status.values
        self.story.append(f"{at}: {values}")
        if not minds:
            return
        gravest = max((fault for fault in Fault if values["faults"] & fault.bit), default=Fault.NONE)
        if values["fault"] != gravest:
            self._fail(at, f"{Fault(values['fault']).name} is not the gravest of {values['faults']:#x}")
        if gravest in self.suspects and values["channel"] not in self.suspects[gravest]:
            self._fail(at, f"{gravest.name} of channel {values['channel']}, but {self.suspects[gravest]} had cause")
        self._new_session(at, values["session"])

    def _new_session(self, at: int, session: int) -> None:
        upper = session >> 16
        if upper != self.upper:
            boots = self.trace.boot[at]
            if session in self.sessions or (self.upper >= 0 and not 0 < (upper - self.upper) & 0xFFFF <= boots):
                self._fail(at, f"session {session:#x} after {self.upper:#x}")
            self.upper = upper

    def _send(self, mind: Mind, at: int) -> Iterator[Mind]:
        """What may be after an answer was put together, if there is one to give."""
        ack = self._acks[mind.answer] if mind.answer < len(self._acks) else None
        if (ack is None or ack.record > at) and (mind.pending < 0 or at - mind.pending < 2 * ANSWER_WINDOW):  # it is not too late yet
            yield mind
        if ack is None or mind.pending < 0 or not ack.record - ANSWER_WINDOW <= at <= ack.record:
            return
        values, told = ack.values, (mind.last[0], mind.last[1], mind.result, mind.state)
        if self.trace.boot[ack.record] != self.trace.boot[at] or told != tuple(
            values[name] for name in ("request", "id", "result", "state")
        ):
            return
        same_boot = self.trace.boot[ack.record] == self.trace.boot[at]
        if same_boot and values["channel"] in mind.channels and mind.session in (-1, values["session"]):
            yield mind._replace(session=values["session"], answer=mind.answer + 1, pending=-1)

    def _watch_dacs(self, at: int) -> None:
        """No pressure rises but on its way to a set point of an armed robot."""
        trace = self.trace
        if not at or trace.records[at - 1]["kind"]:
            return
        before, now = trace.records[at - 1]["dac"], trace.records[at]["dac"]
        doubtful = self._bus_doubtful(int(trace.records[at]["cycle"]))  # then what was written may be late
        for k in (now > before).nonzero()[0]:
            most = max(goals[k] for goals in self.goals[-(LATE_WRITE if doubtful else self.delay) :])
            if now[k] > most or int(now[k]) - int(before[k]) > RISE * (LATE_WRITE / 6 if doubtful else 1):
                self._fail(at, f"DAC {k} rises from {before[k]} to {now[k]} on its way to {most}")
