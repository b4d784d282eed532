"""Inputs between the samples of a run: the time grid of the simulation, interpolation, and delayed inputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy.signal import resample_poly

from tepm_opt.data.run import Run
from tepm_opt.solvers.mechanics.plant import PredictionError

Between = Literal["hold", "line", "band"]


def refine_time_grid(run: Run, between: Between) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times that are simulated, in s, the inputs there, and the rows of them that are samples.

    An interval of 1.5 times the usual length or more is divided into several.

    Raises:
        PredictionError: samples are too far apart, or not equally far although only all samples together determine the inputs.
    """
    apart = np.diff(run.time)
    usual = float(np.median(apart)) if len(apart) else 1.0
    if between == "band" and np.abs(apart - usual).max(initial=0.0) > 1e-3 * usual:
        raise PredictionError(f'{run.file}: samples are not equally far apart; valid: between = "line" or "hold"')
    if apart.sum() > 1000 * usual * run.rows:  # a clock that jumps would ask for a simulation without end
        raise PredictionError(f"{run.file}: samples are {apart.min():g} to {apart.max():g} s apart; valid: a run of its own for each part")
    rows = np.append(0, np.cumsum(np.maximum(np.round(apart / usual), 1).astype(int)))
    if len(rows) == rows[-1] + 1:
        return run.time, run.inputs, rows
    steps = np.arange(rows[-1] + 1)
    time = np.interp(steps, rows, run.time)
    if between == "hold":
        return time, run.inputs[np.searchsorted(rows, steps, side="right") - 1], rows
    return time, _interpolate(time, run.time, run.inputs), rows


def sample_steps(time: np.ndarray) -> np.ndarray:
    """Steps from sample to sample, (times - 1,) in s: equal where they differ only by the rounding of the file."""
    steps = np.diff(time)
    return np.full(len(steps), steps.mean()) if len(steps) and np.ptp(steps) <= 1e-3 * steps.mean() else steps


def inputs_at_steps(time: np.ndarray, u: np.ndarray, late: Sequence[tuple[int, float]], between: Between, substeps: int) -> np.ndarray:
    """Inputs at the ends of all steps between samples and at the later sample, (times - 1, (substeps + 2) · inputs).

    A dead time of held inputs takes their mean over the step, which lies on the straight line between two samples.

    Args:
        time: of the samples, (times,) in s.
        u: inputs there, (times, inputs).
        late: numbers of delayed inputs with their delays in s.
        between: see `CasadiPlant`.
        substeps: steps from sample to sample.
    """
    gaps = len(u) - 1
    ends = append_delayed(u, time, late)
    if between == "hold":
        fine = np.repeat(ends[:-1, None], substeps + 1, axis=1)
    else:
        rows = np.arange(gaps * substeps + 1) / substeps
        if between == "band" and substeps > 1:
            every = resample_poly(u, substeps, 1, axis=0, padtype="line")[: len(rows)]
        else:
            every = _interpolate(rows, np.arange(len(u)), u)
        every = append_delayed(every, np.interp(rows, np.arange(len(u)), time), late)
        fine = np.stack([every[k : len(every) - substeps + k : substeps] for k in range(substeps + 1)], axis=1)
    return np.concatenate([fine, ends[1:, None]], axis=1).reshape(gaps, -1)


def append_delayed(columns: np.ndarray, time: np.ndarray, late: Sequence[tuple[int, float]]) -> np.ndarray:
    """Append the values of the symbols of each dead time to inputs, (times, inputs + 5 · dead times).

    Args:
        columns: inputs, (times, inputs).
        time: of the rows, (times,) in s.
        late: numbers of delayed inputs with their delays in s.
    """
    more = [
        np.column_stack([_interpolate_delayed(time - seconds, time, columns[:, number]), np.full(len(time), seconds)])
        for number, seconds in late
    ]
    return np.hstack([columns, *more])


def _interpolate_delayed(at: np.ndarray, time: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Values and slopes of a column at other times, (times, 4): each as a constant and a factor of the value before the run.

    Samples are joined by straight lines. Before the first one the column has one value, from which it goes to the first sample within a
    step. Where two lines meet, the slope is that of the earlier one, which is the one towards longer dead times.
    """
    step = time[1] - time[0] if len(time) > 1 else 1.0
    times, unit = np.append(time[0] - step, time), np.zeros(len(time) + 1)
    unit[0] = 1.0
    line = np.searchsorted(times, at, side="left") - 1
    found = []
    for values in (np.append(0.0, column), unit):
        slopes = np.append(np.diff(values) / np.diff(times), 0.0)
        found += [np.interp(at, times, values), np.where(line >= 0, slopes[line], 0.0)]
    return np.stack([found[0], found[2], found[1], found[3]], axis=1)


def _interpolate(at: np.ndarray, time: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Columns (times, columns) at other times."""
    return np.array([np.interp(at, time, column) for column in columns.T]).reshape(-1, len(at)).T
