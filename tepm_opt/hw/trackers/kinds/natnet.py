"""OptiTrack's NatNet by the package natnet: rigid bodies by name, and markers of marker sets as "SET/marker"."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from types import ModuleType
from typing import Any

from tepm_opt.data.documents import Section
from tepm_opt.hw.trackers.poses import marker_position, rigid_body_pose
from tepm_opt.hw.trackers.receiver import CONNECT_S, Inbox, Pose, StreamReceiver, require_package
from tepm_opt.hw.trackers.tracker import TrackerKind
from tepm_opt.models.hardware import TrackerLink

ASK_S = 0.5
"""Pause between two requests for the names: an answer may be lost on its way."""


class NatNetOptions(Section):
    """Options of NatNet."""

    multicast: str = ""
    """Group that the server sends to, as Motive's 239.255.42.99; empty: it sends to this machine only (unicast)."""
    data_port: int = 1511
    """Port of the group's data."""
    interface: str = "0.0.0.0"
    """This machine's address towards the server, where it has several."""


class _Stream:
    """Frames that the client's threads put into a queue, with the names that the server told.

    Args:
        client: `natnet.NatNetClient`, connected; its handlers are set here.
    """

    def __init__(self, client: Any) -> None:
        self._client, self._frames = client, SimpleQueue[Any]()
        self._names: Any = None
        self._outdated, self._asked = True, -ASK_S
        client.on_data_frame_received_event.handlers.append(self._frames.put)
        client.on_data_description_received_event.handlers.append(self._set_names)

    def poll(self, timeout: float) -> list[Pose]:
        """See `Stream`; nothing before the names are known."""
        if self._outdated and time.monotonic() - self._asked > ASK_S:
            self._asked = time.monotonic()
            self._client.request_modeldef()
        poses = list[Pose]()
        try:
            poses += self._poses(self._frames.get(timeout=timeout))
            while True:
                poses += self._poses(self._frames.get_nowait())
        except Empty:
            return poses

    def _set_names(self, names: Any) -> None:
        self._names, self._outdated = names, False

    def _poses(self, frame: Any) -> list[Pose]:
        names = self._names
        self._outdated |= frame.suffix.tracked_models_changed
        if names is None:
            return []
        bodies = {each.id_num: each.name for each in names.rigid_bodies}
        markers = {each.name: each.marker_names for each in names.marker_sets}
        stamp, poses = frame.suffix.timestamp, list[Pose]()
        for body in frame.rigid_bodies:
            if name := bodies.get(body.id_num):
                poses.append(Pose(name, None if body.tracking_valid is False else rigid_body_pose(body.pos, body.rot), stamp))
        for each in frame.marker_sets:
            marked = zip(markers.get(each.model_name, ()), each.marker_pos_list, strict=False)
            poses += [Pose(f"{each.model_name}/{marker}", marker_position(position), stamp) for marker, position in marked]
        return poses


@contextmanager
def _connect(natnet: ModuleType, link: TrackerLink, options: NatNetOptions) -> Iterator[_Stream]:
    """Ask the server for its version, then receive in the client's threads, which end with this one's connection."""
    group = {"multicast_address": options.multicast} if options.multicast else {}
    client = natnet.NatNetClient(
        link.host, options.interface, command_port=link.port, data_port=options.data_port, use_multicast=bool(group), **group
    )
    try:
        try:
            client.connect(CONNECT_S)
        except TimeoutError as error:
            raise ConnectionError(f"no answer within {CONNECT_S:g} s") from error
        stream = _Stream(client)
        client.run_async()
        yield stream
    finally:
        client.shutdown()


def _receive(link: TrackerLink, options: Section, inbox: Inbox) -> StreamReceiver:
    """Begin to receive."""
    assert isinstance(options, NatNetOptions)
    natnet = require_package("natnet", "natnet", "tracker natnet")
    return StreamReceiver(lambda: _connect(natnet, link, options), inbox)


NATNET = TrackerKind("natnet", "OptiTrack by NatNet", _receive, "Motive with NatNet streaming on", NatNetOptions, port=1510, needs="natnet")
