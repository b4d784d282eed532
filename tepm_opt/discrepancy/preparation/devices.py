"""What gauges say of the regulators before anything is asked of the body: the grid of their set points, lag and delay.

A gauge's own reading is compared with what a device would make of the commands. Where that leaves nothing but the gauge's noise, the
commands are taken as the device takes them, and its lag is known better than the robot's motion could tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from tepm_opt.data.run import Run, RunSet
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.adapters.network import SearchableNetwork
from tepm_opt.discrepancy.preparation.measured_inputs import gauged, measured_column
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.models.effects import find_effect

PARTS = 8  # of the time between rows, or fine samples, in which stairs are looked at
FINE = 4e-3  # s, of the simulated regulators
FIRST, MOST = (0.01, 0.1, 0.1), (0.5, 10.0, 10.0)  # delay, filling and exhausting time in s: where the fit begins, and bounds
CLEARER = 0.9  # part of the squares that a further property of a device must leave at most to be there
ONLY_NOISE = 1.3  # times the gauge's noise, as differences from sample to sample show it, that may be left
EXACT = 1e-3  # part of the deviation without a lag that may be left however little noise there is
RANGE = 5.0  # standard deviations, and
NEARLY = 0.02  # part of a time constant, within which it is sought on
AT_ONCE = 1e-3  # s, below which a delay is none, and by which it may be longer than gauges show: the body's sluggishness looks like one
EVALUATIONS = 12


@dataclass(frozen=True, eq=False)
class DevicesSeen:
    """What gauges show.

    Attributes:
        runs: all runs, with pressures on the grid where gauges show one.
        shown: candidates that are there: a lag, its values within the range that gauges leave, and, where gauges show one, a delay that is
            no longer than they do. It may be shorter: a gauge may be late itself.
        values: of their parameters by full name.
        delay: as a candidate of that range, shown or not.
        note: in a sentence, what was seen.
    """

    runs: tuple[Run, ...]
    shown: tuple[Candidate, ...]
    values: dict[str, float]
    delay: Candidate
    note: str

    def among(self, missing: Sequence[Candidate]) -> tuple[Candidate, ...]:
        """Candidates, those of the devices within the ranges that gauges leave."""
        narrowed = {known: known for known in (*self.shown, self.delay)}
        return tuple(narrowed.get(candidate, candidate) for candidate in missing)


def devices_seen(dataset: RunSet, network: SearchableNetwork) -> DevicesSeen | None:
    """Grid, lag and delay of the pressure regulators; None where no gauge shows them, or shows something else besides.

    Args:
        dataset: checked data.
        network: the machine's, with lag and delay among its candidates.
    """
    lag, delay = (_declaring(network.candidates, hook) for hook in ("lag", "delay"))
    columns = _pressures(dataset.fit, network.signals)
    if lag is None or delay is None or not columns:
        return None
    step = network.known_model.robot.actuation.pressure_step
    fits = [_Fit.of(dataset.fit, columns, network.signals, grid) for grid in ({0.0, step} if step else {0.0})]
    best = min(fits, key=lambda fit: fit.squares)
    plain = max(fits, key=lambda fit: fit.squares)
    best = best if best.squares < CLEARER * plain.squares else next(fit for fit in fits if not fit.grid)
    noise = _white(dataset.fit, columns, network.signals)
    exact = best.squares < EXACT**2 * best.unlagged
    if best.squares > CLEARER * best.unlagged or not (exact or best.rms < ONLY_NOISE * noise):
        return None
    names = [f"{lag.label}.{name}" for name in ("filling_time", "exhausting_time")]
    ranges = {
        name: (max(time - max(RANGE * std, NEARLY * time), 0.0), time + max(RANGE * std, NEARLY * time))
        for name, time, std in zip(names, best.times, best.stds, strict=True)
    }
    known = replace(
        lag,
        null={name: lag.null[name] for name in names},
        probes=tuple({n: probe[n] for n in names} for probe in lag.probes[:1]),
        ranges=ranges,
    )
    late = replace(delay, ranges=dict.fromkeys(delay.parameters, (0.0, best.delay + AT_ONCE)))
    shown, values = (known,), dict(zip(names, best.times, strict=True))
    if best.delay > AT_ONCE:
        shown, values = (known, late), values | dict.fromkeys(delay.parameters, best.delay)
    after = f" after {best.delay:.3f} s" if late in shown else ""
    stairs = f", on a grid of {best.grid:g} Pa" if best.grid else ""
    note = (
        f"gauges show regulators that lag by {best.times[0]:.3g} s filling and {best.times[1]:.3g} s exhausting{after}{stairs}; "
        "commands are taken as they take them"
    )
    runs = tuple(_on_grid(run, columns, best.grid) for run in dataset.runs) if best.grid else dataset.runs
    return DevicesSeen(runs, shown, values, late, note)


def _declaring(candidates: Sequence[Candidate], hook: str) -> Candidate | None:
    """The candidate whose effect declares a lag or a delay that stays as it is."""
    named = [(c, find_effect(c.name)) for c in candidates if c.stage == "input" and c.detail is None]
    return next((c for c, effect in named if effect.has(hook) and not effect.timed), None)


def _pressures(runs: Sequence[Run], signals: Signals) -> list[int]:
    """Columns of the pressures, where gauges show all of them in all runs."""
    seen = set(gauged(runs, signals))
    columns = [k for k, name in enumerate(signals.inputs) if name.endswith("_Pa")]
    return columns if columns and all(signals.inputs[k] in seen for k in columns) else []


def _readings(run: Run, columns: Sequence[int], signals: Signals) -> np.ndarray:
    return np.stack([run.extra[measured_column(signals.inputs[k])] for k in columns], axis=1)


def _white(runs: Sequence[Run], columns: Sequence[int], signals: Signals) -> float:
    """A gauge's noise, 1 sigma: the median second difference of its readings, which a slow pressure hardly has."""
    second = [np.diff(_readings(run, columns, signals), 2, axis=0).ravel() for run in runs]
    return float(1.4826 * np.nanmedian(np.abs(np.concatenate(second))) / np.sqrt(6))


def _on_grid(run: Run, columns: Sequence[int], grid: float) -> Run:
    """A run whose pressures are those of regulators that take set points on a grid.

    Between rows these are stairs, whose steps may come at any time. A row has the mean of what stairs differ by about it, by the weights
    with which what is linear between rows depends on it: what follows slowly then gets as much as from the stairs.
    """
    fine = (np.arange(PARTS) + 0.5) / PARTS
    asked, lasts = run.inputs[:, columns], np.diff(run.time)
    between = asked[:-1, None] + fine[:, None] * np.diff(asked, axis=0)[:, None]  # (rows - 1, parts, columns)
    stairs = grid * np.round(between / grid)
    means, weights = np.zeros_like(asked), np.zeros((run.rows, 1))
    for rows, part in ((slice(0, -1), 1 - fine), (slice(1, None), fine)):
        means[rows] += lasts[:, None] * np.einsum("kpc,p->kc", stairs - between, part) / PARTS
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

    @staticmethod
    def of(runs: Sequence[Run], columns: Sequence[int], signals: Signals, grid: float) -> _Fit:
        """Least squares; every gauge may have an offset and a gain of its own."""
        count = max(int((run.time[-1] - run.time[0]) / FINE) + 2 for run in runs)
        readings, fine = [_readings(run, columns, signals) for run in runs], FINE * np.arange(count)
        within = (fine[:, None] + FINE * ((np.arange(PARTS) + 0.5) / PARTS - 1)).ravel()  # of the time before each sample

        def left(values: np.ndarray) -> np.ndarray:
            delay, filling, exhausting = values
            asked = [np.interp(run.time[0] - delay + within, run.time, run.inputs[:, k]) for run in runs for k in columns]
            stairs = grid * np.round(np.array(asked) / grid) if grid else np.array(asked)
            followed = _followed(stairs.reshape(len(asked), count, PARTS).mean(axis=2), filling, exhausting)
            modelled = [
                np.stack(
                    [np.interp(run.time - run.time[0], fine, row) for row in followed[k * len(columns) : (k + 1) * len(columns)]], axis=1
                )
                for k, run in enumerate(runs)
            ]
            return _without_affine(np.concatenate(readings), np.concatenate(modelled))

        scale = np.array(FIRST)
        found = least_squares(left, scale, bounds=(np.full(3, 1e-4), np.array(MOST)), x_scale=scale, diff_step=0.05, max_nfev=EVALUATIONS)
        spread = float(np.mean(found.fun**2))
        covariance = spread * np.linalg.pinv(found.jac.T @ found.jac)
        stds = np.sqrt(np.diag(covariance))
        delay, filling, exhausting = (float(value) for value in found.x)
        unlagged = float(np.sum(left(np.full(3, 1e-4)) ** 2))
        return _Fit(
            grid, delay, (filling, exhausting), (float(stds[1]), float(stds[2])), float(2 * found.cost), unlagged, float(np.sqrt(spread))
        )


def _followed(commands: np.ndarray, filling: float, exhausting: float) -> np.ndarray:
    """A first-order lag of set points held over the time before every fine sample, (channels, samples)."""
    up, down = (1 - np.exp(-FINE / max(time, 1e-6)) for time in (filling, exhausting))
    found = np.empty_like(commands)
    found[:, 0] = state = commands[:, 0]
    for k in range(1, commands.shape[1]):
        missing = commands[:, k] - state
        state = state + np.where(missing > 0, up, down) * missing
        found[:, k] = state
    return found


def _without_affine(readings: np.ndarray, modelled: np.ndarray) -> np.ndarray:
    """What is left of readings (samples, channels) by the best line over what was modelled, a line each; 0 where a reading is missing."""
    left = np.zeros_like(readings)
    for k in range(readings.shape[1]):
        seen = np.isfinite(readings[:, k])
        line = np.stack([np.ones(seen.sum()), modelled[seen, k]], axis=1)
        left[seen, k] = readings[seen, k] - line @ np.linalg.lstsq(line, readings[seen, k], rcond=None)[0]
    return left.ravel()
