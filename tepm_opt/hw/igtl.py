"""The line to an OpenIGTLink server.

pyigtl packs and unpacks the messages. Its client keeps only the newest message of a device, takes a closed connection for a quiet one (and
then burns a core), forgets the first half of a header that comes in two pieces, and cannot be stopped while messages come faster than every
10 ms. So only its receiving and unpacking are used here: the connection, its end and the queue are this file's.
"""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable

from pyigtl import MessageBase, OpenIGTLinkClient, TransformMessage

from tepm_opt.hw.tracker import WAIT_PERIODS, FrameAssembler

WATCHDOG_S, CONNECT_S, RETRY_S = 1.0, 1.0, 0.05
"""Without a usable pose for so long the connection is made anew; for how long that is tried; pause between two attempts."""
LARGEST_BODY = 1 << 27
"""Bytes of a message beyond which what comes is not OpenIGTLink."""


class Client(OpenIGTLinkClient):
    """A receiving connection in a thread of its own: what comes goes to `frames` at once; a connection that ends is made anew.

    It is itself what pyigtl's receiver takes for socket and inbox: pieces come whole, the end is an error.

    Args:
        host, port: of the server.
        frames: take the poses.
        arrived: held while they do, notified when a frame is ready.
        clock: the host's, in s.

    Attributes:
        connections: made so far.
    """

    def __init__(self, host: str, port: int, frames: FrameAssembler, arrived: threading.Condition, clock: Callable[[], float]) -> None:
        super().__init__(host, port, start_now=False)
        self.frames, self.arrived, self.clock, self.connections = frames, arrived, clock, 0
        self.incoming_messages = self  # in place of a dictionary with the newest message of each device
        self._bytes, self._received = bytearray(), 0.0
        self.start()

    def _client_thread_function(self) -> None:
        try:
            while not self.communication_thread_stop_requested:
                try:
                    with socket.create_connection((self.host, self.port), CONNECT_S) as self.socket:
                        self._listen()
                except (OSError, UnicodeError):  # refused, closed, silent, or not OpenIGTLink
                    self._connected = False
                    time.sleep(RETRY_S)
        finally:
            self.communication_thread_stopped = True

    def _listen(self) -> None:
        self._bytes.clear()
        with self.arrived:
            self.frames.restart(self.clock())
            self.connections += 1
        self._connected = True
        while not self.communication_thread_stop_requested:
            try:
                self._receive_message_from_socket(self)
            except (OSError, UnicodeError):
                raise
            except Exception:  # a body that pyigtl cannot unpack; the next header is where it should be
                with self.arrived:
                    self.frames.counts["malformed"] += 1
            if self.clock() - self.frames.progress > WATCHDOG_S:
                raise ConnectionError("silent, or only old poses")

    def recv(self, count: int) -> bytes:
        """`count` bytes; TimeoutError, with nothing lost, if they are not there yet; ConnectionError if they will never be."""
        if count > LARGEST_BODY or self.socket is None:
            raise ConnectionError(f"a message of {count} bytes")
        while len(self._bytes) < count:
            self.socket.settimeout(WAIT_PERIODS * self.frames.period if self.frames.pending else RETRY_S)
            try:
                chunk = self.socket.recv(1 << 16)
            except TimeoutError:
                with self.arrived:
                    self.frames.flush(self.clock())
                    self.arrived.notify_all()
                raise
            if not chunk or self.communication_thread_stop_requested:
                raise ConnectionError("closed")
            self._received = self.clock()
            self._bytes += chunk
        piece = bytes(self._bytes[:count])
        del self._bytes[:count]
        return piece

    def __setitem__(self, name: str, message: MessageBase) -> None:
        """What pyigtl does with a message: it goes on to the frames at once."""
        if isinstance(message, TransformMessage):
            valid = message.metadata.get("Status", "OK") == "OK"
            with self.arrived:
                self.frames.take(name, message.timestamp, message.matrix if valid else None, self._received)
                if self.frames.ready:
                    self.arrived.notify_all()
