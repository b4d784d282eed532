"""Shared parts of the commands: options, progress, printing."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from rich.console import Console
from rich.markup import escape

from tepm_opt.cli import INTERRUPTED
from tepm_opt.data.files import output_folder, write_atomically
from tepm_opt.data.sizes import judge_force, judge_inputs, judge_places
from tepm_opt.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from tepm_opt.models.compile import CompiledModel

SOLVED, UNSOLVED, WRONG_INPUT = 0, 1, 2
Item = TypeVar("Item")
stdout, stderr = Console(), Console(stderr=True)

RobotOption = Annotated[str | None, typer.Option("--robot", help="Built-in robot or path of a robot file.", show_default="kang2017")]
ModelOption = Annotated[Path | None, typer.Option("--model", help="Model file (robot, parameters, effects) instead of --robot.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the summary as JSON and nothing else.")]


def load(robot: str | None, model: Path | None) -> CompiledModel:
    """The model that --robot and --model name, compiled.

    Raises:
        InputError: both are given, or either names nothing usable.
    """
    from tepm_opt.models.compile import compile_model
    from tepm_opt.models.model import Model, read_model

    if robot and model:
        raise InputError("--robot and --model exclude each other: the model file names its robot")
    nominal = read_model(model) if model else Model.from_robot(robot or "kang2017")
    with show_compiling("the network"):
        return compile_model(nominal)


@contextmanager
def show_compiling(what: str) -> Iterator[None]:
    """Say on a terminal what is compiled, and how much of it."""
    from tepm_opt.models.backends.compiler import report_to

    status = stderr.status(f"compiling {what}")
    with status, report_to(lambda stage, done, of: status.update(f"compiling {what}: {done:.0f} of {of:.0f} kernels")):
        yield


def vector(text: str | None, name: str, count: int = 3) -> list[float] | None:
    """Comma-separated numbers of an option.

    Raises:
        InputError: not `count` finite numbers.
    """
    if text is None:
        return None
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise InputError(f"{name} {text!r}: {len(text.split(','))} values; valid: {count} numbers separated by commas")
    return values


def given_inputs(model: CompiledModel, pressures: str | None, tensions: str | None) -> np.ndarray:
    """Inputs of --pressures and --tensions; those not given are 0.

    Raises:
        InputError: wrong numbers, inputs outside the robot's limits or in another unit.
    """
    import numpy as np

    half = model.layout.inputs // 2
    given = [vector(text, name, half) or [0.0] * half for text, name in ((pressures, "--pressures"), (tensions, "--tensions"))]
    inputs = model.check_inputs(np.concatenate(given), "inputs")
    if wrong := judge_inputs(inputs, model.input_max):
        raise InputError(f"--{wrong.partition(' ')[0]}: {wrong}")
    return inputs


def given_force(model: CompiledModel, text: str | None) -> list[float] | None:
    """The force of --tip-force on the tip in G, (3,) in N; None where there is none.

    Raises:
        InputError: wrong numbers, or a force in another unit.
    """
    force = vector(text, "--tip-force")
    most = float(model.input_max[model.layout.inputs // 2 :].sum())
    if force is not None and (wrong := judge_force(math.hypot(*force), most)):
        raise InputError(f"--tip-force {text}: {wrong}")
    return force


def refuse_far(model: CompiledModel, places: np.ndarray, where: str) -> None:
    """Refuse places of the tip (places, 3) in m in G that are in another unit for the size of the model's robot.

    Raises:
        InputError: in the words that data sets get.
    """
    robot = model.robot
    if wrong := judge_places(places, robot.mount.base_position_m, robot.modules * robot.parameters.L_0):
        raise InputError(f"{where}: {wrong}")


def open_page(address: str, wanted: bool = True) -> bool:
    """Say where a page is, on the error stream, and open it where that is wanted; whether there is a browser to open it."""
    stderr.print(f"opens once, in a browser on this computer: [bold]{escape(address)}[/]", soft_wrap=True, highlight=False)
    if not wanted:
        return False
    import threading
    import webbrowser

    try:
        found = webbrowser.get()
    except webbrowser.Error:
        return False
    threading.Thread(target=found.open, args=(address,), daemon=True).start()  # some do not return until they are closed
    return True


@contextmanager
def folder_for(out: Path) -> Iterator[Path]:
    """The output folder; if it is new and stays empty (wrong input, interrupted at once) it goes again."""
    new = [path for path in (out, *out.parents) if not path.exists()]
    try:
        yield output_folder(out)
    finally:
        for path in new:
            with suppress(OSError):  # it holds something
                path.rmdir()


def write_new(path: Path, text: str, kind: str, as_json: bool) -> int:
    """Write a file to edit, which must not be there yet, and tell how it is checked; the exit status.

    Args:
        path: of the file.
        text: its content.
        kind: that has a command `tepm KIND check`.
        as_json: whether the path alone is printed.

    Raises:
        InputError: the file is there, or cannot be written.
    """
    if path.exists():
        raise InputError(f"{path} exists; name another file")
    write_atomically(path, text)
    print(json.dumps({"file": str(path)})) if as_json else print(f"wrote {path}: edit it, then run tepm {kind} check {path}")
    return SOLVED


def warn(text: str) -> None:
    """A yellow line on the error stream, as it is."""
    stderr.print(text, style="yellow", markup=False, soft_wrap=True, highlight=False)


def report(summary: dict[str, Any], lines: Iterable[str], as_json: bool, ok: bool) -> int:
    """Print a run's summary or its lines for people; the exit status.

    Args:
        summary: the run's numbers, plain data; "interrupted" in it decides the exit status.
        lines: what people read instead, in rich's markup.
        as_json: whether to print the summary.
        ok: whether everything was solved.
    """
    if as_json:
        print(json.dumps(summary, indent=2))
    else:
        for line in lines:
            stdout.print(line, soft_wrap=True, highlight=False)
    return INTERRUPTED if summary.get("interrupted") else SOLVED if ok else UNSOLVED


def unsolved_lines(summary: dict[str, Any], most: int = 8) -> list[str]:
    """A line for each unsolved point, the first few."""
    entries = summary["unsolved"]
    lines = ["[yellow]interrupted: what was finished is kept[/]"] if summary["interrupted"] else []
    lines += [f"[yellow]point {entry['point'] + 1}: {escape(entry['message'])}[/]" for entry in entries[:most]]
    return lines + ([f"[yellow]… and {len(entries) - most} more, see summary.json[/]"] if len(entries) > most else [])
