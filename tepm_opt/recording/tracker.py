"""Noise and latency of a tracker, measured on the arm: at rest, then under slow sines of one actuator that the model follows, too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from tepm_opt.data.checks.findings import MAD
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Rig
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.robot import Robot
from tepm_opt.progress import Progress, silent
from tepm_opt.recording.drive import Driver
from tepm_opt.solvers.mechanics.simulate import simulate

PERIODS_S, CYCLES = (4.0, 2.5, 1.6), 3
"""Periods of the sines and how often each: friction that the model lacks shifts every period by another time, latency does not."""
SHARE = 0.2
"""Amplitude over the actuator's largest input; the input stays below twice that, and a fifth below its largest rate."""
FEWEST, TRIMS, LARGEST_S, STEP_S = 30, 3, 0.5, 0.01
"""Samples that tell a noise; fits of the trend, without strays but for the first; largest error of time stamps and the grid on which it is
sought."""
SURE = 2.0
"""Uncertainties by which stamps have to be off before the measurement corrects them."""
_LINE = np.linalg.pinv(np.column_stack([np.ones(len(PERIODS_S)), PERIODS_S]))
"""Value at 0 and slope of the line through a value for each period, (2, periods)."""


@dataclass(frozen=True, eq=False)
class TrackerRecording:
    """Samples of a tracker while the arm rested and while it swung.

    Attributes:
        rest_times, rest: of the samples at rest in s, and their points, (samples, points, 3) in m.
        ages: of these samples when they were read, in s.
        runs: for each period: times of the samples in s, their points, times of the inputs in s, inputs (samples, inputs) in Pa and N.
    """

    rest_times: np.ndarray
    rest: np.ndarray
    ages: np.ndarray
    runs: tuple[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], ...]


@dataclass(frozen=True, eq=False)
class TrackerMeasurement:
    """Noise, rate and latency of a tracker.

    Attributes:
        noise_m: standard deviation of each coordinate, (points, 3) in m; NaN for a point that was lost.
        noise_rms_m: root mean square of the 3-D noise over the points in m.
        rate_Hz: frames a second.
        lost: share of points that were missing, of all at rest.
        age_s: median age of a sample when it is read, by its time stamp.
        offsets_s, offset_stds_s: how much later than their time stamps the positions of each period are true by the model, and the
            standard errors; positive where poses are older than they say.
        residual_m: root mean square of the coordinates that the shifted and scaled model leaves.
    """

    noise_m: np.ndarray
    noise_rms_m: float
    rate_Hz: float
    lost: float
    age_s: float
    offsets_s: tuple[float, ...]
    offset_stds_s: tuple[float, ...]
    residual_m: float

    @property
    def offset_s(self) -> float:
        """Error of the time stamps by the model in s: of the line through the offsets over the period, the value at period 0.

        Dry friction shifts a motion by a share of its period, latency by the same time in each.
        """
        return float(_LINE[0] @ self.offsets_s)

    @property
    def offset_std_s(self) -> float:
        """Uncertainty of `offset_s`: standard error of the fits, and by how much the periods disagree, as the model's own error."""
        return float(np.hypot(np.linalg.norm(_LINE[0] * self.offset_stds_s), np.ptp(self.offsets_s)))

    @property
    def stamps_are_off(self) -> bool:
        """Whether the motion contradicts the time stamps."""
        return abs(self.offset_s) > SURE * self.offset_std_s

    @property
    def correction_s(self) -> float:
        """Error of the time stamps that is taken for true in s: 0 where the motion does not contradict them."""
        return self.offset_s if self.stamps_are_off else 0.0

    @property
    def latency_s(self) -> float:
        """Age of a pose when it is read in s."""
        return self.age_s + self.correction_s

    def __repr__(self) -> str:
        return f"TrackerMeasurement(noise {1e3 * self.noise_rms_m:.3g} mm rms, latency {1e3 * self.latency_s:.3g} ms)"

    def summary(self) -> dict[str, Any]:
        """All numbers as plain data."""
        noise = np.sqrt(np.square(self.noise_m).sum(axis=1))
        return {
            "noise_rms_m": self.noise_rms_m,
            "noise_by_point_m": [None if np.isnan(value) else float(value) for value in noise],
            "rate_Hz": self.rate_Hz,
            "lost_share": self.lost,
            "latency_s": self.latency_s,
            "age_by_time_stamps_s": self.age_s,
            "stamp_error_s": self.offset_s,
            "stamp_error_std_s": self.offset_std_s,
            "stamps_are_off": self.stamps_are_off,
            "stamp_error_by_period_s": dict(zip((f"{period:g} s" for period in PERIODS_S), self.offsets_s, strict=False)),
            "residual_m": self.residual_m,
        }


def sine_of(robot: Robot, actuator: int, pressure: bool, period: float) -> SetPoints:
    """A slow sine of one tendon or muscle, from zero and back to it.

    Args:
        robot: with the limits.
        actuator: number of it, from 0, module by module.
        pressure: whether its muscle moves rather than its tendon.
        period: of the sine in s.

    Raises:
        InputError: the robot gives this actuator nothing to move with.
    """
    column = actuator + (0 if pressure else robot.modules * robot.actuators)
    most, rate = robot.input_max[column], 0.0 if pressure else robot.actuation.tension_rate_N_per_s
    if not most > 0:
        raise InputError(f"robot {robot.name}: its largest input there is {most:g}; valid: an actuator that can move")
    amplitude = min(SHARE * most, 0.8 * rate * period / (2 * np.pi) if rate else np.inf)
    time = np.arange(0, CYCLES * period + 1e-9, period / 100)
    inputs = np.zeros((len(time), len(robot.input_max)))
    inputs[:, column] = amplitude * (1 - np.cos(2 * np.pi * time / period))
    return SetPoints(time, inputs, np.zeros((len(time), 3)))


def record_tracker(
    rig: Rig, robot: Robot, actuator: int, pressure: bool = False, rest: float = 5.0, progress: Progress = silent
) -> TrackerRecording:
    """Rest, then move one actuator by sines of all periods, then go back to zero. The rig is stopped whatever happens.

    Args:
        rig: any, not yet entered.
        robot: that is there.
        actuator: index of the one that moves.
        pressure: whether its muscle moves rather than its tendon.
        rest: seconds at rest.
        progress: told of every stage in s.

    Raises:
        InputError: the rig has another robot, or nothing that moves.
        RuntimeError: the rig failed, or was stopped because of what it measured.
    """
    channels, sines = channels_of(robot), [sine_of(robot, actuator, pressure, period) for period in PERIODS_S]
    with rig:
        if channels_of(rig.robot) != channels:
            raise InputError(f"the rig's robot is {rig.robot.name!r}, --robot says {robot.name!r}; name the robot that is there")
        driver = Driver(rig, channels, progress)
        driver.start(sines[0])
        times, points, ages = [], [], []
        begin = driver.now
        while driver.now - begin < rest:
            driver.apply(driver.inputs)
            sample = driver.read()
            times.append(sample.time)
            points.append(sample.points)
            ages.append(rig.time - sample.time)
            progress("at rest", driver.now - begin, rest)
        runs = tuple(_follow(driver, sine, rig, actuator, pressure) for sine in sines)
        driver.finish()
    return TrackerRecording(np.array(times), np.array(points), np.array(ages), runs)


def _follow(
    driver: Driver, sine: SetPoints, rig: Rig, actuator: int, pressure: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Samples of one sine, see `TrackerRecording.runs`. A real board's gauges are as new as the reading, a simulated rig's as the pose."""
    times, points, known, inputs, column = [], [], [], [], actuator if pressure else actuator + len(driver.inputs) // 2
    driver.settle()
    for row in driver.follow(sine, 1 / driver.period):
        gauges = row.sample.pressures if pressure else row.sample.tensions
        given, measured = row.inputs.copy(), gauges is not None and np.isfinite(gauges[actuator])
        if gauges is not None and measured:
            given[column] = max(gauges[actuator], 0.0)
        times.append(row.time)
        points.append(row.sample.points)
        known.append(row.time + (rig.time - row.sample.time if measured and rig.simulated is None else 0.0))
        inputs.append(given)
    increasing = np.r_[True, np.diff(np.maximum.accumulate(known)) > 1e-6]
    return np.array(times), np.array(points), np.array(known)[increasing], np.array(inputs)[increasing]


def evaluate_tracker(recording: TrackerRecording, model: CompiledModel, progress: Progress = silent) -> TrackerMeasurement:
    """Noise from the rest, latency from the ages and from the delay that best explains the motion.

    Args:
        recording: as `record_tracker` gives it.
        model: of the robot; one with the effects that it has tells the stamps' error best.
        progress: told which period is compared.

    Raises:
        InputError: the tracker gave too few positions.
    """
    noise = coordinate_noise(recording.rest_times, recording.rest)
    if not np.isfinite(noise).any():
        seen = int(np.isfinite(recording.rest).all(axis=2).sum(axis=0).max(initial=0))
        raise InputError(f"the tracker gave {seen} fresh positions of a point at rest; valid: at least {FEWEST}, with noise on them")
    fits = []
    for number, (times, points, known, inputs) in enumerate(recording.runs, start=1):
        progress("comparing with the model", number, len(recording.runs))
        moved = simulate(model, SetPoints(known - known[0], inputs, np.zeros((len(known), 3)))).complete()
        fits.append(fit_delay(times, points, known, moved.points))
    squared = np.square(noise).sum(axis=1)
    return TrackerMeasurement(
        noise,
        float(np.sqrt(np.nanmean(squared))),
        float(1 / np.median(np.diff(recording.rest_times))),
        float(1 - np.isfinite(recording.rest).all(axis=2).mean()),
        float(np.median(recording.ages)),
        tuple(fit[0] for fit in fits),
        tuple(fit[1] for fit in fits),
        float(np.sqrt(np.mean([fit[2] ** 2 for fit in fits]))),
    )


def coordinate_noise(times: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Robust standard deviation of each coordinate about a parabola in time, (points, 3) in m, from the MAD.

    Args:
        times: (samples,) in s.
        points: at rest, (samples, points, 3) in m; NaN where one was lost.

    A coordinate whose readings mostly repeat (a coarse grid) has its plain standard deviation; one with too few readings NaN.
    """
    found = np.full(points.shape[1:], np.nan)
    for index in np.ndindex(found.shape):
        values = points[(slice(None), *index)]
        seen = np.isfinite(values)
        if seen.sum() < FEWEST:
            continue
        when = (times[seen] - times[seen].mean()) / max(np.ptp(times[seen]), 1e-9)
        near, rest, robust = np.ones(len(when), dtype=bool), values[seen], 0.0
        for _ in range(TRIMS):
            rest = values[seen] - np.polyval(np.polyfit(when[near], values[seen][near], 2), when)
            robust = MAD * np.median(np.abs(rest - np.median(rest)))
            near = np.abs(rest - np.median(rest)) <= 5 * robust
        found[index] = robust if len(np.unique(values[seen])) > seen.sum() / 2 else rest.std()
    return found


def fit_delay(times: np.ndarray, points: np.ndarray, known: np.ndarray, moved: np.ndarray) -> tuple[float, float, float]:
    """Delay of measured points behind the model's in s, its standard error in s, and what is left in m (rms of a coordinate).

    Each coordinate is scaled and offset by least squares; the delay is the one at which the sum of squares is least.

    Args:
        times: of the measured points, (samples,) in s.
        points: measured, (samples, points, 3) in m.
        known: times of the model's points, (rows,) in s.
        moved: the model's points, (rows, points, 3) in m.
    """
    late, coordinates = times > times[0] + LARGEST_S, range(points[0].size)
    late &= times < times[-1] - LARGEST_S
    measured, modelled = points.reshape(len(points), -1)[late], moved.reshape(len(moved), -1)
    seen = np.isfinite(measured)
    if seen.sum(axis=0).max(initial=0) < FEWEST:
        raise InputError(f"the tracker gave fewer than {FEWEST} positions while the arm moved; valid: sensors in sight of the tracker")

    def squares_left(delay: float) -> float:
        return sum(
            _squares_left(measured[seen[:, k], k], np.interp(times[late][seen[:, k]] - delay, known, modelled[:, k])) for k in coordinates
        )

    delays: Sequence[float] = np.arange(-LARGEST_S, LARGEST_S + STEP_S / 2, STEP_S).tolist()
    near = min(delays, key=squares_left)
    bounds = near - STEP_S, near + STEP_S
    best = float(minimize_scalar(squares_left, bounds=bounds, method="bounded", options={"xatol": 1e-6}).x)  # type: ignore[attr-defined]
    variance = squares_left(best) / max(int(seen.sum()) - 2 * points[0].size - 1, 1)
    curvature = (squares_left(best + STEP_S / 2) - 2 * squares_left(best) + squares_left(best - STEP_S / 2)) / (STEP_S / 2) ** 2
    return best, float(np.sqrt(2 * variance / max(curvature, 1e-30))), float(np.sqrt(variance))


def _squares_left(values: np.ndarray, by: np.ndarray) -> float:
    """Sum of squares of `values` that offset and a scale of at least 0 times `by` do not explain."""
    values, by = values - values.mean() if len(values) else values, by - by.mean() if len(by) else by
    along = max(float(values @ by), 0.0)
    return float(values @ values) - (along**2 / float(by @ by) if along else 0.0)
