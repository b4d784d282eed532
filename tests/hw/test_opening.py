"""Opening the real robot: ports by name, what is given free where it fails, and what a sample carries of the tracker's frame."""

from __future__ import annotations

import pytest

from tepm_opt.errors import InputError
from tepm_opt.hw.board import rig as rigs
from tepm_opt.hw.board.errors import LinkError
from tepm_opt.hw.board.protocol import LIMITS, Message
from tepm_opt.hw.board.rig import SerialRig, open_port, open_serial
from tepm_opt.models.robot import load_robot
from tests.hw.emulator.world import World
from tests.hw.lines import FakeBoard

ROBOT = load_robot("kang2017")


@pytest.mark.parametrize(
    ("target", "says"),
    [
        ("/dev/nope", "serial port '/dev/nope' cannot be opened"),
        ("/dev/nope@115200", "serial port '/dev/nope' cannot be opened"),
        ("/dev/nope@fast", "baud rate 'fast'; valid: a number"),
    ],
)
def test_ports_that_cannot_be_opened(target: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        open_port(target)


class Closed:
    """A port, or a log, that notes that it was closed."""

    closed = False

    def close(self) -> None:
        self.closed = True


def test_a_robot_that_does_not_open_gives_its_port_free(monkeypatch: pytest.MonkeyPatch) -> None:
    """Port and log are closed, and the reason is told."""
    port, log = Closed(), Closed()

    def refuse(*arguments: object, **options: object) -> None:
        raise LinkError("no answer")

    monkeypatch.setattr(rigs, "open_port", lambda target: (port, log))
    monkeypatch.setattr(rigs, "SerialRig", refuse)
    with pytest.raises(LinkError, match="no answer"):
        open_serial("somewhere", ROBOT)
    assert port.closed
    assert log.closed


def test_a_board_that_does_not_tell_its_limits_is_left_after_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    """It greets and answers everything else."""
    board = FakeBoard(ROBOT)
    tell = board.tell

    def tell_without_limits(kind: Message, **values: object) -> None:
        if kind is not LIMITS:
            tell(kind, **values)

    monkeypatch.setattr(board, "tell", tell_without_limits)
    with pytest.raises(LinkError, match="the board does not tell its limits within 1 s"):
        SerialRig(board, ROBOT, clock=board.clock, threaded=False)
    assert 1.0 <= board.time < 1.3


def test_samples_carry_what_the_tracker_saw(robot_world: World) -> None:
    """Points and full poses of a frame; without a tracker neither."""
    with SerialRig(robot_world.port, ROBOT, robot_world.tracker, clock=robot_world.clock, threaded=False) as rig:
        sample = rig.read()
    assert sample.status == "ok"
    assert sample.points.shape == (4, 3)
    assert sample.transforms is not None
    assert sample.transforms.shape == (4, 4, 4)
    with SerialRig(robot_world.port, ROBOT, clock=robot_world.clock, threaded=False) as rig:
        sample = rig.read()
    assert sample.status == "no tracker"
    assert sample.transforms is None
