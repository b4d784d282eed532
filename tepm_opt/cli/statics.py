"""`tepm statics`: equilibrium under given inputs."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

import tepm_opt as tepm
from tepm_opt import plots
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, given_force, given_inputs, load, report, unsolved_lines, warn
from tepm_opt.cli.progress import show_progress
from tepm_opt.data.files import output_folder
from tepm_opt.errors import InputError

if TYPE_CHECKING:
    from tepm_opt.jobs.statics import StaticsRun

ROWS = 8  # told to people


def lines(run: StaticsRun, out: Path | None) -> list[str]:
    """Summarize equilibria in lines for the terminal."""
    summary = run.summary()
    text = [f"[bold]{summary['solved']} of {summary['points']}[/] equilibria solved" + (f", files in {escape(str(out))}" if out else "")]
    rows = zip(summary["tip_m"], summary["tip_tilt_deg"], summary["smallest_stiffness_eigenvalue_N_per_m"], strict=True)
    for k, (tip, tilt, stiffness) in enumerate(islice(rows, ROWS)):
        if tip is not None:
            place = ", ".join(f"{1e3 * round(value, 9) + 0.0:.3f}" for value in tip)
            text.append(f"row {k + 1}: tip ({place}) mm, tilt {tilt:.2f}°, stiffness at least {stiffness:.4f} N/m")
    if more := sum(at.solved for at in run.equilibria[ROWS:]):
        text.append(f"… and {more} more rows: " + ("all are in shape.csv there" if out else "--out FOLDER writes all into files"))
    return text + unsolved_lines(summary)


def statics(
    inputs: Annotated[Path | None, typer.Argument(help="Set-point file with pressures, tensions and, if any, tip force.")] = None,
    pressures: Annotated[str | None, typer.Option("--pressures", help="Instead of a file: all pressures in Pa, by commas.")] = None,
    tensions: Annotated[str | None, typer.Option("--tensions", help="Instead of a file: all tensions in N, by commas.")] = None,
    tip_force: Annotated[str | None, typer.Option("--tip-force", help="Instead of a file: force on the tip in G, x,y,z in N.")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results; none are written without it.")] = None,
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Solve equilibria: shape, actuator lengths, stability."""
    from tepm_opt.solvers.mechanics.statics import tell_buckling

    if inputs is not None and (pressures or tensions or tip_force):
        raise InputError("a set-point file and --pressures, --tensions or --tip-force exclude each other")
    folder = None if out is None else output_folder(out)
    compiled = load(robot, model)
    if inputs is not None:
        setpoints = tepm.read_setpoints(inputs, compiled.layout.actuator_names, compiled.input_max)
    else:
        setpoints = tepm.SetPoints.single(given_inputs(compiled, pressures, tensions), given_force(compiled, tip_force))
    if wrong := tell_buckling(compiled):
        warn(f"{compiled.model.source}: {wrong}")
    with show_progress(as_json) as progress:
        run = tepm.run_statics(compiled, setpoints, progress)
    if folder is not None:
        run.save(folder)
        plots.draw(run, folder)
    return report(run.summary(), lines(run, out), as_json, run.ok)
