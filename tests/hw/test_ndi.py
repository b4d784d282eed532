"""An NDI system keeps the contract of trackers: ndicapi talks to one behind a pseudo-terminal, and to one in the network."""

from __future__ import annotations

import os
import select
import socket
import threading
import time
import tty
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tepm_opt.errors import InputError
from tepm_opt.hw.trackers import open_link
from tepm_opt.models.hardware import TrackerLink
from tepm_opt.testing import TrackerContract
from tepm_opt.testing.trackers import Motion, motion_of_arm
from tests.hw.test_tracker_contracts import Sensors

pytest.importorskip("ndicapy", reason="ndicapi is not installed (extra ndi)")

RATE, LATENCY, DEVICES, HANDLES = 60.0, 0.05, ("tool 1", "tool 2", "tool 3", "tool 4"), (0x0A, 0x0B, 0x0D, 0x10)


def crc16(text: str) -> str:
    """Checksum of the combined API: CRC-16 with the reversed polynomial A001, four hexadecimal digits."""
    value = 0
    for byte in text.encode():
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0xA001 * (value & 1)
    return f"{value:04X}"


class NdiStandIn(Sensors):
    """An NDI system with four tools that answers commands as the combined API says, mm, without time stamps.

    Attributes:
        log: names of the commands that came.
        spoil: so many of the next replies to TX have a wrong checksum.
        memory: what was written for a tool without a cable.
    """

    latency_s = LATENCY

    def __init__(self) -> None:
        super().__init__()
        self.log, self.spoil, self.memory = list[str](), 0, bytearray(1024)
        self._states, self._frame, self._shown = dict.fromkeys(HANDLES, 2), 0, list[np.ndarray | None]()

    def answer(self, line: str) -> str:
        """Reply to a command line, both without the carriage return."""
        command, _, rest = line.partition(":")
        given, checksum = rest[:-4], rest[-4:]
        self.log.append(command)
        reply = "ERROR04" if crc16(f"{command}:{given}") != checksum else self._reply(command, given)
        if command == "TX" and self.spoil:
            self.spoil -= 1
            return reply + "0000"
        return reply + crc16(reply)

    def _reply(self, command: str, given: str) -> str:
        if command == "INIT":
            self._states = dict.fromkeys(HANDLES, 2)
        elif command == "PHSR":
            found = [handle for handle, state in self._states.items() if state == int(given)]
            return f"{len(found):02X}" + "".join(f"{handle:02X}001" for handle in found)
        elif command == "PHRQ":
            self._states[0x02] = 2
            return "02"
        elif command == "PVWR":
            place = int(given[2:6], 16)
            self.memory[place : place + 64] = bytes.fromhex(given[6:])
        elif command in ("PINIT", "PENA"):
            wanted, handle = (2, given) if command == "PINIT" else (3, given[:2])
            if self._states.get(int(handle, 16)) != wanted:
                return "ERROR08"
            self._states[int(handle, 16)] = wanted + 1
        elif command == "TX":
            return self._tracked()
        elif command not in ("COMM", "TSTART", "TSTOP"):
            return "ERROR01"
        return "OKAY"

    def _tracked(self) -> str:
        if (frame := int(time.monotonic() * RATE)) != self._frame:
            self._frame, self._shown = frame, self.poses()
        text = f"{len(HANDLES):02X}"
        for handle, pose in zip(HANDLES, self._shown, strict=True):
            text += f"{handle:02X}{_transform(pose)}{0x31:08X}{frame:08X}\n"
        return text + "0000"


def _transform(pose: np.ndarray | None) -> str:
    """Quaternion with four decimals, place in mm with two, error with four, all without points; or MISSING."""
    if pose is None:
        return "MISSING"
    x, y, z, real = Rotation.from_matrix(pose[:3, :3]).as_quat()
    turn = "".join(f"{round(1e4 * each):+06d}" for each in (real, x, y, z))
    return turn + "".join(f"{round(1e5 * each):+07d}" for each in pose[:3, 3]) + f"{123:+06d}"


class SerialStandIn(NdiStandIn):
    """At a serial port: a pseudo-terminal, whose name stays when it is unplugged and plugged in again."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._path, self._ends = folder / "ttyUSB0", tuple[int, ...]()
        self._running, self._thread = threading.Event(), threading.Thread()
        self.link = TrackerLink(kind="ndi", options={"device": str(self._path)}, devices=DEVICES, rate_hz=RATE)

    def start(self, motion: Motion) -> None:
        """See `StandIn`."""
        self._motion, self._ends = motion, os.openpty()
        tty.setraw(self._ends[1])
        self._path.unlink(missing_ok=True)
        self._path.symlink_to(os.ttyname(self._ends[1]))
        self._running.set()
        self._thread = threading.Thread(target=self._serve, args=self._ends[:1], daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """See `StandIn`."""
        self._running.clear()
        if self._ends:
            self._thread.join()
            for end in self._ends:
                os.close(end)
        self._ends = ()
        self._path.unlink(missing_ok=True)

    def _serve(self, end: int) -> None:
        waiting = b""
        while self._running.is_set():
            if select.select([end], [], [], 0.05)[0]:
                *lines, waiting = (waiting + os.read(end, 4096)).split(b"\r")
                for line in lines:
                    os.write(end, self.answer(line.decode()).encode() + b"\r")


@pytest.mark.slow
class TestNdi(TrackerContract):
    """Tools of a system at a serial port; places have two decimals of a mm, the arrival is the time stamp."""

    position_m = 3e-4

    @pytest.fixture(autouse=True)
    def _folder(self, tmp_path: Path) -> None:
        self.folder = tmp_path

    def stand_in(self) -> SerialStandIn:
        """Not started yet."""
        return SerialStandIn(self.folder)


def test_poses_of_tools_at_a_serial_port(tmp_path: Path) -> None:
    """Rotations and places come through; a reply with a wrong checksum is left out and ends nothing."""
    server, motion = SerialStandIn(tmp_path), motion_of_arm()
    server.noise_m, still = 0.0, motion(0.3)
    server.start(lambda _: still.copy())
    try:
        with open_link(server.link, stale_periods=60) as tracker:
            frame = tracker.first(10.0)
            np.testing.assert_allclose(frame.transforms, still, atol=2e-4)
            np.testing.assert_allclose(frame.points, still[:, :3, 3], atol=1e-5)
            server.spoil = 3
            time.sleep(0.2)
            assert server.spoil == 0
            assert tracker.read(1.0)
            assert tracker.statistics.reconnects == 0
    finally:
        server.stop()
    assert server.log[:3] == ["INIT", "COMM", "PHSR"]
    assert server.log[-2:] == ["TSTOP", "COMM"]


def test_a_tool_without_a_cable_is_defined_by_its_file(tmp_path: Path) -> None:
    """The file is sent as it is; its tool comes first, so that those at the ports count on from there."""
    content = bytes(np.random.default_rng(4).integers(0, 256, 752, dtype=np.uint8))
    (tmp_path / "probe.rom").write_bytes(content)
    server = SerialStandIn(tmp_path)
    server.start(motion_of_arm())
    options, devices = {**server.link.options, "roms": str(tmp_path / "probe.rom")}, ("tool 2", "tool 3", "tool 4", "tool 5")
    try:
        with open_link(server.link.model_copy(update={"options": options, "devices": devices}), stale_periods=60) as tracker:
            assert np.isfinite(tracker.first(10.0).points).all()
    finally:
        server.stop()
    assert bytes(server.memory[:752]) == content
    with pytest.raises(InputError, match=r"other\.rom: cannot be read"):
        open_link(server.link.model_copy(update={"options": {**options, "roms": "other.rom"}}))


def test_poses_of_tools_by_network() -> None:
    """At host and port, without a change of speed; two connections: whether anybody is there, and the one that stays."""
    server, motion, listener = NdiStandIn(), motion_of_arm(), socket.create_server(("127.0.0.1", 0))
    server.noise_m, still = 0.0, motion(0.3)
    server._motion = lambda _: still.copy()

    def serve() -> None:
        with suppress(OSError):
            while True:
                line, _ = listener.accept()
                with line, line.makefile("rb") as lines, suppress(OSError):
                    waiting = b""
                    while chunk := lines.read1(4096):
                        *whole, waiting = (waiting + chunk).split(b"\r")
                        for each in whole:
                            line.sendall(server.answer(each.decode()).encode() + b"\r")

    threading.Thread(target=serve, daemon=True).start()
    try:
        link = TrackerLink(kind="ndi", port=listener.getsockname()[1], devices=DEVICES, rate_hz=RATE)
        with open_link(link, stale_periods=60) as tracker:
            np.testing.assert_allclose(tracker.first(10.0).points, still[:, :3, 3], atol=1e-5)
    finally:
        listener.close()
    assert "COMM" not in server.log


def test_nobody_in_the_network() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    wrong = pytest.raises(InputError, match=f"127.0.0.1:{port}: nothing listens there .*refused")
    with open_link(TrackerLink(kind="ndi", port=port, devices=DEVICES)) as tracker, wrong:
        tracker.first(0.3)
