"""`tepm study blind|paper|machines`: the studies as one group of commands."""

from __future__ import annotations

import typer

from tepm_opt.cli.groups import spread
from tepm_opt.cli.study.blind import blind
from tepm_opt.cli.study.machines import machines
from tepm_opt.cli.study.paper import paper

app = typer.Typer(
    help="The project's own studies: blind trials of verdicts, the paper's experiments, a controller on random machines.",
    no_args_is_help=True,
)
for command in (blind, paper, machines):
    app.command(command.__name__)(spread(command))
