"""An OpenIGTLink server of the simulated arm's sensors, as PlusServer is one."""

from __future__ import annotations

import contextlib
import socket
import time

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Sample
from tepm_opt.models.hardware import TrackerLink

VALID = {"TransformValid": "True", "TransformStatus": "OK"}
"""Metadata of a pose that is seen, as PlusServer writes it."""


class PoseServer:
    """Sends the points of samples as poses to all who are connected.

    Args:
        link: host, port and names of the sensors.

    Raises:
        InputError: the port is taken.
    """

    def __init__(self, link: TrackerLink) -> None:
        self._link, self._clients = link, list[socket.socket]()
        try:
            self._server = socket.create_server((link.host, link.port))
        except OSError as error:
            raise taken_port(link.host, link.port, error) from error
        self._server.setblocking(False)

    def show(self, sample: Sample) -> None:
        """Send a sample's points."""
        with contextlib.suppress(BlockingIOError):
            client, _ = self._server.accept()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._clients.append(client)
        data = b"".join(self._pose(name, point) for name, point in zip(self._link.devices, sample.points, strict=True))
        for client in self._clients.copy():
            try:
                client.sendall(data)
            except OSError:
                client.close()
                self._clients.remove(client)

    def _pose(self, device: str, point: np.ndarray) -> bytes:
        """A TRANSFORM message; of a lost sensor the identity, and its metadata say so."""
        from pyigtl import TransformMessage

        pose, seen = np.eye(4), bool(np.isfinite(point).all())
        if seen:
            pose[:3, 3] = self._link.units_per_m * point
        message = TransformMessage(pose, timestamp=time.time(), device_name=device)
        message.header_version, message.metadata = 2, VALID if seen else {"TransformValid": "False", "TransformStatus": "MISSING"}
        return bytes(message.pack())

    def close(self) -> None:
        """End all connections; a second time does nothing."""
        for each in (*self._clients, self._server):
            each.close()


def taken_port(host: str, port: int, error: OSError) -> InputError:
    """The error of a server whose port is taken."""
    return InputError(f"{host}:{port}: the tracker's server cannot listen there ({error.strerror}); name a free port")
