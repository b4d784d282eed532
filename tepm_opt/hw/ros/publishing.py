"""A run that ROS can watch and stop: whatever goes over a rig is published, without that the rig or its driver waits."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import cast

import numpy as np

from tepm_opt.hw.rig import Command, Rig, Sample, Simulated
from tepm_opt.hw.ros.bridge import Message
from tepm_opt.hw.ros.foxglove import FoxgloveServer
from tepm_opt.hw.ros.messages import DIAGNOSTICS, ERROR, OK, TARGET, TOPICS, WARN, RunMessages, diagnostics, pose_stamped
from tepm_opt.hw.ros.node import RosNode

STOP = "/tepm/stop"
AGAIN_S = 1.0
"""Diagnostics are published when they change, and after so long."""


def interrupt() -> None:
    """Interrupt the main thread as Ctrl-C does, also while it waits for a rig."""
    signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


class RunPublisher:
    """Publishes runs on rigs. Use it as a context manager.

    Args:
        node: takes the messages; see `to_ros` and `to_foxglove`.
    """

    def __init__(self, node: RosNode | FoxgloveServer) -> None:
        self.node = node
        self._faults = dict[str, str]()
        self._known, self._told, self._due = dict[str, None](), ("", {}), 0.0

    def watch(self, rig: Rig) -> Rig:
        """The rig, whose samples and commands are published from now on."""
        return cast("Rig", _WatchedRig(rig, self))

    def aim(self, target: np.ndarray, faults: Mapping[str, str] | None = None) -> None:
        """Publish the tip's target, (3,) in m.

        Args:
            target: in G.
            faults: what the controller doubts, a sentence each, by what it is about.
        """
        stamp, self._faults = time.time(), dict(faults or {})
        self.node.publish(lambda: {TARGET: pose_stamped(target, stamp)})

    def show(self, messages: RunMessages, sample: Sample, age: float) -> None:
        """Publish a sample that was true `age` in s ago."""
        stamp, faults = time.time() - max(age, 0.0), {**self._faults, **sample.faults}
        self.node.publish(lambda: {**messages.of_sample(sample, stamp), **self._diagnostics(sample, faults, stamp)})

    def _diagnostics(self, sample: Sample, faults: dict[str, str], stamp: float) -> dict[str, Message]:
        """In the node's thread; a fault that has gone is told as such."""
        if (sample.status, faults) == self._told and stamp < self._due:
            return {}
        self._told, self._due = (sample.status, faults), stamp + AGAIN_S
        self._known |= dict.fromkeys(faults)
        levels = [("rig", OK if sample.status == "ok" else WARN, sample.status)]
        levels += [(name, ERROR if name in faults else OK, faults.get(name, "ok")) for name in self._known]
        return {DIAGNOSTICS: diagnostics(levels, stamp, {"time_s": f"{sample.time:.3f}", "dropped": str(self.node.dropped)})}

    def close(self) -> None:
        """Send what waits and close the connection."""
        self.node.close()

    def __enter__(self) -> RunPublisher:
        """The publisher itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close."""
        self.close()


def to_ros(address: str, stop: Callable[[], None] = interrupt) -> RunPublisher:
    """A publisher to a rosbridge.

    Args:
        address: its `HOST:PORT`.
        stop: what the service /tepm/stop does.

    Raises:
        InputError: as for `RosNode`.
    """
    return RunPublisher(RosNode(address, TOPICS, triggers={STOP: stop}))


def to_foxglove(port: int, stop: Callable[[], None] = interrupt) -> RunPublisher:
    """A publisher to whatever Foxglove connects to this port.

    Args:
        port: of this machine.
        stop: what the service /tepm/stop does.

    Raises:
        InputError: as for `FoxgloveServer`.
    """
    return RunPublisher(FoxgloveServer(port, STOP, stop))


class _WatchedRig:
    """A rig; all that is not here is the rig's own."""

    def __init__(self, rig: Rig, publisher: RunPublisher) -> None:
        self._rig, self._publisher, self._messages = rig, publisher, RunMessages(rig.robot)

    def __getattr__(self, name: str) -> object:
        return getattr(self._rig, name)

    def __repr__(self) -> str:
        return repr(self._rig)

    @property
    def simulated(self) -> Simulated | None:
        return None if self._rig.simulated is None else cast("Simulated", self)

    def read(self) -> Sample:
        sample = self._rig.read()
        self._publisher.show(self._messages, sample, self._rig.time - sample.time)
        return sample

    def read_many(self, count: int) -> list[Sample]:
        samples = cast("Simulated", self._rig).read_many(count)
        for sample in samples:
            self._publisher.show(self._messages, sample, self._rig.time - sample.time)
        return samples

    def apply(self, command: Command) -> None:
        self._rig.apply(command)
        self._publisher.node.publish(lambda: self._messages.of_command(command))

    def __enter__(self) -> Rig:
        self._rig.__enter__()
        return cast("Rig", self)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._rig.__exit__(kind, error, trace)
