"""What `tepm record` and `tepm play` share: opening rigs, progress, and stopping them also when the system ends the program."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Annotated

import typer
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from tepm_opt.cli.common import UNSOLVED, stderr
from tepm_opt.errors import InputError
from tepm_opt.hw.registry import open_rig
from tepm_opt.hw.rig import Rig
from tepm_opt.models.robot import Robot
from tepm_opt.recording.drive import Show

RigOption = Annotated[
    str, typer.Option("--rig", help="sim, sim:FILE, replay:FILE, …: the default simulated rig, another one, a recording.")
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, max=2**32 - 1, help="Of the noise on a simulated rig.")]


def opener(text: str, robot: Robot, seed: int) -> Callable[[int], Rig]:
    """Opens the rig that --rig names; what it is called with makes the noise of its devices another one, where they are simulated.

    Raises:
        InputError: when called: no such rig; or --seed is given and the rig has nothing to seed.
    """

    def open_seeded(noise: int) -> Rig:
        rig = open_rig(text, robot)
        if simulated := rig.simulated:
            simulated.reseed(noise)
        elif seed:
            raise InputError(f"--seed {seed}: rig {text!r} has no noise that can be seeded; leave the option out")
        return rig

    return open_seeded


def failed(error: Exception, kept: str) -> int:
    """What went wrong in a rig (a simulation that leaves all bounds, a dead line) in one line; the exit status."""
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
    before = {name: signal.signal(name, interrupt) for name in names}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)


@contextmanager
def stages(quiet: bool) -> Iterator[tuple[Callable[[str], Show], Callable[[str], None]]]:
    """Progress of runs on the error stream: a bar with the time left, named after the run and what goes on in it; and asking a person."""
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[passed]}"), TimeRemainingColumn())
    with Progress(*columns, console=stderr, transient=True, disable=quiet or not stderr.is_terminal) as bar:

        def of_run(name: str) -> Show:
            for old in bar.task_ids:
                bar.remove_task(old)
            state = {"stage": "", "task": bar.add_task(name, total=None, passed="")}

            def show(stage: str, done: float, of: float) -> None:
                if stage != state["stage"]:
                    bar.remove_task(state["task"])  # type: ignore[arg-type]
                    state.update(stage=stage, task=bar.add_task(f"{name}: {stage}", total=of, passed=""))
                bar.update(state["task"], completed=done, passed=f"{done:.1f} of {of:.1f} s")  # type: ignore[arg-type]

            return show

        def ask(request: str) -> None:
            bar.stop()
            stderr.print(f"[bold]{escape(request)}[/]", soft_wrap=True, highlight=False)
            if sys.stdin.isatty():
                stderr.input("Enter when it is done, Ctrl-C to stop here: ")
            bar.start()

        yield of_run, ask
