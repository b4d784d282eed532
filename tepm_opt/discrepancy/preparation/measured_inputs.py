"""Measured pressures and tensions, which separate effects before a gauge from effects behind it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.forward_backward import Explanation


def with_measured_inputs(runs: Sequence[Run], signals: Signals) -> tuple[Run, ...] | None:
    """The runs with measured pressures and tensions in place of commanded ones, for channels measured in all runs; None without any.

    Values outside the robot's limits (a gauge's noise at zero) are put on them, missing samples are interpolated.
    """
    columns = {signals.inputs.index(name): measured_column(name) for name in measured_inputs(runs, signals)}
    if not columns:
        return None
    found = []
    for run in runs:
        inputs = run.inputs.copy()
        for k, name in columns.items():
            values = run.extra[name]
            seen = np.isfinite(values)
            inputs[:, k] = np.clip(np.interp(np.arange(run.rows), np.flatnonzero(seen), values[seen]), 0.0, signals.limits[k])
        found.append(replace(run, inputs=inputs))
    return tuple(found)


def measured_inputs(runs: Sequence[Run], signals: Signals) -> tuple[str, ...]:
    """Names of the inputs that are measured in all runs."""
    return tuple(name for name in signals.inputs if all(_is_measured(run, measured_column(name)) for run in runs))


def _is_measured(run: Run, column: str) -> bool:
    values = run.extra.get(column)
    return values is not None and values.dtype.kind == "f" and bool(np.isfinite(values).mean() > 0.5)


def measured_column(column: str) -> str:
    """Column of the measured value of an input: "pressure_11_Pa" to "pressure_11_measured_Pa", "force" to "force_measured"."""
    stem, _, unit = column.rpartition("_")
    return f"{stem}_measured_{unit}" if stem else f"{unit}_measured"


def downstream_candidates(missing: Sequence[Candidate], gauges: Collection[str]) -> tuple[Candidate, ...]:
    """Candidates without those between a command and the gauge that shows the input; errors of the gauge itself stay."""
    return tuple(c for c in missing if c.gauge or c.stage != "input" or c.detail not in gauges)


def exclude_by_measured_inputs(body: Explanation, missing: Sequence[Candidate], settings: SearchSettings) -> tuple[Candidate, ...]:
    """Candidates that remain after a search with measured inputs: those it found, and those that act on inputs.

    All candidates remain where that search left structure that nothing explains.
    """
    if body.best.excess > settings.max_noise_excess and not body.best.effects:
        return tuple(missing)
    return tuple(c for c in missing if c in body.best.effects or c.stage == "input")
