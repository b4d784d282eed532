"""`tepm identify`: parameters of a model from data sets."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.markup import escape
from rich.table import Table

from tepm_opt.cli.common import INTERRUPTED, JsonOption, ModelOption, RobotOption, load, stderr, stdout
from tepm_opt.data.datasets import DataSet
from tepm_opt.data.files import output_folder, write_atomically
from tepm_opt.data.metrics import error_over_time
from tepm_opt.discrepancy.library import narrow
from tepm_opt.discrepancy.workflow import noise_of
from tepm_opt.errors import InputError
from tepm_opt.jobs.discrepancy import MODEL, refuse_errors
from tepm_opt.models.channels import open_dataset
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.model import write_model
from tepm_opt.solvers.identify import ParameterEstimate, Problem, free_parameters
from tepm_opt.solvers.predict import PredictionError, predict_all
from tepm_opt.solvers.uncertainty import multi_start, profile, unidentifiable

SUMMARY = "identified.json"
STEP = 0.005  # s; longer ones damp a little by themselves, which biases the damping found


def together(folders: Sequence[Path], despite_errors: bool) -> list[DataSet]:
    """The data sets, their runs named by folder and file.

    Raises:
        InputError: the check of one finds errors, they are of different robots, or some are static and some not.
    """
    found = []
    for folder in folders:
        if not despite_errors:
            refuse_errors(folder)
        dataset = open_dataset(folder)
        runs = tuple(replace(run, file=f"{folder.name}/{run.file}") for run in dataset.runs)
        found.append(replace(dataset, runs=runs))
        if dataset.channels != found[0].channels:
            raise InputError(
                f"{folder}: its robot {dataset.robot} has other channels than that of {folders[0]}; identify one robot at a time"
            )
        if dataset.static != found[0].static:
            raise InputError(f"{folder}: static data and motion cannot be fitted together; identify from one kind, then from the other")
    return found


def identify(
    datasets: Annotated[list[Path], typer.Argument(metavar="DATASET...", help="Folders with dataset.toml and a CSV file a run.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for model.toml and identified.json.")] = Path("identified"),
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
    as_json: JsonOption = False,
) -> int:
    """Fit parameters to measured runs (role fit) within their priors, judge them on the others, say what the runs cannot tell."""
    if starts < 1:
        raise InputError(f"--starts {starts}; valid: at least 1")
    sets = together(datasets, despite_errors)
    compiled = load(robot or (None if model else sets[0].robot), model)
    names = [name.strip() for name in free.split(",")] if free else None
    chosen = free_parameters(compiled, names)
    if not chosen:
        raise InputError(f"robot {compiled.robot.name} has no priors: name the parameters to fit with --free")
    runs = [(run, noise_of(dataset)) for dataset in sets for run in dataset.fit]
    noise = tuple(sigma for _, sigma in runs)
    problem = Problem(compiled, tuple(run for run, _ in runs), chosen, noise, sets[0].static, outliers, STEP)
    try:
        with stderr.status("compiling the motion") as status:

            def tell(stage: str, done: float, of: float) -> None:
                status.update(f"{stage}: step {done:.0f} of {of:.0f}")

            estimate = multi_start(problem, starts, seed, progress=tell)
            status.update("judging")
            summary = _summary(estimate, compiled, sets, intervals)
    except PredictionError as error:
        raise InputError(f"the model cannot do the runs: {error}") from error
    except KeyboardInterrupt:
        stderr.print("interrupted: nothing was written")
        return INTERRUPTED
    folder = output_folder(out)
    write_model(narrow(compiled.model, estimate.model.values, ()), folder / MODEL)
    write_atomically(folder / SUMMARY, json.dumps(summary, indent=2) + "\n")
    if as_json:
        print(json.dumps(summary, indent=2))
    else:
        _tell(summary, folder)
    return 0 if estimate.solved else 1


def _summary(estimate: ParameterEstimate, before: CompiledModel, sets: Sequence[DataSet], intervals: bool) -> dict[str, Any]:
    values = {}
    correlation = estimate.covariance / np.maximum(np.outer(estimate.std, estimate.std), 1e-300)
    for k, free in enumerate(estimate.problem.free):
        value, std = float(estimate.values[k]), float(estimate.std[k])
        low, high = profile(estimate, free.name) if intervals else (value - 1.96 * std, value + 1.96 * std)
        values[free.name] = {
            "value": value, "std": std, "low": max(low, free.low), "high": min(high, free.high), "unit": free.unit,
            "before": before.values[free.name], "at_bound": bool(estimate.at_bound[k]),
        }  # fmt: skip
    judged = [run for dataset in sets for run in dataset.validation]
    return {
        "parameters": values,
        "correlation": correlation.round(4).tolist(),
        "residual_over_noise": float(np.sqrt(estimate.cost / max(estimate.count, 1))),
        "validation_rmse_m": {
            name: _error(which, judged, estimate.problem.static) for name, which in (("before", before), ("after", estimate.model))
        },
        "cannot_tell": unidentifiable(estimate),
        "iterations": estimate.iterations,
        "converged": estimate.solved,
        "message": estimate.outcome.message,
    }


def _error(model: CompiledModel, runs: Sequence[Any], static: bool) -> float | None:
    """Eq. (5) over time on runs not fitted to; None where there are none."""
    if not runs:
        return None
    found = predict_all(model, runs, (), static)
    return error_over_time(np.concatenate([run.points for run in runs]), np.concatenate([each.points for each in found]))


def _tell(summary: dict[str, Any], folder: Path) -> None:
    table = Table("parameter", "before", "found", "95 %", "unit", "")
    for name, entry in summary["parameters"].items():
        interval = f"{entry['low']:.5g} … {entry['high']:.5g}"
        note = "at its bound" if entry["at_bound"] else ""
        table.add_row(escape(name), f"{entry['before']:.5g}", f"{entry['value']:.6g}", interval, entry["unit"], note)
    stdout.print(table)
    errors = summary["validation_rmse_m"]
    lines = [f"residuals {summary['residual_over_noise']:.3g} times the noise after {summary['iterations']} steps ({summary['message']})"]
    if errors["after"] is not None:
        lines.append(f"validation runs, Eq. (5): {1e3 * errors['before']:.3g} mm before, [bold]{1e3 * errors['after']:.3g} mm[/] after")
    lines += [f"[yellow]{escape(text)}[/]" for text in summary["cannot_tell"]]
    for line in (*lines, f"{folder / MODEL}, {folder / SUMMARY}"):
        stdout.print(line, soft_wrap=True, highlight=False)
