"""Is a data set what it says? Units, time, sensors, starts at rest: what `tepm data check` finds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from tepm_opt.data.checks.findings import Finding, Subject
from tepm_opt.data.checks.inputs import check_inputs, is_excited
from tepm_opt.data.checks.motion import check_motion
from tepm_opt.data.checks.points import check_points, wrong_units
from tepm_opt.data.checks.time import check_time
from tepm_opt.data.datasets import DESCRIPTION, DataSet, FolderReading
from tepm_opt.data.run import ROLES, Run


def check_dataset(dataset: DataSet) -> list[Finding]:
    """Findings in a data set: all that is wrong or doubtful, in the order of its runs.

    Limits, units and order of the points are judged as far as `dataset.channels` knows the robot.
    """
    subjects = [Subject(run, dataset.channels, None if dataset.static else dataset.sample_rate) for run in dataset.runs]
    findings = [finding for subject in subjects for finding in _check_run(subject, dataset.static)]
    return findings + list(_check_together(dataset, subjects))


def _check_run(subject: Subject, static: bool) -> Iterator[Finding]:
    yield from () if static else check_time(subject)
    yield from check_inputs(subject)
    yield from check_points(subject)
    if static:
        yield from _same_equilibria(subject)
    elif np.all(np.diff(subject.run.time) > 0) and not any(wrong_units(subject)):
        yield from check_motion(subject)


def _same_equilibria(subject: Subject) -> Iterator[Finding]:
    values = np.hstack([subject.driven, subject.run.points.reshape(subject.run.rows, -1)])
    _, first = np.unique(values, axis=0, return_index=True)
    rows = np.setdiff1d(np.arange(len(values)), first)
    if rows.size:
        yield subject.make_finding("warning", "", "stands in the file before", rows)


def _check_together(dataset: DataSet, subjects: list[Subject]) -> Iterator[Finding]:
    """Find faults that concern several runs."""

    def make_finding(severity: Any, message: str) -> Finding:
        return Finding(severity, DESCRIPTION, None, None, "", message)

    if not dataset.runs:
        yield make_finding("warning", "lists no runs")
        return
    for role in ROLES:
        if not any(run.role == role for run in dataset.runs):
            yield make_finding("warning", f"no run has the role {role!r}")
    if dataset.fit and not any(is_excited(subject) for subject in subjects if subject.run.role == "fit"):
        yield make_finding("error", "no run to fit to excites anything: nothing can be learnt from them")
    for k, run in enumerate(dataset.runs):
        for other in dataset.runs[:k]:
            if _same_positions(run, other):
                both = "" if run.role == other.role else ", though one is to judge what is fitted to the other"
                yield Finding("error", run.file, None, None, "", f"the same positions as in {other.file}{both}")
    yield from _declared_noise(dataset, subjects)


def _same_positions(run: Run, other: Run) -> bool:
    rows = min(run.rows, other.rows)
    same = run.points[:rows] == other.points[:rows]
    moving = np.any(np.nan_to_num(run.points[:rows]) != np.nan_to_num(run.points[0]))
    return bool(same.size and moving and same.mean() > 0.9)


def _declared_noise(dataset: DataSet, subjects: list[Subject]) -> Iterator[Finding]:
    """`position_noise_m` far from what the quietest run shows."""
    declared = dataset.position_noise
    levels = [np.nanmedian(subject.noise) for subject in subjects if np.isfinite(subject.noise).any()]
    if declared is None or dataset.static or not levels:
        return
    seen = float(min(levels))
    if max(seen, declared) > 2 * min(seen, declared) and abs(seen - declared) > 1e-4:
        message = f"position_noise_m = {declared:g}, but the samples scatter by {seen:.1e} m per axis"
        yield Finding("warning", DESCRIPTION, None, None, "", message)


def check_reading(reading: FolderReading) -> list[Finding]:
    """List all that is wrong or doubtful in a data set's folder that was read, not just the first fault.

    Runs are looked at once `dataset.toml` is right.
    """
    findings = [Finding("error", file, None, None, "", message) for file, message in reading.faults]
    if reading.dataset is None:
        return findings
    if reading.dataset.runs or not findings:
        findings += check_dataset(reading.dataset)
    listed = {(reading.folder / file).resolve() for file in reading.listed}
    for path in sorted(reading.folder.glob("*.csv")):
        if path.resolve() not in listed and not path.name.startswith("."):
            findings.append(Finding("warning", path.name, None, None, "", f"in the folder, but not listed in {DESCRIPTION}"))
    return findings
