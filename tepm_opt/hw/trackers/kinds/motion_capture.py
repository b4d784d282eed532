"""Vicon, OptiTrack, Qualisys and VRPN by the package motioncapture (libmotioncapture), in a process of its own: it blocks."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal

from tepm_opt.data.documents import Section
from tepm_opt.errors import InputError
from tepm_opt.hw.trackers import motion_capture_process
from tepm_opt.hw.trackers.motion_capture_process import ANSWER_S
from tepm_opt.hw.trackers.poses import rigid_body_pose
from tepm_opt.hw.trackers.receiver import Inbox, Pose, StreamReceiver, require_package
from tepm_opt.hw.trackers.tracker import TrackerKind
from tepm_opt.models.hardware import TrackerLink

START_S = 10.0
"""Longest time until the process has started and connected; Python starts slowly on a busy machine."""
PORTS = {"vicon": 801, "optitrack": 1510, "qualisys": 22222, "vrpn": 3883}
"""Usual port of each system: of its data stream, of NatNet's commands, QTM's base port, VRPN's."""


class MotionCaptureOptions(Section):
    """Options of motioncapture."""

    system: Literal["vicon", "optitrack", "qualisys", "vrpn", "mock"]
    """System of cameras, as the package names it; "mock" has the devices stand still without any."""
    interface: str = "0.0.0.0"
    """This machine's address towards OptiTrack's cameras, where it has several."""


def connection_settings(link: TrackerLink, options: MotionCaptureOptions, address: str) -> dict[str, str]:
    """The library's settings for a link.

    Args:
        link: has port, rate and devices.
        options: of the kind.
        address: of the link's host, in numbers.
    """
    match options.system:
        case "optitrack":
            return {"hostname": address, "port_command": str(link.port), "interface_ip": options.interface}
        case "qualisys":
            return {"hostname": address, "port": str(link.port), "enable_pointcloud": "false"}
        case "mock":
            bodies = ";".join(f"{name}({0.1 * k:g},0,0,1,0,0,0)" for k, name in enumerate(link.devices, 1))
            return {"frequency": f"{link.rate_hz:.0f}", "rigid_bodies": bodies}
        case _:
            return {"hostname": f"{address}:{link.port}"}


class _Stream:
    """Frames of the process; VRPN's bodies come when they like, elsewhere a body that is missing from a frame is lost.

    Args:
        line: the process writes to it.
        process: started.
        tells_loss: whether a missing body is lost.
    """

    def __init__(self, line: Connection, process: subprocess.Popen[bytes], tells_loss: bool) -> None:
        self._line, self._process, self._tells_loss, self._known = line, process, tells_loss, set[str]()

    def connect(self) -> None:
        """Wait until it is connected.

        Raises:
            ConnectionError: it is not, and why.
        """
        if not self._line.poll(START_S):
            raise ConnectionError(f"motioncapture did not start within {START_S:g} s")
        if trouble := self._receive():
            raise ConnectionError(trouble)

    def poll(self, timeout: float) -> list[Pose]:
        """See `Stream`."""
        poses = list[Pose]()
        while self._line.poll(timeout):
            arrival, bodies = self._receive()
            timeout = 0.0
            poses += [Pose(name, rigid_body_pose(each[:3], each[3:]), arrival) for name, each in bodies.items()]
            if self._tells_loss:
                poses += [Pose(name, None, arrival) for name in self._known.difference(bodies)]
                self._known.update(bodies)
        return poses

    def _receive(self) -> Any:
        """The next message.

        Raises:
            ConnectionError: the process has ended.
        """
        try:
            return self._line.recv()
        except EOFError as error:
            status = self._process.wait()
            silent = status == -signal.SIGALRM
            raise ConnectionError(f"no answer within {ANSWER_S:g} s" if silent else f"motioncapture ended with status {status}") from error


@contextmanager
def _connect(link: TrackerLink, options: MotionCaptureOptions) -> Iterator[_Stream]:
    """Start the process and wait until it is connected; it is killed in the end, since the library cannot be interrupted.

    It has a session of its own: Ctrl-C is the host's to handle, which may need the tracker meanwhile.
    """
    settings = connection_settings(link, options, socket.gethostbyname(link.host))
    ours, theirs = Pipe(duplex=False)
    command = [sys.executable, "-P", str(Path(motion_capture_process.__file__)), str(theirs.fileno()), options.system, json.dumps(settings)]
    with ours, theirs:
        process = subprocess.Popen(
            command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            start_new_session=True,
        )  # fmt: skip
        try:
            theirs.close()
            stream = _Stream(ours, process, options.system != "vrpn")
            stream.connect()
            yield stream
        finally:
            process.kill()
            process.wait()


def _receive(link: TrackerLink, options: Section, inbox: Inbox) -> StreamReceiver:
    """Begin to receive."""
    assert isinstance(options, MotionCaptureOptions)
    require_package("motioncapture", "motioncapture", "tracker motioncapture")
    usual = PORTS.get(options.system)
    if usual and link.port == TrackerLink.model_fields["port"].default:
        raise InputError(f"hardware.tracker.port: {link.port} is not for {options.system}; valid: the server's port, usually {usual}")
    return StreamReceiver(lambda: _connect(link, options), inbox)


MOTION_CAPTURE = TrackerKind(
    "motioncapture",
    "Vicon, OptiTrack, Qualisys or VRPN, by libmotioncapture",
    _receive,
    "the camera system's server",
    MotionCaptureOptions,
    needs="motioncapture",
)
