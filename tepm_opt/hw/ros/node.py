"""A part of the ROS graph in a thread of its own: whoever publishes never waits, and a connection that ends is made anew."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from types import TracebackType

from tepm_opt.errors import InputError
from tepm_opt.hw.ros.bridge import PORT, SERVER, Message, Rosbridge
from tepm_opt.hw.trackers.receiver import CONNECT_S, RETRY_S

WAIT_S = 0.005
"""Longest time in s after which messages that came are looked at, while nothing is published."""
TRIGGER = "std_srvs/srv/Trigger"

Build = Callable[[], Mapping[str, Message]]
"""Makes messages by topic; called in the node's thread."""


def parse_address(text: str) -> tuple[str, int]:
    """Host and port of `HOST` or `HOST:PORT`; of an IPv6 address in brackets where a port follows.

    Raises:
        InputError: the port is none.
    """
    host, colon, port = text.rpartition(":")
    if not colon or text.endswith("]") or (":" in host and not host.endswith("]")):
        host, port = text, str(PORT)
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise InputError(f"ROS at {text!r}: valid: HOST or HOST:PORT, such as localhost:{PORT}")
    return host.strip("[]"), int(port)


class RosNode:
    """Topics and services by a rosbridge. Use it as a context manager.

    Args:
        address: `HOST:PORT` of rosbridge.
        topics: types of the topics that are published, by name.
        subscriptions: types of topics that are taken, and what takes a message, by name. It is called in the node's thread.
        triggers: services of the type std_srvs/Trigger, by name, and what they do once they are answered.
        most: builds that wait at most; where more come the oldest are dropped.

    Attributes:
        dropped: builds that were not sent.
        trouble: why there is no connection; empty while there is one.

    Raises:
        InputError: websocket-client is not installed, or nobody answers.
    """

    def __init__(
        self,
        address: str,
        topics: Mapping[str, str],
        subscriptions: Mapping[str, tuple[str, Callable[[Message], None]]] | None = None,
        triggers: Mapping[str, Callable[[], None]] | None = None,
        most: int = 200,
    ) -> None:
        self._address, self._topics = parse_address(address), topics
        self._subscriptions, self._triggers = subscriptions or {}, triggers or {}
        self._waiting, self._wake, self._closing = deque[Build](maxlen=most), threading.Event(), threading.Event()
        self.dropped, self.trouble = 0, ""
        try:
            first = Rosbridge(*self._address)
        except InputError:
            raise
        except Exception as error:  # whatever websocket-client raises where nobody answers
            raise InputError(f"ROS at {address}: nobody answers ({_words(error)}); valid: host and port of {SERVER}") from error
        self._thread = threading.Thread(target=self._run, args=(first,), name="ros", daemon=True)
        self._thread.start()

    def publish(self, build: Build) -> None:
        """Publish what `build` makes, soon, without waiting."""
        self.dropped += len(self._waiting) == self._waiting.maxlen
        self._waiting.append(build)
        self._wake.set()

    def close(self) -> None:
        """Send what waits and close the connection; a second time does nothing."""
        self._closing.set()
        self._wake.set()
        self._thread.join(2 * CONNECT_S)

    def _run(self, first: Rosbridge) -> None:
        bridge: Rosbridge | None = first
        while bridge is not None or not self._closing.is_set():
            try:
                with bridge or Rosbridge(*self._address) as line:
                    self._introduce(line)
                    self.trouble = ""
                    self._serve(line)
            except Exception as error:  # whatever websocket-client raises where its server is gone
                self.trouble = _words(error)
                self._closing.wait(RETRY_S)
            bridge = None

    def _introduce(self, line: Rosbridge) -> None:
        for topic, kind in self._topics.items():
            line.send("advertise", topic=topic, type=kind)
        for topic, (kind, _) in self._subscriptions.items():
            line.send("subscribe", topic=topic, type=kind, compression="none")
        for service in self._triggers:
            line.send("advertise_service", service=service, type=TRIGGER)

    def _serve(self, line: Rosbridge) -> None:
        """Send and take by turns until it is closed; where more is published than can be sent, what comes is taken all the same."""
        while self._waiting or not self._closing.is_set():
            if not self._waiting:
                self._wake.wait(WAIT_S)
                self._wake.clear()
            else:
                for topic, message in self._waiting.popleft()().items():
                    line.send("publish", topic=topic, msg=message)
            while (found := line.receive(0.0)) is not None:
                self._take(line, found)

    def _take(self, line: Rosbridge, found: Message) -> None:
        if found.get("op") == "publish" and found.get("topic") in self._subscriptions:
            self._subscriptions[found["topic"]][1](found["msg"])
        elif found.get("op") == "call_service" and (service := str(found.get("service"))) in self._triggers:
            values = {"success": True, "message": ""}
            line.send("service_response", id=found.get("id"), service=service, values=values, result=True)
            self._triggers[service]()

    def __enter__(self) -> RosNode:
        """The node itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close."""
        self.close()


def _words(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
