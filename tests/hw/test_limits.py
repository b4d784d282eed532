"""Numbers that stand in more than one place: the firmware's, the guide's, the robot file's."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.calibration import Calibration
from tepm_opt.hw.board.errors import LinkError
from tepm_opt.hw.board.limits import Limits, differences
from tepm_opt.hw.board.protocol import State
from tepm_opt.hw.board.rig import SerialRig
from tepm_opt.hw.rig import Command
from tepm_opt.models.robot import Robot, load_robot
from tests.hw.emulator import FIRMWARE, Board, build_firmware
from tests.hw.emulator.world import World
from tests.hw.lines import FakeBoard

GUIDE = Path(__file__).parents[2] / "docs" / "explanation" / "safety.md"


def constant(name: str) -> float:
    """A number of `config.h`."""
    found = re.search(rf"constexpr \w+ {name} = ([\d.]+)f?;", (FIRMWARE / "config.h").read_text(encoding="utf-8"))
    assert found, name
    return float(found[1])


def spaced(number: float) -> str:
    """1600000 as 1 600 000."""
    return f"{number:,.0f}".replace(",", " ")


def test_the_guide_has_the_numbers_of_the_firmware() -> None:
    """Ramps, rates and times in docs/explanation/safety.md are those that are compiled in."""
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
    most, steps = robot.actuation, Limits.from_robot(robot).position_max
    assert f"{most.pressure_max_Pa / 1e6:g} MPa, {most.tension_max_N:.1f} N, {steps} steps" in text


def robot_with(pressure_max_Pa: float = 0.5e6, tension_max_N: float = 7.0, **hardware: dict[str, Any]) -> Robot:
    """The robot kang2017 with other limits, or another calibration."""
    robot = load_robot("kang2017")
    content = robot.model_dump()
    content["actuation"] |= {"pressure_max_Pa": pressure_max_Pa, "pressure_full_scale_Pa": 1.8e6}
    content["actuation"] |= {"tension_max_N": tension_max_N, "tension_full_scale_N": 14.0}
    for part, values in hardware.items():
        content["hardware"][part] |= values
    return Robot.model_validate(content)


STRONG = {
    "pressure": {"dac_full_scale_V": 10.0, "monitor_V_per_MPa": 2.0 / 0.9},
    "tension": {"counts_per_N": 1638.4, "steps_per_N": 476.19},
}
"""Calibration with which a board can give 1.0 MPa and measure 14 N."""


def test_the_firmware_is_that_of_the_robot_that_ships() -> None:
    assert (FIRMWARE / "limits.h").read_text(encoding="utf-8") == Limits.from_robot(load_robot("kang2017")).header("kang2017")


def lists(random: np.random.Generator, spread: float) -> Robot:
    """A robot each of whose actuators has a calibration of its own."""

    def around(value: float, off: float = 0.0) -> tuple[float, ...]:
        return tuple(value * random.uniform(1 - spread, 1 + spread, 6) + random.uniform(-off, off, 6))

    pressure = {"V_per_MPa": around(5 / 0.9), "zero_V": around(0.0, 2 * spread), "monitor_V_per_MPa": around(4 / 0.9)}
    pressure |= {"dac_full_scale_V": around(5.0), "monitor_zero_V": around(float(random.choice([0.0, 1.0])), spread)}
    tension = {"counts_per_N": around(3276.8), "zero_counts": around(3277.0), "steps_per_N": around(952.38)}
    return robot_with(float(random.uniform(0.2e6, 0.5e6)), float(random.uniform(2, 7)), pressure=pressure, tension=tension)


def test_no_actuator_is_taken_beyond_its_own_limits() -> None:
    """What the common numbers let pass, read with each actuator's own calibration, is within its own limits; and nothing in order trips."""
    random, refused = np.random.default_rng(2017), 0
    for _ in range(200):
        robot = lists(random, float(random.choice([0.0, 3e-3, 0.01, 0.02])))
        own, most, pull = Calibration.from_robot(robot), robot.actuation.pressure_max_Pa, robot.actuation.tension_max_N
        try:
            limits = Limits.from_robot(robot)
        except InputError:
            refused += 1
            continue
        codes = np.arange(limits.pressure_max + 1)[:, None]
        given = np.maximum(codes - own.codes_zero, 0) / own.codes
        assert given.max() <= most + 1e-6
        assert np.all(limits.codes_per_MPa <= 1e6 * own.codes)
        assert np.all((limits.monitor_trip - own.monitor_zero) / own.monitor <= 1.1 * most)
        assert np.all(own.monitor_zero + own.monitor * given[-1] < limits.monitor_trip)
        expected = limits.monitor_zero + (np.maximum(codes - limits.code_zero, 0) * limits.monitor_per_code >> 8)  # as board.cpp does
        for edge in (expected - limits.regulator_band, expected + limits.regulator_band):
            assert np.abs((edge - own.monitor_zero) / own.monitor - given).max() <= 0.1e6
        shown = np.maximum(own.monitor_zero + own.monitor * given, 0)
        assert np.all(np.abs(shown - expected) < limits.regulator_band)
        assert limits.monitor_low == 0 or np.all(own.monitor_zero / 2 - 1 <= limits.monitor_low)
        assert np.all(shown >= limits.monitor_low)
        half = 0.5 / own.counts  # limits of tension are rounded as set points are
        assert np.all((limits.tension_max - own.counts_zero) / own.counts <= pull + half)
        assert np.all((limits.tension_trip - own.counts_zero) / own.counts <= 1.05 * pull + half)
        assert np.all(own.counts_zero / 2 - 1 <= limits.dynamometer_low)
        assert np.all(own.counts_zero > limits.dynamometer_low)
        assert limits.tension_max < limits.tension_trip
        assert np.all(limits.position_max <= own.steps * pull + 0.5)
        assert np.all(limits.steps_per_1000_counts <= 1e3 * own.steps / own.counts + 0.5)
    assert refused < 40


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        (robot_with(1.0e6), "pressure_max of the board = 4551; valid: 1 … 4095"),
        (robot_with(0.85e6), "monitor_trip of the board = 33787; valid: 1 … 32735"),
        (robot_with(tension_max_N=14), "tension_max of the board = 49152; valid: 1000 … 31128"),
        (robot_with(tension={"steps_per_N": 1e5}), "position_max of the board = 700000; valid: 1 … 29999"),
        (robot_with(tension={"steps_per_N": 4000}), "steps_per_1000_counts of the board = 1221; valid: 1 … 900"),
        (robot_with(tension={"zero_counts": 0}), "tension_zero of the board = 0; valid: 1638 … 32767 .*broken wire"),
        (robot_with(tension={"zero_counts": (3277,) * 5 + (9000,)}), "dynamometers show 0.50 … 1.37 V at zero"),
        (robot_with(pressure={"zero_V": (0.0, 0.0, 0.6, 0.0, 0.0, 0.0)}), "regulator 1[123] is 5. kPa off .*valid: at most 40 kPa"),
        (robot_with(pressure={"monitor_zero_V": (1.0,) * 5 + (0.0,)}), "regulator .. is 11. kPa off"),
        (
            robot_with(0.2e6, pressure={"monitor_zero_V": (1.0,) * 5 + (1.06,)}),
            "monitor of regulator 23 shows at the largest pressure nearly what another one may not exceed",
        ),
    ],
)
def test_robots_that_no_firmware_can_be_made_for(robot: Robot, message: str) -> None:
    """They are refused before anything is compiled or armed, by what a person can change; `tepm play` says it where it opens the rig."""
    with pytest.raises(InputError, match=message):
        Limits.from_robot(robot)
    port = FakeBoard(load_robot("kang2017"))
    with pytest.raises(InputError, match=message):
        SerialRig(port, robot, clock=port.clock, threaded=False)


def test_zeros_of_all_kinds() -> None:
    """Commands below zero, monitors a little below or above it without a live zero, and the negative zero that a fit may give."""
    below = Limits.from_robot(robot_with(pressure={"zero_V": -0.05, "monitor_zero_V": -0.01}))
    assert (below.code_zero, below.monitor_zero, below.monitor_low) == (-41, 0, 0)
    assert below.pressure_max == int(-40.96 + 4551.11 * 0.5)
    assert protocol.LIMITS.unpack(below.payload())["code_zero"] == -41
    assert Limits.from_robot(robot_with(pressure={"monitor_zero_V": 0.2})).monitor_low == 0
    assert Limits.from_robot(robot_with(pressure={"monitor_zero_V": 0.26})).monitor_low == 851
    nothing = {"zero_V": (-0.0, 0.0, -0.0, 0.0, 0.0, -0.0)}
    assert Limits.from_robot(robot_with(pressure=nothing)) == Limits.from_robot(load_robot("kang2017"))


STRONGER = {
    "1.0 MPa": (robot_with(1.0e6, pressure=STRONG["pressure"]), "codes_per_MPa is {0}; regulator_band is "),
    "14 N": (
        robot_with(tension_max_N=14, tension=STRONG["tension"] | {"steps_per_N": 500}),
        "position_max is {0}; steps_per_1000_counts is ",
    ),
    "0.6 MPa": (robot_with(0.6e6), "pressure_max is {0}; monitor_trip is "),
    "6 N": (robot_with(tension_max_N=6), "tension_max is {0}; tension_trip is {1}; position_max is "),
    "monitors": (robot_with(pressure={"monitor_zero_V": 1.01}), "monitor_zero is {0}; monitor_low is {1}; monitor_trip is "),
}


@pytest.mark.parametrize("swapped", [False, True], ids=["in the robot file", "in the firmware"])
@pytest.mark.parametrize("name", STRONGER)
def test_firmware_and_robot_file_that_disagree(name: str, swapped: bool) -> None:
    """Whichever allows more: nothing is armed, no set point sent, and every number that differs is named with both values."""
    robots = load_robot("kang2017"), STRONGER[name][0]
    robot, flashed = robots[::-1] if not swapped else robots
    port = FakeBoard(flashed)
    with (
        SerialRig(port, robot, clock=port.clock, threaded=False) as rig,
        pytest.raises(LinkError, match="firmware and robot file kang2017 disa") as raised,
    ):
        rig.apply(Command(np.zeros(6), np.zeros(6), np.ones(6, dtype=bool)))
    said, mine, other = str(raised.value), asdict(Limits.from_robot(robot)), asdict(Limits.from_robot(flashed))
    for key in mine:
        assert (f"{key} is {other[key]}" in said) == (mine[key] != other[key])
    assert "tepm hw limits" in said
    assert {kind for kind, _ in port.heard} == {protocol.ASK}
    assert differences(flashed, Limits.from_robot(robot))


def test_differences_in_physical_units() -> None:
    said = differences(robot_with(0.45e6, 6.0), Limits.from_robot(load_robot("kang2017")))
    assert said[0] == "pressure_max is 2275 (499.9 kPa) in the firmware, 2048 (450 kPa) by the robot file"
    assert "tension_max is 26215 (7 N) in the firmware, 22938 (6 N) by the robot file" in said
    assert "position_max is 6667 (7 N) in the firmware, 5714 (6 N) by the robot file" in said


def test_limits_that_are_not_what_their_crc_says() -> None:
    port = FakeBoard(load_robot("kang2017"))
    port.hello["limits"] ^= 1
    with pytest.raises(LinkError, match="the board's limits have the CRC"):
        SerialRig(port, load_robot("kang2017"), clock=port.clock, threaded=False)


@pytest.mark.slow
def test_firmware_of_another_robot(tmp_path: Path, library: Path, board_factory: Callable[..., Board]) -> None:
    """The header of a stronger robot, compiled: the board arms for that robot, and not for the one that ships."""
    strong = robot_with(1.0e6, 14.0, **STRONG)
    (tmp_path / "limits.h").write_text(Limits.from_robot(strong).header(strong.name), encoding="utf-8")
    world = World(board_factory(build_firmware(tmp_path / "build", limits=tmp_path / "limits.h")))
    zero = Command(np.zeros(6), np.zeros(6), np.ones(6, dtype=bool))
    with SerialRig(world.port, load_robot("kang2017"), clock=world.clock, threaded=False) as rig:
        with pytest.raises(LinkError, match=r"codes_per_MPa is 2275 in the firmware, 4551 by the robot file; regulator_band is "):
            rig.apply(zero)
        with pytest.raises(LinkError, match="the board refuses ARM: its limits or calibration are not those of the robot file"):
            rig.link.arm(Limits.from_robot(load_robot("kang2017")).check)
        assert rig.board.state is State.IDLE
    with SerialRig(world.port, strong, clock=world.clock, threaded=False) as rig:
        for _ in range(100):
            rig.apply(Command(np.full(6, 1.0e6), np.full(6, 1.0), np.ones(6, dtype=bool)))
            rig.read()
        sample = rig.read()
        assert sample.pressures is not None
        np.testing.assert_allclose(sample.pressures, 1.0e6, atol=3e3)
