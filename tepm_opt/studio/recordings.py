"""Measured runs beside what a model makes of them: the film of a log, and the arrows from the model to what was measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.datasets import DESCRIPTION
from tepm_opt.data.run import Run, read_run
from tepm_opt.data.setpoints import AXES, SetPoints
from tepm_opt.errors import InputError
from tepm_opt.jobs.closed_loop import LOG
from tepm_opt.jobs.discrepancy import MODEL, VERDICT, read_verdict
from tepm_opt.models.channels import channels_of, open_dataset
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.model import Model, read_model
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.mechanics.simulate import simulate
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.studio.shapes import nodes_in_g

VALID = f"a run or log (CSV), a folder with {LOG}, {DESCRIPTION} or {VERDICT}"


@dataclass(frozen=True, eq=False)
class Recordings:
    """Runs that a person wants to look at, with the models to hold beside them.

    Attributes:
        title: what they are.
        runs: measured.
        models: by what they are called on the page, the first one shown first.
        static: whether rows are equilibria, not samples of a motion.
        verdict: what a discrepancy verdict says, as Markdown; empty where there is none.
    """

    title: str
    runs: tuple[Run, ...]
    models: dict[str, Model]
    static: bool = False
    verdict: str = ""

    def __repr__(self) -> str:
        return f"Recordings({self.title}, {len(self.runs)} runs beside {' and '.join(self.models)})"


@dataclass(frozen=True, eq=False)
class Film:
    """A run and the motion that a model has under the same inputs, a row a sample.

    Attributes:
        run: measured.
        model: of the motion.
        time: of the rows since the first in s; their numbers where rows are equilibria.
        nodes: of the model in G, (rows, n + 1, actuators, 3) in m; NaN from where on it has no motion.
        points: of the model in G, (rows, points, 3) in m.
        message: why the model's motion ended early; empty where it did not.
    """

    run: Run
    model: CompiledModel
    time: np.ndarray
    nodes: np.ndarray
    points: np.ndarray
    message: str = ""

    def __repr__(self) -> str:
        return f"Film({self.run.file}, {len(self.time)} rows, {1e3 * float(self.rms().mean()):.3g} mm beside the model)"

    def row(self, time: float) -> int:
        """The row that is shown at a time."""
        return int(np.clip(np.searchsorted(self.time, time + 1e-9, side="right") - 1, 0, len(self.time) - 1))

    def scale_inputs(self, row: int) -> np.ndarray:
        """Scale the inputs of a row by their ranges, (2 · modules · actuators,)."""
        return self.run.inputs[row] / self.model.input_max

    def arrows(self, row: int, magnified: float = 1.0) -> np.ndarray:
        """Arrows from the model's reference points towards the measured ones, where both are known, (arrows, 2, 3) in m.

        Args:
            row: of the run.
            magnified: how many times as long as they are.
        """
        modelled, measured = self.points[row], self.run.points[row]
        known = np.isfinite(modelled).all(axis=1) & np.isfinite(measured).all(axis=1)
        start = modelled[known]
        return np.stack([start, start + magnified * (measured[known] - start)], axis=1)

    def rms(self) -> np.ndarray:
        """Root mean square over the run of each reference point's distance from the model's, (points,) in m; NaN where never known."""
        squares = ((self.run.points - self.points) ** 2).sum(axis=2)
        count = np.isfinite(squares).sum(axis=0)
        return np.sqrt(np.where(count, np.nansum(squares, axis=0) / np.maximum(count, 1), np.nan))

    def column(self, prefix: str, row: int) -> np.ndarray | None:
        """A place that the log has beside the reference points, such as "target" or "true_tip", (3,) in m; None where it has none."""
        values = [self.run.extra.get(f"{prefix}_{axis}_m") for axis in AXES]
        found = np.array([np.nan if each is None else each[row] for each in values])
        return found if np.isfinite(found).all() else None


def film(model: CompiledModel, run: Run, static: bool = False, progress: Progress = silent) -> Film:
    """The film of a run beside a model, which moves from rest under the run's first row.

    Args:
        model: compiled model.
        run: measured.
        static: whether rows are equilibria, not samples of a motion.
        progress: told the time simulated.

    Raises:
        InputError: inputs beyond the robot's limits, or no equilibrium to start from.
    """
    layout = model.layout
    x = np.full((run.rows, layout.levels + 1, layout.block), np.nan)
    points, message = np.full((run.rows, layout.points, 3), np.nan), ""
    if static or run.rows < 2:
        last = None
        for row, (inputs, force) in enumerate(zip(run.inputs, run.tip_force, strict=True)):
            found = solve_statics(model, inputs, force, start=last)
            if found.solved:
                x[row], points[row], last = found.x, found.points, found
            else:
                message = f"row {row + 1}: {found.outcome.message}"
    else:
        motion = simulate(model, SetPoints(run.time, run.inputs, run.tip_force), progress=progress, began=run.began)
        kept = len(motion.setpoints.time)
        x[:kept], points[:kept], message = motion.levels, motion.points, motion.outcome.message
    timed = not static and run.rows > 0 and bool(np.isfinite(run.time).all())
    time = run.time - run.time[0] if timed else np.arange(run.rows, dtype=float)
    return Film(run, model, time, nodes_in_g(model.robot, x), points, message)


def open_recordings(path: str | Path, model: Model | None = None) -> Recordings:
    """Open the recordings at a path: a run or log, a data set, or the data set of a verdict with its models.

    Args:
        path: a CSV file, or a folder with log.csv, dataset.toml or verdict.json.
        model: to hold beside it; absent: the one that data or verdict name, or kang2017.

    Raises:
        InputError: nothing of the kind is there, or it cannot be read.
    """
    found = _read_recordings(Path(path), model)
    empty = [run.file for run in found.runs if not run.rows]
    if empty or not found.runs:
        raise InputError(f"{path}: {f'{empty[0]} has no rows' if empty else 'there are no runs'}; valid: runs of at least one row")
    return found


def _read_recordings(path: Path, model: Model | None) -> Recordings:
    if (path / VERDICT).is_file():
        return _of_verdict(path, model)
    if (path / DESCRIPTION).is_file():
        dataset = open_dataset(path)
        return Recordings(dataset.name, dataset.runs, {"model": model or Model.from_robot(dataset.robot)}, dataset.static)
    file = path / LOG if (path / LOG).is_file() else path
    if not file.is_file():
        raise InputError(f"{path}: nothing to look at; valid: {VALID}")
    if (file.parent / DESCRIPTION).is_file():
        dataset = open_dataset(file.parent)
        if listed := tuple(run for run in dataset.runs if run.file == file.name):
            return Recordings(dataset.name, listed, {"model": model or Model.from_robot(dataset.robot)}, dataset.static)
    known = model or Model.from_robot("kang2017")
    return Recordings(file.name, (read_run(file, channels=channels_of(known.robot)),), {"model": known})


def _of_verdict(folder: Path, model: Model | None) -> Recordings:
    """Data and models of a verdict.

    Raises:
        InputError: it is of another machine, or its data or model are gone.
    """
    content = read_verdict(folder)
    data, file = content.get("data"), folder / MODEL
    if not data or not file.is_file():
        lacking = "does not say which data it is about" if file.is_file() else f"has no {MODEL}: it is of a plant file's machine"
        raise InputError(f"{folder / VERDICT}: {lacking}; valid: what tepm discrepancy made of a robot's data set")
    dataset, *added = (open_dataset(folder / each) for each in data)
    known = content.get("model")
    nominal = model or (read_model(folder / known) if known else Model.from_robot(dataset.robot))
    later = (replace(run, file=f"{Path(each).name}/{run.file}") for each, more in zip(data[1:], added, strict=True) for run in more.runs)
    runs = (*dataset.validation, *dataset.fit, *later)
    return Recordings(dataset.name, runs, {"nominal": nominal, "corrected": read_model(file)}, dataset.static, _words(content))


def _words(content: Mapping[str, Any]) -> str:
    """A verdict as Markdown, without pictures: the page would open what they name."""
    status = f"**{str(content.get('status', '?')).replace('_', ' ')}**"
    rows = [list(map(str, row))[:-1] for row in content.get("table", ())]  # the panel is too narrow for the share of the gap
    lines = [f"| {' | '.join(row)} |" for row in rows]
    table = "\n".join([lines[0], "|" + " --- |" * len(rows[0]), *lines[1:]]) if rows else ""
    said = str(content.get("answer", content.get("paragraph", "")))  # verdicts until version 0.2 have a paragraph alone
    return "\n\n".join(part for part in (status, table, said) if part).replace("![", "[")
