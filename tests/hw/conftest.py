"""The emulated board, built once for the tests of a process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from tepm_opt.hw.simulation.rig import SimulatedRig
from tests.hw import emulator
from tests.hw.emulator import Board
from tests.hw.emulator.host import Host
from tests.hw.emulator.world import World

PRESSURE_MAX = 2275
"""DAC code of 0.5 MPa, the firmware's hard limit."""


@pytest.fixture(scope="session")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The firmware for a Mega, as a lab would flash it."""
    if lacking := emulator.missing():
        pytest.skip(lacking)
    return emulator.build_firmware(tmp_path_factory.mktemp("firmware"))


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The emulator as a library."""
    if lacking := emulator.missing():
        pytest.skip(lacking)
    return emulator.build_emulator(tmp_path_factory.mktemp("emulator"))


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
def build(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    """Builds other firmware: for a board, with options."""
    if lacking := emulator.missing():
        pytest.skip(lacking)
    return cache(lambda board, options: emulator.build_firmware(tmp_path_factory.mktemp("other"), board, options))


@pytest.fixture
def world(board: Board) -> World:
    """A board with nothing on it, its line and its time."""
    return World(board)


@pytest.fixture
def robot_world(board: Board) -> World:
    """A board that drives the virtual prototype."""
    return World(board, SimulatedRig())
