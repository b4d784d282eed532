"""The program `tepm` with all its commands, and how wrong input is told.

Command modules import nothing heavy at the top: the help and a typing error are answered at once.
"""

from __future__ import annotations

import warnings
from importlib.metadata import version
from typing import Annotated, Any

import typer
from rich.markup import escape
from threadpoolctl import threadpool_limits
from typer.core import TyperGroup

from tepm_opt.cli import (
    INTERRUPTED,
    blind,
    close,
    data,
    demo,
    discrepancy,
    excite,
    export,
    gain,
    identify,
    ik,
    modes,
    mpc,
    next_run,
    paper,
    plan,
    play,
    record,
    rig,
    robot,
    simulate,
    statics,
    studio,
)
from tepm_opt.cli.common import WRONG_INPUT, stderr, warn
from tepm_opt.cli.groups import spread
from tepm_opt.cli.hw import commands as hw
from tepm_opt.errors import InputError


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"tepm_opt {version('tepm-opt')}")
        raise typer.Exit


class InterruptedByUserError(Exception):
    """Interruption by Ctrl-C, under a name that typer does not catch and end the program for."""


class Program(TyperGroup):
    """All commands; lets an interruption be told."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command.

        Raises:
            InterruptedByUserError: by the user.
        """
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as error:
            raise InterruptedByUserError from error


app = typer.Typer(
    name="tepm",
    cls=Program,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)


@app.callback()
def options(
    wanted: Annotated[bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)] = False,
) -> None:
    """Continuum robots of pneumatic muscles with embedded tendons: inverse kinematics, statics, gain matrix."""


COMMANDS = {
    "ik": ik.ik,
    "gain": gain.gain,
    "statics": statics.statics,
    "simulate": simulate.simulate,
    "modes": modes.modes,
    "mpc": mpc.mpc,
    "demo": demo.demo,
    "paper": paper.paper,
    "plan": plan.plan,
    "excite": excite.excite,
    "record": record.record,
    "play": play.play,
    "identify": identify.identify,
    "discrepancy": discrepancy.discrepancy,
    "next": next_run.next_run,
    "close": close.close,
    "blind": blind.blind,
    "studio": studio.studio,
}
for name, command in COMMANDS.items():
    app.command(name)(spread(command))
app.add_typer(robot.app, name="robot")
app.add_typer(rig.app, name="rig")
app.add_typer(data.app, name="data")
app.add_typer(export.app, name="export")
app.add_typer(hw.app, name="hw")


def execute(arguments: list[str]) -> int:
    """Exit status of the program with these arguments; linear algebra that is loaded already runs on one thread; a warning is one line."""
    try:
        with threadpool_limits(1, "blas"), warnings.catch_warnings():
            warnings.showwarning = _warn
            return int(app(arguments, prog_name="tepm", standalone_mode=False) or 0)
    except InputError as error:
        return _explain(str(error))
    except (InterruptedByUserError, KeyboardInterrupt, typer.Abort):
        stderr.print("interrupted", style="yellow")
        return INTERRUPTED
    except Exception as error:
        # usage errors of typer (unknown option, no such command) carry a message of one line; anything else is a bug
        if not hasattr(error, "format_message"):
            raise
        message = error.format_message().replace("Value error, ", "")  # type: ignore[attr-defined]
        return _explain(f"{message} (see tepm --help)") if message else WRONG_INPUT


def _warn(message: Warning | str, *where: object) -> None:
    """Show a warning to a person: what it says, not where in the program."""
    warn(f"warning: {' '.join(str(message).split())}")


def _explain(message: str) -> int:
    stderr.print(f"[bold red]error:[/] {escape(' '.join(message.split()))}", soft_wrap=True, highlight=False)
    return WRONG_INPUT
