"""Measured pressures and tensions: what happens before them is told apart from what happens behind them."""

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
    """The runs with measured pressures and tensions in the place of commanded ones, where a channel is measured in all of them.

    Values outside the robot's limits (a gauge's noise at zero) are put on them, missing samples are interpolated. None where no channel
    is measured in all runs.
    """
    columns = {k: measured_column(signals.inputs[k]) for k in _measured(runs, signals)}
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


def gauged(runs: Sequence[Run], signals: Signals) -> tuple[str, ...]:
    """Names of the inputs that are measured in all runs."""
    return tuple(signals.inputs[k] for k in _measured(runs, signals))


def _measured(runs: Sequence[Run], signals: Signals) -> list[int]:
    found = []
    for k, column in enumerate(signals.inputs):
        name = measured_column(column)
        if all(name in run.extra and _usable(run.extra[name]) for run in runs):
            found.append(k)
    return found


def behind(missing: Sequence[Candidate], gauges: Collection[str]) -> tuple[Candidate, ...]:
    """The candidates but for those between the command and a gauge that shows the input; what the gauge may have itself stays."""
    return tuple(c for c in missing if c.gauge or c.stage != "input" or c.detail not in gauges)


def measured_column(column: str) -> str:
    """Column of the measured value of an input: "pressure_11_Pa" to "pressure_11_measured_Pa", "force" to "force_measured"."""
    stem, _, unit = column.rpartition("_")
    return f"{stem}_measured_{unit}" if stem else f"{unit}_measured"


def _usable(values: np.ndarray) -> bool:
    return values.dtype.kind == "f" and bool(np.isfinite(values).mean() > 0.5)


def separated(body: Explanation, missing: Sequence[Candidate], settings: SearchSettings) -> tuple[Candidate, ...]:
    """The candidates that are left once a search with measured inputs has looked at what happens behind them.

    What that search found, and what acts on inputs; all candidates where it left structure that nothing explains.
    """
    if body.best.excess > settings.max_noise_excess and not body.best.effects:
        return tuple(missing)
    return tuple(c for c in missing if c in body.best.effects or c.stage == "input")
