"""Set-point files (`inputs.csv`) and the other tables whose columns SPEC section 4 names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tepm_opt.data.sizes import PRESSURE, TENSION, judge_force, judge_inputs
from tepm_opt.data.tables import Table, read_table, write_table
from tepm_opt.errors import InputError

AXES = ("x", "y", "z")
INPUT = re.compile(r"pressure_\d+(_\d+)?_Pa|tension_\d+(_\d+)?_N")
FORCE_COLUMNS = tuple(f"tip_force_{axis}_N" for axis in AXES)


def input_columns(actuators: Sequence[str]) -> list[str]:
    """Columns of u: pressures, then tensions, of the named actuators ("11", "12", …)."""
    return [f"pressure_{name}_Pa" for name in actuators] + [f"tension_{name}_N" for name in actuators]


def point_columns(points: Sequence[str]) -> list[str]:
    """Columns of the reference points ("s1", …) in G."""
    return [f"{name}_{axis}_m" for name in points for axis in AXES]


def length_columns(actuators: Sequence[str]) -> list[str]:
    """Columns of the actuator lengths."""
    return [f"length_{name}_m" for name in actuators]


def gain_columns(inputs: int) -> list[str]:
    """Columns of G, row by row: g_1_1 … g_3_12."""
    return [f"g_{row + 1}_{number + 1}" for row in range(3) for number in range(inputs)]


@dataclass(frozen=True, eq=False)
class SetPoints:
    """Inputs over time.

    Attributes:
        time: (rows,) in s, increasing.
        inputs: (rows, 2 · modules · actuators) in Pa and N; a row all NaN has no inputs (its inverse kinematics failed).
        tip_force: known force on the tip in G, (rows, 3) in N.
    """

    time: np.ndarray
    inputs: np.ndarray
    tip_force: np.ndarray

    def __repr__(self) -> str:
        rows, columns = self.inputs.shape
        lasting = f" over {self.time[-1] - self.time[0]:g} s" if rows else ""
        return f"SetPoints({rows} rows{lasting}, {columns} inputs{', with a tip force' if self.tip_force.any() else ''})"

    @classmethod
    def single(cls, inputs: Sequence[float] | np.ndarray, tip_force: Sequence[float] | None = None) -> SetPoints:
        """One row at time 0: inputs (2 · modules · actuators,) in Pa and N, force on the tip (3,) in N, none where absent."""
        force = np.zeros(3) if tip_force is None else np.asarray(tip_force, dtype=float)
        return cls(np.zeros(1), np.asarray(inputs, dtype=float)[None], force[None])


def read_setpoints(path: str | Path, actuators: Sequence[str], limits: np.ndarray) -> SetPoints:
    """A set-point file: `time_s`, the inputs of the named actuators and, where there is one, the tip force.

    Raises:
        InputError: unreadable file, missing column, actuator the robot has not, value that is no number or
            outside 0 … limit, row with some inputs and not others, time that does not increase, inputs or forces in another unit.
    """
    table = read_table(path)
    time = table.read_increasing("time_s")
    names = input_columns(actuators)
    for name in table.columns:
        if INPUT.fullmatch(name) and name not in names:
            raise InputError(f"{path}: column {name!r}: the robot has no such actuator; valid: {', '.join(actuators)}")
    absent = np.all([np.isnan(table.columns[name]) for name in names if name in table], axis=0)
    columns = [table.column(name, may_be_empty=absent) for name in names]
    refuse_out_of_range(table, names, limits)
    forces = [table.column(name) if name in table else np.zeros(len(time)) for name in FORCE_COLUMNS]
    inputs, force = np.stack(columns, axis=1), np.stack(forces, axis=1)
    most = float(np.sum(limits[len(actuators) :]))
    if wrong := judge_inputs(inputs, limits) or judge_force(float(np.linalg.norm(force, axis=1).max()), most):
        raise InputError(f"{path}: {wrong}")
    return SetPoints(time, inputs, force)


def refuse_out_of_range(table: Table, names: Sequence[str], limits: np.ndarray) -> None:
    """Refuse inputs outside 0 … limit; empty fields pass.

    Args:
        table: of a file.
        names: columns of the inputs.
        limits: upper limits of the columns in Pa and N, (columns,).

    Raises:
        InputError: with file, line, column and the range.
    """
    for name, limit in zip(names, limits, strict=True):
        values, quantity = table.columns[name], PRESSURE if name.startswith(PRESSURE.name) else TENSION
        largest = float(np.nanmax(values, initial=0.0))
        table.refuse((values < -1e-9 * limit) | (values > limit * (1 + 1e-9)), name, quantity.valid(largest, limit))


def write_setpoints(path: str | Path, setpoints: SetPoints, actuators: Sequence[str]) -> None:
    """Write a set-point file; the tip force's columns only where there is one."""
    columns = [setpoints.time[:, None], setpoints.inputs]
    names = ["time_s", *input_columns(actuators)]
    if setpoints.tip_force.any():
        columns.append(setpoints.tip_force)
        names += FORCE_COLUMNS
    write_table(path, names, np.hstack(columns))
