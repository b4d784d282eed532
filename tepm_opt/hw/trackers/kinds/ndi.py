"""NDI's trackers, Aurora, Polaris and Vega, through their combined API: over a serial port, or by network where they have it."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from tepm_opt.data.documents import Section
from tepm_opt.errors import InputError
from tepm_opt.hw.trackers.receiver import CONNECT_S, Inbox, Pose, StreamReceiver, require_package
from tepm_opt.hw.trackers.tracker import TrackerKind
from tepm_opt.models.hardware import TrackerLink

PAUSE_S = 1e-3
"""Until a system that has no new frame yet is asked again."""
MOST_ROUNDS = 4
"""Rounds of making tools ready: one that has two sensors shows the second only once the first is."""

ROM_BYTES, ROM_CHUNK = 1024, 64
"""Length of a tool's definition, and of the part that one command sends."""


class NdiOptions(Section):
    """Options of an NDI system.

    Attributes:
        device: its serial port, such as /dev/ttyUSB0; empty: it is asked by network, at the link's host and port.
        baud: speed of the serial port while it tracks.
        roms: definition files (SROM) of tools without a cable, separated by commas; these tools are counted first.
    """

    device: str = ""
    baud: Literal[9600, 14400, 19200, 38400, 57600, 115200, 230400] = 115200
    roms: Annotated[str, Field(description="paths of .rom files, separated by commas")] = ""


class _System:
    """A system that tracks: "tool 1" and so on by the order of its port handles.

    Args:
        ndi: the module ndicapy.
        device: as `ndi` opened it.
        options: baud rate of a serial port.
        roms: definitions of tools, each `ROM_BYTES` long.

    Raises:
        OSError: it does not answer, or refuses a command.
        ConnectionError: no tool is there.
    """

    def __init__(self, ndi: Any, device: Any, options: NdiOptions, roms: Sequence[bytes]) -> None:
        self._ndi, self._device, self._frame = ndi, device, -1
        try:
            ndi.ndiINIT(device)
        except OSError:  # it is still at the speed of a session that did not end well
            ndi.ndiRESET(device)
            ndi.ndiINIT(device)
        if options.device:
            speed = getattr(ndi, f"NDI_{options.baud}")
            ndi.ndiCOMM(device, speed, ndi.NDI_8N1, ndi.NDI_NOHANDSHAKE)
        for handle in self._handles(1):  # those that are to be freed
            ndi.ndiCommand(device, f"PHF:{handle:02X}")
        for rom in roms:
            ndi.ndiCommand(device, "PHRQ:*********1****")
            handle = ndi.ndiGetPHRQHandle(device)
            for at in range(0, ROM_BYTES, ROM_CHUNK):  # ndiPVWRFromFile would keep all other threads of Python waiting
                ndi.ndiCommand(device, f"PVWR:{handle:02X}{at:04X}{rom[at : at + ROM_CHUNK].hex().upper()}")
        for _ in range(MOST_ROUNDS):
            for handle in self._handles(2):
                ndi.ndiCommand(device, f"PINIT:{handle:02X}")
            for handle in self._handles(3):
                ndi.ndiCommand(device, f"PENA:{handle:02X}D")
        self._tools = {f"tool {k}": bytes([handle]) for k, handle in enumerate(sorted(self._handles(4)), start=1)}
        if not self._tools:
            raise ConnectionError("the system has no tool; valid: tools at its ports, or option roms")
        ndi.ndiTSTART(device)

    def _handles(self, which: int) -> list[int]:
        """Port handles: 1 to be freed, 2 to be initialised, 3 initialised, 4 enabled."""
        self._ndi.ndiCommand(self._device, f"PHSR:{which:02X}")
        return [self._ndi.ndiGetPHSRHandle(self._device, k) for k in range(self._ndi.ndiGetPHSRNumberOfHandles(self._device))]

    def poll(self, timeout: float) -> list[Pose]:
        """See `Stream`: the tools' poses if there is a new frame. Its number orders frames; the arrival stands for the time stamp.

        Raises:
            OSError: it does not answer, or refuses.
        """
        try:
            self._ndi.ndiTX(self._device, self._ndi.NDI_XFORMS_AND_STATUS)
        except OSError:
            if self._ndi.ndiGetError(self._device) != self._ndi.NDI_BAD_CRC:
                raise
            return []  # noise on the line; the next reply is whole
        frame = max(self._ndi.ndiGetTXFrame(self._device, handle) for handle in self._tools.values())
        if frame == self._frame:
            time.sleep(min(timeout, PAUSE_S))
            return []
        self._frame = frame
        return [Pose(name, _pose(self._ndi.ndiGetTXTransform(self._device, handle))) for name, handle in self._tools.items()]

    def stop(self, options: NdiOptions) -> None:
        """End tracking; a serial port goes back to the speed at which the next session begins."""
        with suppress(OSError):  # it is gone
            self._ndi.ndiTSTOP(self._device)
            if options.device:
                self._ndi.ndiCOMM(self._device, self._ndi.NDI_9600, self._ndi.NDI_8N1, self._ndi.NDI_NOHANDSHAKE)


def _pose(transform: tuple[float, ...] | str) -> np.ndarray | None:
    """Pose, (4, 4) in mm, of a quaternion (real part first), a place and an error; None of "MISSING" or "DISABLED"."""
    if isinstance(transform, str):
        return None
    real, *imaginary = transform[:4]
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat([*imaginary, real]).as_matrix()
    pose[:3, 3] = transform[4:7]
    return pose


def _read_rom(path: str) -> bytes:
    """A tool's definition.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        return Path(path).read_bytes()[:ROM_BYTES].ljust(ROM_BYTES, b"\0")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; valid: a tool's definition, a .rom file") from error


def _receive(link: TrackerLink, options: Section, inbox: Inbox) -> StreamReceiver:
    """Begin to receive.

    Raises:
        InputError: ndicapi is not installed; a ROM file cannot be read.
    """
    assert isinstance(options, NdiOptions)
    ndi = require_package("ndicapy", "ndi", "tracker ndi")
    roms = [_read_rom(path) for path in filter(None, map(str.strip, options.roms.split(",")))]

    @contextmanager
    def connect() -> Iterator[_System]:
        if options.device:
            device, close = ndi.ndiOpen(options.device), ndi.ndiClose
        else:
            socket.create_connection((link.host, link.port), CONNECT_S).close()  # ndicapi itself takes a refused connection for one
            device, close = ndi.ndiOpenNetwork(link.host, link.port), ndi.ndiCloseNetwork
        if not device:
            raise ConnectionError(f"{options.device or link.host} does not open")
        try:
            system = _System(ndi, device, options, roms)
            try:
                yield system
            finally:
                system.stop(options)
        finally:
            close(device)

    return StreamReceiver(connect, inbox)


def _place(link: TrackerLink) -> str | None:
    return str(link.options.get("device", "")) or None


SERVER = "an NDI system; one at a serial port has option device"
NDI = TrackerKind(
    "ndi", "NDI Aurora, Polaris and Vega", _receive, SERVER, NdiOptions, port=8765, units_per_m=1000.0, needs="ndicapy", place=_place
)
