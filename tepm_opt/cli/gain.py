"""`tepm gain`: the open-loop gain matrix along set points."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.markup import escape

from tepm_opt import plots
from tepm_opt.cli.common import JsonOption, ModelOption, RobotOption, load, progress, report, unsolved_lines
from tepm_opt.cli.progress import shown
from tepm_opt.data.files import output_folder
from tepm_opt.data.setpoints import read_setpoints
from tepm_opt.data.tables import write_table
from tepm_opt.errors import unknown_name
from tepm_opt.jobs.runs import GainRun, run_gain
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.gain import Curve, WorkspaceMap, input_curve, workspace_map

INTERVALS = {"10–20 %": (0.10, 0.20), "45–55 %": (0.45, 0.55)}


def curves(model: CompiledModel) -> dict[tuple[str, str], Curve]:
    """Fig. 11's curves of the third actuator; those with an unstable operating point are left out."""
    found = {}
    for label, (low, high) in INTERVALS.items():
        for kind in ("pressure", "tension"):
            try:
                found[kind, label] = input_curve(model, kind, model.layout.actuator_names[2], low, high)
            except ValueError:
                continue
    return found


def grid_map(model: CompiledModel, quiet: bool) -> WorkspaceMap:
    """G over a vertical plane that holds the robot's workspace; a coarser grid where no C compiler makes it quick."""
    count = 17 if model.is_c else 9
    height = model.layout.modules * model.values["L_0"]
    across, up = np.linspace(-0.96, 0.96, count) * height, np.linspace(0.1, 1.3, count) * height
    with shown(quiet) as bars:
        return workspace_map(model, across, up, progress=bars)


def save_map(workspace: WorkspaceMap, path: Path) -> None:
    """Write the map: tip position and, where in reach, singular values of pressure and tension."""
    rows = []
    for z, gains in zip(workspace.height, workspace.gains, strict=True):
        for x, gain in zip(workspace.across, gains, strict=True):
            values = [np.full(3, np.nan)] * 2 if gain is None else [gain.singular_values("pressure"), gain.singular_values("tension")]
            rows.append([x, z, *np.concatenate(values)])
    names = ["across_m", "z_m", *(f"{kind}_sigma_{k}_m" for kind in ("pressure", "tension") for k in (1, 2, 3))]
    write_table(path, names, np.array(rows))


def lines(run: GainRun, out: Path) -> list[str]:
    """What a run says to people."""
    found = [gain for gain in run.gains if gain]
    text = [f"[bold]G at {len(found)} of {len(run.gains)}[/] operating points, files in {escape(str(out))}"]
    for kind in ("pressure", "tension"):
        if found:
            values = 1e3 * np.array([gain.singular_values(kind) for gain in found])  # type: ignore[arg-type]
            text.append(f"{kind}: singular values {values[:, 2].min():.1f} … {values[:, 0].max():.1f} mm per full range")
    return text + unsolved_lines(run.summary())


def gain(
    inputs: Annotated[Path, typer.Argument(help="Set-point file, such as the inputs.csv of tepm ik.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("gain"),
    point: Annotated[str | None, typer.Option("--point", help="Reference point (s1 …); the tip where absent.")] = None,
    with_map: Annotated[bool, typer.Option("--map", help="Also map G over the workspace (some seconds).")] = False,
    robot: RobotOption = None,
    model: ModelOption = None,
    as_json: JsonOption = False,
) -> int:
    """Compute the open-loop gain matrix G of Eq. (6) at every row of a set-point file."""
    compiled = load(robot, model)
    names = compiled.layout.point_names
    if point is not None and point not in names:
        raise unknown_name("reference point", point, names)
    setpoints = read_setpoints(inputs, compiled.layout.actuator_names, compiled.input_max)
    folder = output_folder(out)
    at = names.index(point) if point else -1
    run = run_gain(compiled, setpoints, at, progress("gain", len(setpoints.time), as_json))
    run.save(folder)
    workspace = grid_map(compiled, as_json) if with_map else None
    if workspace is not None:
        save_map(workspace, folder / "gain_map.csv")
    plots.save(plots.gain_figure(run, curves(compiled), workspace), folder / "gain.png")
    return report(run.summary(), lines(run, out), as_json, run.ok)
