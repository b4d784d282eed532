"""All firmware that can be built keeps its time, with the flags of make, of the Arduino IDE and of PlatformIO; what they need is there."""

from __future__ import annotations

import configparser
import subprocess
import tomllib
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.hw.board import protocol
from tepm_opt.hw.board.limits import Limits
from tepm_opt.hw.board.protocol import CONFIG, Key, State
from tepm_opt.models.robot import load_robot
from tests.hw.conftest import PRESSURE_MAX
from tests.hw.emulator import FIRMWARE, Board
from tests.hw.emulator.host import ZERO, Host

LIMITS = Limits.from_robot(load_robot("kang2017"))
FLAVOURS = ("make", "arduino", "platformio")
RECEIVED = 13
"""Bytes that the firmware takes in a pass."""


class Load:
    """What keeps a board as busy as it can be without losing set points: frames good and bad, and motors that never rest.

    Args:
        host: on an armed board.
        motors: that it has.
        baud: of its line.
    """

    def __init__(self, host: Host, motors: int, baud: int) -> None:
        self.host, self.motors, self.baud = host, motors, baud
        self.random = np.random.default_rng(2)
        host.board.counts_per_step(0)

    def each(self, values: list[int]) -> list[int]:
        """Of the motors and regulators that there are; 0 for the others."""
        return [*values[: self.motors], *[0] * (6 - self.motors)]

    def set(self, k: int) -> bytes:
        """A set point: full rate one way or the other, rates that all differ, or tensions that jump; motors go off and on."""
        kind = k // 20 % 4
        if kind == 0:
            tendons = [ZERO + round((10 - motor) * 8000 / LIMITS.steps_per_1000_counts) for motor in range(6)]  # 10, 9, 8 … steps a pass
        elif kind == 1:
            tendons = [ZERO + 20000 * (k % 2)] * 6
        else:
            tendons = [LIMITS.position_max * (k // 60 % 2)] * 6
        every = (1 << self.motors) - 1
        pressures = self.random.integers(0, PRESSURE_MAX + 1, 6).tolist()
        return self.host.set(self.each(pressures), self.each(tendons), every if k % 10 else every & 0x15, steps=kind > 1)

    def filler(self, k: int, most: int) -> bytes:
        """Bytes of other kinds, as many as there is time for: damaged frames, empty ones, the longest code bytes, requests."""
        if k % 4 == 0:
            return b"".join(bytes(self.random.integers(1, 256, 7, dtype=np.uint8)) + b"\0" for _ in range(most // 8))
        if k % 4 == 1:
            return bytes(most)
        if k % 4 == 2:
            return b"\1" * (most - 1) + b"\0"
        period = 5 if self.baud >= 250000 else 10
        request = CONFIG.pack(id=k % 256, session=self.host.session, key=int(Key.STATUS_PERIOD_MS), value=period)
        return protocol.frame(request) * (most // len(protocol.frame(request)))

    def upset(self) -> None:
        """Whatever changes the state, with the line full: set points that cease, the button; and back to ARMED."""
        self.fill(0.2)
        assert self.host.state is State.HOST_TIMEOUT
        self.host.board.estop(True)
        self.fill(0.1)
        self.host.board.estop(False)
        self.fill(0.1)
        assert self.host.state is State.ESTOP
        self.host.run(0.05)
        self.host.board.send(b"\0")  # the end of what the board could not read is lost
        assert self.host.clear()["state"] == State.IDLE
        assert self.host.arm()["state"] == State.ARMED

    def fill(self, duration: float) -> None:
        """A full line, of which the board cannot read all, without set points."""
        whole = int(0.98 * 0.005 * self.baud / 10)
        for k in range(round(duration / 0.005)):
            self.host.board.send(b"\0" + self.filler(k, whole - 1))
            self.host.run(0.005)

    def run(self, duration: float) -> None:
        """Keep it busy."""
        period = 0.005 if self.baud >= 250000 else 0.01
        room = min(round(1e3 * period) * RECEIVED, int(0.98 * period * self.baud / 10))
        for k in range(round(duration / period)):
            data = self.set(k)
            self.host.board.send(b"\0" + self.filler(k, room - len(data) - 1))
            self.host.run(period + self.random.integers(0, 4) * 0.00025)  # in all places of a pass


def combinations() -> list[tuple[str, str, str, int, str]]:
    """Board, DACs, converter of the dynamometers, baud rate and flavour: all that can be built."""
    mega = product(["mega"], ["MCP4922", "MCP4728"], ["AD7606", "INTERNAL"], [250000, 115200], FLAVOURS)
    return [*mega, *product(["uno"], ["MCP4922"], ["INTERNAL"], [250000, 115200], FLAVOURS)]


FAST = (
    ("mega", "MCP4728", "AD7606", 250000, "arduino"),  # the slowest
    ("mega", "MCP4922", "INTERNAL", 115200, "platformio"),
    ("uno", "MCP4922", "INTERNAL", 250000, "make"),
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("which", "dac", "converter", "baud", "flavour"),
    [pytest.param(*each, marks=[] if each in FAST else pytest.mark.slow) for each in combinations()],
)
def test_it_keeps_its_time(
    board_factory: Callable[..., Board], build: Callable[..., Path], which: str, dac: str, converter: str, baud: int, flavour: str
) -> None:
    """Under the worst load no pass takes its whole millisecond, and signs of life come twice as often as the interrupt needs them."""
    options = f"-DDAC=DAC_{dac} -DADC_TENSION=ADC_{converter} -DBAUD={baud}L"
    board = board_factory(build(which, options, flavour), mcu={"mega": "atmega2560", "uno": "atmega328p"}[which])
    board.line(baud)
    host = Host(board)
    host.ready()
    late, good, sequence = host.status["late"], host.status["good"], host.sequence
    load = Load(host, {"mega": 6, "uno": 3}[which], baud)
    board.watch()
    load.run(1.5)
    host.run(0.03)
    good, sequence, bad = host.status["good"] - good, host.sequence - sequence, host.status["bad"]
    refused = host.status["refused"], host.status["stale"]
    armed = host.state is State.ARMED and host.status["sequence"] == host.sequence
    for _ in range(3):
        load.upset()
        load.run(0.15)
    gap, longest = board.worst_gap, board.longest_pass
    print(
        f"longest pass {1e6 * longest:.0f} us, worst gap {1e6 * gap:.0f} us, idle {100 * board.idle:.0f} %, {board.step_counts.sum()} steps"
    )
    assert armed
    assert refused == (0, 0)
    assert good % 2**16 > sequence  # every set point, and the requests
    assert bad > 100
    assert board.step_counts.sum() > 6000 * load.motors
    assert host.status["late"] == late
    assert longest < 1e-3
    assert gap <= 200e-6


def test_every_option_is_in_the_fast_tests() -> None:
    """Each value of each option at least once."""
    assert set(FAST) <= set(combinations())
    for position in range(5):
        assert {each[position] for each in FAST} == {each[position] for each in combinations()}


@pytest.mark.slow
def test_without_optimisation_it_does_not_build(tmp_path: Path, firmware: Path) -> None:
    """A pass would be late: the compiler says so."""
    assert firmware.exists()
    with pytest.raises(RuntimeError, match="without optimisation the main loop is late"):
        build_with(tmp_path, "OPTIONS=-O0")


def build_with(folder: Path, *variables: str) -> None:
    """Build for a Mega, or raise what make said."""
    done = subprocess.run(["make", "-s", "-C", str(FIRMWARE), f"OUT={folder}", *variables], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr)


def test_an_unknown_flavour_is_refused(tmp_path: Path, firmware: Path) -> None:
    assert firmware.exists()
    with pytest.raises(RuntimeError, match="FLAVOUR=cmake; valid: make, arduino, platformio"):
        build_with(tmp_path, "FLAVOUR=cmake")


def told(*variables: str) -> list[str]:
    """What make would do."""
    done = subprocess.run(["make", "-n", "-C", str(FIRMWARE), *variables], capture_output=True, text=True, check=True)
    return [line for line in done.stdout.splitlines() if line.startswith("avrdude")]


@pytest.mark.usefixtures("firmware")
def test_flash_goes_through_the_boot_loader(tmp_path: Path) -> None:
    """The flash memory only, with the loader of the board; a Mega's is too large to be erased as a whole."""
    assert told("flash", f"OUT={tmp_path}", "PORT=/dev/ttyUSB3") == [
        f"avrdude -p atmega2560 -c wiring -b 115200 -D -P /dev/ttyUSB3 -U flash:w:{tmp_path}/tepm.hex:i"
    ]
    assert told("flash", f"OUT={tmp_path}", "BOARD=uno") == [
        f"avrdude -p atmega328p -c arduino -b 115200 -P /dev/ttyACM0 -U flash:w:{tmp_path}/tepm.hex:i"
    ]


@pytest.mark.usefixtures("firmware")
@pytest.mark.parametrize(("board", "mcu"), [("mega", "atmega2560"), ("uno", "atmega328p")])
def test_fuses(board: str, mcu: str) -> None:
    """Two bytes, by a programmer, and nothing is erased: Arduino's but for a brown-out at 4.3 V and an EEPROM that outlives chip erase."""
    (line,) = told("fuses", f"BOARD={board}", "PROGRAMMER=avrispmkII")
    words = line.split()
    assert words[:5] == ["avrdude", "-p", mcu, "-c", "avrispmkII"]
    written = dict(word.removesuffix(":m").split(":w:") for word in words[6::2])
    assert words[5::2] == ["-U", "-U"]
    arduino = fuses_of_arduino(board)
    assert int(written["hfuse"], 16) == arduino["high"] & ~0b1000  # EESAVE is bit 3; 0 is programmed
    assert int(written["efuse"], 16) == arduino["extended"] & ~0b111 | 0b100  # BODLEVEL: 100 is 4.3 V, 101 is 2.7 V
    assert arduino["extended"] & 0b111 == 0b101


def fuses_of_arduino(board: str) -> dict[str, int]:
    """High and extended fuses in the Arduino core's list of boards."""
    names = {"mega": "mega.menu.cpu.atmega2560.bootloader", "uno": "uno.bootloader"}
    lines = Path("/usr/share/arduino/hardware/arduino/avr/boards.txt").read_text(encoding="utf-8").splitlines()
    listed = dict(line.split("=", 1) for line in lines if line.startswith(names[board]))
    return {which: int(listed[f"{names[board]}.{which}_fuses"], 16) for which in ("high", "extended")}


@pytest.mark.usefixtures("firmware")
def test_the_arduino_flavour_has_arduinos_flags(tmp_path: Path) -> None:
    """All that platform.txt of the core gives the compiler and the linker, and nothing of make's own but for the emulated gcc."""
    lines = Path("/usr/share/arduino/hardware/arduino/avr/platform.txt").read_text(encoding="utf-8").splitlines()
    recipe = dict(line.split("=", 1) for line in lines if "=" in line)
    given = {name: recipe[f"compiler.{name}.flags"].replace("{compiler.warning_flags}", "-w").split() for name in ("c", "cpp", "c.elf")}
    command = ["make", "-n", "-C", str(FIRMWARE), f"OUT={tmp_path}", "FLAVOUR=arduino"]
    done = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    commands = {name: next(line.split() for line in done if words in line) for name, words in COMMANDS.items()}
    for name, flags in given.items():
        assert set(flags) <= set(commands[name])
        assert {flag for flag in commands[name] if flag.startswith(("-f", "-O", "-s", "-std", "-W"))} == {
            flag for flag in flags if flag.startswith(("-f", "-O", "-s", "-std", "-W"))
        }
    assert not [flag for flag in commands["cpp"] if flag.startswith(("-DBUILD", "-DLIMITS", "-DSERIAL"))]


COMMANDS = {"c": "core/wiring.c.o", "cpp": "/link.o", "c.elf": "tepm.elf "}


def test_sketch_and_project_are_in_the_folder() -> None:
    """The sketch has the folder's name and no code; the project takes the sources of the folder, and make has all of them."""
    assert [path.name for path in FIRMWARE.glob("*.ino")] == [f"{FIRMWARE.name}.ino"]
    sketch = (FIRMWARE / f"{FIRMWARE.name}.ino").read_text(encoding="utf-8")
    assert all(line.startswith("//") for line in sketch.splitlines())
    project = configparser.ConfigParser()
    project.read(FIRMWARE / "platformio.ini", encoding="utf-8")
    assert project["platformio"]["src_dir"] == "."
    assert {project[f"env:{name}"]["board"] for name in ("mega", "uno")} == {"megaatmega2560", "uno"}
    assert project["env"]["framework"] == "arduino"
    assert project["env"]["build_src_filter"] == "+<*.cpp>"
    listed = next(line for line in (FIRMWARE / "Makefile").read_text(encoding="utf-8").splitlines() if line.startswith("SOURCES"))
    assert set(listed.split()[2:]) == {path.name for path in FIRMWARE.glob("*.cpp")}
    for path in FIRMWARE.glob("*.cpp"):
        includes = [line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("#include")]
        assert includes[0] == '#include "fast.h"', path


def test_the_package_ships_them() -> None:
    """The wheel takes the whole package; no pattern leaves out a part of the firmware."""
    root = FIRMWARE.parents[2]
    settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert settings == {"packages": ["tepm_opt"]}
    names = [str(path.relative_to(root)) for path in FIRMWARE.iterdir() if path.is_file()]
    done = subprocess.run(["git", "check-ignore", *names], cwd=root, capture_output=True, text=True)
    if done.returncode == 128:
        pytest.skip("this is no git repository")
    assert done.stdout == ""
    assert {f"tepm_opt/hw/firmware/{name}" for name in ("firmware.ino", "platformio.ini", "Makefile", "fast.h")} <= set(names)
