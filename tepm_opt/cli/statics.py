"""`tepm statics`: equilibrium under given inputs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.markup import escape

from tepm_opt import plots
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, load, progress, report, unsolved_lines, vector
from tepm_opt.data.files import output_folder
from tepm_opt.data.setpoints import SetPoints, read_setpoints
from tepm_opt.errors import InputError
from tepm_opt.jobs.runs import run_statics


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
    if inputs is not None and (pressures or tensions or tip_force):
        raise InputError("a set-point file and --pressures, --tensions or --tip-force exclude each other")
    folder = None if out is None else output_folder(out)
    compiled = load(robot, model)
    layout = compiled.layout
    if inputs is not None:
        setpoints = read_setpoints(inputs, layout.actuator_names, compiled.input_max)
    else:
        half = layout.inputs // 2
        given = [vector(text, name, half) or [0.0] * half for text, name in ((pressures, "--pressures"), (tensions, "--tensions"))]
        u = compiled.check_inputs(np.concatenate(given), "inputs")
        setpoints = SetPoints(np.zeros(1), u[None], np.array([vector(tip_force, "--tip-force") or [0.0] * 3]))
    run = run_statics(compiled, setpoints, progress("statics", len(setpoints.time), as_json))
    if folder is not None:
        run.save(folder)
        plots.save(plots.statics_figure(run), folder / "statics.png")
    summary = run.summary()
    text = [f"[bold]{summary['solved']} of {summary['points']}[/] equilibria solved" + (f", files in {escape(str(out))}" if out else "")]
    for k, at in list(enumerate(run.equilibria))[:8]:
        if at.solved:
            tip = ", ".join(f"{1e3 * value + 0.0:.3f}" for value in at.tip.round(9))
            text.append(
                f"row {k + 1}: tip ({tip}) mm, tilt {np.rad2deg(at.tip_tilt):.2f}°, stiffness at least {at.smallest_eigenvalue:.4f} N/m"
            )
    return report(summary, text + unsolved_lines(summary), as_json, run.ok)
