"""What the sensors showed, pass by pass, and which faults that may and must have caused, whatever the board did about it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tepm_opt.hw.board.limits import Limits
from tepm_opt.hw.board.protocol import Fault
from tepm_opt.models.robot import load_robot
from tests.hw.emulator import CHANNELS, HZ

LIMITS = Limits.from_robot(load_robot("kang2017"))
DYNAMOMETER_HIGH = 31130
JUMP = 2500
"""Counts between two samples that may be taken for a loose contact."""
ROUND = 13
"""Passes in which the processor's own converter has seen all monitors."""
NOISE = 50
"""Counts by which what it shows may be off."""
MOTORS_MS, LOOSE_MS, MONITOR_MS, REGULATOR_MS = 10, 30, 70, 1600
"""How long something has to be wrong until the board must have noticed: dead or too high dynamometers, loose ones, monitors, regulators."""
HISTORY = 40


def run_lengths(wrong: np.ndarray, before: np.ndarray) -> np.ndarray:
    """For how many passes without a break, by now, each channel has been wrong: (passes, channels).

    Args:
        wrong: (passes, channels).
        before: the last row of the passes before.
    """
    index = np.arange(1, len(wrong) + 1)[:, None]
    broken = np.maximum.accumulate(np.where(wrong, 0, index), axis=0)
    return np.where(broken > 0, index - broken, index + before)


@dataclass
class Causes:
    """Of passes of one boot after the other; `add` takes them in turn.

    Attributes:
        may: of each record, faults that the board may find in it, with the channels.
        armed: of each record, for how many passes the robot must have been armed at least for the board to have switched it off.
        must: of each record, faults that the board must have found by now unless it was cleared for so many passes.
        fine, disordered: of each record and channel, whether a monitor is surely in order, or surely not.
        dead: of each record, channels whose dynamometer shows nothing sensible.
    """

    may: list[dict[Fault, set[int]]] = field(default_factory=list)
    armed: list[int] = field(default_factory=list)
    must: list[dict[Fault, int]] = field(default_factory=list)
    fine: list[np.ndarray] = field(default_factory=list)
    disordered: list[np.ndarray] = field(default_factory=list)
    dead: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """A new boot: nothing has been seen."""
        self._dynamometers = np.zeros((HISTORY, CHANNELS), dtype=int)
        self._monitors = np.zeros((HISTORY, CHANNELS), dtype=int)
        self._dacs = np.zeros((HISTORY, CHANNELS), dtype=int)
        self._runs = {name: np.zeros(CHANNELS, dtype=int) for name in ("dead", "high", "over", "low", "off")}
        self._gaps: list[int] = []
        self._last = -1
        self._held = np.zeros(CHANNELS, dtype=bool)
        self._levels = {fault: np.zeros(CHANNELS) for fault in (Fault.PRESSURE_TOO_HIGH, Fault.MONITOR, Fault.REGULATOR)}

    def skip(self) -> None:
        """A record that is a reset."""
        self.reset()
        nothing = np.zeros(CHANNELS, dtype=bool)
        self._note({}, 0, {}, (nothing, nothing, ~nothing))

    def _note(self, may: dict[Fault, set[int]], armed: int, must: dict[Fault, int], sensors: tuple[np.ndarray, ...]) -> None:
        self.may.append(may)
        self.armed.append(armed)
        self.must.append(must)
        self.fine.append(sensors[0])
        self.disordered.append(sensors[1])
        self.dead.append(sensors[2])

    def add(self, records: np.ndarray, delay: int) -> None:
        """Passes of one boot.

        Args:
            records: as of `Board.passes`.
            delay: passes until a DAC has what the firmware wrote.
        """
        count = len(records)
        cycles = records["cycle"].astype(int)
        since = np.diff(cycles, prepend=cycles[0] - HZ // 1000 if self._last < 0 else self._last)
        gaps = [*self._gaps, *np.ceil(since / (HZ / 1000) - 0.5).astype(int).tolist()]
        self._last, self._gaps = int(cycles[-1]), gaps[-ROUND:]
        dyn = np.concatenate([self._dynamometers, records["dynamometers"].astype(int)])
        mon = np.concatenate([self._monitors, records["monitors"].astype(int)])
        dac = np.concatenate([self._dacs, records["dac"].astype(int)])
        self._dynamometers, self._monitors, self._dacs = dyn[-HISTORY:], mon[-HISTORY:], dac[-HISTORY:]

        dead = (dyn < LIMITS.dynamometer_low) | (dyn > DYNAMOMETER_HIGH)
        lost = dead | (np.abs(np.diff(dyn, axis=0, prepend=dyn[:1])) > JUMP)
        high = dyn > LIMITS.tension_trip
        may_dead = _moving(lost, 20, count) >= 4
        loose = _moving(dead, LOOSE_MS, count) >= LOOSE_MS // 2
        pairs = ~(lost | high)
        calm = pairs[HISTORY:] & pairs[HISTORY - 1 : -1]
        steady = high & ~lost

        low, top = _extremes(mon, ROUND, count)
        code_low, code_top = _extremes(dac, delay + 2, count)
        over_may, over_must = top + NOISE > LIMITS.monitor_trip, low - NOISE > LIMITS.monitor_trip
        low_may, low_must = low - NOISE < LIMITS.monitor_low, top + NOISE < LIMITS.monitor_low
        counts = LIMITS.monitor_per_code / 256
        most, least = top + NOISE - LIMITS.monitor_zero - counts * code_low, low - NOISE - LIMITS.monitor_zero - counts * code_top
        off_may = (most > LIMITS.regulator_band) | (least < -LIMITS.regulator_band)
        off_must = (least > LIMITS.regulator_band) | (most < -LIMITS.regulator_band)

        now, code = mon[HISTORY:], dac[HISTORY:]
        off_now = np.abs(now - LIMITS.monitor_zero - counts * code) > LIMITS.regulator_band + NOISE
        runs = {
            "dead": run_lengths(dead[HISTORY:], self._runs["dead"]),
            "high": run_lengths(steady[HISTORY:], self._runs["high"]),
            "over": run_lengths(now > LIMITS.monitor_trip + NOISE, self._runs["over"]),
            "low": run_lengths(now < LIMITS.monitor_low - NOISE, self._runs["low"]),
            "off": run_lengths(off_now, self._runs["off"]),
        }
        self._runs = {name: values[-1] for name, values in runs.items()}
        quiet = not (
            may_dead.any() or high[HISTORY:].any() or self._held.any() or over_may.any() or low_may.any() or off_may.any() or lost.any()
        )
        fine, disordered = ~(over_may | low_may | off_may), over_must | low_must | off_must
        if quiet and not any(level.any() for level in self._levels.values()):
            for n in range(count):
                self._note({}, 0, {}, (fine[n], disordered[n], dead[HISTORY + n]))
            return
        for n in range(count):
            may: dict[Fault, set[int]] = {}
            gap = max(gaps[max(len(gaps) - count + n - ROUND, 0) : len(gaps) - count + n + 1])  # ms for which one look at a monitor counts
            self._held = (self._held & ~calm[n]) | high[HISTORY + n]
            if self._held.any():
                may[Fault.TENSION_TOO_HIGH] = set(np.flatnonzero(self._held).tolist())
            if may_dead[n].any():
                may[Fault.DYNAMOMETER] = set(np.flatnonzero(may_dead[n]).tolist())
            for fault, wrong, rise, enough, most_of in (
                (Fault.PRESSURE_TOO_HIGH, over_may, 4, 150, 230),
                (Fault.MONITOR, low_may, 4, 150, 230),
                (Fault.REGULATOR, off_may, 1, 1400, 1520),
            ):
                level = self._levels[fault]
                level[:] = np.clip(np.where(wrong[n], level + rise * gap, level - 1), 0, most_of)
                if (level >= enough).any():
                    may[fault] = set(np.flatnonzero(level >= enough).tolist())
            armed = 0
            if loose[n].any():
                armed = LOOSE_MS
            if max(runs["dead"][n].max(), runs["high"][n].max()) >= MOTORS_MS:
                armed = MOTORS_MS
            must = {
                fault: longest
                for fault, name, longest in (
                    (Fault.PRESSURE_TOO_HIGH, "over", MONITOR_MS),
                    (Fault.MONITOR, "low", MONITOR_MS),
                    (Fault.REGULATOR, "off", REGULATOR_MS),
                )
                if runs[name][n].max() >= longest
            }
            self._note(may, armed, must, (fine[n], disordered[n], dead[HISTORY + n]))


def _moving(values: np.ndarray, width: int, count: int) -> np.ndarray:
    """How many of the last `width` are true, for each of the last `count` rows."""
    sums = np.concatenate([np.zeros((1, values.shape[1]), dtype=int), np.cumsum(values, axis=0)])
    ends = np.arange(len(values) - count + 1, len(values) + 1)
    return sums[ends] - sums[np.maximum(ends - width, 0)]


def _extremes(values: np.ndarray, width: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The smallest and largest of the last `width`, for each of the last `count` rows."""
    windows = np.lib.stride_tricks.sliding_window_view(values, width, axis=0)[-count:]
    return windows.min(axis=-1), windows.max(axis=-1)
