"""`tepm robot modes`: small motions about an operating point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

import tepm_opt as tepm
from tepm_opt import plots
from tepm_opt.cli.common import UNSOLVED, JsonOption, ModelOption, RobotOption, given_force, given_inputs, load, report, warn
from tepm_opt.cli.progress import show_progress
from tepm_opt.data.files import output_folder
from tepm_opt.errors import InputError

if TYPE_CHECKING:
    from tepm_opt.jobs.modes import ModesRun
    from tepm_opt.models.compile import CompiledModel
    from tepm_opt.solvers.linear.modes import Mode
    from tepm_opt.solvers.mechanics.statics import Equilibrium


def lines(run: ModesRun, shown: int, out: Path | None) -> list[str]:
    """Summarize modes in lines for the terminal, with `shown` lines of modes at most."""
    at, held = run.linear.equilibrium, int(run.linear.held.sum())
    tip = ", ".join(f"{1e3 * value + 0.0:.1f}" for value in at.tip.round(9))
    where = f", files in {escape(str(out))}" if out else ""
    text = [f"[bold]{len(run.modes)} modes[/] of {len(run.linear.A)} states about tip ({tip}) mm{where}"]
    if held:
        text.append(f"{held} eigenvalues are 0: internal states that stick (dry friction, hysteresis) and act as springs on small motions")
    text += ["", "frequency  damping   time const.  tip by full range     shape"]
    text += _merge_memory_modes([(mode, _line(run, mode)) for mode in run.modes])[:shown]
    text += [
        "",
        f"fastest eigenvalue {max(abs(mode.value) for mode in run.modes):.4g} 1/s; RK4 is stable up to {1e3 * run.step:.4f} ms",
    ]
    if run.linear.delay:
        text.append(f"pressures and tensions act {1e3 * run.linear.delay:g} ms late")
    bound = f"within {1e3 * run.reduced.bound:.2g} mm per full range at any frequency"
    text.append(f"{' and '.join(run.reduced.inputs)} to {', '.join(run.reduced.outputs)}: {len(run.reduced.A)} states do, {bound}")
    return text


def _line(run: ModesRun, mode: Mode) -> str:
    """A row of the table of modes."""
    name, moved = run.driver(mode)
    swings = f"{mode.frequency:6.2f} Hz  {mode.damping:7.4f}" if mode.oscillates else f"{'-':>9}  {'-':>7}"
    driven = f"{1e3 * moved:6.1f} mm {name:12}" if name != "none" else f"{'-':>9} {'':12}"
    return f"{swings}  {mode.time_constant:10.4g} s  {driven}{mode.words}"


def _merge_memory_modes(rows: Sequence[tuple[Mode, str]]) -> list[str]:
    """Write lines of the table; more than two modes of memory in a row are one line."""
    text: list[str] = []
    k = 0
    while k < len(rows):
        end = k
        while rows[k][0].memory and end < len(rows) and rows[end][0].memory == rows[k][0].memory:
            end += 1
        if end - k > 2:
            times = [mode.time_constant for mode, _ in rows[k:end]]
            text.append(f"{'-':>9}  {'-':>7}  {min(times):.3g} … {max(times):.3g} s: {end - k} modes, {rows[k][0].memory}")
            k = end
        else:
            text.append(rows[k][1])
            k += 1
    return text


def _operating_point(
    model: CompiledModel, inputs: Path | None, row: int | None, pressures: str | None, tensions: str | None, tip_force: str | None
) -> Equilibrium:
    """The equilibrium under the inputs given, or under a row of the file.

    Raises:
        InputError: both are given, or there is no such row.
    """
    if inputs is None:
        if row is not None:
            raise InputError(f"--row {row} needs a set-point file")
        return tepm.solve_statics(model, given_inputs(model, pressures, tensions), given_force(model, tip_force))
    if pressures or tensions or tip_force:
        raise InputError("a set-point file and --pressures, --tensions or --tip-force exclude each other")
    setpoints = tepm.read_setpoints(inputs, model.layout.actuator_names, model.input_max)
    row = 1 if row is None else row
    if not 1 <= row <= len(setpoints.time):
        raise InputError(f"--row {row}: {inputs} has no such row; valid: 1 … {len(setpoints.time)}")
    if not all(map(math.isfinite, setpoints.inputs[row - 1])):
        raise InputError(f"--row {row}: {inputs} has no inputs there; valid: a row with inputs")
    return tepm.solve_statics(model, setpoints.inputs[row - 1], setpoints.tip_force[row - 1])


def modes(
    inputs: Annotated[Path | None, typer.Argument(help="Set-point file; one of its rows is the operating point.")] = None,
    row: Annotated[int | None, typer.Option("--row", help="Which row of the file, from 1; the first where absent.")] = None,
    pressures: Annotated[str | None, typer.Option("--pressures", help="Instead of a file: all pressures in Pa, by commas.")] = None,
    tensions: Annotated[str | None, typer.Option("--tensions", help="Instead of a file: all tensions in N, by commas.")] = None,
    tip_force: Annotated[str | None, typer.Option("--tip-force", help="Instead of a file: force on the tip in G, x,y,z in N.")] = None,
    start: Annotated[str | None, typer.Option("--from", help="Inputs for Bode and step, by commas: pressure_11, force_s4_x …")] = None,
    end: Annotated[
        str | None, typer.Option("--to", help="Outputs for Bode and step, by commas: s4, s2_x, length_11 …; else the tip.")
    ] = None,
    order: Annotated[
        int | None, typer.Option("--order", help="States of the reduced system; else as many as 1 mm per range takes.")
    ] = None,
    count: Annotated[int, typer.Option("--count", help="How many modes to print.")] = 12,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results; none are written without it.")] = None,
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Small motions about an operating point: modes, state space, Bode diagram, step response, a reduced system."""
    for name, value in (("--count", count), ("--order", order)):
        if value is not None and value < 1:
            raise InputError(f"{name} {value}; valid: at least 1")
    compiled = load(robot, model)
    equilibrium = _operating_point(compiled, inputs, row, pressures, tensions, tip_force)
    if not equilibrium.solved:
        warn(f"no stable operating point: {equilibrium.outcome.message}")
        return UNSOLVED
    with show_progress(as_json) as progress:
        run = tepm.run_modes(equilibrium, _names(start), _names(end), order, progress)
    if out is not None:
        folder = output_folder(out)
        run.save(folder, count)
        plots.draw(run, folder)
    return report(run.summary(count), lines(run, count, out), as_json, run.ok)


def _names(text: str | None) -> list[str] | None:
    """Names by commas."""
    return [name.strip() for name in text.split(",")] if text else None
