"""The program `tepm` with all its commands, and how wrong input is told.

Command modules import nothing heavy at the top: the help and a typing error are answered at once.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from typing import Annotated, Any

import typer
from rich.markup import escape
from threadpoolctl import threadpool_limits
from typer.core import TyperGroup

from tepm_opt.cli import (
    INTERRUPTED,
    cite,
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
    plan,
    play,
    record,
    robot,
    simulate,
    statics,
    studio,
    tune,
    update_model,
)
from tepm_opt.cli.common import WRONG_INPUT, stderr, warn
from tepm_opt.cli.groups import spread
from tepm_opt.cli.hw import commands as hw
from tepm_opt.cli.hw import rig
from tepm_opt.cli.study import blind, paper
from tepm_opt.cli.study import commands as study
from tepm_opt.errors import InputError


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"tepm_opt {version('tepm-opt')}")
        raise typer.Exit


class InterruptedByUserError(Exception):
    """Interruption by Ctrl-C, under a name that typer does not catch and end the program for."""


class Program(TyperGroup):
    """All commands in the order of work; tells what an old name is now, and lets an interruption be told."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of the commands in the order of work, old names last."""
        order = [*(name for names in PANELS.values() for name in names), *OLD_NAMES]
        return sorted(self.commands, key=order.index)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that arguments begin with; an old name is told on the error stream."""
        found = super().resolve_command(ctx, args)
        if found[0] in OLD_NAMES:
            warn(f"`tepm {found[0]}` is now `tepm {OLD_NAMES[found[0]]}`; the old name goes with version 0.4")
        return found

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


PANELS = {
    "Robot and path": ("robot", "ik", "statics", "gain", "simulate", "plan"),
    "Control": ("mpc", "tune", "play", "studio"),
    "Data and verdict": ("record", "data", "identify", "discrepancy", "update-model"),
    "Hardware": ("hw",),
    "More": ("demo", "export", "study", "cite"),
}
"""Commands by the panels of the help, in the order of work."""
OLD_NAMES = {
    "modes": "robot modes",
    "rig": "hw rig",
    "excite": "data excite",
    "next": "data next",
    "close": "update-model",
    "blind": "study blind",
    "paper": "study paper",
}
"""Commands that go with version 0.4, which the help does not list, and what they are called now."""
COMMANDS: dict[str, Callable[..., int] | typer.Typer] = {
    "robot": robot.app,
    "ik": ik.ik,
    "statics": statics.statics,
    "gain": gain.gain,
    "simulate": simulate.simulate,
    "plan": plan.plan,
    "mpc": mpc.mpc,
    "tune": tune.tune,
    "play": play.play,
    "studio": studio.studio,
    "record": record.record,
    "data": data.app,
    "identify": identify.identify,
    "discrepancy": discrepancy.discrepancy,
    "update-model": update_model.update_model,
    "hw": hw.app,
    "demo": demo.demo,
    "export": export.app,
    "study": study.app,
    "cite": cite.cite,
    "modes": modes.modes,
    "rig": rig.app,
    "excite": excite.excite,
    "next": next_run.next_run,
    "close": update_model.update_model,
    "blind": blind.blind,
    "paper": paper.paper,
}


def _add_commands() -> None:
    """Give the program its commands, each in its panel, old names hidden."""
    panels = {name: panel for panel, names in PANELS.items() for name in names}
    for name, command in COMMANDS.items():
        old, panel = name in OLD_NAMES, panels.get(name)
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name, hidden=old, rich_help_panel=panel)
        else:
            app.command(name, hidden=old, rich_help_panel=panel)(spread(command))


_add_commands()


@cache
def build_program() -> Any:
    """The program with all its commands, once a process: typer would make it anew at every call."""
    return typer.main.get_command(app)


def execute(arguments: list[str]) -> int:
    """Exit status of the program with these arguments; linear algebra that is loaded already runs on one thread; a warning is one line."""
    try:
        with threadpool_limits(1, "blas"), warnings.catch_warnings():
            warnings.showwarning = _warn
            return int(build_program()(arguments, prog_name="tepm", standalone_mode=False) or 0)
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
