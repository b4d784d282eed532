"""Calibration lines from measured pairs, and how they are written into a robot file. Nothing here asks anybody or moves anything."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from pydantic import ValidationError

from tepm_opt.data.documents import explain
from tepm_opt.errors import InputError
from tepm_opt.hw.board.errors import LinkError
from tepm_opt.hw.board.link import Link
from tepm_opt.hw.board.protocol import DAC_CODES
from tepm_opt.hw.board.status import BoardStatus
from tepm_opt.models.hardware import COUNTS_PER_V, Hardware, PressureLines, TensionLines
from tepm_opt.models.robot import Robot

if TYPE_CHECKING:
    from tepm_opt.hw.service.registration import Registration

STANDARD_GRAVITY = 9.80665
"""m/s²: a mass of 1 g pulls with 9.80665 mN."""
UNDERWAY = 0.2
"""Seconds in which what was measured before may still come, and a hand lets go."""
OTHER_SHARE = 3.0
"""So many times the change of the named sensor on another one means that they are mixed up."""


@dataclass(frozen=True, eq=False)
class CalibrationFit:
    """A least-squares line y = zero + slope · x.

    Attributes:
        zero, slope: in the units of y, and of y a unit of x.
        zero_std, slope_std: their standard deviations from the residuals; NaN with two points.
        residuals: measured less line, (points,) in the units of y.
    """

    zero: float
    slope: float
    zero_std: float
    slope_std: float
    residuals: np.ndarray

    def __repr__(self) -> str:
        return f"CalibrationFit(y = {self.zero:.6g} + {self.slope:.6g} x, rms {self.rms:.3g}, {len(self.residuals)} points)"

    @property
    def rms(self) -> float:
        """Root mean square of the residuals in the units of y."""
        return float(np.sqrt((self.residuals**2).mean()))

    @property
    def rms_x(self) -> float:
        """Root mean square of the residuals in the units of x."""
        return self.rms / abs(self.slope) if self.slope else np.inf


def fit_line(x: Sequence[float] | np.ndarray, y: Sequence[float] | np.ndarray) -> CalibrationFit:
    """The line through points (x, y).

    Raises:
        InputError: fewer than two different x.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if len(np.unique(x)) < 2:
        raise InputError(f"calibration: values {', '.join(f'{value:g}' for value in x)}; valid: at least two different ones")
    columns = np.stack([np.ones_like(x), x], axis=1)
    solution = np.linalg.lstsq(columns, y, rcond=None)[0]
    residuals = y - columns @ solution
    free = len(x) - 2
    covariance = np.linalg.inv(columns.T @ columns) * ((residuals**2).sum() / free if free else np.nan)
    zero_std, slope_std = np.sqrt(np.diag(covariance))
    return CalibrationFit(float(solution[0]), float(solution[1]), float(zero_std), float(slope_std), residuals)


def parse_increasing(text: str, name: str, least: float, most: float, unit: str) -> list[float]:
    """Parse the numbers of an option, at least two, each larger than the one before.

    Args:
        text: numbers by commas.
        name: of the option.
        least, most: of the numbers, in `unit`.
        unit: for the message.

    Raises:
        InputError: they are not.
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    good = len(values) >= 2 and values[0] >= least and values[-1] <= most and all(a < b for a, b in pairwise(values))
    if not good:
        raise InputError(f"{name} {text!r}; valid: at least two numbers by commas, increasing, within {least:g} … {most:g} {unit}")
    return values


@dataclass(frozen=True, eq=False)
class Counts:
    """Raw counts that a board told over some time.

    Attributes:
        dynamometers, monitors: counts, (samples, 6).
    """

    dynamometers: np.ndarray
    monitors: np.ndarray

    def __repr__(self) -> str:
        return f"Counts({len(self.dynamometers)} samples)"


def collect(link: Link, seconds: float) -> Counts:
    """Every STATUS of some time from now on.

    Raises:
        LinkError: the line is gone, or the board is silent.
    """
    link.wait(lambda: False, UNDERWAY)
    taken: list[BoardStatus] = []
    last = link.status
    begin = None

    def news() -> bool:
        return link.status is not None and link.status is not last

    while begin is None or taken[-1].time - begin < seconds:
        if not link.wait(news, 1.0) or link.status is None:
            raise LinkError("the board is silent")
        last = link.status
        taken.append(last)
        begin = last.time if begin is None else begin
    return Counts(np.array([status.dynamometers for status in taken]), np.array([status.monitors for status in taken]))


def refuse_mixed_up(change: np.ndarray, actuator: int, names: Sequence[str], what: str) -> None:
    """Refuse where another sensor changed and the named one did not.

    Args:
        change: of each sensor, (actuators,) in counts.
        actuator: index of the one that was pulled or filled.
        names: of all actuators.
        what: kind of the sensor, for the message.

    Raises:
        InputError: naming the other one.
    """
    change = np.abs(change[: len(names)])
    other = int(np.argmax(change))
    if other != actuator and change[other] > OTHER_SHARE * change[actuator] and change[other] > 100:
        raise InputError(
            f"{what} {names[actuator]} changed by {change[actuator]:.0f} counts, {names[other]} by {change[other]:.0f}: wires mixed up, "
            f"or the wrong actuator; valid: that only {names[actuator]} changes"
        )


# ---------------------------------------------------------------- for robot files


def with_value(value: float | tuple[float, ...], count: int, found: dict[int, float]) -> list[float]:
    """A list with a value for each of `count` actuators: those found, and for the others what the robot file has."""
    values = Hardware.of_each(value, count)
    for actuator, new in found.items():
        values[actuator] = new
    return [float(f"{each:.7g}") for each in values]


def tension_part(robot: Robot, lines: dict[int, CalibrationFit]) -> dict[str, list[float]]:
    """Keys of `[hardware.tension]` from lines of counts over N by actuator.

    Raises:
        InputError: a line that no dynamometer has.
    """
    tension, count = _hardware(robot).tension, robot.modules * robot.actuators
    part = {
        "zero_counts": with_value(tension.zero_counts, count, {k: line.zero for k, line in lines.items()}),
        "counts_per_N": with_value(tension.counts_per_N, count, {k: line.slope for k, line in lines.items()}),
    }
    _check(TensionLines, part, "did the weight pull at this dynamometer?")
    return part


def pressure_part(robot: Robot, monitors: dict[int, CalibrationFit], commands: dict[int, CalibrationFit]) -> dict[str, list[float]]:
    """Keys of `[hardware.pressure]` from lines of the monitors' and, if there are any, commands' volts over MPa by actuator.

    Raises:
        InputError: a line that no regulator has.
    """
    pressure, count = _hardware(robot).pressure, robot.modules * robot.actuators
    part = {}
    if commands:
        part["zero_V"] = with_value(pressure.zero_V, count, {k: line.zero for k, line in commands.items()})
        part["V_per_MPa"] = with_value(pressure.V_per_MPa, count, {k: line.slope for k, line in commands.items()})
    part["monitor_zero_V"] = with_value(pressure.monitor_zero_V, count, {k: line.zero for k, line in monitors.items()})
    part["monitor_V_per_MPa"] = with_value(pressure.monitor_V_per_MPa, count, {k: line.slope for k, line in monitors.items()})
    _check(PressureLines, part, "is the air on and the regulator fed?")
    return part


def mount_part(found: Registration) -> dict[str, list[float]]:
    """Keys of `[mount]`."""
    return {"base_position_m": _round_values(found.position_m), "base_rotation_deg": _round_values(found.rotation_deg)}


def holders_part(found: Registration) -> dict[str, list[list[float]]]:
    """Keys of `[hardware.tracker]`."""
    return {"holders_m": [_round_values(holder) for holder in found.holders_m]}


def snippet(parts: dict[str, dict[str, list]], notes: Sequence[str]) -> str:
    """Tables of a robot file as text, with notes as comments before."""
    lines = [f"# {note}" for note in notes]
    for name, part in parts.items():
        lines += ["", f"[{name}]", *(f"{key} = {value!r}" for key, value in part.items())]
    return "\n".join([*lines, ""])


def command_volts(robot: Robot, actuator: int, code: int) -> float:
    """Volts that a regulator gets for a DAC code."""
    full = Hardware.of_each(_hardware(robot).pressure.dac_full_scale_V, robot.modules * robot.actuators)
    return float(code / DAC_CODES * full[actuator])


def monitor_volts(counts: np.ndarray) -> np.ndarray:
    """Volts of a monitor for counts of the converter, in the shape of `counts`."""
    return np.asarray(counts) / COUNTS_PER_V


def _hardware(robot: Robot) -> Hardware:
    if robot.hardware is None:
        raise InputError(f"robot {robot.name}: the file has no [hardware] part, which says how the electronics are calibrated")
    return robot.hardware


def _check(model: type[TensionLines] | type[PressureLines], part: dict[str, list[float]], question: str) -> None:
    try:
        model.model_validate({key: tuple(value) for key, value in part.items()})
    except ValidationError as failure:
        raise InputError(f"calibration: {explain(model, failure)[0]}; {question}") from failure


def _round_values(values: np.ndarray) -> list[float]:
    return [round(float(value), 6) + 0.0 for value in values]
