"""A stand-in for rosbridge on the loopback: its JSON protocol, version 2, over the least of RFC 6455 that clients use.

It routes topics between its clients and the test as a ROS graph would, and forwards calls of services that a client offers.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import json
import queue
import socket
import struct
import threading
from collections import defaultdict
from typing import Any

MAGIC = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"  # RFC 6455, section 1.3
TEXT, CLOSE, PING, PONG = 1, 8, 9, 10
Message = dict[str, Any]


class RosbridgeStandIn:
    """Serves on a port of its own, which it keeps over `stop` and `start`.

    Attributes:
        port: of the loopback.
        types: of the topics and services that clients advertised, by name.
        messages: published by clients, by topic, in order.
        responses: to calls of services.
        reading: cleared: it stops taking what clients send.
    """

    def __init__(self) -> None:
        self.port, self.types, self.messages = 0, dict[str, str](), defaultdict[str, list[Message]](list)
        self.responses: queue.Queue[Message] = queue.Queue()
        self.reading = threading.Event()
        self.reading.set()
        self._lock, self._subscribers, self._lines = threading.Lock(), defaultdict[str, list[socket.socket]](list), list[socket.socket]()
        self._services, self._listener = dict[str, socket.socket](), None

    def start(self) -> None:
        """Begin to serve."""
        self._listener = socket.create_server(("127.0.0.1", self.port))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, args=(self._listener,), daemon=True).start()

    def stop(self) -> None:
        """End all connections and stop listening."""
        listener, self._listener = self._listener, None
        if listener is not None:
            with contextlib.suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)
            listener.close()
        with self._lock:
            lines, self._lines = self._lines, []
            self._subscribers.clear()
            self._services.clear()
        for line in lines:
            with contextlib.suppress(OSError):
                line.shutdown(socket.SHUT_RDWR)

    def has_subscriber(self, topic: str) -> bool:
        """Whether a client takes a topic."""
        return bool(self._subscribers[topic])

    def publish(self, topic: str, message: Message) -> None:
        """Publish, as another node would."""
        with self._lock:
            for line in self._subscribers[topic]:
                with contextlib.suppress(OSError):
                    _send(line, {"op": "publish", "topic": topic, "msg": message})

    def call(self, service: str, timeout: float = 5.0) -> Message:
        """Call a service that a client offers; its response."""
        with self._lock:
            _send(self._services[service], {"op": "call_service", "id": "call:1", "service": service, "args": {}})
        return self.responses.get(timeout=timeout)

    def _accept(self, listener: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while True:
                line = listener.accept()[0]
                line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=self._serve, args=(line,), daemon=True).start()

    def _serve(self, line: socket.socket) -> None:
        with contextlib.suppress(OSError, EOFError), line, line.makefile("rb") as stream:
            key = next(row.split(b":")[1].strip() for row in stream if row.lower().startswith(b"sec-websocket-key:"))
            for _ in iter(lambda: stream.readline().strip(), b""):  # the rest of the request
                pass
            accept = base64.b64encode(hashlib.sha1(key + MAGIC).digest())
            line.sendall(
                b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: "
                + accept
                + b"\r\n\r\n"
            )
            with self._lock:
                self._lines.append(line)
            while True:
                self.reading.wait()
                kind, payload = _receive(stream)
                if kind == CLOSE:
                    break
                if kind == PING:
                    _frame(line, PONG, payload)
                elif kind == TEXT:
                    self._take(line, json.loads(payload))
        with self._lock:
            for lines in self._subscribers.values():
                if line in lines:
                    lines.remove(line)

    def _take(self, line: socket.socket, message: Message) -> None:
        match message["op"]:
            case "subscribe":
                with self._lock:
                    self._subscribers[message["topic"]].append(line)
            case "advertise":
                self.types[message["topic"]] = message["type"]
            case "advertise_service":
                self.types[message["service"]] = message["type"]
                self._services[message["service"]] = line
            case "service_response":
                self.responses.put(message)
            case "publish":
                assert message["topic"] in self.types, "rosbridge refuses what was not advertised"
                self.messages[message["topic"]].append(message["msg"])
                self.publish(message["topic"], message["msg"])


def _read(stream: Any, count: int) -> bytes:
    found = stream.read(count)
    if len(found) < count:
        raise EOFError
    return found


def _receive(stream: Any) -> tuple[int, bytes]:
    """Kind and payload of a client's frame, which is masked and not fragmented."""
    first, second = _read(stream, 2)
    size = second & 127
    if size > 125:
        size = struct.unpack(">H" if size == 126 else ">Q", _read(stream, 2 if size == 126 else 8))[0]
    assert first & 128, "a fragment"
    assert second & 128, "a client masks"
    mask, payload = _read(stream, 4), _read(stream, size)
    key = (mask * (size // 4 + 1))[:size]
    return first & 15, (int.from_bytes(payload) ^ int.from_bytes(key)).to_bytes(size)


def _send(line: socket.socket, message: Message) -> None:
    _frame(line, TEXT, json.dumps(message).encode())


def _frame(line: socket.socket, kind: int, payload: bytes) -> None:
    size = len(payload)
    header = bytes([128 | kind]) + (bytes([size]) if size < 126 else struct.pack(">BH", 126, size))
    line.sendall(header + payload)
