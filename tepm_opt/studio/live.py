"""The view of a closed loop that a terminal runs (`tepm mpc --view`): it shows and has nothing to press."""

from __future__ import annotations

import time
from types import TracebackType

import numpy as np

from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.robot import Robot
from tepm_opt.studio.loop import Moment, Pace
from tepm_opt.studio.moments import MomentNode, Trace, describe_moment
from tepm_opt.studio.scene import prepare
from tepm_opt.studio.server import start, stop
from tepm_opt.studio.worker import Worker

FRAME = 1 / 30  # s: a controller beside it has work to do


class LiveView:
    """A page that shows a rig's samples as they come. It takes no commands, and nothing waits for what it draws.

    Args:
        robot: of the rig.
        paced: whether `show` waits for a sample's time to come, for rigs of virtual time.
        title: of the page.
        port: to listen at, or the next free one above it; any where 0.

    Attributes:
        address: to open in a browser, once.

    Raises:
        InputError: viser is not installed.
    """

    def __init__(self, robot: Robot, paced: bool = False, title: str = "tepm mpc", port: int = 0) -> None:
        self._server, gate = start(title, port)
        self.address = gate.address
        prepare(self._server, robot)
        self._node, self._trace = MomentNode(self._server.scene, robot, robot.input_max), Trace()
        self._words = self._server.gui.add_markdown("waiting for the first sample …")
        self._worker = Worker(lambda error: None, FRAME)
        self._pace = Pace() if paced else None
        self._last: float | None = None

    def show(self, sample: Sample, command: Command, target: np.ndarray, nodes: np.ndarray | None = None) -> None:
        """Take a sample; what is drawn is the newest.

        Args:
            sample: as read.
            command: given then.
            target: of the tip, (3,) in m.
            nodes: true nodes in G where they are known, (n + 1, actuators, 3) in m.
        """
        if self._pace is not None and self._last is not None:
            self._pace(sample.time - self._last)
        self._last = sample.time
        moment = Moment.from_sample(sample, command, target, None if nodes is None else nodes.copy())
        self._trace.add(moment)
        self._worker.ask("moment", lambda: self._draw(moment))

    def _draw(self, moment: Moment) -> None:
        path = self._trace.path
        with self._server.atomic():
            self._node.show(moment, path)
            self._words.content = describe_moment(moment, path)

    def wait_for_somebody(self, seconds: float = 10.0) -> bool:
        """Wait until a browser shows the page; whether one does by then."""
        end = time.monotonic() + seconds
        while not self._server.get_clients() and time.monotonic() < end:
            time.sleep(0.05)
        return bool(self._server.get_clients())

    def settle(self) -> bool:
        """Wait until the newest sample is drawn; whether it was."""
        return self._worker.settle()

    def close(self) -> None:
        """End the page."""
        self._worker.close()
        stop(self._server)

    def __enter__(self) -> LiveView:
        """The view itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """End the page."""
        self.close()
