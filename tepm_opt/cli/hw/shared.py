"""Shared parts of the commands of `tepm hw`: options, questions to a person, safe ends that one line explains."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from tepm_opt.cli import INTERRUPTED
from tepm_opt.cli.common import UNSOLVED, stderr, stdout
from tepm_opt.cli.rigs import stopped_by_signals
from tepm_opt.errors import InputError
from tepm_opt.hw.board.errors import LinkError
from tepm_opt.hw.guard import Stopped

if TYPE_CHECKING:
    from tepm_opt.hw.service.line import Line
    from tepm_opt.hw.trackers import LiveTracker
    from tepm_opt.models.robot import Robot

PortArgument = Annotated[str, typer.Argument(metavar="PORT", help="Serial port, PORT or PORT@BAUD; tepm hw ports lists them.")]
YesOption = Annotated[bool, typer.Option("--yes", help="Do not ask before the robot moves.")]
STOPPED = "motors are off and pressure goes to zero"


def open_line(target: str) -> Line:
    """A line to the board at PORT or PORT@BAUD, or a recording of one, log:FILE.

    Raises:
        InputError: no such port, or the file is no link log.
    """
    from tepm_opt.hw.service import line

    return line.open_line(target)


def open_tracker(robot: Robot) -> LiveTracker | None:
    """The tracker that a robot file names; None where it names none."""
    from tepm_opt.hw.service import line

    return line.open_tracker(robot)


def ask(question: str) -> str:
    """Ask a person a question; return the answer typed.

    Raises:
        InputError: there is nobody.
    """
    try:
        return stderr.input(f"[bold]{escape(question)}[/] ").strip()
    except EOFError as error:
        raise InputError(f"{question!r}: nobody answers; run this on a terminal") from error


def confirm(what: str, yes: bool) -> None:
    """Ask whether the robot may move.

    Raises:
        InputError: nobody can be asked, and --yes is not given.
        typer.Abort: it may not.
    """
    if yes:
        return
    if not sys.stdin.isatty():
        raise InputError("the robot would move and nobody can be asked here; valid: a terminal, or --yes")
    if ask(f"{what} Keep a hand at the emergency stop button. Go on? [y/N]").lower() not in ("y", "yes"):
        raise typer.Abort


def safely(work: Callable[[], int], interrupted: str, left: str) -> int:
    """Run a command; Ctrl-C, SIGTERM and a dead line are one line on the error stream. The exit status."""
    try:
        with stopped_by_signals():
            return work()
    except KeyboardInterrupt:
        stderr.print(f"interrupted: {interrupted}", style="yellow", soft_wrap=True, highlight=False)
        return INTERRUPTED
    except Stopped as stop:
        stderr.print(f"[bold red]stopped:[/] {escape(str(stop))}; {escape(left)}", soft_wrap=True, highlight=False)
        return UNSOLVED
    except (LinkError, OSError) as error:
        stderr.print(f"[bold red]the board:[/] {escape(' '.join(str(error).split()))}; {escape(left)}", soft_wrap=True, highlight=False)
        return UNSOLVED


def say(text: str, style: str = "") -> None:
    """A line on the standard output, as it is."""
    stdout.print(escape(text), style=style, soft_wrap=True, highlight=False)
