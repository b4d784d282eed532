"""Data sets of any machine: a folder with `dataset.toml` and one CSV file a run, whose columns are the machine's inputs and outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from tepm_opt.data.channels import TIME
from tepm_opt.data.datasets import DESCRIPTION, RunEntry
from tepm_opt.data.documents import Section, read_toml, require_range, validate
from tepm_opt.data.run import Run, RunSet, Start
from tepm_opt.data.signals import Signals
from tepm_opt.data.tables import read_table
from tepm_opt.errors import InputError, unknown_name


class TrialEntry(RunEntry):
    """A run in `dataset.toml`."""

    start: Start | None = None
    group: str = ""


class TrialsDescription(Section):
    """The content of `dataset.toml` of a machine that a plant file describes."""

    name: Annotated[str, Field(min_length=1, description="any text")]
    noise: Annotated[dict[str, float], Field(description="1 sigma of each output, in its unit")]
    static: bool = False
    start: Start = "equilibrium"
    piece_s: Annotated[float, require_range(1e-6, 1e6, "s")] | None = None
    gauges: list[str] = Field(default_factory=list)
    runs: list[TrialEntry]

    @model_validator(mode="after")
    def _consistent(self) -> TrialsDescription:
        files = [entry.file for entry in self.runs]
        if twice := sorted({name for name in files if files.count(name) > 1}):
            raise ValueError(f"runs: {twice[0]!r} is listed twice; a run belongs to one role")
        if self.piece_s is not None and any((entry.start or self.start) != "free" for entry in self.runs if entry.role == "fit"):
            raise ValueError('piece_s cuts runs to fit to into pieces that begin as they will; valid: with start = "free"')
        return self


@dataclass(frozen=True, eq=False)
class Trials(RunSet):
    """Runs of any machine.

    Attributes:
        name: for people.
        runs: in the order of `dataset.toml`; those to fit to in pieces where it says so.
        noise: 1 sigma of what is measured: of each output, (outputs, 1).
        gauges: names of the inputs that gauges show behind the actuators; the others are commands.
    """

    name: str
    runs: tuple[Run, ...]
    noise: np.ndarray
    gauges: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Trials({self.name}: {len(self.fit)} runs to fit to, {len(self.validation)} to judge by)"


def read_trials(folder: str | Path, signals: Signals, static: bool = False) -> Trials:
    """Read a data set of a machine.

    Args:
        folder: of `dataset.toml`.
        signals: the machine's inputs and outputs: the names of the columns, besides `time_s`.
        static: whether the machine is one whose rows are equilibria, which need no time.

    Raises:
        InputError: unreadable file, missing column, input that is not finite, time that does not increase, output without noise;
            equilibria of a machine that moves.
    """
    folder = Path(folder)
    path = folder / DESCRIPTION
    if not path.is_file():
        raise InputError(f"data set {folder} has no {DESCRIPTION}")
    description = validate(TrialsDescription, read_toml(path), str(path))
    if description.static and not static:
        raise InputError(f"{path}: static = true, but the machine's runs are motions; valid: a plant with static = True")
    if static and description.piece_s is not None:
        raise InputError(f"{path}: piece_s cuts runs in time, which equilibria do not have; valid: without it")
    if unknown := [name for name in description.noise if name not in signals.points]:
        raise unknown_name("output", unknown[0], signals.points, f"{path}: noise")
    if silent := [name for name in signals.points if not description.noise.get(name, 0.0) > 0]:
        raise InputError(f"{path}: noise of {silent[0]!r} is missing or not positive; valid: [noise] with 1 sigma of each output")
    if unknown := [name for name in description.gauges if name not in signals.inputs]:
        raise unknown_name("input", unknown[0], signals.inputs, f"{path}: gauges")
    runs = [_read(folder / entry.file, entry, description.start, signals, static) for entry in description.runs]
    if description.piece_s is not None:
        cut = [pieces(run, description.piece_s) if run.role == "fit" else [run] for run in runs]
        if short := [run.file for run, found in zip(runs, cut, strict=True) if not found]:
            raise InputError(f"{path}: piece_s = {description.piece_s:g} is shorter than the steps of {short[0]}; valid: many of them")
        runs = [piece for found in cut for piece in found]
    noise = np.array([[description.noise[name]] for name in signals.points])
    return Trials(description.name, tuple(runs), noise, tuple(description.gauges))


def _read(path: Path, entry: TrialEntry, start: Start, signals: Signals, static: bool) -> Run:
    needed = (*(() if static else (TIME,)), *signals.inputs, *signals.columns)
    table = read_table(path, text=lambda name: name not in needed)
    if missing := [name for name in needed if name not in table.columns]:
        more = f" (and {', '.join(missing[1:])})" if len(missing) > 1 else ""
        raise InputError(f"{path}: column {missing[0]!r} is missing{more}; found: {', '.join(table.columns)}")
    if not static:
        table.read_increasing(TIME)
    for name in signals.inputs:
        table.column(name)
    for name in signals.columns:
        table.refuse(np.isinf(table.columns[name]), name, "a finite number, or an empty field where the sample is missing")
    rows = len(table.lines)
    time = np.full(rows, np.nan) if static else table.columns[TIME]
    inputs = np.stack([table.columns[name] for name in signals.inputs], axis=1) if signals.inputs else np.zeros((rows, 0))
    outputs = np.stack([table.columns[name] for name in signals.columns], axis=1).reshape(rows, len(signals.points), len(signals.axes))
    extra = {name: values for name, values in table.columns.items() if name not in needed}
    return Run(entry.file, entry.role, time, inputs, np.zeros((rows, 3)), outputs, extra, table.lines, entry.start or start, entry.group)


def pieces(run: Run, seconds: float) -> list[Run]:
    """A run in pieces of so many seconds, each a run of its own that begins as it will; what is left at the end is part of the last.

    A row that is alone in its piece says nothing of a motion and is left out.
    """
    number = np.floor((run.time - run.time[0]) / seconds + 1e-9).astype(int)
    last = max(int(np.floor((run.time[-1] - run.time[0]) / seconds + 1e-9)), 1)
    number = np.minimum(number, last - 1)
    found = []
    for k in range(last):
        rows = np.flatnonzero(number == k)
        if len(rows) > 1 or run.rows == 1:
            found.append(replace(_part(run, rows), file=f"{run.file} from {run.time[rows[0]]:g} s"))
    return found


def _part(run: Run, rows: Sequence[int] | np.ndarray) -> Run:
    extra = {name: values[rows] for name, values in run.extra.items()}
    lines = tuple(run.lines[k] for k in rows) if run.lines else ()
    return replace(
        run, time=run.time[rows], inputs=run.inputs[rows], tip_force=run.tip_force[rows], points=run.points[rows], extra=extra, lines=lines
    )
