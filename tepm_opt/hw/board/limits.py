"""The numbers that firmware and robot file have to agree about. `firmware/limits.h` is written from a robot file with them.

The board compares in its own units and knows no calibration but this one; a host whose robot file says anything else can neither trust
the board's limits nor be trusted with its own. So both refuse to arm: `tepm hw limits ROBOT` writes the header, flashing mends it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.hw.board import protocol
from tepm_opt.models.hardware import COUNTS_PER_V

if TYPE_CHECKING:
    from tepm_opt.hw.board.calibration import Calibration
    from tepm_opt.models.robot import Robot

PRESSURE_TRIP, TENSION_TRIP = 1.10, 1.05
"""Measured pressures and tensions beyond the largest set point times this are a fault."""
REGULATOR_BAND_PA, OFF_LINE_PA = 0.1e6, 0.04e6
"""A monitor that is further from its set point for long is a fault; and how far a regulator's own lines may be from the common ones."""
LIVE_ZERO = 1638
"""Counts (0.25 V) from which on a sensor's zero can be told from a broken wire."""
LOUD = 0.8
"""The threshold of a broken wire is at most this part of any sensor's zero."""
TITLE = "// Limits and calibration of robot "
"""Beginning of the header."""
RANGES = {
    "code_zero": (-0x2000, 4094, "the DAC ends there"),
    "codes_per_MPa": (1, 0xFFFF, "the DAC's codes a MPa"),
    "pressure_max": (1, 4095, "the DAC ends there; see actuation.pressure_max_Pa, hardware.pressure.dac_full_scale_V"),
    "monitor_zero": (0, 0x7FDF, "the converter ends at 5 V"),
    "monitor_per_code": (1, 0xFFFF, "1/256 counts a code"),
    "monitor_trip": (1, 0x7FDF, "the converter ends at 5 V, which 1.1 times actuation.pressure_max_Pa exceeds"),
    "regulator_band": (1, 0x7FFF, "the converter ends at 5 V"),
    "tension_zero": (LIVE_ZERO, 0x7FFF, "0.25 … 5 V without tension, so that a broken wire is not taken for a slack tendon"),
    "tension_max": (1000, 31128, "the dynamometers end at 4.75 V"),
    "tension_trip": (1000, 31129, "the dynamometers end at 4.75 V, which 1.05 times actuation.tension_max_N exceeds"),
    "position_max": (1, 29999, "a motor that winds further is stopped"),
    "steps_per_1000_counts": (1, 900, "the gain of the board's tension loop"),
}
"""Ranges that the firmware can hold or compiles, and why; as in its `config.h`."""


@dataclass(frozen=True)
class Limits:
    """Limits and calibration in the board's units. Where actuators differ a limit is that of the most restricted one.

    Attributes:
        code_zero: DAC code at no pressure.
        codes_per_MPa: DAC codes a MPa.
        pressure_max: DAC code of the largest pressure.
        monitor_zero: counts of a monitor at no pressure.
        monitor_per_code: 1/256 counts of a monitor a DAC code.
        monitor_low: counts of a monitor below which it is broken; 0 where it has no live zero.
        monitor_trip: counts of a monitor that no pressure may exceed.
        regulator_band: counts by which a monitor may be off its set point.
        tension_zero: counts of a dynamometer without tension.
        tension_max: counts of a dynamometer at the largest tension.
        tension_trip: counts of a dynamometer that no tension may exceed.
        dynamometer_low: counts of a dynamometer below which it is broken.
        position_max: steps of a motor at the largest tension, in position mode.
        steps_per_1000_counts: of a motor for 1000 counts of its dynamometer: the gain of the tension loop.
    """

    code_zero: int
    codes_per_MPa: int
    pressure_max: int
    monitor_zero: int
    monitor_per_code: int
    monitor_low: int
    monitor_trip: int
    regulator_band: int
    tension_zero: int
    tension_max: int
    tension_trip: int
    dynamometer_low: int
    position_max: int
    steps_per_1000_counts: int

    @staticmethod
    def from_robot(robot: Robot) -> Limits:
        """Work out the limits that a robot file asks for.

        Raises:
            InputError: as for `Calibration.from_robot`; a number that the board cannot hold; or actuators that differ too much for one.
        """
        from tepm_opt.hw.board.calibration import Calibration

        lines, pressure, tension = Calibration.from_robot(robot), robot.actuation.pressure_max_Pa, robot.actuation.tension_max_N
        values = {
            "code_zero": round(_middle(lines.codes_zero)),
            "codes_per_MPa": int(1e6 * np.min(lines.codes)),
            "pressure_max": int(np.min(lines.codes_zero + lines.codes * pressure) + 1e-6),
            "monitor_zero": max(round(_middle(lines.monitor_zero)), 0),
            "monitor_per_code": round(256 * _middle(lines.monitor / lines.codes)),
            "monitor_low": int(np.max(lines.monitor_zero) / 2) if np.min(lines.monitor_zero) >= LIVE_ZERO else 0,
            "monitor_trip": int(np.min(lines.monitor_zero + lines.monitor * PRESSURE_TRIP * pressure)),
            "regulator_band": int(REGULATOR_BAND_PA * np.min(lines.monitor)),
            "tension_zero": round(_middle(lines.counts_zero)),
            "tension_max": round(np.min(lines.counts_zero + lines.counts * tension)),
            "tension_trip": round(np.min(lines.counts_zero + lines.counts * TENSION_TRIP * tension)),
            "dynamometer_low": int(np.max(lines.counts_zero) / 2),
            "position_max": round(np.min(lines.steps * tension)),
            "steps_per_1000_counts": round(1e3 * np.min(lines.steps / lines.counts)),
        }
        for name, (low, high, why) in RANGES.items():
            if not low <= values[name] <= high:
                raise InputError(f"robot {robot.name}: {name} of the board = {values[name]}; valid: {low} … {high} ({why})")
        found = Limits(**values)
        return replace(found, regulator_band=_common_band(robot, lines, found))

    def payload(self) -> bytes:
        """Payload of the message with which the board tells them."""
        return protocol.LIMITS.pack(**asdict(self))

    @property
    def check(self) -> int:
        """Their CRC."""
        return protocol.crc(self.payload())

    def header(self, robot: str) -> str:
        """The C++ header for the firmware.

        Args:
            robot: name of the robot that they are for.
        """
        meanings = _meanings()
        lines = [
            f"{TITLE}{' '.join(robot.split())}, which host and board compare. Written by `tepm hw limits`; do not edit.",
            "#pragma once",
            '#include "protocol.h"',
            "",
            "constexpr protocol::Limits LIMITS = {",
            "    protocol::Limits::CODE,",
            *(f"    {value},  // {name}: {meanings.get(name, '')}" for name, value in asdict(self).items()),
            "};",
        ]
        return "\n".join([*lines, ""])


def differences(robot: Robot, firmware: Limits) -> list[str]:
    """List numbers of firmware that differ from those that a robot file asks for, also in the units of the robot file's calibration.

    Raises:
        InputError: as for `Limits.from_robot`.
    """
    from tepm_opt.hw.board.calibration import Calibration

    units, mine, other = _units(Calibration.from_robot(robot)), asdict(Limits.from_robot(robot)), asdict(firmware)

    def format_value(name: str, value: int) -> str:
        return f"{value} ({units[name](value)})" if name in units else str(value)

    return [
        f"{name} is {format_value(name, other[name])} in the firmware, {format_value(name, value)} by the robot file"
        for name, value in mine.items()
        if value != other[name]
    ]


def _middle(values: np.ndarray) -> float:
    return float(np.min(values) + np.max(values)) / 2


def _common_band(robot: Robot, lines: Calibration, limits: Limits) -> int:
    """Counts by which a monitor may be off the common lines, so that none is further than allowed off its own.

    Raises:
        InputError: an actuator's own lines are too far from the common ones.
    """
    from tepm_opt.models.layout import Layout

    codes = np.arange(limits.pressure_max + 1)[:, None]
    own = lines.monitor_zero + lines.monitor / lines.codes * np.maximum(codes - lines.codes_zero, 0)
    zero, slope, first = (_middle(values) for values in (lines.monitor_zero, lines.monitor / lines.codes, lines.codes_zero))
    off = np.abs(max(zero, 0) + slope * np.maximum(codes - first, 0) - own).max(axis=0)
    rounding = 0.5 * limits.monitor_per_code / 256 + 0.5 * protocol.DAC_CODES / 256 + 1.5  # of code_zero, monitor_per_code, the rest
    room = (limits.monitor_trip - own[-1]) / lines.monitor / robot.actuation.pressure_max_Pa
    names, mend = Layout.from_robot(robot).actuator_names, "adjust zero and span at the regulators, or calibrate anew"
    if (off > OFF_LINE_PA * lines.monitor).any():
        worst = int(np.argmax(off / lines.monitor))
        far, most = 1e-3 * off[worst] / lines.monitor[worst], 1e-3 * OFF_LINE_PA
        what = f"regulator {names[worst]} is {far:.0f} kPa off the line that the board has for all of them"
        raise InputError(f"robot {robot.name}: {what}; valid: at most {most:g} kPa. If it is so, {mend}")
    if (room < (PRESSURE_TRIP - 1) / 2).any():
        what = (
            f"the monitor of regulator {names[int(np.argmin(room))]} shows at the largest pressure nearly what another one may not exceed"
        )
        raise InputError(f"robot {robot.name}: {what}; valid: monitors that differ less. If it is so, {mend}")
    for sensor, zeros, low in (
        ("monitors", lines.monitor_zero, limits.monitor_low),
        ("dynamometers", lines.counts_zero, limits.dynamometer_low),
    ):
        if low and (low > LOUD * zeros).any():
            shown = f"{min(zeros) / COUNTS_PER_V:.2f} … {max(zeros) / COUNTS_PER_V:.2f} V"
            raise InputError(
                f"robot {robot.name}: {sensor} show {shown} at zero; valid: voltages that one threshold tells from a broken wire"
            )
    return int(np.min(REGULATOR_BAND_PA * lines.monitor - off) - rounding)


def _units(lines: Calibration) -> dict[str, Callable[[int], str]]:
    """Formatters of numbers in the units of a robot file, by name; each for the actuator that limits the number."""

    def kilopascal(value: float) -> str:
        return f"{1e-3 * value:.4g} kPa"

    def newton(value: float) -> str:
        return f"{value:.4g} N"

    def volt(value: int) -> str:
        return f"{value / COUNTS_PER_V:.3g} V"

    return {
        "pressure_max": lambda value: kilopascal(np.max((value - lines.codes_zero) / lines.codes)),
        "monitor_zero": volt,
        "monitor_low": volt,
        "monitor_trip": lambda value: kilopascal(np.max((value - lines.monitor_zero) / lines.monitor)),
        "regulator_band": lambda value: kilopascal(np.max(value / lines.monitor)),
        "tension_zero": volt,
        "tension_max": lambda value: newton(np.max((value - lines.counts_zero) / lines.counts)),
        "tension_trip": lambda value: newton(np.max((value - lines.counts_zero) / lines.counts)),
        "dynamometer_low": volt,
        "position_max": lambda value: newton(np.max(value / lines.steps)),
    }


def _meanings() -> dict[str, str]:
    attributes = (Limits.__doc__ or "").partition("Attributes:")[2].splitlines()
    return {name: text for name, _, text in (line.strip().rstrip(".").partition(": ") for line in attributes)}
