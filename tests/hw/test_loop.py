"""The whole loop: host, link, firmware, drivers, robot, sensors, tracker; in virtual time, and in real time over a pseudo-terminal."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.cli import rigs, run
from tepm_opt.data.run import read_run
from tepm_opt.hw.board.calibration import Calibration
from tepm_opt.hw.board.errors import LinkError
from tepm_opt.hw.board.rig import SerialRig
from tepm_opt.hw.registry import open_rig
from tepm_opt.hw.rig import Command, Rig, Sample
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.models.robot import load_robot
from tepm_opt.recording import drive
from tests.hw.emulator import Board
from tests.hw.emulator.world import World

ROBOT = load_robot("kang2017")


class Checked(SerialRig):
    """Before each set point it looks whether the last one has arrived at the pins.

    Attributes:
        off: by how many codes and steps the outputs were off, per set point, (set points, 12).
    """

    def __init__(self, world: World) -> None:
        super().__init__(world.port, ROBOT, world.tracker, clock=world.clock, threaded=False, tendons="position")
        self.world, self.off = world, []
        self._goal: np.ndarray | None = None

    def apply(self, command: Command) -> None:
        board = self.world.board
        if self._goal is not None:
            self.off.append(np.r_[board.dac, board.positions - self.world._unwound] - self._goal)
        super().apply(command)
        calibration = Calibration.from_robot(self.robot)
        self._goal = np.r_[
            calibration.to_codes(command.pressures, self.limits.pressure_max),
            calibration.to_steps(command.tensions, self.limits.position_max),
        ]


def hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    """Glides to the start and back are fast, and 5 mm in a second are rest enough."""
    for name, value in (("FULL_RANGE", 3.0), ("SHORTEST", 1.0), ("REST_SPREAD", 5e-3)):
        monkeypatch.setattr(drive, name, value)


@pytest.mark.slow
@pytest.mark.parametrize("count", [5, pytest.param(33, marks=pytest.mark.slow)])
def test_play_reaches_every_pin(board: Board, count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`tepm play` of inverse kinematics along the circle, a point every 0.4 s: every DAC and step count, at every set point."""
    assert run(["ik", "circle", "--out", str(tmp_path), "--json"]) == 0
    head, *rows = (tmp_path / "inputs.csv").read_text().splitlines()
    circle = tmp_path / "circle.csv"
    slower = [f"{0.4 * k},{row.partition(',')[2]}" for k, row in enumerate(rows[:count])]
    circle.write_text("\n".join([head, *slower]) + "\n")
    world = World(board, SimulatedRig())
    opened: list[Checked] = []
    hurry(monkeypatch)
    monkeypatch.setattr(rigs, "open_rig", lambda text, robot: opened.append(Checked(world)) or opened[0])
    assert run(["play", str(circle), "--rig", "serial:emulated", "--out", str(tmp_path / "out.csv"), "--json"]) == 0
    off = np.array(opened[0].off)[5:]  # the motors start from rest
    assert len(off) > 40 * (count - 1)
    assert np.all(np.abs(off) <= 1), np.abs(off).max(axis=0)
    assert np.ptp(read_run(tmp_path / "out.csv").points[:, -1, 0]) > 0.02
    assert board.safe
    assert board.idle_steps == 0


@pytest.mark.slow
def test_the_robot_moves_as_the_simulated_rig(board: Board) -> None:
    """Through firmware and drivers, or directly: the same virtual prototype goes to the same place."""
    random = np.random.default_rng(3)
    inputs = Command(random.uniform(0.5e5, 3e5, 6), random.uniform(0.5, 4, 6), np.ones(6, dtype=bool))
    world = World(board, SimulatedRig())
    with SerialRig(world.port, ROBOT, world.tracker, clock=world.clock, threaded=False) as rig:
        for _ in range(350):
            rig.apply(inputs)
            rig.read()
        through = world.rig.true_points if world.rig else np.empty(0)
    with SimulatedRig() as direct:
        direct.read()
        for _ in range(350):
            direct.apply(inputs)
            direct.read()
        np.testing.assert_allclose(through, direct.true_points, atol=2.0e-3)
        assert np.linalg.norm(direct.true_points[-1] - [0, 0, 0.35]) > 0.03


def script(rig: Rig) -> list[Sample]:
    """What a person might write, for any rig: a slow push of one muscle and a pull of one tendon."""
    samples = []
    with rig:
        for k in range(60):
            samples.append(rig.read())
            part = min(k / 40, 1.0)
            rig.apply(Command(part * np.array([1e5, 0, 0, 0, 0, 0]), part * np.array([0, 1.0, 0, 0, 0, 0]), np.ones(6, dtype=bool)))
        samples.append(rig.read())
    return samples


def undisturbed(work: Callable[[], list[Sample]], attempts: int = 6) -> list[Sample]:
    """What came of a run in real time in which the test's machine did not stand still: link and board rightly end the others."""
    for _ in range(attempts - 1):
        with contextlib.suppress(LinkError):
            return work()
        time.sleep(1.0)
    return work()


@pytest.fixture
def terminal(firmware: Path, program: Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """The emulated board as a program of its own, in real time behind a pseudo-terminal."""
    process = subprocess.Popen([program, firmware], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if process.stdout is None:
        raise RuntimeError("no output")
    yield process.stdout.readline().strip(), process
    process.kill()
    process.wait()


def ended(process: subprocess.Popen[str]) -> str:
    """What the emulated board looked like when it was switched off: six pairs of DAC code and steps, and the motors that are on."""
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=10)
    return said


@pytest.mark.slow
def test_one_script_for_every_rig(terminal: tuple[str, subprocess.Popen[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Unchanged on the simulated rig, on a serial port and on a recording of the first."""
    hurry(monkeypatch)
    port, process = terminal
    out = tmp_path / "run.csv"
    simulated = script(open_rig("sim"))
    steps = tmp_path / "steps.csv"
    names = [f"pressure_{name}_Pa" for name in ("11", "12", "13", "21", "22", "23")]
    names += [name.replace("pressure", "tension").replace("Pa", "N") for name in names]
    steps.write_text("\n".join([",".join(["time_s", *names]), ",".join(["0", *["0"] * 12]), ",".join(["0.8", *["0"] * 12])]) + "\n")
    assert run(["play", str(steps), "--out", str(out), "--rate", "100", "--json"]) == 0
    played = script(open_rig(f"replay:{out}"))
    on_hardware = undisturbed(lambda: script(open_rig(f"serial:{port}")))
    for samples in (simulated, played, on_hardware):
        assert len(samples) == 61
        assert samples[-1].points.shape == (4, 3)
        assert np.all(np.diff([sample.time for sample in samples]) > 0)
    last = on_hardware[-1]
    assert last.status == "no tracker"
    assert last.pressures is not None
    assert last.tensions is not None
    assert last.pressures[0] == pytest.approx(1e5, abs=2e3)
    assert last.tensions[1] == pytest.approx(1.0, abs=0.02)
    time.sleep(0.4)  # the ramp
    assert ended(process).split()[0:12:2] == ["0"] * 6


@pytest.mark.slow
def test_host_killed(terminal: tuple[str, subprocess.Popen[str]]) -> None:
    """The host's process is killed in the middle of a motion: the board stops the robot by itself."""
    port, process = terminal
    code = (
        "import sys, numpy as np; from tepm_opt.hw.registry import open_rig; from tepm_opt.hw.rig import Command\n"
        f"with open_rig('serial:{port}') as rig:\n"
        "    for k in range(10**6):\n"
        "        rig.apply(Command(np.full(6, 2e5), np.full(6, 3.0), np.ones(6, dtype=bool))); s = rig.read()\n"
        "        if k >= 60 and s.pressures is not None: print(s.pressures.min(), s.tensions.min(), flush=True)\n"
    )
    host = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    if host.stdout is None:
        raise RuntimeError("no output")
    pressure, tension = map(float, host.stdout.readline().split())
    assert pressure > 1.5e5
    assert tension > 1.0
    os.kill(host.pid, signal.SIGKILL)
    host.wait()
    time.sleep(1.5)  # 0.1 s of silence, then the ramp
    said = ended(process).split()
    assert said[0:12:2] == ["0"] * 6
    assert said[-2:] == ["enabled", "0"]
