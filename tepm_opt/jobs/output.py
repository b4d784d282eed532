"""Shared parts of jobs: items until the user interrupts, and files that several of them write.

A job is `run_<name>(…, progress)`, which returns a frozen run: `ok`, a `summary` for people and programs, and `save`, which writes its
tables and the summary into a folder.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tepm_opt.data.files import write_atomically
from tepm_opt.data.setpoints import FORCE_COLUMNS, SetPoints, input_columns, length_columns, point_columns
from tepm_opt.data.tables import write_table
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.solvers.mechanics.statics import Equilibrium

Item = TypeVar("Item")


def collect(items: Iterable[Item]) -> tuple[list[Item], bool]:
    """All items, or those so far and True where the user interrupts (Ctrl-C)."""
    found: list[Item] = []
    try:
        for item in items:
            found.append(item)
    except KeyboardInterrupt:
        return found, True
    return found, False


def outcome_of(solved: int, asked: int, interrupted: bool) -> Outcome:
    """Summarize a job on many points as one outcome: solved where all of them are."""
    if interrupted:
        return Outcome(Ending.INTERRUPTED, f"{solved} of {asked} points were solved until then")
    if solved < asked:
        return Outcome(Ending.FAILED, f"{asked - solved} of {asked} points are not solved")
    return Outcome()


def save_summary(folder: Path, job: str, summary: dict[str, Any]) -> None:
    """Put a job's summary under its name into the folder's summary.json, beside those of other jobs."""
    path = folder / "summary.json"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        content = {}
    content = content if isinstance(content, dict) else {}
    write_atomically(path, json.dumps({**content, job: summary}, indent=2) + "\n")


def shape_columns(setpoints: SetPoints, equilibria: Sequence[Equilibrium], good: Sequence[bool]) -> dict[str, np.ndarray]:
    """Columns of set points and of the equilibria under them, (rows,) each.

    Args:
        setpoints: of the rows; what has no equilibrium is left out.
        equilibria: a row each.
        good: whether a row has a shape; else it is NaN.
    """
    if not equilibria:
        return {}
    layout, rows = equilibria[0].model.layout, slice(len(equilibria))
    seen = np.array([np.append(at.points.ravel(), at.lengths.ravel()) for at in equilibria])
    seen[~np.array(good, dtype=bool)] = np.nan
    columns = {"time_s": setpoints.time[rows], **dict(zip(input_columns(layout.actuator_names), setpoints.inputs[rows].T, strict=True))}
    columns |= dict(zip(FORCE_COLUMNS, setpoints.tip_force[rows].T, strict=True))
    return columns | dict(zip([*point_columns(layout.point_names), *length_columns(layout.actuator_names)], seen.T, strict=True))


def endings(outcomes: Iterable[Outcome]) -> np.ndarray:
    """Convert outcomes to a column of text, the ending of each."""
    return np.array([outcome.ending.value for outcome in outcomes], dtype=np.str_)


def save_shapes(folder: Path, time: np.ndarray, equilibria: Sequence[Equilibrium], good: Sequence[bool]) -> None:
    """Write shape.csv (reference points) and lengths.csv (actuators).

    Args:
        folder: that is there.
        time: of the rows in s, (rows,).
        equilibria: at least one, a row each.
        good: whether a row is written; others stay empty.

    Raises:
        InputError: the folder cannot be written to.
    """
    layout = equilibria[0].model.layout
    points = np.array([e.points.ravel() if ok else np.full(e.points.size, np.nan) for e, ok in zip(equilibria, good, strict=True)])
    lengths = np.array([e.lengths.ravel() if ok else np.full(e.lengths.size, np.nan) for e, ok in zip(equilibria, good, strict=True)])
    write_table(folder / "shape.csv", ["time_s", *point_columns(layout.point_names)], np.column_stack([time, points]))
    write_table(folder / "lengths.csv", ["time_s", *length_columns(layout.actuator_names)], np.column_stack([time, lengths]))
