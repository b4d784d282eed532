"""`tepm hw` as a person meets it: on an emulated board in virtual time, and on one behind a pseudo-terminal in real time."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tepm_opt.cli.hw import calibrate as hw_calibrate
from tepm_opt.cli.hw import commands as hw
from tepm_opt.cli.hw import shared as hw_shared
from tepm_opt.data.setpoints import SetPoints, write_setpoints
from tepm_opt.errors import InputError
from tepm_opt.hw.board.link import Link
from tepm_opt.hw.board.linklog import LinkLog
from tepm_opt.hw.board.ports import FoundPort, PortBusyError
from tepm_opt.hw.rig import Command as RigCommand
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.service import monitor as service_monitor
from tepm_opt.hw.service.line import Line, open_line
from tepm_opt.models.compile import compile_model
from tepm_opt.models.robot import Mount, load_robot, robot_text
from tepm_opt.solvers.mechanics.statics import solve_statics
from tests.cli.conftest import Command, script
from tests.data.made import ACTUATORS
from tests.hw.conftest import *  # noqa: F403  its fixtures
from tests.hw.emulator import FIRMWARE, Board
from tests.hw.emulator.world import World
from tests.hw.lines import EventfulPort, line_of

TRACKER = '\n[hardware.tracker]\ndevices = ["A", "B", "C", "D"]\n'


class Bench:
    """A board in virtual time that the commands find whatever port they are told.

    Attributes:
        world, port: its world and the line to it.
        opened: ports that were asked for.
        answers: what a person types, each a text or a function that gives one.
        asked: what the person was asked.
    """

    def __init__(self, world: World) -> None:
        self.world, self.port = world, EventfulPort(world)
        self.opened: list[str] = []
        self.answers: list[str | Callable[[], str]] = []
        self.asked: list[str] = []

    def open(self, target: str) -> Line:
        self.opened.append(target)
        return line_of(self.world, self.port)

    def answer(self, question: str) -> str:
        self.asked.append(question)
        answer = self.answers.pop(0)
        return answer if isinstance(answer, str) else answer()


@pytest.fixture
def bench(board: Board, monkeypatch: pytest.MonkeyPatch) -> Bench:
    found = Bench(World(board))
    monkeypatch.setattr(hw_shared, "open_line", found.open)
    monkeypatch.setattr(hw_shared, "ask", found.answer)
    monkeypatch.setattr(hw_calibrate, "AVERAGED_S", 0.3)
    return found


def raising(error: BaseException) -> Callable[[], None]:
    def throw() -> None:
        raise error

    return throw


class TestPorts:
    def test_none(self, tepm: Command, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(hw, "find_ports", list)
        done = tepm("hw", "ports")
        assert (done.status, done.err) == (1, "")
        for word in ("There is no serial port", "cable", "CH340", "dialout"):
            assert word in done.out
        done = tepm("hw", "ports", "--json")
        assert (done.status, done.json()) == (1, [])

    def test_some(self, tepm: Command, monkeypatch: pytest.MonkeyPatch) -> None:
        found = [FoundPort("/dev/ttyACM0", "Arduino [Mega]", True), FoundPort("/dev/ttyS0", "n/a", False)]
        monkeypatch.setattr(hw, "find_ports", lambda: found)
        done = tepm("hw", "ports")
        assert (done.status, done.out) == (0, "/dev/ttyACM0  Arduino [Mega]  likely a board\n/dev/ttyS0  n/a\n")
        assert tepm("hw", "ports", "--json").json()[0] == {"device": "/dev/ttyACM0", "description": "Arduino [Mega]", "arduino": True}
        monkeypatch.setattr(hw, "find_ports", lambda: found[1:])
        assert "None of them looks like an Arduino" in tepm("hw", "ports").out


class TestCheck:
    @pytest.mark.slow
    def test_good_board(self, tepm: Command, bench: Bench, here: Path) -> None:
        (here / "board").touch()
        done = tepm("hw", "check", "board")
        assert (done.status, done.err, bench.opened) == (0, "", ["board"])
        assert " 1. ✓ python packages: " in done.out
        assert " 9. ✓ state: IDLE" in done.out
        assert "0 wrong" in done.out
        assert "tepm hw jog board 11 --tension 1 --no-tendon" in done.out
        assert bench.world.board.safe

    @pytest.mark.slow
    def test_bad_board(self, tepm: Command, bench: Bench, here: Path) -> None:
        (here / "board").touch()
        bench.world.board.estop(True)
        done = tepm("hw", "check", "board", "--json")
        found = done.json()
        assert (done.status, done.err, found["ok"]) == (1, "", False)
        wrong = [entry for entry in found["checks"] if entry["mark"] == "wrong"]
        assert [entry["name"] for entry in wrong] == ["state", "emergency stop"]
        assert all(entry["says"] and entry["next"] for entry in wrong)
        assert [entry["number"] for entry in found["checks"]] == list(range(1, 16))

    def test_nothing_there(self, tepm: Command, bench: Bench) -> None:
        done = tepm("hw", "check", "/dev/nope")
        assert (done.status, bench.opened) == (1, [])
        assert "3. ✗ serial port: /dev/nope does not exist" in done.out
        assert "begin with: serial port." in done.out


class TestLimits:
    def test_printed(self, tepm: Command) -> None:
        done = tepm("hw", "limits")
        assert (done.status, done.err) == (0, "")
        assert done.out == (FIRMWARE / "limits.h").read_text(encoding="utf-8")

    def test_written(self, tepm: Command, here: Path) -> None:
        (here / "weak.toml").write_text(robot_text("kang2017").replace("tension_max_N = 7.0", "tension_max_N = 6.0"), encoding="utf-8")
        for _ in range(2):  # what this command wrote it may write again
            done = tepm("hw", "limits", "--robot", "weak.toml", "--out", "limits.h")
            assert (done.status, done.err) == (0, "")
            assert done.out.startswith("limits.h: 500 kPa, 6 N and the calibration of robot kang2017\n")
            assert f"flash PORT=PORT LIMITS={here / 'limits.h'}" in done.out
        assert "22938,  // tension_max: counts" in (here / "limits.h").read_text(encoding="utf-8")

    def test_wrong(self, tepm: Command, here: Path) -> None:
        (here / "mine.h").write_text("// mine\n", encoding="utf-8")
        for out in ("mine.h", "."):
            done = tepm("hw", "limits", "--out", out)
            assert (done.status, done.out) == (2, "")
            assert "was not written by this command" in done.err
        assert (here / "mine.h").read_text(encoding="utf-8") == "// mine\n"
        text = robot_text("kang2017").replace("\nV_per_MPa = 5.5555555555555556", "\nV_per_MPa = 20")
        (here / "loud.toml").write_text(text, encoding="utf-8")
        done = tepm("hw", "limits", "--robot", "loud.toml")
        assert (done.status, done.out) == (2, "")
        assert "pressure_max of the board = 8192; valid: 1 … 4095" in done.err


class TestJog:
    @pytest.mark.slow
    def test_tension(self, tepm: Command, bench: Bench) -> None:
        done = tepm("hw", "jog", "x", "12", "--tension", "1.5", "--seconds", "2", "--yes")
        assert (done.status, done.err) == (0, "")
        assert done.out.startswith("12: 1.5 N commanded, 1.5 N measured while held, the motor wound 14")
        steps = bench.world.board.step_counts
        assert steps[1] > 2500
        assert not np.delete(steps, 1).any()
        bench.world.advance(0.1)
        assert bench.world.board.safe

    @pytest.mark.slow
    def test_pressure(self, tepm: Command, bench: Bench) -> None:
        done = tepm("hw", "jog", "x", "23", "--pressure-kPa", "50", "--seconds", "2", "--yes")
        assert (done.status, done.err) == (0, "")
        assert re.match(r"23: 50 kPa commanded, (49|50)(\.\d)? kPa measured while held\.\n", done.out)
        assert "far off" not in done.out
        peak = bench.world.board.dac_peak
        assert peak[5] == pytest.approx(50 / 900 * 4096, abs=1)
        assert not peak[:5].any()
        assert not bench.world.board.step_counts.any()

    @pytest.mark.slow
    def test_no_tendon(self, tepm: Command, bench: Bench) -> None:
        bench.world.board.counts_per_step(0.0)
        done = tepm("hw", "jog", "x", "11", "--tension", "1", "--seconds", "2", "--no-tendon", "--yes")
        assert (done.status, done.err) == (0, "")
        assert "the motor wound 95" in done.out
        assert " steps, 3.45 mm of tendon" in done.out  # 1 N at 290 N/m
        assert "hooked on" not in done.out
        assert bench.world.board.positions[0] == pytest.approx(0, abs=5)

    @pytest.mark.slow
    def test_missing_air(self, tepm: Command, bench: Bench) -> None:
        bench.world.board.follow(False)
        for k in range(6):
            bench.world.board.monitor(k, 1.0)
            bench.world.board.dynamometer(k, 3277)
        done = tepm("hw", "jog", "x", "11", "--pressure-kPa", "50", "--seconds", "2", "--yes")
        assert done.status == 0
        assert "That is far off: is it the right actuator, is the air on" in done.out

    def test_mixed_up(self, tepm: Command, bench: Bench) -> None:
        bench.world.board.follow(False)
        for k in range(6):
            bench.world.board.monitor(k, 1.3 if k == 3 else 1.0)
            bench.world.board.dynamometer(k, 3277)
        done = tepm("hw", "jog", "x", "11", "--pressure-kPa", "50", "--seconds", "1", "--yes")
        assert "Another actuator showed up to" in done.out

    @pytest.mark.slow
    def test_interrupted(self, tepm: Command, bench: Bench) -> None:
        bench.port.at(1.5, raising(KeyboardInterrupt()))
        done = tepm("hw", "jog", "x", "11", "--tension", "2", "--seconds", "4", "--yes")
        assert (done.status, done.out) == (130, "")
        assert done.err == "interrupted: motors are off and pressure goes to zero\n"
        assert bench.world.board.step_counts[0] > 0
        bench.world.advance(0.02)
        assert bench.world.board.safe

    @pytest.mark.slow
    def test_fault_on_the_way(self, tepm: Command, bench: Bench) -> None:
        bench.port.at(1.5, lambda: bench.world.board.dynamometer(4, 0))
        done = tepm("hw", "jog", "x", "11", "--tension", "2", "--seconds", "4", "--yes")
        assert (done.status, done.out) == (1, "")
        assert "the board stopped the robot: FAULT: dynamometer" in done.err
        assert "open or shorted" in done.err
        assert bench.world.board.safe

    def test_firmware_of_another_robot(self, tepm: Command, bench: Bench, here: Path) -> None:
        (here / "weak.toml").write_text(robot_text("kang2017").replace("tension_max_N = 7.0", "tension_max_N = 6.0"), encoding="utf-8")
        done = tepm("hw", "jog", "x", "11", "--tension", "1", "--robot", "weak.toml", "--yes")
        assert (done.status, done.out) == (1, "")
        assert (
            "firmware and robot file kang2017 disagree: tension_max is 26215 (7 N) in the firmware, 22938 (6 N) by the robot file"
            in done.err
        )
        assert done.err.count("\n") == 1
        assert not bench.world.board.step_counts.any()

    @pytest.mark.slow
    def test_asks(self, tepm: Command, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
        bench.answers = ["n", "y"]
        arguments = ("hw", "jog", "x", "11", "--pressure-kPa", "20", "--seconds", "1")
        done = tepm(*arguments)
        assert (done.status, done.err, bench.opened) == (130, "interrupted\n", [])
        assert tepm(*arguments).status == 0
        assert bench.asked[0] == (
            "This moves the robot: actuator 11 goes to 20 kPa and back in 1 s. Keep a hand at the emergency stop button. Go on? [y/N]"
        )

    @pytest.mark.parametrize(
        ("arguments", "says"),
        [
            (("31", "--tension", "1", "--yes"), "actuator '31'"),
            (("11,12", "--tension", "1", "--yes"), "one at a time; valid: 11, 12"),
            (("11", "--yes"), "either --pressure-kPa or --tension"),
            (("11", "--tension", "1", "--pressure-kPa", "5", "--yes"), "either --pressure-kPa or --tension"),
            (("11", "--tension", "8", "--yes"), "--tension 8; valid: more than 0, at most 7 N"),
            (("11", "--pressure-kPa", "nan", "--yes"), "--pressure-kPa nan; valid: more than 0, at most 500 kPa"),
            (("11", "--pressure-kPa", "5", "--no-tendon", "--yes"), "--no-tendon goes with --tension"),
            (("11", "--tension", "1", "--seconds", "0", "--yes"), "--seconds"),
            (("11", "--tension", "1"), "valid: a terminal, or --yes"),
            (("11", "--tension", "1", "--robot", "nope", "--yes"), "nope"),
        ],
    )
    def test_wrong(self, tepm: Command, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], says: str) -> None:
        monkeypatch.setattr(hw_shared, "open_line", raising(AssertionError("opened")))
        done = tepm("hw", "jog", "x", *arguments)
        assert (done.status, done.out) == (2, "")
        assert says in done.err
        assert done.err.count("\n") == 1


class TestEstop:
    def test_acknowledged(self, tepm: Command, bench: Bench) -> None:
        done = tepm("hw", "estop", "x")
        assert (done.status, done.err) == (0, "")
        assert done.out.startswith("ESTOP acknowledged")
        assert "tepm hw check x --clear" in done.out
        assert not bench.world.board.outputs

    @pytest.mark.slow
    def test_no_answer(self, tepm: Command, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(hw, "ESTOP_S", 1.0)
        bench.port.write = lambda data: None  # type: ignore[method-assign]
        done = tepm("hw", "estop", "x")
        assert (done.status, done.out) == (1, "")
        assert "not acknowledged within 1 s" in done.err
        assert "press the emergency stop button" in done.err

    def test_in_use(self, tepm: Command, monkeypatch: pytest.MonkeyPatch) -> None:
        busy = PortBusyError("serial port 'x' cannot be opened: another program has it open")
        monkeypatch.setattr(hw_shared, "open_line", lambda target: raising(busy)())
        done = tepm("hw", "estop", "x")
        assert done.status == 2
        assert "only that program can stop the robot over this line: press the emergency stop button" in done.err


class TestCalibrate:
    @pytest.mark.slow
    def test_tension(self, tepm: Command, bench: Bench, here: Path) -> None:
        board = bench.world.board

        def hang(grams: float) -> Callable[[], str]:
            return lambda: board.dynamometer(1, round(3290 + 3200 * grams * 9.80665e-3)) or ""

        bench.answers = [hang(grams) for grams in (0, 100, 500)]
        done = tepm("hw", "calibrate", "tension", "x", "--actuator", "12", "--weights-g", "0,100,500", "--out", "new.toml")
        assert done.status == 0
        assert bench.asked[0] == "Dynamometer 12: take all weight off, let it rest, then press Enter:"
        assert "hang 500 g on" in bench.asked[2]
        part = tomllib.loads((here / "new.toml").read_text(encoding="utf-8"))["hardware"]["tension"]
        assert part["zero_counts"] == pytest.approx([3277, 3290, 3277, 3277, 3277, 3277], abs=0.5)
        assert part["counts_per_N"] == pytest.approx([3276.8, 3200, 3276.8, 3276.8, 3276.8, 3276.8], rel=1e-4)
        assert "residual" in done.out
        assert "then into the firmware, which does not arm otherwise: tepm hw limits --robot ROBOT.toml --out limits.h && make" in done.out
        assert "100 g: 6428.0 counts, standard deviation 0.0" in done.err
        assert board.safe
        assert tepm("hw", "calibrate", "tension", "x", "--actuator", "12", "--out", "new.toml").status == 2

    def test_wrong_dynamometer(self, tepm: Command, bench: Bench) -> None:
        bench.answers = ["", lambda: bench.world.board.dynamometer(0, 6000) or ""]
        done = tepm("hw", "calibrate", "tension", "x", "--actuator", "12", "--weights-g", "0,100")
        assert done.status == 2
        assert "dynamometer 12 changed by 0 counts, 11 by 2723" in done.err

    @pytest.mark.slow
    def test_pressure(self, tepm: Command, bench: Bench) -> None:
        bench.world.board.monitor(2, 1.1)
        done = tepm("hw", "calibrate", "pressure", "x", "--actuator", "13", "--at-kPa", "0,100", "--yes")
        assert done.status == 0
        part = tomllib.loads(done.out[done.out.index("[hardware.pressure]") :])["hardware"]["pressure"]
        assert part["monitor_zero_V"][:3] == pytest.approx([1, 1, 1.1], abs=6e-3)
        assert part["monitor_V_per_MPa"][2] == pytest.approx(4.444, rel=0.02)
        assert set(part) == {"monitor_zero_V", "monitor_V_per_MPa"}
        bench.world.advance(0.3)
        assert bench.world.board.safe
        assert not bench.world.board.step_counts.any()

    def test_no_monitors(self, tepm: Command, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(Link, "monitored", False)
        done = tepm("hw", "calibrate", "pressure", "x", "--actuator", "13", "--at-kPa", "0,100", "--yes")
        assert (done.status, done.out) == (2, "")
        assert "this board has no inputs for pressure monitors" in done.err
        assert not bench.world.board.dac_peak.any()

    @pytest.mark.slow
    def test_pressure_with_gauge(self, tepm: Command, bench: Bench) -> None:
        bench.answers = ["2", "much", "104"]
        done = tepm("hw", "calibrate", "pressure", "x", "--actuator", "11", "--at-kPa", "0,100", "--gauge", "--yes")
        assert done.status == 0
        assert "'much'; valid: a number of kPa up to 750" in done.err
        part = tomllib.loads(done.out[done.out.index("[hardware.pressure]") :])["hardware"]["pressure"]
        slope = (455 / 4096 * 5) / 0.102
        assert part["V_per_MPa"][0] == pytest.approx(slope, rel=1e-5)
        assert part["zero_V"][0] == pytest.approx(-0.002 * slope, abs=1e-6)

    @pytest.mark.slow
    def test_interrupted(self, tepm: Command, bench: Bench) -> None:
        bench.port.at(2.0, raising(KeyboardInterrupt()))
        done = tepm("hw", "calibrate", "pressure", "x", "--actuator", "11", "--at-kPa", "100,200", "--yes")
        assert (done.status, done.out) == (130, "")
        assert bench.world.board.dac[0] > 0
        bench.world.advance(0.5)
        assert bench.world.board.safe

    @pytest.mark.parametrize(
        ("arguments", "says"),
        [
            (("tension", "x", "--actuator", "11", "--weights-g", "0"), "--weights-g '0'; valid: at least two numbers"),
            (("tension", "x", "--actuator", "11", "--weights-g", "0,900"), "within 0 … 713.8"),
            (("tension", "x", "--actuator", "14"), "actuator '14'"),
            (("pressure", "x", "--actuator", "11", "--at-kPa", "0,600", "--yes"), "within 0 … 500 kPa"),
            (("pressure", "x", "--actuator", "11"), "valid: a terminal, or --yes"),
            (("pressure", "x", "--actuator", "11", "--out", "no/such.toml", "--yes"), "there is no such folder"),
            (("base", "x", "nope.csv", "--yes"), "nope.csv"),
        ],
    )
    def test_wrong(self, tepm: Command, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], says: str) -> None:
        monkeypatch.setattr(hw_shared, "open_line", raising(AssertionError("opened")))
        done = tepm("hw", "calibrate", *arguments)
        assert (done.status, done.out) == (2, "")
        assert says in done.err


class PosedRig:
    """An arm that follows at once, on another base than its robot file says, seen by sensors on holders, with noise."""

    mount = Mount(gravity_m_per_s2=(0, 0, -9.81), base_position_m=(0.1, -0.2, 0.03), base_rotation_deg=(8.0, -5.0, 30.0))
    holders = np.array([[0.04, 0, 0], [0.0, 0.04, 0.005], [0.02, -0.03, 0], [0.04, 0.001, -0.01]])

    robot, simulated = load_robot("kang2017"), None

    def __init__(self) -> None:
        self.model = compile_model(self.robot.model_copy(update={"mount": self.mount}), backend="python")
        self.random = np.random.default_rng(1)
        self.time, self.stops = 0.0, 0
        self.wanted = self.solved = np.zeros(12)
        self.points = np.zeros((4, 3))

    def read(self) -> Sample:
        self.time += 0.01
        transforms = np.tile(np.eye(4), (4, 1, 1))
        arms = (self.points - self.mount.base_position_m) @ self.mount.rotation
        turns = Rotation.from_rotvec(np.stack([-8 * arms[:, 1], 8 * arms[:, 0], 0.3 + 0 * arms[:, 0]], axis=1)).as_matrix()
        transforms[:, :3, :3] = self.mount.rotation @ turns
        transforms[:, :3, 3] = self.points - np.einsum("pij,pj->pi", transforms[:, :3, :3], self.holders)
        transforms[:, :3, 3] += 3e-4 * self.random.normal(size=(4, 3))
        return Sample(self.time, self.points, transforms=transforms)

    def apply(self, command: RigCommand) -> None:
        new = np.concatenate([command.pressures, command.tensions])
        if np.array_equal(new, self.wanted) and not np.array_equal(new, self.solved):
            self.points, self.solved = solve_statics(self.model, new).points, new
        self.wanted = new

    def stop(self) -> None:
        self.stops += 1

    def close(self) -> None:
        """As a tracker."""

    def first(self) -> None:
        """As a tracker."""

    def __enter__(self) -> PosedRig:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()


class TestBase:
    @pytest.fixture
    def posed(self, monkeypatch: pytest.MonkeyPatch, here: Path) -> PosedRig:
        rig = PosedRig()

        class FakeLine:
            def rig(self, robot: object, tracker: object) -> PosedRig:
                return rig

        monkeypatch.setattr(hw_shared, "open_line", lambda target: FakeLine())
        monkeypatch.setattr(hw_shared, "open_tracker", lambda robot: rig)
        (here / "robot.toml").write_text(robot_text("kang2017") + TRACKER, encoding="utf-8")
        return rig

    def rows(self, here: Path, count: int) -> None:
        random = np.random.default_rng(3)
        values = np.hstack([random.uniform(5e4, 3e5, (count, 6)), random.uniform(0, 1.5, (count, 6))])
        write_setpoints(here / "inputs.csv", SetPoints(np.arange(count, dtype=float), values, np.zeros((count, 3))), ACTUATORS)

    @pytest.mark.slow
    def test_found(self, tepm: Command, here: Path, posed: PosedRig) -> None:
        self.rows(here, 10)
        done = tepm("hw", "calibrate", "base", "x", "inputs.csv", "--robot", "robot.toml", "--hold", "0.5", "--yes", "--out", "base.toml")
        assert done.status == 0, done.err
        assert posed.stops > 0
        found = tomllib.loads((here / "base.toml").read_text(encoding="utf-8"))
        assert found["mount"]["base_position_m"] == pytest.approx(posed.mount.base_position_m, abs=3e-4)
        assert found["mount"]["base_rotation_deg"] == pytest.approx(posed.mount.base_rotation_deg, abs=0.05)
        assert np.array(found["hardware"]["tracker"]["holders_m"]) == pytest.approx(posed.holders, abs=3e-4)
        assert "10 rows" in done.out
        assert "mm rms" in done.out

    def test_straight_arm_does_not_tell(self, tepm: Command, here: Path, posed: PosedRig) -> None:
        values = np.repeat([[1e5] * 6 + [0.0] * 6], 3, axis=0)
        write_setpoints(here / "inputs.csv", SetPoints(np.arange(3.0), values, np.zeros((3, 3))), ACTUATORS)
        done = tepm("hw", "calibrate", "base", "x", "inputs.csv", "--robot", "robot.toml", "--hold", "0.5", "--yes")
        assert done.status == 2
        assert "bent arms" in done.err
        assert posed.stops > 0

    def test_no_tracker(self, tepm: Command, here: Path) -> None:
        self.rows(here, 3)
        done = tepm("hw", "calibrate", "base", "x", "inputs.csv", "--yes")
        assert done.status == 2
        assert "[hardware.tracker]" in done.err


class TestMonitor:
    @pytest.mark.slow
    def test_lines(self, tepm: Command, bench: Bench) -> None:
        done = tepm("hw", "monitor", "x", "--seconds", "2")
        lines = done.out.splitlines()
        assert (done.status, done.err, len(lines)) == (0, "", 2)
        assert "IDLE; kPa 11:" in lines[1]
        assert "0 lost, 0 damaged" in lines[1]
        assert bench.world.board.safe

    @pytest.mark.slow
    def test_cable_out_and_in(self, tepm: Command, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(service_monitor, "RETRY", 0.3)
        first, tries = bench.port, []

        def opened(target: str) -> Line:
            tries.append(target)
            if len(tries) == 2:
                raise InputError("there is no such port")
            return line_of(bench.world, first if len(tries) == 1 else EventfulPort(bench.world))

        monkeypatch.setattr(hw_shared, "open_line", opened)
        first.at(1.5, lambda: setattr(first, "cut", True))
        done = tepm("hw", "monitor", "x", "--seconds", "4")
        assert done.status == 0
        assert len(tries) == 3
        assert "the line to the board is gone: the cable is out; trying to open it again" in done.out
        assert "IDLE" in done.out.splitlines()[-1]
        assert bench.world.board.safe

    def test_wrong_port(self, tepm: Command) -> None:
        done = tepm("hw", "monitor", "/dev/nope")
        assert (done.status, done.out) == (2, "")
        assert "'/dev/nope' cannot be opened: there is no such port" in done.err

    def test_log(self, tepm: Command, bench: Bench, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        log = LinkLog(here / "link.log", bench.world.clock)
        with Line(bench.port, bench.world.clock, log, threaded=False).rig(load_robot("kang2017")) as rig:
            while rig.time < 2.5:
                rig.read()
        monkeypatch.setattr(hw_shared, "open_line", open_line)
        done = tepm("hw", "monitor", "log:link.log")
        assert (done.status, done.err) == (0, "")
        assert done.out.splitlines()[-1].startswith("the log ended after 2.")
        assert "IDLE" in done.out
        assert len(done.out.splitlines()) == 3
        (here / "bad.log").write_text("nonsense\n")
        assert "line 1" in tepm("hw", "monitor", "log:bad.log").err


@pytest.fixture
def terminal(firmware: Path, program: Path, tmp_path: Path) -> Iterator[Path]:
    """A board behind a pseudo-terminal, in real time."""
    running = subprocess.Popen([program, firmware, tmp_path / "board"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert running.stdout is not None
    assert running.stdout.readline().startswith("/dev/")
    yield tmp_path / "board"
    running.terminate()
    running.wait(10)


def started(*arguments: Any) -> subprocess.Popen[str]:
    """`tepm ARGUMENTS` that goes on."""
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from tepm_opt.cli import main; main()"
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def has_open(process: subprocess.Popen[str], device: Path) -> bool:
    """Whether a program holds a device (Linux: what its descriptors point to)."""
    held = Path(f"/proc/{process.pid}/fd")
    return any(path.is_symlink() and path.resolve() == device.resolve() for path in held.iterdir())


@pytest.mark.slow
def test_real_time(terminal: Path) -> None:
    """A check; a jog that has the port while an emergency stop is tried, and that is then interrupted; an emergency stop."""
    done = script("hw", "check", terminal)
    assert done.status in (0, 1), done.err
    assert "✓ firmware: " in done.out
    assert "✓ state: IDLE" in done.out
    jog = started("hw", "jog", terminal, "11", "--tension", "1", "--seconds", "60", "--yes")
    try:
        deadline = time.monotonic() + 60
        while not has_open(jog, terminal) and time.monotonic() < deadline:
            time.sleep(0.05)
        busy = script("hw", "estop", terminal)
        assert busy.status == 2, busy.err
        assert "another program has it open" in busy.err
        assert "press the emergency stop button" in busy.err
        time.sleep(1.0)
        jog.send_signal(signal.SIGINT)
        out, err = jog.communicate(timeout=30)
    finally:
        jog.kill()
    assert (jog.returncode, out) == (130, "")
    assert err.endswith("interrupted: motors are off and pressure goes to zero\n")
    done = script("hw", "estop", terminal)
    assert done.status == 0, done.err
    assert "ESTOP acknowledged" in done.out
