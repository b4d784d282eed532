"""Identification of pressure regulators from gauges: grid of their set points, lag and delay.

A gauge's reading is compared with the output of a simulated device. If only the gauge's noise is left, the commands are replaced by those
that the device executes. Its lag is then known better than from the robot's motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from tepm_opt.data.run import Run, RunSet
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.preparation.measured_inputs import measured_column, measured_inputs
from tepm_opt.discrepancy.preparation.settings import DEFAULT, PreparationSettings
from tepm_opt.discrepancy.problem.plant import Candidate, SearchablePlant, as_network
from tepm_opt.models.effects import find_effect


@dataclass(frozen=True, eq=False)
class IdentifiedDevices:
    """Pressure regulators as gauges show them.

    Attributes:
        runs: all runs, with pressures on the grid where gauges show one.
        gauge_effects: candidates that act: a lag within the range that gauges leave and, where gauges show one, a delay that is no longer
            than theirs. It may be shorter: a gauge may be late itself.
        values: of their parameters by full name.
        delay: as a candidate of that range, shown or not.
        note: the result in a sentence.
    """

    runs: tuple[Run, ...]
    gauge_effects: tuple[Candidate, ...]
    values: dict[str, float]
    delay: Candidate
    note: str

    def narrow_candidates(self, missing: Sequence[Candidate]) -> tuple[Candidate, ...]:
        """Candidates, those of the devices within the ranges that gauges leave."""
        narrowed = {known: known for known in (*self.gauge_effects, self.delay)}
        return tuple(narrowed.get(candidate, candidate) for candidate in missing)


def identify_devices(dataset: RunSet, plant: SearchablePlant, settings: PreparationSettings = DEFAULT) -> IdentifiedDevices | None:
    """Grid, lag and delay of the pressure regulators; None where no gauge shows them, or shows something else besides.

    Args:
        dataset: checked data.
        plant: a network with lag and delay among its candidates, or another machine, whose devices are not looked at.
        settings: thresholds.
    """
    network = as_network(plant)
    if network is None or plant.static:
        return None
    lag, delay = (_candidate_with_hook(plant.candidates, hook) for hook in ("lag", "delay"))
    columns = _pressure_columns(dataset.fit, plant.signals)
    if lag is None or delay is None or not columns:
        return None
    names = [measured_column(plant.signals.inputs[k]) for k in columns]
    readings = [np.stack([run.extra[name] for name in names], axis=1) for run in dataset.fit]
    step = network.model.robot.actuation.pressure_step
    fits = [_fit_regulators(dataset.fit, columns, readings, grid, settings) for grid in ({0.0, step} if step else {0.0})]
    best, plain = min(fits, key=lambda fit: fit.squares), max(fits, key=lambda fit: fit.squares)
    best = best if best.squares < settings.regulator_max_remaining * plain.squares else next(fit for fit in fits if not fit.grid)
    exact = best.squares < settings.regulator_exact**2 * best.unlagged
    only_noise = exact or best.rms < settings.regulator_max_noise * _gauge_noise(readings)
    if best.squares > settings.regulator_max_remaining * best.unlagged or not only_noise:
        return None
    runs = tuple(_on_grid(run, columns, best.grid, settings) for run in dataset.runs) if best.grid else dataset.runs
    return _restrict_candidates(best, runs, lag, delay, settings)


def _restrict_candidates(
    best: _Fit, runs: tuple[Run, ...], lag: Candidate, delay: Candidate, settings: PreparationSettings
) -> IdentifiedDevices:
    """Lag and delay kept to the ranges that a fit to gauges leaves."""
    names = [f"{lag.label}.{name}" for name in ("filling_time", "exhausting_time")]
    halves = [
        max(settings.regulator_range_sigmas * std, settings.regulator_range_share * t) for t, std in zip(best.times, best.stds, strict=True)
    ]
    ranges = {name: (max(t - half, 0.0), t + half) for name, t, half in zip(names, best.times, halves, strict=True)}
    probes = tuple({n: probe[n] for n in names} for probe in lag.probes[:1])
    known = replace(lag, null={name: lag.null[name] for name in names}, probes=probes, ranges=ranges)
    late = replace(delay, ranges=dict.fromkeys(delay.parameters, (0.0, best.delay + settings.regulator_min_delay)))
    shown, values, after = (known,), dict(zip(names, best.times, strict=True)), ""
    if best.delay > settings.regulator_min_delay:
        shown, values, after = (known, late), values | dict.fromkeys(delay.parameters, best.delay), f" after {best.delay:.3f} s"
    stairs = f", on a grid of {best.grid:g} Pa" if best.grid else ""
    note = (
        f"Pressure gauges show regulators that lag by {best.times[0]:.3g} s filling and {best.times[1]:.3g} s exhausting{after}{stairs}; "
        "the model follows them"
    )
    return IdentifiedDevices(runs, shown, values, late, note)


def _candidate_with_hook(candidates: Sequence[Candidate], hook: str) -> Candidate | None:
    """The candidate whose effect declares a lag or a delay that stays as it is."""
    named = [(c, find_effect(c.name)) for c in candidates if c.stage == "input" and c.detail is None]
    return next((c for c, effect in named if effect.has(hook) and not effect.timed), None)


def _pressure_columns(runs: Sequence[Run], signals: Signals) -> list[int]:
    """Columns of the pressures, where gauges show all of them in all runs."""
    seen = set(measured_inputs(runs, signals))
    columns = [k for k, name in enumerate(signals.inputs) if name.endswith("_Pa")]
    return columns if all(signals.inputs[k] in seen for k in columns) else []


def _gauge_noise(readings: Sequence[np.ndarray]) -> float:
    """A gauge's noise, 1 sigma: the median second difference of its readings, which a slow pressure hardly has."""
    second = np.concatenate([np.diff(each, 2, axis=0).ravel() for each in readings])
    return float(1.4826 * np.nanmedian(np.abs(second)) / np.sqrt(6))


def _on_grid(run: Run, columns: Sequence[int], grid: float, settings: PreparationSettings) -> Run:
    """A run whose pressures are those of regulators that take set points on a grid.

    Between rows these are stairs, whose steps may come at any time. The differences between stairs and commands are averaged about each
    row. Their weights are those with which a function that is linear between rows depends on the row. A slow follower then gets as much as
    from the stairs.
    """
    parts = settings.regulator_substeps
    fine = (np.arange(parts) + 0.5) / parts
    asked, lasts = run.inputs[:, columns], np.diff(run.time)
    between = asked[:-1, None] + fine[:, None] * np.diff(asked, axis=0)[:, None]  # (rows - 1, parts, columns)
    stairs = grid * np.round(between / grid)
    means, weights = np.zeros_like(asked), np.zeros((run.rows, 1))
    for rows, part in ((slice(0, -1), 1 - fine), (slice(1, None), fine)):
        means[rows] += lasts[:, None] * np.einsum("kpc,p->kc", stairs - between, part) / parts
        weights[rows] += lasts[:, None] / 2
    inputs = run.inputs.copy()
    inputs[:, columns] = np.clip(asked + means / np.maximum(weights, 1e-9), stairs.min(axis=(0, 1)), stairs.max(axis=(0, 1)))
    return replace(run, inputs=inputs)


@dataclass(frozen=True, eq=False)
class _Fit:
    """A lag and a delay fitted to gauges.

    Attributes:
        grid: of the set points in Pa; 0 is none.
        delay: in s.
        times, stds: time constants filling and exhausting in s, and their standard deviations.
        squares, unlagged: sum of squares left, and without lag and delay.
        rms: root mean square left.
    """

    grid: float
    delay: float
    times: tuple[float, float]
    stds: tuple[float, float]
    squares: float
    unlagged: float
    rms: float


def _fit_regulators(
    runs: Sequence[Run], columns: Sequence[int], readings: Sequence[np.ndarray], grid: float, settings: PreparationSettings
) -> _Fit:
    """Least-squares fit of delay and lag; every gauge may have an offset and a gain of its own.

    Args:
        runs: to fit to.
        columns: of the pressures.
        readings: of their gauges, (rows, columns) of every run.
        grid: of the set points in Pa; 0 is none.
        settings: thresholds.
    """
    step, parts = settings.regulator_step, settings.regulator_substeps
    count = max(int((run.time[-1] - run.time[0]) / step) + 2 for run in runs)
    fine = step * np.arange(count)
    within = (fine[:, None] + step * ((np.arange(parts) + 0.5) / parts - 1)).ravel()  # of the time before each sample

    def residuals(values: np.ndarray) -> np.ndarray:
        delay, filling, exhausting = values
        asked = np.array([np.interp(run.time[0] - delay + within, run.time, run.inputs[:, k]) for run in runs for k in columns])
        stairs = grid * np.round(asked / grid) if grid else asked
        followed = _simulate_lag(stairs.reshape(len(asked), count, parts).mean(axis=2), step, filling, exhausting)
        by_run = followed.reshape(len(runs), len(columns), count)
        modelled = [
            np.stack([np.interp(run.time - run.time[0], fine, row) for row in own], axis=1) for run, own in zip(runs, by_run, strict=True)
        ]
        return _subtract_affine(np.concatenate(readings), np.concatenate(modelled))

    start, low, high = np.array([0.01, 0.1, 0.1]), np.full(3, 1e-4), np.array([0.5, 10.0, 10.0])  # delay, filling and exhausting time in s
    found = least_squares(residuals, start, bounds=(low, high), x_scale=start, diff_step=0.05, max_nfev=12)
    spread = float(np.mean(found.fun**2))
    _, *stds = (float(std) for std in np.sqrt(np.diag(spread * np.linalg.pinv(found.jac.T @ found.jac))))
    delay, filling, exhausting = (float(value) for value in found.x)
    unlagged = float(np.sum(residuals(low) ** 2))
    rms = float(np.sqrt(spread))
    return _Fit(grid, delay, (filling, exhausting), (stds[0], stds[1]), float(2 * found.cost), unlagged, rms)


def _simulate_lag(commands: np.ndarray, step: float, filling: float, exhausting: float) -> np.ndarray:
    """Output of a first-order lag with other time constants up and down, (channels, samples).

    Args:
        commands: held over the time step before every sample, (channels, samples).
        step: between samples in s.
        filling, exhausting: time constants in s.
    """
    up, down = (1 - np.exp(-step / max(time, 1e-6)) for time in (filling, exhausting))
    found = np.empty_like(commands)
    found[:, 0] = state = commands[:, 0]
    for k in range(1, commands.shape[1]):
        missing = commands[:, k] - state
        state = state + np.where(missing > 0, up, down) * missing
        found[:, k] = state
    return found


def _subtract_affine(readings: np.ndarray, modelled: np.ndarray) -> np.ndarray:
    """Readings (samples, channels) less their best line over the modelled values, a line each; 0 where a reading is missing."""
    left = np.zeros_like(readings)
    for k in range(readings.shape[1]):
        seen = np.isfinite(readings[:, k])
        line = np.stack([np.ones(seen.sum()), modelled[seen, k]], axis=1)
        left[seen, k] = readings[seen, k] - line @ np.linalg.lstsq(line, readings[seen, k], rcond=None)[0]
    return left.ravel()
