"""The topics of a run for Foxglove, without ROS: a websocket server of foxglove-sdk with the messages that ROS gets, as JSON."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from tepm_opt.errors import InputError
from tepm_opt.hw.ros.bridge import Message
from tepm_opt.hw.ros.messages import TF, TOPICS
from tepm_opt.hw.ros.node import Build
from tepm_opt.hw.trackers.receiver import require_package

PORT = 8765
"""Default of Foxglove."""
SCHEMAS = {"geometry_msgs/msg/PoseStamped": "foxglove.PoseInFrame", "tf2_msgs/msg/TFMessage": "foxglove.FrameTransforms"}
"""Names of Foxglove's own schemas for types that its 3D view shows; all others keep their name."""
_ANY = b'{"type": "object"}'


class FoxgloveServer:
    """Serves what is published; the newest messages win where a client is slow.

    Args:
        port: of this machine; 0 takes any.
        service: name of the service that stops.
        stop: what it does.

    Attributes:
        dropped: builds that were not sent.
        port: that was taken.

    Raises:
        InputError: foxglove-sdk is not installed, or the port is taken.
    """

    def __init__(self, port: int, service: str, stop: Callable[[], None]) -> None:
        foxglove, websocket = (require_package(name, "foxglove", "--foxglove") for name in ("foxglove", "foxglove.websocket"))

        def handle(request: Any) -> bytes:
            threading.Timer(0.0, stop).start()  # once it is answered
            return json.dumps({"success": True, "message": ""}).encode()

        def schema(name: str) -> Any:
            return foxglove.Schema(name=name, encoding="jsonschema", data=_ANY)

        ends = [websocket.MessageSchema(encoding="json", schema=schema(f"std_srvs/srv/Trigger_{end}")) for end in ("Request", "Response")]
        offered = websocket.Service(
            service, schema=websocket.ServiceSchema("std_srvs/srv/Trigger", request=ends[0], response=ends[1]), handler=handle
        )
        self._context = context = foxglove.Context()  # which the server does not keep
        try:
            self._server = foxglove.start_server(
                name="tepm", port=port, services=[offered], supported_encodings=["json"], context=context, message_backlog_size=200
            )
        except RuntimeError as error:
            raise InputError(f"Foxglove at port {port}: {error}; valid: a free port, or 0 for any") from error
        self.port: int = self._server.port
        self._channels = {
            topic: foxglove.Channel(topic, schema=schema(SCHEMAS.get(kind, kind)), message_encoding="json", context=context)
            for topic, kind in TOPICS.items()
        }
        self._waiting, self._wake, self._closing = deque[Build](maxlen=200), threading.Event(), threading.Event()
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name="foxglove", daemon=True)
        self._thread.start()

    def publish(self, build: Build) -> None:
        """See `RosNode`."""
        self.dropped += len(self._waiting) == self._waiting.maxlen
        self._waiting.append(build)
        self._wake.set()

    def close(self) -> None:
        """See `RosNode`."""
        self._closing.set()
        self._wake.set()
        self._thread.join()
        self._server.stop()

    def _run(self) -> None:
        while self._waiting or not self._closing.is_set():
            if not self._waiting:
                self._wake.wait()
                self._wake.clear()
                continue
            for topic, message in self._waiting.popleft()().items():
                self._channels[topic].log(json.dumps(_for_foxglove(topic, message)).encode())


def _for_foxglove(topic: str, message: Message) -> Message:
    """The message in Foxglove's own schema, where it has one."""
    if topic == TF:
        return {"transforms": [_with_time(each, "parent_frame_id") | each["transform"] for each in message["transforms"]]}
    return _with_time(message, "frame_id") if "pose" in message else message


def _with_time(message: Message, frame: str) -> dict[str, Any]:
    head, rest = message["header"], {key: value for key, value in message.items() if key not in ("header", "transform")}
    return {"timestamp": {"sec": head["stamp"]["sec"], "nsec": head["stamp"]["nanosec"]}, frame: head["frame_id"], **rest}
