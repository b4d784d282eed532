"""`tepm identify`: parameters of a model from data sets."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

import tepm_opt as tepm
from tepm_opt.cli import INTERRUPTED
from tepm_opt.cli.common import SOLVED, UNSOLVED, JsonOption, ModelOption, RobotOption, load, stderr, stdout
from tepm_opt.cli.groups import WorkerOptions
from tepm_opt.cli.progress import show_progress
from tepm_opt.data.files import output_folder
from tepm_opt.errors import InputError
from tepm_opt.solvers.identification.prior import JointPrior


def identify(
    datasets: Annotated[list[Path], typer.Argument(metavar="DATASET...", help="Folders with dataset.toml and a CSV file a run.")],
    workers: WorkerOptions,
    out: Annotated[
        Path, typer.Option("--out", help="Folder for identified.json, posterior.json and model.toml or, with --plant, values.json.")
    ] = Path("identified"),
    free: Annotated[
        str | None, typer.Option("--free", help="Parameters by commas: K_a,c_a,r,payload.mass.", show_default="those with priors")
    ] = None,
    starts: Annotated[int, typer.Option("--starts", help="Fits from random values besides; the best counts.")] = 1,
    intervals: Annotated[bool, typer.Option("--intervals", help="Profile intervals (95 %): slower, right where bounds are near.")] = False,
    outliers: Annotated[bool, typer.Option("--robust/--plain", help="Whether outliers are weighted down.")] = True,
    seed: Annotated[int, typer.Option("--seed", help="Of the random starts.")] = 0,
    despite_errors: Annotated[bool, typer.Option("--despite-errors", help="Go on where the check of the data finds errors.")] = False,
    robot: RobotOption = None,
    model: ModelOption = None,
    plant: Annotated[Path | None, typer.Option("--plant", help="Python file of another machine, which the data sets are of.")] = None,
    prior: Annotated[
        Path | None,
        typer.Option("--prior", metavar="FILE", help="posterior.json of an earlier fit, or baseline.json: what is known before."),
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Fit parameters to measured runs (role fit) within their priors, judge them on the others, say what the runs cannot tell.

    Exit status: 1 where the fit does not converge, leaves far more than noise, or has parameters at their bounds: something is missing.
    """
    if starts < 1:
        raise InputError(f"--starts {starts}; valid: at least 1")
    if workers.given and starts == 1:
        raise InputError("--jobs and --scheduler are for --starts; leave them out, or fit from several starts")
    names = [name.strip() for name in free.split(",")] if free else None
    options = tepm.FitOptions(starts, intervals, outliers, seed, JointPrior.from_file(prior) if prior else None)
    if plant is not None:
        if robot or model or despite_errors or workers.given:
            raise InputError("--plant excludes --robot, --model, --despite-errors, --jobs and --scheduler; leave these out")
        machine = tepm.load_plant(plant)
        fit: Any = partial(tepm.run_identify_plant, machine, tepm.open_trials(datasets, machine), names, options)
    else:
        sets = tepm.open_datasets(datasets, despite_errors)
        compiled = load(robot or (None if model else sets[0].robot), model)
        if names is None and not compiled.robot.priors:
            raise InputError(f"robot {compiled.robot.name} has no priors: name the parameters to fit with --free")
        fit = partial(tepm.run_identify, compiled, sets, names, options)
    try:
        with workers.open_executor() as executor, show_progress(as_json) as progress:
            run = fit(progress) if executor is None else fit(progress, executor)
    except KeyboardInterrupt:
        stderr.print("interrupted: nothing was written")
        return INTERRUPTED
    folder = output_folder(out)
    run.save(folder)
    if as_json:
        print(json.dumps(run.summary(), indent=2))
    else:
        _tell(run.summary(), folder)
        if run.doubts:
            step = f"Next: find out what the model lacks: {_next(datasets, model, plant, despite_errors)}"
            stdout.print(step, soft_wrap=True, highlight=False, markup=False)
    return SOLVED if run.ok else UNSOLVED


def _next(datasets: Sequence[Path], model: Path | None, plant: Path | None, despite_errors: bool) -> str:
    """The command that finds out what the model lacks."""
    from tepm_opt.jobs.advice import Asked

    more = () if plant else datasets[1:]  # of a plant one at a time
    return Asked(datasets[0], Path("found"), model, plant, more, despite_errors=despite_errors).again()


def _tell(summary: dict[str, Any], folder: Path) -> None:
    """Print what was found for people."""
    from tepm_opt.jobs.advice import MODEL, VALUES
    from tepm_opt.jobs.identify import SUMMARY

    table = Table("parameter", "before", "found", "95 %", "unit", "")
    for name, entry in summary["parameters"].items():
        interval = f"{entry['low']:.5g} … {entry['high']:.5g}"
        note = "at its bound" if entry["at_bound"] else ""
        table.add_row(escape(name), f"{entry['before']:.5g}", f"{entry['value']:.6g}", interval, entry["unit"], note)
    stdout.print(table)
    of_plant = "validation_over_noise" in summary
    errors = summary["validation_over_noise" if of_plant else "validation_rmse_m"]
    lines = [f"residuals {summary['residual_over_noise']:.3g} times the noise after {summary['iterations']} steps ({summary['message']})"]
    if errors["after"] is not None and of_plant:
        lines.append(f"validation runs: {errors['before']:.3g} times the noise before, [bold]{errors['after']:.3g} times[/] after")
    elif errors["after"] is not None:
        lines.append(f"validation runs, Eq. (5): {1e3 * errors['before']:.3g} mm before, [bold]{1e3 * errors['after']:.3g} mm[/] after")
    lines += [f"[yellow]{escape(text)}[/]" for text in (*summary["doubts"], *summary["cannot_tell"])]
    for line in (*lines, f"{folder / (VALUES if of_plant else MODEL)}, {folder / SUMMARY}"):
        stdout.print(line, soft_wrap=True, highlight=False)
