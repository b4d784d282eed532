"""`tepm robot show|new|check|modes`: robot files, and small motions of a robot."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

import tepm_opt as tepm
from tepm_opt.cli.common import JsonOption, stdout, write_new
from tepm_opt.cli.groups import spread
from tepm_opt.cli.modes import modes

app = typer.Typer(help="Robot files: show, start a new one, check; modes of small motions.", no_args_is_help=True)


@app.command()
def show(
    robot: Annotated[str, typer.Argument(help="Built-in robot or path of a robot file.")] = "kang2017",
    as_json: JsonOption = False,
) -> int:
    """Print a robot's numbers."""
    found = tepm.load_robot(robot)
    if as_json:
        print(json.dumps(found.model_dump(), indent=2))
        return 0
    table = Table(title=f"robot {found.name}", show_header=False)
    for section, values in found.model_dump().items():
        if isinstance(values, dict):
            for key, value in values.items():
                table.add_row(section, key, str(value))
    stdout.print(table)
    return 0


@app.command()
def new(
    path: Annotated[Path, typer.Argument(help="Robot file to write (.toml); never overwrites.")],
    template: Annotated[str, typer.Option("--from", help="Built-in robot to start from.")] = "kang2017",
    as_json: JsonOption = False,
) -> int:
    """Write a commented robot file to edit."""
    from tepm_opt.models.robot import robot_text

    name = f"name = {json.dumps(path.stem, ensure_ascii=False)}"
    return write_new(path, robot_text(template).replace(f'name = "{template}"', name, 1), "robot", as_json)


@app.command()
def check(
    robot: Annotated[str, typer.Argument(help="Path of a robot file, or a built-in robot.")],
    as_json: JsonOption = False,
) -> int:
    """Check a robot file, and whether the arm stands."""
    from tepm_opt.models.robot import builtin_robots

    found = tepm.load_robot(robot)
    built_in = robot in builtin_robots()
    if not built_in:
        _refuse_heavy(robot)
    summary = {"robot": found.name, "modules": found.modules, "actuators": found.actuators, "levels": found.levels}
    if as_json:
        print(json.dumps({**summary, "built_in": built_in}, indent=2))
    else:
        print(f"{robot} is valid: {found.name}, {found.modules} modules of {found.actuators} actuators, {found.levels} levels")
    return 0


def _refuse_heavy(robot: str) -> None:
    """Refuse a robot file whose arm buckles under its own weight.

    Raises:
        InputError: naming the mass and the largest one that stands.
    """
    from tepm_opt.cli.common import load
    from tepm_opt.solvers.mechanics.statics import tell_buckling

    if wrong := tell_buckling(load(robot, None)):
        raise tepm.InputError(f"{robot}: {wrong}")


app.command("modes")(spread(modes))
