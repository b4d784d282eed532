"""A connection to rosbridge: its JSON protocol, version 2, by websocket-client.

roslibpy is not used: it buffers without bound what a stalled rosbridge does not take, and cannot say so; a control loop has to drop it.
"""

from __future__ import annotations

import json
import select
import socket
from collections.abc import Mapping
from types import TracebackType
from typing import Any

from tepm_opt.hw.trackers.receiver import CONNECT_S, require_package

PORT = 9090
"""Default of rosbridge_server."""
SERVER = "a running rosbridge (ros2 launch rosbridge_server rosbridge_websocket_launch.xml)"

Message = Mapping[str, Any]
"""A ROS message, or one of the protocol, as JSON has it."""


class Rosbridge:
    """A connection; use it as a context manager.

    Args:
        host, port: of rosbridge.

    Raises:
        InputError: websocket-client is not installed.
        Exception: nobody answers within a second, here and in all methods: as websocket-client and sockets do.
    """

    def __init__(self, host: str, port: int) -> None:
        websocket = require_package("websocket", "ros2", "ROS 2")
        address = f"[{host}]" if ":" in host else host
        options = ((socket.IPPROTO_TCP, socket.TCP_NODELAY, 1),)
        self._socket = websocket.create_connection(f"ws://{address}:{port}", timeout=CONNECT_S, sockopt=options)

    def send(self, op: str, **fields: Any) -> None:
        """Send an operation of the protocol; one that is not taken within a second ends the connection."""
        self._socket.send(json.dumps({"op": op, **fields}))

    def receive(self, timeout: float) -> Message | None:
        """The next operation, waiting at most `timeout` in s for it to begin; None if there is none.

        Raises:
            ConnectionError: closed by rosbridge, or what comes is none.
        """
        if not select.select([self._socket.sock], [], [], timeout)[0]:
            return None
        text = self._socket.recv()  # it reads no further than the frame's end, and answers pings
        if not text:
            raise ConnectionError("closed by rosbridge")
        found = json.loads(text)
        if not isinstance(found, dict):
            raise ConnectionError("what comes is not of rosbridge's protocol")
        return found

    def close(self) -> None:
        """Close it without waiting for an answer."""
        self._socket.shutdown()

    def __enter__(self) -> Rosbridge:
        """The connection itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close."""
        self.close()
