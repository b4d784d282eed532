"""Moving one actuator by itself, for jogging and calibrating: slowly there, steady, slowly back. All others stay at 0, their motors off."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.hw.board.calibration import Calibration
from tepm_opt.hw.board.rig import SerialRig
from tepm_opt.hw.ramp import smooth_ramp, smooth_step
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot

RISE, HELD = 0.4, 0.2
"""Shares of a jog's time: on the way there, as on the way back, and held."""
FULL_RANGE, SHORTEST = 6.0, 0.5
"""Seconds in which a glide covers the full range, and the least that one takes."""
WINDOW, STEADY_PA = 0.5, 1e3
"""A regulator has settled when its monitor's means over two such times in s differ by less than this in Pa."""
KEEP = 0.02
"""Seconds between set points while a person is waited for."""


@dataclass(frozen=True, eq=False)
class Single:
    """One actuator's set points.

    Attributes:
        robot: whose.
        actuator: its index.
        tension: whether its tendon is pulled (N); else its pressure is set (Pa).
    """

    robot: Robot
    actuator: int
    tension: bool = False

    @property
    def name(self) -> str:
        """Name of the actuator."""
        return Layout.from_robot(self.robot).actuator_names[self.actuator]

    @property
    def most(self) -> float:
        """The largest value, in Pa or N."""
        actuation = self.robot.actuation
        return actuation.tension_max_N if self.tension else actuation.pressure_max_Pa

    def command(self, value: float) -> Command:
        """A value in Pa or N for it, nothing for all others."""
        count = self.robot.modules * self.robot.actuators
        alone = np.zeros(count)
        alone[self.actuator] = value
        nothing, off = np.zeros(count), np.zeros(count, dtype=bool)
        return Command(nothing, alone, alone > 0) if self.tension else Command(alone, nothing, off)

    def read_measured(self, sample: Sample) -> float:
        """Read its measured value from a sample in Pa or N; NaN where nothing was measured."""
        values = sample.tensions if self.tension else sample.pressures
        return float("nan") if values is None else float(values[self.actuator])

    def refuse(self, value: float, rig: SerialRig) -> None:
        """Refuse a value that the robot or its firmware does not allow, before anything moves.

        Raises:
            InputError: naming the limit.
        """
        calibration, command = Calibration.from_robot(self.robot), self.command(value)
        calibration.to_codes(command.pressures, rig.limits.pressure_max)
        calibration.to_counts(command.tensions, rig.limits.tension_max)


def refuse_outside(value: float, most: float, name: str, unit: str) -> None:
    """Refuse a value that is not within 0 … most.

    Args:
        value: asked for.
        most: the limit in the same unit.
        name: of the option.
        unit: for the message.

    Raises:
        InputError: it is not.
    """
    if not 0 < value <= most * (1 + 1e-9):
        raise InputError(f"{name} {value:g}; valid: more than 0, at most {most:g} {unit}")


def profile(part: float) -> float:
    """Share of the value at a share of the time of a jog: smoothly up, held, smoothly down."""
    return smooth_step(min(part, 1.0 - part) / RISE)


def jog(rig: SerialRig, single: Single, value: float, seconds: float) -> Iterator[tuple[float, float, Sample]]:
    """Take one actuator to a value and back.

    Args:
        rig: armed or to be armed by this.
        single: the actuator.
        value: to go to, in Pa or N.
        seconds: there and back.

    Yields:
        At every sample the time in s, what is commanded in Pa or N, and the sample.

    Raises:
        LinkError: the board stopped by itself, or the line is gone.
    """
    begin = rig.time
    while (now := rig.time - begin) < seconds:
        commanded = value * profile(now / seconds)
        rig.apply(single.command(commanded))
        yield now, commanded, rig.read()
    rig.apply(single.command(0.0))


def is_held(now: float, seconds: float) -> bool:
    """Whether a jog of `seconds` s is held at a time in s since its begin."""
    return RISE <= now / seconds <= RISE + HELD


def glide(rig: SerialRig, single: Single, start: float, end: float) -> None:
    """Take one actuator from a value to another, smoothly.

    Args:
        rig: armed or to be armed by this.
        single: the actuator.
        start, end: in Pa or N.
    """
    seconds = max(SHORTEST, FULL_RANGE * abs(end - start) / single.most)
    for _, share in smooth_ramp(lambda: rig.time, seconds):
        rig.apply(single.command(start + (end - start) * share))
        rig.read()


def settle(rig: SerialRig, single: Single, value: float, least: float = 1.0, most: float = 15.0) -> bool:
    """Hold a value until the pressure measured is steady; whether it is.

    Args:
        rig: armed or to be armed by this.
        single: the actuator.
        value: to hold, in Pa.
        least, most: seconds for which it is held at least and at most.
    """
    begin, taken = rig.time, []
    while (now := rig.time - begin) < most:
        rig.apply(single.command(value))
        taken.append((now, single.read_measured(rig.read())))
        times, values = np.array(taken).T
        new, old = values[times > now - WINDOW], values[(times > now - 2 * WINDOW) & (times <= now - WINDOW)]
        if now >= max(least, 2 * WINDOW) and len(old) and abs(np.nanmean(new) - np.nanmean(old)) < STEADY_PA:
            return True
    return False


def monitors(rig: SerialRig, single: Single, value: float, seconds: float) -> np.ndarray:
    """Counts of all monitors while a value is held, (samples, 6).

    Args:
        rig: armed or to be armed by this.
        single: the actuator.
        value: to hold, in Pa or N.
        seconds: for which it is held.
    """
    begin, taken = rig.time, []
    while rig.time - begin < seconds:
        rig.apply(single.command(value))
        rig.read()
        taken.append(rig.board.monitors)
    return np.array(taken)


@contextmanager
def keep_sending(rig: SerialRig, command: Command, threaded: bool = True) -> Iterator[None]:
    """Send a command again and again while a person is waited for; a thread does that, so not where time is virtual.

    Raises:
        LinkError: in the end, if the board stopped meanwhile.
    """
    done, failed = threading.Event(), list[Exception]()

    def keep() -> None:
        while not done.is_set():
            try:
                rig.apply(command)
            except Exception as error:
                failed.append(error)
                return
            time.sleep(KEEP)

    keeper = threading.Thread(target=keep, name="keeper", daemon=True)
    if threaded:
        keeper.start()
    try:
        yield
    finally:
        done.set()
        if threaded:
            keeper.join()
    if failed:
        raise failed[0]
