"""The command line `tepm`: renders results of the library, computes nothing itself.

Exit status: 0 all points solved, 1 some not, 2 wrong input, 130 interrupted (what was solved is kept).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import Annotated

import typer
from rich.markup import escape
from threadpoolctl import threadpool_limits

from tepm_opt.cli import data, demo, discrepancy, gain, identify, ik, modes, mpc, paper, plan, play, record, robot, simulate, statics
from tepm_opt.cli.common import INTERRUPTED, WRONG_INPUT, stderr
from tepm_opt.cli.hw import commands as hw
from tepm_opt.errors import InputError


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"tepm_opt {version('tepm-opt')}")
        raise typer.Exit


app = typer.Typer(
    name="tepm",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)


@app.callback()
def options(
    wanted: Annotated[bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)] = False,
) -> None:
    """Continuum robots of pneumatic muscles with embedded tendons: inverse kinematics, statics, gain matrix."""


app.command("ik")(ik.ik)
app.command("gain")(gain.gain)
app.command("statics")(statics.statics)
app.command("simulate")(simulate.simulate)
app.command("modes")(modes.modes_command)
app.command("mpc")(mpc.mpc)
app.command("demo")(demo.demo)
app.command("paper")(paper.paper)
app.command("plan")(plan.plan)
app.command("record")(record.record)
app.command("play")(play.play)
app.command("identify")(identify.identify)
app.command("discrepancy")(discrepancy.discrepancy)
app.add_typer(robot.app, name="robot")
app.add_typer(data.app, name="data")
app.add_typer(hw.app, name="hw")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its status; what a person got wrong is one line on the error stream."""
    sys.exit(run(list(sys.argv[1:] if arguments is None else arguments)))


def run(arguments: list[str]) -> int:
    """Exit status of the command line with these arguments.

    Linear algebra runs on one thread: threads that share matrices of this size wait for each other, badly so on a busy machine.
    """
    try:
        with threadpool_limits(1, "blas"):
            return int(app(arguments, prog_name="tepm", standalone_mode=False) or 0)
    except InputError as error:
        return _explain(str(error))
    except (KeyboardInterrupt, typer.Abort):
        stderr.print("interrupted", style="yellow")
        return INTERRUPTED
    except Exception as error:
        # usage errors of typer (unknown option, no such command) carry a message of one line; anything else is a bug
        if not hasattr(error, "format_message"):
            raise
        message = error.format_message().replace("Value error, ", "")  # type: ignore[attr-defined]
        return _explain(f"{message} (see tepm --help)") if message else WRONG_INPUT


def _explain(message: str) -> int:
    stderr.print(f"[bold red]error:[/] {escape(' '.join(message.split()))}", soft_wrap=True, highlight=False)
    return WRONG_INPUT
