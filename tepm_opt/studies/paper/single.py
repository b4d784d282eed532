"""One actuator on the bench: the free actuator and Table I's identification (III.B), set points in both modes (Fig. 6)."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from tepm_opt.control.baselines.length_control import HoldRecord, HoldTask, LengthController, LengthTarget, TendonUse, hold
from tepm_opt.hw.rig import Command
from tepm_opt.hw.simulation.bench import BenchRig
from tepm_opt.studies.paper.common import Setting
from tepm_opt.studies.paper.result import ExperimentResult

SET_POINTS = (0.220, 0.230, 0.240)  # m
STAY, TAKEN = 6.0, 5.0  # s at a set point, and at its end for error and SD
LINEAR = (0.05e6, 0.45e6)  # Pa, where III.B finds the actuator linear
STAIRS = 11  # pressures from 0 to the largest
REST = 3.0  # s at each
ABOUT, PULL, RELEASES = 0.20e6, 5.0, 12  # Pa and N before a release, number of releases


def bench(setting: Setting, noise: int) -> BenchRig:
    """The bench with an actuator of the virtual prototype."""
    rig = BenchRig(setting.rig)
    rig.reseed(noise)
    return rig


def staircase(setting: Setting, noise: int) -> tuple[np.ndarray, np.ndarray]:
    """Pressures up and down again (steps,) in Pa and the lengths at which the actuator rests (steps,) in m, tendon slack."""
    rig = bench(setting, noise)
    up = np.linspace(0.0, rig.robot.input_max[0], STAIRS)
    pressures, lengths = np.concatenate([up, up[-2::-1]]), []
    frames = round(REST * rig.file.tracker.rate_hz)
    for pressure in pressures:
        rig.apply(Command(np.array([pressure]), np.zeros(1), np.zeros(1, dtype=bool)))
        samples = [float(rig.read().lengths[0]) for _ in range(frames)]  # type: ignore[index]
        lengths.append(float(np.mean(samples[-frames // 2 :])))
        setting.clock.advance(REST)
    return pressures, np.array(lengths)


def stiffness(area: float, pressures: np.ndarray, lengths: np.ndarray) -> float:
    """K_a in N/m: least squares of the length over p A within the linear range (III.B)."""
    used = (pressures >= LINEAR[0]) & (pressures <= LINEAR[1])
    return float(1 / np.polyfit(area * pressures[used], lengths[used], 1)[0])


def release_tendon(setting: Setting, noise: int) -> tuple[np.ndarray, np.ndarray]:
    """Release the tendon (motor off): a step of the force, for which regulators are too slow; return time in s and mean length in m."""
    rig = bench(setting, noise)
    rate = rig.file.tracker.rate_hz
    pressure, curves = np.array([ABOUT]), []
    for _ in range(RELEASES):
        rig.apply(Command(pressure, np.array([PULL]), np.ones(1, dtype=bool)))
        for _ in range(round(2.0 * rate)):
            rig.read()
        rig.apply(Command(pressure, np.zeros(1), np.zeros(1, dtype=bool)))
        curves.append([float(rig.read().lengths[0]) for _ in range(round(0.25 * rate))])  # type: ignore[index]
        setting.clock.advance(2.25)
    return np.arange(len(curves[0])) / rate, np.mean(curves, axis=0)


def fit_damping(setting: Setting, stiff: float, time: np.ndarray, length: np.ndarray) -> tuple[float, np.ndarray]:
    """c_v in N s/m, and the fitted length (samples,) in m: least squares of a mass on spring and damper, let go at an unknown instant.

    A chain of n_e edges with c_v each acts as c_v / n_e between its ends; a third of the actuator's mass moves with its end.

    Args:
        setting: what all experiments start from.
        stiff: K_a in N/m.
        time: of the samples since about the release, (samples,) in s.
        length: of the actuator once let go, (samples,) in m.
    """
    robot = bench(setting, 0).robot
    mass = robot.parameters.m_d / 3

    def course(unknown: np.ndarray) -> np.ndarray:
        start, end, end_damping, delay = unknown
        rate = end_damping / (2 * mass)
        root = np.sqrt(complex(rate**2 - stiff / mass))
        passed = np.maximum(time - delay, 0.0)
        decay = np.exp(-rate * passed) * (np.cosh(root * passed) + rate / root * np.sinh(root * passed))
        return end + (start - end) * decay.real

    guess = np.array([length[:2].mean(), length[-8:].mean(), 2.0, 0.03])
    found = least_squares(lambda unknown: 1e3 * (course(unknown) - length), guess, x_scale=[1e-3, 1e-3, 1.0, 1e-2])
    return float(found.x[2] * robot.geometry.segments_per_module), course(found.x)


def identification(setting: Setting) -> ExperimentResult:
    """Experiment of section III.B: the free actuator, K_a and c_v."""
    pressures, lengths = staircase(setting, 1)
    area = setting.model.values["A"]
    stiff = stiffness(area, pressures, lengths)
    time, length = release_tendon(setting, 1)
    damped, fitted = fit_damping(setting, stiff, time, length)
    grown = lengths - lengths[0]
    numbers = {"free_length": float(1e3 * grown.max()), "K_a": stiff, "c_v": damped}
    method = (
        f"One actuator on the bench. Pressures in {STAIRS} steps up and down, {REST:g} s each, tendon slack; K_a by least squares of the "
        f"length over p A between 0.05 and 0.45 MPa. c_v by least squares of a mass on spring and damper on the mean of {RELEASES} courses "
        f"after {PULL:g} N of tension are let go."
    )
    tables = {
        "table1_staircase": {"pressure_Pa": pressures, "length_m": lengths},
        "table1_release": {"time_s": time, "length_m": length, "fitted_m": fitted},
    }
    data = {"pressures": pressures, "grown": grown, "time": time, "length": length, "fitted": fitted}
    return ExperimentResult("table1", "Identification of one actuator", method, numbers, {}, tables, data)


def regulate(setting: Setting, use: TendonUse, noise: int) -> HoldRecord:
    """The three set points, one after the other, from the actuator's rest."""
    rig = bench(setting, noise)
    value = rig.robot.parameters
    wanted = [LengthTarget(np.array([length]), np.array([value.K_a * (length - value.L_0)])) for length in SET_POINTS]
    controller = LengthController(rig.robot, use)
    with rig:
        held = hold(rig, controller, lambda sample: sample.lengths, HoldTask(wanted, STAY))  # type: ignore[arg-type, return-value]
    setting.clock.advance(STAY * len(SET_POINTS))
    return held


def set_points(setting: Setting) -> ExperimentResult:
    """Experiment of Fig. 6: set points of one actuator in both modes."""
    numbers, tables, data = {}, {}, {}
    for use in TendonUse:
        rounds = [regulate(setting, use, noise) for noise in range(1, setting.runs + 1)]
        for k, wanted in enumerate(SET_POINTS):
            late = [(held.target == k) & (held.time - k * STAY > STAY - TAKEN) for held in rounds]
            errors = np.concatenate([held.lengths[used, 0] - wanted for held, used in zip(rounds, late, strict=True)])
            errors = errors[np.isfinite(errors)]
            numbers[f"fig6_error_mode{use.value}_{1e3 * wanted:.0f}"] = float(1e3 * np.abs(errors).mean())
            numbers[f"fig6_sd_mode{use.value}_{1e3 * wanted:.0f}"] = float(1e3 * errors.std())
        columns = {"time_s": rounds[0].time, "set_point_m": np.array(SET_POINTS)[rounds[0].target]}
        columns |= {f"length_run{k + 1}_m": held.lengths[:, 0] for k, held in enumerate(rounds)}
        tables[f"fig6_mode{use.value}"] = columns
        data[f"mode{use.value}"] = rounds
    method = (
        f"Length PID on the bench, {STAY:g} s a set point, {setting.repeated}. Mean error is the mean of |length − set point| over the "
        f"last {TAKEN:g} s of all runs, SD that of the length in the same time. The length is measured between two sensors of the "
        f"tracker, whose noise alone has an SD of {1e3 * setting.rig.tracker.noise_rms_m * np.sqrt(2 / 3):.2f} mm in it."
    )
    better = all(
        numbers[f"fig6_{kind}_mode2_{n}"] <= numbers[f"fig6_{kind}_mode1_{n}"] for kind in ("error", "sd") for n in (220, 230, 240)
    )
    return ExperimentResult(
        "fig6", "Set points of one actuator", method, numbers, {"mode 2 is better at every set point": better}, tables, data
    )
