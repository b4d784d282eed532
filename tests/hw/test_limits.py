"""Numbers that stand in more than one place: the firmware's, the guide's, the robot file's."""

from __future__ import annotations

import re
from pathlib import Path

from tepm_opt.hw.board.limits import Limits
from tepm_opt.models.robot import load_robot
from tests.hw.emulator import FIRMWARE

GUIDE = Path(__file__).parents[2] / "docs" / "safety.md"


def constant(name: str) -> float:
    """A number of `config.h`."""
    found = re.search(rf"constexpr \w+ {name} = ([\d.]+)f?;", (FIRMWARE / "config.h").read_text(encoding="utf-8"))
    assert found, name
    return float(found[1])


def spaced(number: float) -> str:
    """1600000 as 1 600 000."""
    return f"{number:,.0f}".replace(",", " ")


def test_the_guide_has_the_numbers_of_the_firmware() -> None:
    """Ramps, rates and times in docs/safety.md are those that are compiled in."""
    text = GUIDE.read_text(encoding="utf-8")
    for number in (
        f"{constant('STEP_RATE_HZ'):g} steps/s (10 N/s), {spaced(constant('STEP_ACCELERATION_HZ_S'))} steps/s² "
        f"beyond {constant('STEP_START_HZ'):g} steps/s",
        f"{constant('PRESSURE_SLEW_MPA_S'):g} MPa/s",
        f"to zero at {constant('PRESSURE_RAMP_MPA_S'):g} MPa/s",
        f"no new SET for {constant('TIMEOUT_MS'):g} ms",
        f"off its set point by more than 0.1 MPa for {constant('REGULATOR_MS') / 1000:g} s",
        f"(0.55 MPa) for {constant('MONITOR_MS'):g} ms",
        f"does not answer for {constant('BUS_MS'):g} ms",
        f"more than {spaced(constant('TRAVEL_MAX'))} steps",
        f"no sign of life for {constant('PATIENCE') * 0.05:g} ms",
    ):
        assert number in text, number
    robot = load_robot("kang2017")
    most, steps = robot.actuation, Limits.of(robot).position_max
    assert f"{most.pressure_max_Pa / 1e6:g} MPa, {most.tension_max_N:.1f} N, {steps} steps" in text
