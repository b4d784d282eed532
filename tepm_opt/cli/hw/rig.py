"""`tepm hw rig show|new|check`: rig files."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

import tepm_opt as tepm
from tepm_opt.cli.common import JsonOption, RobotOption, stdout, write_new
from tepm_opt.errors import InputError

if TYPE_CHECKING:
    from tepm_opt.hw.simulation.rigfile import RigFile

PROTOTYPE = "virtual_prototype"
app = typer.Typer(help="Rig files, of what --rig sim:FILE simulates: show, start a new one, check.", no_args_is_help=True)


def load_or_scale_rig(rig: str, robot: str | None) -> RigFile:
    """Load a rig file, or scale a built-in rig to a robot.

    Raises:
        InputError: no such rig or robot; a file has a robot of its own.
    """
    from tepm_opt.hw.simulation.rigfile import builtin_rigs, load_rig_file
    from tepm_opt.hw.simulation.scaling import scale_rig

    if robot and rig not in builtin_rigs():
        raise InputError(f"--robot {robot}: rig {rig} names its robot itself; leave the option out, or take a built-in rig")
    file = load_rig_file(rig)
    return scale_rig(file, tepm.load_robot(robot)) if robot else file


@app.command()
def show(
    rig: Annotated[str, typer.Argument(help="Built-in rig or path of a rig file.")] = PROTOTYPE,
    robot: RobotOption = None,
    as_json: JsonOption = False,
) -> int:
    """Print what a simulated rig has: devices, and imperfections that are on; a built-in one scaled to --robot."""
    file = load_or_scale_rig(rig, robot)
    values = file.model_dump(exclude={"robot", "imperfections", "faults"}) | {
        "robot": file.nominal.name,
        "faults": [fault.entries() for fault in file.faults],
        "imperfections": {name: item.model_dump() for name, item in file.imperfections.active.items()},
    }
    if as_json:
        print(json.dumps(values, indent=2))
        return 0
    table = Table(title=f"rig {escape(file.name)}, robot {escape(file.nominal.name)}", show_header=False)
    sections = {name: value for name, value in values.items() if isinstance(value, dict) and name != "imperfections"}
    for section, entries in (sections | values["imperfections"]).items():
        for key, value in entries.items():
            table.add_row(section, key, escape(str(value)))
    for number, fault in enumerate(values["faults"], 1):
        for key, value in fault.items():
            table.add_row(f"faults, entry {number}", key, escape(str(value)))
    stdout.print(table)
    return 0


@app.command()
def new(
    path: Annotated[Path, typer.Argument(help="Rig file to write (.toml); never overwrites.")],
    robot: RobotOption = None,
    template: Annotated[str, typer.Option("--from", help="Built-in rig to start from: virtual_prototype, or perfect.")] = PROTOTYPE,
    as_json: JsonOption = False,
) -> int:
    """Write a commented rig file to edit: a built-in rig scaled to a robot, and everything else that a machine can have."""
    from tepm_opt.hw.simulation.rigfile import builtin_rigs
    from tepm_opt.hw.simulation.rigtext import rig_text
    from tepm_opt.models.robot import builtin_robots

    if template not in builtin_rigs():
        raise InputError(f"--from {template}: no built-in rig; valid: {', '.join(builtin_rigs())}")
    named = robot or "kang2017"
    file = load_or_scale_rig(template, named).model_copy(update={"name": path.stem})
    seen = named if named in builtin_robots() else Path(os.path.relpath(named, path.parent)).as_posix()
    return write_new(path, rig_text(file, seen, f"--rig sim:{path.name}"), "hw rig", as_json)


@app.command()
def check(
    rig: Annotated[str, typer.Argument(help="Path of a rig file, or a built-in rig.")],
    robot: RobotOption = None,
    as_json: JsonOption = False,
) -> int:
    """Check a rig file: that it can be read, fits its robot, and that the robot comes to rest."""
    from tepm_opt.hw.simulation.mujoco_network import MujocoNetwork

    file = load_or_scale_rig(rig, robot)
    found = tepm.SimulatedRig(file)
    try:
        found.read()
    except RuntimeError as error:
        raise InputError(f"rig {rig}: without inputs {error}") from error
    machine = found.machine
    engine = "mujoco" if isinstance(machine.network, MujocoNetwork) else "compiled"
    summary = {
        "rig": file.name, "robot": found.robot.name, "engine": engine, "step_s": machine.step, "longest_step_s": machine.limit,
        "imperfections": sorted(machine.imperfections), "faults": [fault.entries() for fault in file.faults],
    }  # fmt: skip
    if as_json:
        print(json.dumps(summary, indent=2))
        return 0
    shorter = f", shorter than simulation.step_s = {file.simulation.step_s:g}" if machine.step < file.simulation.step_s else ""
    on = ", ".join(summary["imperfections"]) or "none"
    print(f"{rig} is valid: {file.name}, robot {found.robot.name}, {engine} engine in steps of {1e3 * machine.step:.3g} ms{shorter}")
    print(f"imperfections: {on}")
    if file.faults:
        print("faults: " + ", ".join(f"{fault.kind} of {fault.of} from {fault.from_s:g} s" for fault in file.faults))
    return 0
