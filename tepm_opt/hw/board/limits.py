"""The numbers that firmware and robot file have to agree about. `firmware/limits.h` is written from a robot file with them.

The board compares in its own units and knows no calibration but this one; a host whose robot file says anything else can neither trust
the board's limits nor be trusted with its own. So both refuse to arm: `tepm hw limits ROBOT` writes the header, flashing mends it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.calibration import Calibration
from tepm_opt.models.robot import Robot

PRESSURE_TRIP, TENSION_TRIP = 1.10, 1.05
"""Measured pressures and tensions beyond the largest set point times this are a fault."""
REGULATOR_BAND_PA = 0.1e6
"""A monitor that is further from its set point for long is a fault."""


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
    def of(robot: Robot) -> Limits:
        """Limits that a robot file asks for.

        Raises:
            InputError: as for `Calibration.of`; or a number that the board cannot hold.
        """
        lines, pressure, tension = Calibration.of(robot), robot.actuation.pressure_max_Pa, robot.actuation.tension_max_N
        largest_codes = lines.codes_zero + lines.codes * pressure
        monitor_per_code, tension_zero = lines.monitor / lines.codes, lines.counts_zero
        values = {
            "code_zero": round(np.median(lines.codes_zero)),
            "codes_per_MPa": round(1e6 * np.median(lines.codes)),
            "pressure_max": int(np.min(largest_codes) + 1e-6),
            "monitor_zero": round(np.median(lines.monitor_zero)),
            "monitor_per_code": round(256 * np.median(monitor_per_code)),
            "monitor_low": max(0, int(np.min(lines.monitor_zero) / 2)),
            "monitor_trip": int(np.min(lines.monitor_zero + lines.monitor * PRESSURE_TRIP * pressure)),
            "regulator_band": int(REGULATOR_BAND_PA * np.median(lines.monitor)),
            "tension_zero": round(np.median(tension_zero)),
            "tension_max": round(np.min(tension_zero + lines.counts * tension)),
            "tension_trip": round(np.min(tension_zero + lines.counts * TENSION_TRIP * tension)),
            "dynamometer_low": int(np.min(tension_zero) / 2),
            "position_max": round(np.min(lines.steps * tension)),
            "steps_per_1000_counts": round(1e3 * np.min(lines.steps / lines.counts)),
        }
        for name, kind in protocol.LIMITS.fields:
            low, high = (-0x8000, 0x7FFF) if kind == "h" else (0, 0xFFFF)
            if not low <= values[name] <= high:
                raise InputError(f"robot {robot.name}: {name} = {values[name]} of the board; valid: {low} … {high}. See [hardware]")
        return Limits(**values)

    def payload(self) -> bytes:
        """Payload of the message with which the board tells them."""
        return protocol.LIMITS.pack(**asdict(self))

    @property
    def check(self) -> int:
        """Their CRC."""
        return protocol.crc(self.payload())

    def differences(self, firmware: Limits) -> list[str]:
        """What another set of them says otherwise, number by number, for people."""
        mine, other = asdict(self), asdict(firmware)
        return [f"{name} is {other[name]} in the firmware, {mine[name]} by the robot file" for name in mine if mine[name] != other[name]]

    def header(self, robot: str) -> str:
        """The C++ header for the firmware.

        Args:
            robot: name of the robot that they are for.
        """
        meanings = _meanings()
        lines = [
            f"// Limits and calibration of robot {robot}, which host and board compare. Written by `tepm hw limits`; do not edit.",
            "#pragma once",
            '#include "protocol.h"',
            "",
            "constexpr protocol::Limits LIMITS = {",
            "    protocol::Limits::CODE,",
            *(f"    {value},  // {name}: {meanings.get(name, '')}" for name, value in asdict(self).items()),
            "};",
        ]
        return "\n".join([*lines, ""])


def _meanings() -> dict[str, str]:
    attributes = (Limits.__doc__ or "").partition("Attributes:")[2].splitlines()
    return {name: text for name, _, text in (line.strip().rstrip(".").partition(": ") for line in attributes)}


def told(values: dict[str, Any]) -> Limits:
    """Limits that a board told in a LIMITS message."""
    return Limits(**values)
