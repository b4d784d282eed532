"""The bench without hardware: its board keeps the host's rules, and a rig on it is one like any other."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.hw.board.errors import LinkError
from tepm_opt.hw.board.limits import Limits
from tepm_opt.hw.board.protocol import ARM, CLEAR, SET, STATUS, TO_HOST, Decoder, State, frame
from tepm_opt.hw.board.rig import SerialRig
from tepm_opt.hw.emulation.bench import EmulatedBench
from tepm_opt.hw.emulation.board import EmulatedBoard
from tepm_opt.hw.registry import open_rig
from tepm_opt.hw.rig import Command
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.models.robot import load_robot, parse_robot, robot_text
from tests.hw.test_loop import undisturbed

ROBOT = load_robot("kang2017")
LIMITS = Limits.from_robot(ROBOT)


class VirtualPort:
    """A line to the board in virtual time, in which it sends STATUS every 5 ms."""

    def __init__(self) -> None:
        self.time, self.board, self.command = 0.0, EmulatedBoard(ROBOT), Command.from_inputs(np.zeros(12))
        self._answers = b""

    def clock(self) -> float:
        """The time in s."""
        return self.time

    def read(self, timeout: float) -> bytes:
        """As `Port.read`."""
        if not self._answers:
            self.time += min(timeout, 0.005)
            self.command = self.board.outputs(self.time, 0.005)
            self.board.sense(self.command.pressures, self.command.tensions)
            return self.board.status(self.time)
        data, self._answers = self._answers, b""
        return data

    def write(self, data: bytes) -> None:
        """As `Port.write`."""
        self._answers += self.board.receive(data, self.time)

    def close(self) -> None:
        """Nothing to close."""


def test_a_rig_moves_what_the_board_gives_out() -> None:
    """To the resolution of its codes; a host that falls silent is stopped after 0.1 s, and pressure then falls at 1 MPa/s."""
    port = VirtualPort()
    rig = SerialRig(port, ROBOT, clock=port.clock, threaded=False)
    wanted = np.r_[np.linspace(0.5e5, 3e5, 6), np.linspace(1, 6, 6)]
    for _ in range(20):
        rig.apply(Command.from_inputs(wanted))
        sample = rig.read()
    np.testing.assert_allclose(port.command.pressures, wanted[:6], atol=300)
    np.testing.assert_allclose(port.command.tensions, wanted[6:], atol=1e-3)
    assert sample.tensions is not None
    np.testing.assert_allclose(sample.tensions, wanted[6:], atol=1e-3)
    silent = port.time
    while port.board.state is State.ARMED:
        port.read(0.005)
    assert 0.085 < port.time - silent < 0.11  # the last set point was sent up to 10 ms before
    assert not port.command.tensions.any()
    assert port.command.pressures.max() > 2e5
    while port.time < silent + 0.1 + 0.35:
        port.read(0.005)
    assert not port.command.pressures.any()
    with pytest.raises(LinkError, match="HOST_TIMEOUT"):
        rig.apply(Command.from_inputs(wanted))


def set_point(session: int, sequence: int, pressure: int = 100, tendon: int = 4000) -> bytes:
    """A SET with equal values for all actuators."""
    values = {"pressures": [pressure] * 6, "tendons": [tendon] * 6}
    return frame(SET.pack(session=session, sequence=sequence, enabled=0x3F, **values))


def test_only_new_set_points_of_the_session_within_limits_move() -> None:
    board, decoder = EmulatedBoard(ROBOT), Decoder(TO_HOST)

    def status() -> dict[str, int]:
        return next(values for kind, values in decoder.feed(board.status(0.0)) if kind is STATUS)

    board.receive(set_point(status()["session"], 1), 0.0)  # not armed
    assert (status()["stale"], status()["refused"]) == (1, 0)
    board.receive(frame(ARM.pack(id=1, session=status()["session"], limits=LIMITS.check ^ 1)), 0.0)
    assert board.state is State.IDLE
    board.receive(frame(ARM.pack(id=2, session=status()["session"], limits=LIMITS.check)), 0.0)
    assert board.state is State.ARMED
    session = status()["session"]
    board.receive(set_point(session, 5), 0.0)
    first = board.outputs(0.0, 0.0)
    assert first.pressures.min() > 0
    for wrong in (set_point(session, 5, 200), set_point(session - 1, 6, 200)):
        board.receive(wrong, 0.0)
    board.receive(set_point(session, 6, LIMITS.pressure_max + 1), 0.0)
    board.receive(set_point(session, 6, 100, LIMITS.tension_max + 1), 0.0)
    assert (status()["stale"], status()["refused"]) == (3, 2)
    np.testing.assert_array_equal(board.outputs(0.0, 0.0).pressures, first.pressures)
    board.receive(frame(CLEAR.pack(id=3, session=session)), 0.0)
    assert board.state is State.ARMED


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[str]:
    """A living bench; the text of its rig. Its robot file is beside the port."""
    import socket

    with socket.create_server(("127.0.0.1", 0)) as free:
        number = free.getsockname()[1]
    text = robot_text("kang2017") + f'\n[hardware.tracker]\nport = {number}\ndevices = ["A", "B", "C", "D"]\nlatency_s = 0.015\n'
    (tmp_path / "robot.toml").write_text(text)
    link = parse_robot(text, "robot.toml").hardware
    assert link
    assert link.tracker
    with EmulatedBench(SimulatedRig(watched=False), tmp_path / "port", link.tracker) as emulated:
        ended = threading.Event()
        thread = threading.Thread(target=emulated.run, args=(ended.is_set,), daemon=True)
        thread.start()
        yield f"serial:{tmp_path / 'port'}"
        ended.set()
        thread.join(10)
    assert not (tmp_path / "port").is_symlink()


@pytest.mark.slow
def test_the_whole_chain_in_real_time(bench: str) -> None:
    """Serial port, board, arm and tracker: a pull of a tendon is weighed, and the arm bends."""
    robot = load_robot(Path(bench.removeprefix("serial:")).parent / "robot.toml")

    def pull() -> list:
        samples = []
        with open_rig(bench, robot) as rig:
            for k in range(150):
                rig.apply(Command.from_inputs(np.eye(12)[9] * min(k / 40, 2.0)))
                samples.append(rig.read())
        return samples

    samples = undisturbed(pull)
    last = [sample for sample in samples[-30:] if np.isfinite(sample.points).all()]
    assert last
    assert np.median([sample.tensions[3] for sample in last]) == pytest.approx(2.0, abs=0.05)
    assert np.linalg.norm(np.median([sample.points[-1] for sample in last], axis=0) - [0, 0, 0.35]) > 5e-3


def test_a_taken_path_is_refused(tmp_path: Path) -> None:
    taken = tmp_path / "port"
    taken.write_text("")
    link = parse_robot(robot_text("kang2017") + '\n[hardware.tracker]\ndevices = ["A", "B", "C", "D"]\n', "f").hardware
    assert link
    assert link.tracker
    with pytest.raises(InputError, match="a file is there"):
        EmulatedBench(SimulatedRig(), taken, link.tracker)
    assert taken.read_text() == ""
