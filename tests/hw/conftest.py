"""The emulated board, built once for all processes of a test session."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from zlib import crc32

import pytest

from tepm_opt.hw.simulation.rig import SimulatedRig
from tests.hw import emulator
from tests.hw.emulator import Board
from tests.hw.emulator.frames import Frames, build_frames
from tests.hw.emulator.host import Host
from tests.hw.emulator.world import World

PRESSURE_MAX = 2275
"""DAC code of 0.5 MPa, the firmware's hard limit."""


def once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], Path]) -> Path:
    """What `make` builds in a folder; the first of all processes of a test session builds it, the others wait and take it."""
    import fcntl

    base = factory.getbasetemp().parent if "PYTEST_XDIST_WORKER" in os.environ else factory.getbasetemp()
    folder, built = base / name, base / f"{name}.built"
    with (base / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not built.exists():
            folder.mkdir(exist_ok=True)
            built.write_text(str(make(folder)))
        return Path(built.read_text())


def emulated(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], Path]) -> Path:
    """As `once`; skips where the emulated board cannot be built."""
    if lacking := emulator.missing():
        pytest.skip(lacking)
    return once(factory, name, make)


@pytest.fixture(scope="session")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The firmware for a Mega, as a lab would flash it."""
    return emulated(tmp_path_factory, "firmware", emulator.build_firmware)


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The emulator as a library."""
    return emulated(tmp_path_factory, "emulator", emulator.build_emulator)


@pytest.fixture(scope="session")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The emulator as a program with a pseudo-terminal."""
    return emulated(tmp_path_factory, "program", lambda folder: emulator.build_emulator(folder, program=True))


@pytest.fixture(scope="session")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Frames:
    """The firmware's frames, compiled for this machine."""
    return Frames(once(tmp_path_factory, "frames", build_frames))


@pytest.fixture
def board_factory(firmware: Path, library: Path) -> Iterator[Callable[..., Board]]:
    """Makes boards at power-on: with the firmware for a Mega, or with what is given.

    At the end of a test it looks at all of them: whatever happened, no DAC ever gave more than the hard limit, and no motor made a step
    that was not enabled.
    """
    made: list[Board] = []

    def make(elf: Path = firmware, **options: Any) -> Board:
        made.append(Board(library, elf, **options))
        return made[-1]

    yield make
    for board in made:
        assert board.dac_peak.max() <= PRESSURE_MAX
        assert board.idle_steps == 0


@pytest.fixture
def board(board_factory: Callable[..., Board]) -> Board:
    """A board at power-on."""
    return board_factory()


@pytest.fixture
def host(board: Board) -> Host:
    """A bare host on that board, at power-on."""
    return Host(board)


@pytest.fixture
def armed(host: Host) -> Host:
    """A bare host on an armed board."""
    host.ready()
    return host


@pytest.fixture(scope="session")
def build(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Builds other firmware: for a board, with options, with the flags of make or of another builder."""

    def make(board: str, options: str, flavour: str = "make") -> Path:
        name = f"firmware-{board}-{flavour}-{crc32(options.encode()):08x}"
        return emulated(tmp_path_factory, name, lambda folder: emulator.build_firmware(folder, board, options, flavour))

    return make


@pytest.fixture
def world(board: Board) -> World:
    """A board with nothing on it, its line and its time."""
    return World(board)


@pytest.fixture
def robot_world(board: Board) -> World:
    """A board that drives the virtual prototype."""
    return World(board, SimulatedRig())
