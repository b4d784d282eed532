"""A run of an experiment and its CSV file (SPEC section 4)."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, Self

import numpy as np

from tepm_opt.data.channels import TIME, Channels
from tepm_opt.data.setpoints import FORCE_COLUMNS
from tepm_opt.data.tables import Table, read_table, write_columns
from tepm_opt.errors import InputError, unknown_name

Role = Literal["fit", "validation"]
Start = Literal["equilibrium", "measured", "free"]
ROLES: tuple[Role, ...] = ("fit", "validation")


@dataclass(frozen=True, eq=False)
class Run:
    """One run.

    Attributes:
        file: name of the CSV file in the data set's folder.
        role: "fit" or "validation"; the latter is never used to fit or to choose an effect.
        time: (rows,) in s; NaN in data of equilibria that have no time.
        inputs: commanded u = [pressures, tensions], (rows, 2 · modules · actuators) in Pa and N.
        tip_force: known external force on the tip in G, (rows, 3) in N.
        points: reference points in G, (rows, points, 3) in m; NaN where a sample is missing.
        extra: further columns by name, (rows,) each, numbers or text: `pressure_11_measured_Pa`, …
        start: how it begins: at rest under its first row, or in a state that its first samples tell, or all of them ("free").
        group: what runs of one condition have in common.
        state: of the machine at the first row where it is known, or guessed; None for rest.
        lines: line of each row in the file it was read from; empty where there is none.
        began: time in the session in s at the first row, for what changes from run to run.
    """

    file: str
    role: Role
    time: np.ndarray
    inputs: np.ndarray
    tip_force: np.ndarray
    points: np.ndarray
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)
    lines: tuple[int, ...] = ()
    start: Start = "equilibrium"
    group: str = ""
    state: np.ndarray | None = None
    began: float = 0.0

    def __post_init__(self) -> None:
        """Refuse arrays that do not fit together.

        Raises:
            InputError: naming the array and both shapes; unknown role.
        """
        if self.role not in ROLES:
            raise unknown_name("role", self.role, ROLES, self.file)
        rows = len(self.inputs)
        shapes = {
            "time": (rows,),
            "inputs": (rows, self.inputs.shape[-1]),
            "tip_force": (rows, 3),
            "points": (rows, *(*self.points.shape[1:3], 1)[:2]),
        }
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise InputError(f"{self.file}: {name} has the shape {getattr(self, name).shape}; valid: {shape}")
        for name, values in self.extra.items():
            if values.shape != (rows,):
                raise InputError(f"{self.file}: column {name!r} has the shape {values.shape}; valid: {(rows,)}")
            if values.dtype.kind not in "fU":
                raise InputError(f"{self.file}: column {name!r} has the type {values.dtype}; valid: floating-point numbers or text")

    def __repr__(self) -> str:
        lasting = f" over {self.duration:g} s" if self.rows and np.isfinite(self.duration) else ""
        size = f"{self.rows} rows{lasting}, {self.inputs.shape[1]} inputs, {self.points.shape[1]} points"
        return f"Run({self.file}: {self.role}, {size})"

    @property
    def rows(self) -> int:
        """Number of samples."""
        return len(self.inputs)

    @property
    def duration(self) -> float:
        """Seconds from the first to the last sample."""
        return float(self.time[-1] - self.time[0])

    def line(self, row: int) -> int:
        """Line of a row (from 0) in the file; the header is line 1."""
        return self.lines[row] if self.lines else row + 2


class RunSet:
    """Runs of one machine: what data sets of whatever kind have in common.

    Attributes:
        name: for people.
        runs: in the order of their description.
        gauges: names of the inputs that gauges show behind the actuators; the others are commands.
    """

    name: str
    runs: tuple[Run, ...]
    gauges: tuple[str, ...] = ()

    @staticmethod
    def from_runs(name: str, runs: Iterable[Run]) -> RunSet:
        """Make a set of runs under a name."""
        found = RunSet()
        found.name, found.runs = name, tuple(runs)
        return found

    def with_runs(self, runs: Iterable[Run]) -> Self:
        """The same with other runs."""
        found = copy(self)
        object.__setattr__(found, "runs", tuple(runs))
        return found

    @property
    def fit(self) -> tuple[Run, ...]:
        """The runs to fit to."""
        return tuple(run for run in self.runs if run.role == "fit")

    @property
    def validation(self) -> tuple[Run, ...]:
        """The runs that judge a fit."""
        return tuple(run for run in self.runs if run.role == "validation")

    def run(self, file: str) -> Run:
        """The run of this file name.

        Raises:
            InputError: there is none.
        """
        for run in self.runs:
            if run.file == file:
                return run
        raise unknown_name("run", file, [run.file for run in self.runs], self.name)


def thin_out(run: Run, apart: float) -> Run:
    """Keep samples of a run that are at least so many seconds apart, and its last one."""
    time = run.time
    first = np.searchsorted(time, np.arange(time[0], time[-1], apart) - 1e-6 * apart)
    kept = np.unique(np.append(first, run.rows - 1))
    return replace(
        run, time=time[kept], inputs=run.inputs[kept], tip_force=run.tip_force[kept], points=run.points[kept], extra={}, lines=()
    )


def read_run(path: str | Path, role: Role = "fit", channels: Channels | None = None, static: bool = False) -> Run:
    """A run from its CSV file.

    Args:
        path: the file.
        role: "fit" or "validation".
        channels: expected columns; those that the header tells where absent.
        static: whether rows are equilibria, not samples of a motion.

    Raises:
        InputError: unreadable file, missing column, text where a number belongs, input that is not finite, time that does not increase.
    """
    table = read_run_table(path)
    channels = channels or Channels.from_header(table.columns)
    run = run_of(table, Path(path).name, role, channels, static)
    refuse_unusable(table, channels, static)
    return run


def read_run_table(path: str | Path) -> Table:
    """The table of a run; columns that SPEC does not name may hold text."""
    return read_table(path, text=lambda name: name not in Channels.from_header([name]).columns)


def run_of(table: Table, file: str, role: Role, channels: Channels, static: bool) -> Run:
    """A run from its table, values unchecked; data of equilibria need no time, and a tip force that is not there is none.

    Args:
        table: columns of the file, (rows,) each in the units of the header.
        file: file name of the run.
        role: "fit" or "validation".
        channels: expected columns.
        static: whether rows are equilibria, not samples of a motion.

    Raises:
        InputError: a column is missing, or stands for an actuator or point that the robot does not have.
    """
    columns, rows = table.columns, len(table.lines)
    optional = {TIME} if static else set()
    optional |= set() if any(name in columns for name in FORCE_COLUMNS) else set(FORCE_COLUMNS)
    if missing := [name for name in channels.columns if name not in columns and name not in optional]:
        near = difflib.get_close_matches(missing[0], [name for name in columns if name not in channels.columns], n=1, cutoff=0.8)
        more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
        hint = f"; found {near[0]!r} in its place" if near else f"; found: {', '.join(columns)}"
        hint += "; data of equilibria have static = true in dataset.toml" if missing[0] == TIME else ""
        raise InputError(f"{table.path}: column {missing[0]!r} is missing{more}{hint}")
    extra = {name: values for name, values in columns.items() if name not in channels.columns}
    own = Channels.from_header(extra)
    if own.actuators or own.points:
        name = next(name for name in extra if Channels.from_header([name]) != Channels((), ()))
        raise InputError(f"{table.path}: column {name!r} is of no actuator or point of the robot; valid: {', '.join(channels.columns)}")

    empty = {TIME: np.full(rows, np.nan)} | dict.fromkeys(FORCE_COLUMNS, np.zeros(rows))
    values = np.stack([columns[name] if name in columns else empty[name] for name in channels.columns], axis=1)
    time, inputs, force, points = np.split(values, np.cumsum([1, len(channels.inputs), 3]), axis=1)
    return Run(file, role, time[:, 0], inputs, force, points.reshape(rows, len(channels.points), 3), extra, table.lines)


def refuse_unusable(table: Table, channels: Channels, static: bool) -> None:
    """Refuse inputs that are not finite, time that does not increase and infinite positions.

    Raises:
        InputError: with file, line and column.
    """
    if not static:
        table.read_increasing(TIME)
    for name in (*channels.inputs, *(name for name in FORCE_COLUMNS if name in table)):
        table.column(name)
    for name in channels.coordinates:
        table.refuse(np.isinf(table.columns[name]), name, "a finite number, or an empty field where the sample is missing")


def run_columns(run: Run, channels: Channels) -> dict[str, np.ndarray]:
    """The columns of a run's CSV file in SPEC's order, then the others; no time where there is none."""
    columns = {} if np.isnan(run.time).all() else {TIME: run.time}
    columns |= dict(zip(channels.inputs, run.inputs.T, strict=True))
    columns |= dict(zip(FORCE_COLUMNS, run.tip_force.T, strict=True))
    columns |= dict(zip(channels.coordinates, run.points.reshape(run.rows, len(channels.coordinates)).T, strict=True))
    return columns | dict(run.extra)


def write_run(path: str | Path, run: Run, channels: Channels) -> None:
    """Write one CSV file, whole or not at all.

    Raises:
        InputError: the folder cannot be written to.
    """
    write_columns(path, run_columns(run, channels))
