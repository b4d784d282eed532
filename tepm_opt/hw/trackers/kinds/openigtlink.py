"""The line to an OpenIGTLink server, which may be broken: lengths are not believed, memory is bounded, and one that stalls is left.

pyigtl unpacks the bodies of poses. The connection, its end, headers and the queue are this file's.
"""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Mapping

from pyigtl import TransformMessage

from tepm_opt.data.documents import Section
from tepm_opt.hw.trackers.frames import WAIT_PERIODS
from tepm_opt.hw.trackers.receiver import CONNECT_S, RETRY_S, WATCHDOG_S, Inbox
from tepm_opt.hw.trackers.tracker import TrackerKind
from tepm_opt.models.hardware import TrackerLink

LARGEST_POSE, LARGEST_BODY = 1 << 16, 1 << 27
"""Bytes of a pose with all its metadata, and of a message beyond which what comes is not OpenIGTLink."""
VERSIONS = (1, 2, 3)
_HEADER = struct.Struct(">H12s20sIIQQ")  # version, type, device, stamp in s and its fraction, bytes of the body, checksum
_CHUNK = 1 << 16
STATUS_KEYS = {"transformstatus": "OK", "transformvalid": "true", "status": "OK", "valid": "true"}
"""Metadata keys that say whether a pose is valid, in lower case, and the only value that says that it is. PlusServer writes the first two
(PlusLib, vtkPlusIgtlMessageCommon.cxx); any of them may begin with the device's name. `Status` alone is what this package once expected."""
WHOLE_NAME = "IGTL_DEVICE_NAME"
"""Metadata key of a device's name that is too long for the header, where PlusServer cuts it off."""


def is_valid(metadata: Mapping[str, str], device: str) -> bool:
    """Whether a pose is valid by its metadata; without metadata about its status it is a plain pose, which is valid.

    Args:
        metadata: of the message; none in version 1 of the header.
        device: its name. Keys that begin with it stand for those that begin with another device's name.
    """
    told: dict[str, list[bool]] = {}
    for key, value in metadata.items():
        low = key.lower()
        for name in ("transformstatus", "transformvalid"):
            if low.endswith(name):
                told.setdefault(low.removesuffix(name), []).append(_means_valid(value, STATUS_KEYS[name]))
                break
        else:
            for name in ("status", "valid"):
                if low in (name, device.lower() + name):
                    told.setdefault(low.removesuffix(name), []).append(_means_valid(value, STATUS_KEYS[name]))
    own = [told.get(prefix, []) for prefix in ("", device.lower())]
    about = own if device.lower() in told else list(told.values())
    return all(all(each) for each in about)


def _means_valid(value: str, wanted: str) -> bool:
    """Whether a value is the one that means a valid pose; "true" in any case of letters, "OK" exactly."""
    return value == wanted if wanted == "OK" else value.lower() == wanted


class Client:
    """A receiving connection in a thread of its own: what comes goes to `frames` at once; a connection that ends is made anew.

    Args:
        host, port: of the server.
        inbox: takes the poses.

    Attributes:
        connections: made so far.
        trouble: why the last connection ended, or could not be made; empty once a pose has come.
    """

    def __init__(self, host: str, port: int, inbox: Inbox) -> None:
        self.frames, self.arrived, self.clock, self.connections, self.trouble = inbox.frames, inbox.arrived, inbox.clock, 0, ""
        self._address, self._bytes, self._received, self._stopping = (host, port), bytearray(), 0.0, threading.Event()
        self._thread = threading.Thread(target=self._run, name="tracker", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Close the connection; a second time does nothing."""
        self._stopping.set()
        self._thread.join(2 * CONNECT_S)  # a name server may take longer; the thread ends then

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                with socket.create_connection(self._address, CONNECT_S) as line:
                    self._listen(line)
            except (OSError, UnicodeError) as error:  # refused, closed, stalled, or not OpenIGTLink; a host's name that is none
                self.trouble = getattr(error, "strerror", None) or str(error)
                self._stopping.wait(RETRY_S)

    def _listen(self, line: socket.socket) -> None:
        self._bytes.clear()
        with self.arrived:
            self.frames.restart(self.clock())
            self.connections += 1
        while not self._stopping.is_set():
            version, kind, name, seconds, fraction, size, _ = _HEADER.unpack(self._take(line, _HEADER.size))
            if version not in VERSIONS or size > LARGEST_BODY:
                raise ConnectionError(f"what comes is not OpenIGTLink (a message of version {version} with {size} bytes)")
            if _text(kind) != "TRANSFORM":
                self._skip(line, size)
            elif size > LARGEST_POSE:
                self._skip(line, size)
                self._count_malformed()
            else:
                fields = {"header_version": version, "message_type": "TRANSFORM", "device_name": _text(name)}
                self._unpack({**fields, "timestamp": seconds + fraction / 2**32}, self._take(line, size))

    def _unpack(self, header: dict[str, object], body: bytes) -> None:
        message = TransformMessage()
        try:
            message.unpack(header, body)
            valid = is_valid(message.metadata, message.device_name)
        except Exception:  # whatever pyigtl makes of bytes that are no pose; the next header is where it should be
            self._count_malformed()
            return
        if not message.device_name.isprintable():
            self._count_malformed()
            return
        whole = message.metadata.get(WHOLE_NAME, "")
        device = whole if whole in self.frames.link.devices else message.device_name
        with self.arrived:
            self.frames.take(device, message.timestamp, message.matrix if valid else None, self._received)
            if self.frames.ready:
                self.arrived.notify_all()
                self.trouble = ""

    def _count_malformed(self) -> None:
        with self.arrived:
            self.frames.counts["malformed"] += 1

    def _take(self, line: socket.socket, count: int) -> bytes:
        """`count` bytes, at most `LARGEST_POSE`."""
        while len(self._bytes) < count:
            self._wait(line)
        piece = bytes(self._bytes[:count])
        del self._bytes[:count]
        return piece

    def _skip(self, line: socket.socket, count: int) -> None:
        """Let `count` bytes go by, of which no more than a chunk is kept at a time."""
        while len(self._bytes) < count:
            count -= len(self._bytes)
            self._bytes.clear()
            self._wait(line)
        del self._bytes[:count]

    def _wait(self, line: socket.socket) -> None:
        """Wait a moment for bytes; meanwhile a frame that waited too long for its missing sensors is made without them.

        Raises:
            ConnectionError: there will be none, or what came for a second, however much, held no usable pose.
        """
        self._flush(self._received)  # bytes that came since, but have no end yet, are not what it waits for
        line.settimeout(WAIT_PERIODS * self.frames.period if self.frames.pending else RETRY_S)
        try:
            chunk = line.recv(_CHUNK)
        except TimeoutError:
            self._flush(self.clock())
        else:
            if not chunk:
                raise ConnectionError("closed by the server")
            self._received = self.clock()
            self._bytes += chunk
        if self._stopping.is_set():
            raise ConnectionError("stopped")
        if self.clock() - self.frames.progress > WATCHDOG_S:
            raise ConnectionError(f"no usable pose came for {WATCHDOG_S:g} s")

    def _flush(self, now: float) -> None:
        if self.frames.pending:
            with self.arrived:
                self.frames.flush(now)
                self.arrived.notify_all()


def _text(field: bytes) -> str:
    """The text of a field that ends with zeros."""
    return field.partition(b"\0")[0].decode(errors="replace").rstrip()


def _receive(link: TrackerLink, _: Section, inbox: Inbox) -> Client:
    """Begin to receive."""
    return Client(link.host, link.port, inbox)


SERVER = "a running OpenIGTLink server (PlusServer)"
OPENIGTLINK = TrackerKind("openigtlink", "OpenIGTLink, as PlusServer gives it", _receive, SERVER, port=18944, units_per_m=1000.0)
