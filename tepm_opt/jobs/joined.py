"""Data sets of one machine as one: what was recorded later goes on with what there was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tepm_opt.data.datasets import APART, DataSet
from tepm_opt.data.run import Run
from tepm_opt.errors import InputError
from tepm_opt.models.robot import load_robot


def concatenate_datasets(first: DataSet, added: Sequence[tuple[Path, DataSet]]) -> DataSet:
    """Append the runs of other data sets to one, as if the session had gone on.

    Runs that are added are named after their folder: `extra/next.csv` is `extra_next.csv`. An unknown noise is taken to be the first's.

    Args:
        first: the data set that is gone on with.
        added: folders with what was read of them, in order.

    Raises:
        InputError: another robot, other columns, equilibria beside motion, another noise or sample rate; names the folder.
    """
    found, robot = first, load_robot(first.robot)
    for folder, other in added:
        if other.channels.columns != first.channels.columns or load_robot(other.robot) != robot:
            raise InputError(f"{folder}: its robot is {other.robot!r}, not {first.robot!r}; valid: more data of the same machine")
        if other.static != first.static:
            kinds = ("equilibria" if each.static else "motion" for each in (other, first))
            raise InputError(f"{folder}: its rows are {next(kinds)}, those before {next(kinds)}; valid: data of one kind")
        for name, unit, own, before in (
            ("position_noise_m", "m", other.position_noise, first.position_noise),
            ("sample_rate_hz", "Hz", other.sample_rate, first.sample_rate),
        ):
            if own is not None and before is not None and abs(own - before) > 1e-6 * before:
                raise InputError(f"{folder}: {name} = {own:g} {unit}; valid: {before:g} {unit}, as in the data before")
        found = found.with_runs([*found.runs, *_rename_runs(found, folder, other)])
    return found


def _rename_runs(before: DataSet, folder: Path, added: DataSet) -> tuple[Run, ...]:
    """Runs under names that are free, after those before."""
    last = max(before.runs, key=lambda run: run.began)
    taken, prefix, number = {run.file for run in before.runs}, folder.resolve().name, 2
    while any(f"{prefix}_{Path(run.file).name}" in taken for run in added.runs):
        prefix, number = f"{folder.resolve().name}-{number}", number + 1
    after = last.began + APART + (last.duration if last.rows and not before.static else 0.0)
    return tuple(replace(run, file=f"{prefix}_{Path(run.file).name}", began=after + run.began) for run in added.runs)
