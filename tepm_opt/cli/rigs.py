"""Shared parts of `tepm record` and `tepm play`: opening rigs, progress, and a stop that also works when the system ends the program."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from tepm_opt.cli.common import UNSOLVED, stderr
from tepm_opt.errors import InputError

if TYPE_CHECKING:
    from tepm_opt.hw.rig import Rig
    from tepm_opt.hw.ros.publishing import RunPublisher
    from tepm_opt.models.robot import Robot

RigOption = Annotated[
    str, typer.Option("--rig", help="sim, sim:FILE, replay:FILE, …: the robot simulated, a rig file's (tepm hw rig new), a recording.")
]
RosOption = Annotated[
    str | None, typer.Option("--ros", metavar="HOST:PORT", help="Publish it to ROS 2, by the rosbridge there; /tepm/stop stops it.")
]
FoxgloveOption = Annotated[
    int | None,
    typer.Option("--foxglove", min=0, max=65535, metavar="PORT", help="Serve it to Foxglove at ws://localhost:PORT; 8765 is its default."),
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, max=2**32 - 1, help="Of the noise on a simulated rig.")]


def open_rig(text: str, robot: Robot) -> Rig:
    """The rig that --rig names.

    Raises:
        InputError: no such rig.
    """
    from tepm_opt.hw import registry

    return registry.open_rig(text, robot)


def robot_there(robot: str | None, model: Path | None, rig: str) -> str | None:
    """The robot that --robot names, or that of the rig where neither --robot nor --model is given.

    Raises:
        InputError: no such rig.
    """
    from tepm_opt.hw.registry import robot_of

    return robot if robot or model else robot_of(rig)


@contextmanager
def publisher(ros: str | None, foxglove: int | None) -> Iterator[RunPublisher | None]:
    """Publishes to the ROS that --ros names, or at the port of --foxglove, where one is given.

    Raises:
        InputError: both are given, nobody answers there, the port is taken, or a package is not installed.
    """
    if ros is None and foxglove is None:
        yield None
        return
    if ros is not None and foxglove is not None:
        raise InputError("--ros and --foxglove: give one; Foxglove reads topics of ROS, too")
    from tepm_opt.hw.ros.publishing import to_foxglove, to_ros

    with to_foxglove(foxglove) if foxglove is not None else to_ros(ros or "") as found:
        yield found


def opener(text: str, robot: Robot, seed: int, live: RunPublisher | None = None) -> Callable[[int], Rig]:
    """Opens the rig that --rig names; what it is called with makes the noise of its devices another one, where they are simulated.

    Args:
        text: of --rig.
        robot: that shall be there.
        seed: of --seed.
        live: publishes what goes over the rig.

    Raises:
        InputError: when called: no such rig; or --seed is given and the rig has nothing to seed.
    """

    def open_seeded(noise: int) -> Rig:
        rig = open_rig(text, robot)
        if simulated := rig.simulated:
            simulated.reseed(noise)
        elif seed:
            raise InputError(f"--seed {seed}: rig {text!r} has no noise that can be seeded; leave the option out")
        return rig if live is None else live.watch(rig)

    return open_seeded


def report_failure(error: Exception, kept: str) -> int:
    """Print in one line why a rig failed (a simulation that leaves all bounds, a dead line); return the exit status."""
    reason = " ".join(str(error).split()) or type(error).__name__
    stderr.print(f"[bold red]the rig failed:[/] {escape(reason)}; {escape(kept)}", soft_wrap=True, highlight=False)
    return UNSOLVED


@contextmanager
def stopped_by_signals() -> Iterator[None]:
    """The signals that end a program (SIGTERM, a closed terminal) act as Ctrl-C does, so that the robot is stopped first."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    main = threading.current_thread() is threading.main_thread()  # only there can they be caught
    names = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if main and hasattr(signal, name)]
    heard = [name for name in names if signal.getsignal(name) is not signal.SIG_IGN]  # nohup wants it to go on
    before = {name: signal.signal(name, interrupt) for name in heard}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)
