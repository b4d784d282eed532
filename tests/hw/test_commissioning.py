"""The checks of commissioning against an emulated board, a stand-in for PlusServer, and nothing at all; calibration lines."""

from __future__ import annotations

import re
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.hw.board.ports import FoundPort, PortBusyError
from tepm_opt.hw.board.protocol import State
from tepm_opt.hw.service import calibrate, checks, commissioning, moves
from tepm_opt.hw.service.checks import Check, Mark
from tepm_opt.hw.service.commissioning import Commissioning, by_hand
from tepm_opt.hw.service.line import Line, actuators_of
from tepm_opt.models.robot import load_robot, robot_text
from tests.hw.emulator import BROWN_OUT, Board
from tests.hw.emulator.world import World
from tests.hw.igtl import DEVICES, PlusServer
from tests.hw.lines import EventfulPort, line_of

BOARD = FoundPort("/dev/ttyACM0", "Arduino Mega 2560", True)
OTHER = FoundPort("/dev/ttyS0", "n/a", False)


def made(**settings: Any) -> dict[str, Check]:
    """All checks by name."""
    found = list(Commissioning(**settings).checks())
    names = [entry.name for entry in found]
    assert len(set(names)) == len(names)
    return {entry.name: entry for entry in found}


def marks(found: dict[str, Check], mark: Mark) -> list[str]:
    """Names of the checks that ended so."""
    return [name for name, entry in found.items() if entry.mark is mark]


@pytest.fixture
def device(tmp_path: Path) -> str:
    """A file that stands for a port which exists."""
    (tmp_path / "board").touch()
    return str(tmp_path / "board")


@pytest.fixture
def world(board: Board) -> World:
    """A board with nothing on it."""
    return World(board)


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """The line is listened to for a quarter of a second only."""
    monkeypatch.setattr(checks, "LISTEN_S", 0.25)


@pytest.fixture
def walk(world: World, device: str) -> Callable[..., dict[str, Check]]:
    """The checks on that board."""
    return lambda **settings: made(**{"port": device, "open_line": lambda target: line_of(world), **settings})


def robot_with(tmp_path: Path, *lines: str) -> str:
    """A robot file with more lines at its end."""
    (tmp_path / "robot.toml").write_text("\n".join([robot_text("kang2017"), *lines, ""]), encoding="utf-8")
    return str(tmp_path / "robot.toml")


class TestWithoutBoard:
    def test_nothing_there(self) -> None:
        found = made(find=list)
        assert marks(found, Mark.WRONG) == ["serial port"]
        assert "cable" in found["serial port"].next
        assert found["firmware"].next == "", "nothing is flashed before there is a port"
        assert found["line"].mark is Mark.OPEN
        assert len(found) == 15

    def test_several(self) -> None:
        found = made(find=lambda: [BOARD, FoundPort("/dev/ttyACM1", "clone", True), OTHER])
        assert found["serial port"].says == "several boards: /dev/ttyACM0, /dev/ttyACM1."
        assert found["serial port"].next == "name yours: tepm hw check /dev/ttyACM0"

    def test_the_only_likely_one_is_taken(self) -> None:
        opened: list[str] = []

        def refuse(target: str) -> Line:
            opened.append(target)
            raise PortBusyError(f"serial port {target!r} cannot be opened: another program has it open")

        found = made(find=lambda: [BOARD, OTHER], open_line=refuse)
        assert opened == ["/dev/ttyACM0"]
        assert found["firmware"].mark is Mark.WRONG
        assert found["firmware"].next == checks.BUSY

    def test_wrong_port(self) -> None:
        found = made(port="/dev/nope", find=lambda: [BOARD])
        assert found["serial port"].says == "/dev/nope does not exist; there is /dev/ttyACM0."
        assert found["firmware"].mark is Mark.OPEN

    @pytest.mark.parametrize("robot", ["kang2018", "bare.toml"])
    def test_wrong_robot(self, tmp_path: Path, robot: str, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        Path("bare.toml").write_text(robot_text("kang2017").split("[hardware.pressure]")[0], encoding="utf-8")
        found = made(robot=robot, find=list)
        assert found["robot file"].mark is Mark.WRONG
        assert robot.removesuffix(".toml") in found["robot file"].says or "[hardware]" in found["robot file"].says

    def test_missing_tools(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(checks.shutil, "which", lambda tool: None if tool == "avrdude" else tool)
        assert checks.tools() == Check(
            "tools to flash", Mark.OPEN, "avrdude not installed; needed only to flash the firmware.", "sudo apt install avrdude"
        )

    def test_missing_package(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(checks, "PACKAGES", ("numpy", "no-such-package"))
        assert checks.packages().next == "pip install no-such-package"

    def test_by_hand(self) -> None:
        steps = by_hand("COM3", "mine.toml", "11")
        order = [
            "compressed air off",
            "--button",
            "--no-tendon",
            "calibrate tension",
            "tepm hw limits --robot mine.toml",
            "Hook",
            "--pressure-kPa 50",
            "calibrate pressure",
            "calibrate base",
        ]
        text = " ".join(steps)
        assert [text.index(word) for word in order] == sorted(text.index(word) for word in order)
        assert "COM3 --robot mine.toml" in text


class TestWholeBoard:
    @pytest.mark.slow
    def test_all_is_right(self, walk: Callable[..., dict[str, Check]], world: World) -> None:
        found = walk()
        assert marks(found, Mark.WRONG) == []
        assert {"firmware", "limits", "state", "dynamometers", "pressure monitors", "motors", "line"} <= set(marks(found, Mark.RIGHT))
        assert found["emergency stop"].mark is Mark.OPEN
        assert "0 lost" in found["line"].says
        assert world.board.safe
        assert not world.board.step_counts.any()

    @pytest.mark.slow
    def test_cable_pulled(self, world: World, device: str) -> None:
        port = EventfulPort(world)
        port.at(1.0, lambda: setattr(port, "cut", True))
        found = made(port=device, open_line=lambda target: line_of(world, port))
        assert "the line to the board is gone" in found["line"].says
        assert found["line"].mark is Mark.WRONG


@pytest.mark.usefixtures("brief")
class TestBoard:
    @pytest.mark.slow
    def test_fault_is_shown_then_cleared(self, walk: Callable[..., dict[str, Check]], world: World) -> None:
        with line_of(world).rig(load_robot("kang2017")) as rig:
            single = moves.Single(rig.robot, 0)
            for _ in moves.jog(rig, single, 1e4, 1.0):
                pass
            world.board.reset()
        world.advance(0.5)
        found = walk()
        assert found["state"].says == "FAULT: the board was reset while the robot was armed."
        assert "--clear" in found["state"].next
        found = walk(clear=True)
        assert found["state"] == Check(
            "state", Mark.RIGHT, "it was FAULT: the board was reset while the robot was armed; cleared, it is IDLE now."
        )
        assert walk()["state"].says.startswith("IDLE")

    def test_pressed_button_cannot_be_cleared(self, walk: Callable[..., dict[str, Check]], world: World) -> None:
        world.board.estop(True)
        world.advance(0.2)
        found = walk(clear=True)
        assert "the board refuses CLEAR: the emergency stop is pressed, or its wire is broken" in found["state"].says
        assert found["emergency stop"].mark is Mark.WRONG

    @pytest.mark.slow
    def test_mega_alone(self, walk: Callable[..., dict[str, Check]], world: World) -> None:
        """Without regulators their monitors are pulled to 0 V: the board says so, and CLEAR is refused until they are there."""
        world.board.follow(False)
        for k in range(6):
            world.board.monitor(k, 0.0)
            world.board.dynamometer(k, 3277)
        world.advance(0.3)
        assert re.fullmatch(r"FAULT: the pressure monitor of regulator \d is open or shorted\.", walk()["state"].says)
        found = walk(clear=True)["state"]
        assert "the board refuses CLEAR: the pressure monitor of regulator 1 does not show what the regulator was told" in found.says
        assert found.next.startswith("is the regulator fed, is its monitor wired, has the air gone?")
        world.advance(2.0)
        assert re.fullmatch(r"FAULT: regulator \d does not follow its set point; also MONITOR\.", walk()["state"].says)
        for k in range(6):
            world.board.monitor(k, 1.0)
        world.advance(0.1)
        assert walk(clear=True)["state"].says.endswith("cleared, it is IDLE now.")

    def test_button(self, walk: Callable[..., dict[str, Check]], world: World) -> None:
        asked: list[bool] = []

        def person(press: bool) -> None:
            asked.append(press)
            world.board.estop(press)

        found = walk(button=person)
        assert asked == [True, False]
        assert found["emergency stop"].mark is Mark.RIGHT
        assert walk()["state"].mark is Mark.RIGHT

    @pytest.mark.slow
    def test_dead_button(self, walk: Callable[..., dict[str, Check]], monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(commissioning, "BUTTON_S", 1.0)
        found = walk(button=lambda press: None)
        assert found["emergency stop"].says == "the board saw nothing in 1 s."

    def test_sensors(self, walk: Callable[..., dict[str, Check]], world: World) -> None:
        world.board.dynamometer(1, 100)
        world.board.monitor(3, 1.5)
        found = walk()
        assert marks(found, Mark.WRONG) == ["dynamometers", "pressure monitors"]
        assert found["dynamometers"].says == "open or shorted: 12 (0.02 V)."
        assert found["pressure monitors"].says.startswith("not at zero: 21 (11")
        world.board.dynamometer(1, 3277 + 3277)
        assert "not at zero: 12 (1.00 N)" in walk()["dynamometers"].says

    def test_reset_cause(self, walk: Callable[..., dict[str, Check]], world: World) -> None:
        world.advance(0.01)
        world.board.reset(BROWN_OUT)
        assert walk()["last reset"].says == "the supply dipped."

    def test_limits(self, walk: Callable[..., dict[str, Check]], tmp_path: Path) -> None:
        strong = tmp_path / "strong.toml"
        strong.write_text(robot_text("kang2017").replace("pressure_max_Pa = 0.5e6", "pressure_max_Pa = 0.7e6"), encoding="utf-8")
        found = walk(robot=str(strong))["limits"]
        assert found.mark is Mark.WRONG
        assert "pressure_max is 2275 (499.9 kPa) in the firmware, 3185 (699.8 kPa) by the robot file" in found.says
        assert "monitor_trip is 22573 (550 kPa) in the firmware, " in found.says
        assert f"tepm hw limits --robot {strong} --out limits.h && make -C" in found.next
        assert "or use the robot file that the firmware was made for" in found.next

    def test_silent_board(self, world: World, device: str) -> None:
        world.board.take()
        port = EventfulPort(world)
        port.read = lambda timeout: setattr(world, "time", world.time + timeout) or b""  # type: ignore[method-assign,func-returns-value]
        found = made(port=device, open_line=lambda target: line_of(world, port))
        assert found["firmware"].mark is Mark.WRONG
        assert found["firmware"].says == "nothing answers in 5 s."
        steps = ["right port", "cable", "power", "flash"]
        assert sorted(steps, key=found["firmware"].next.index) == steps
        assert device in found["firmware"].next


class TestTracker:
    def robot(self, tmp_path: Path, port: int) -> str:
        names = ", ".join(f'"{name}"' for name in DEVICES)
        return robot_with(tmp_path, "[hardware.tracker]", f"port = {port}", f"devices = [{names}]", "rate_hz = 100.0")

    def test_seen(self, tmp_path: Path) -> None:
        with PlusServer(rate=100.0) as server:
            found = made(robot=self.robot(tmp_path, server.port), find=list)
        assert found["tracker"].mark is Mark.RIGHT
        assert found["tracker"].says.endswith(f":{server.port} sends {', '.join(DEVICES)}.")
        assert found["tracker's sensors"].says.startswith("s1, s2, s3, s4 are seen, poses are ")

    @pytest.mark.slow
    def test_unreachable(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        with PlusServer() as server:
            port = server.port
        found = made(robot=self.robot(tmp_path, port), find=list)
        assert "nothing listens there" in found["tracker"].says
        assert found["tracker"].mark is Mark.WRONG


class TestLines:
    def test_fit(self) -> None:
        fit = calibrate.fit_line([0, 1, 2, 3], [1.0, 3.1, 4.9, 7.0])
        slope, zero = np.polyfit([0, 1, 2, 3], [1.0, 3.1, 4.9, 7.0], 1)
        assert (fit.slope, fit.zero) == pytest.approx((slope, zero))
        assert fit.rms == pytest.approx(np.sqrt((fit.residuals**2).mean()))
        covariance = np.polyfit([0, 1, 2, 3], [1.0, 3.1, 4.9, 7.0], 1, cov=True)[1]
        assert (fit.slope_std, fit.zero_std) == pytest.approx(np.sqrt(np.diag(covariance)))

    def test_two_points_have_no_deviation(self) -> None:
        fit = calibrate.fit_line([0, 1], [1.0, 3.0])
        assert (fit.zero, fit.slope) == pytest.approx((1, 2))
        assert np.isnan(fit.slope_std)

    def test_one_point(self) -> None:
        with pytest.raises(InputError, match="at least two different"):
            calibrate.fit_line([1, 1], [1.0, 3.0])

    @pytest.mark.parametrize("text", ["1", "a,b", "0,100,100", "-5,100", "0,900", ""])
    def test_wrong_values(self, text: str) -> None:
        with pytest.raises(InputError, match="--weights-g"):
            calibrate.parse_increasing(text, "--weights-g", 0, 700, "g")

    def test_parts_keep_the_others(self, tmp_path: Path) -> None:
        robot = load_robot("kang2017")
        lines = {1: calibrate.CalibrationFit(3300.0, 3200.0, 0, 0, np.zeros(3))}
        part = calibrate.tension_part(robot, lines)
        assert part["zero_counts"] == [3277, 3300, 3277, 3277, 3277, 3277]
        assert part["counts_per_N"][:3] == [3276.8, 3200, 3276.8]
        monitors = {0: calibrate.CalibrationFit(1.01, 4.4, 0, 0, np.zeros(3))}
        text = calibrate.snippet({"hardware.pressure": calibrate.pressure_part(robot, monitors, {})}, ["a note"])
        assert text.startswith("# a note\n\n[hardware.pressure]\nmonitor_zero_V = [1.01, 1.0,")
        assert list(tomllib.loads(text)["hardware"]["pressure"]) == ["monitor_zero_V", "monitor_V_per_MPa"]
        merged = robot_text("kang2017")
        for key, value in tomllib.loads(text)["hardware"]["pressure"].items():
            merged = "\n".join(f"{key} = {value}" if line.startswith(f"{key} =") else line for line in merged.split("\n"))
        (tmp_path / "new.toml").write_text(merged, encoding="utf-8")
        hardware = load_robot(tmp_path / "new.toml").hardware
        assert hardware is not None
        assert hardware.pressure.monitor_zero_V == (1.01, 1, 1, 1, 1, 1)

    def test_no_change(self) -> None:
        with pytest.raises(InputError, match=r"counts_per_N.*valid: 1 … 32767 counts/N.*did the weight pull"):
            calibrate.tension_part(load_robot("kang2017"), {0: calibrate.CalibrationFit(3277.0, 0.0, 0, 0, np.zeros(2))})

    def test_mixed_up(self) -> None:
        change = np.array([3.0, 3000.0, 0, 0, 0, 0])
        with pytest.raises(InputError, match="dynamometer 11 changed by 3 counts, 12 by 3000"):
            calibrate.refuse_mixed_up(change, 0, ("11", "12", "13", "21", "22", "23"), "dynamometer")
        calibrate.refuse_mixed_up(change, 1, ("11", "12", "13", "21", "22", "23"), "dynamometer")

    def test_actuators(self) -> None:
        names = ("11", "12", "13")
        assert actuators_of("12", names) == [1]
        assert actuators_of("13, 11", names) == [2, 0]
        assert actuators_of("all", names) == [0, 1, 2]
        for text in ("21", "", "11,11"):
            with pytest.raises(InputError, match="valid: 11, 12, 13"):
                actuators_of(text, names)


def test_profile() -> None:
    parts = np.linspace(0, 1, 101)
    values = np.array([moves.profile(part) for part in parts])
    assert (values[0], values[50], values[-1]) == (0, 1, 0)
    assert values == pytest.approx(values[::-1])
    assert np.abs(np.diff(values)).max() < 1.6 / moves.RISE / 100


def test_holding_hands_on_what_failed(world: World) -> None:
    with line_of(world).rig(load_robot("kang2017")) as rig:
        rig.stop()
        single = moves.Single(rig.robot, 0)
        rig._armed = False
        holding = moves.keep_sending(rig, single.command(0.0))
        with pytest.raises(RuntimeError, match="open it anew"), holding:
            time.sleep(0.2)
        assert rig.board.state is State.IDLE
