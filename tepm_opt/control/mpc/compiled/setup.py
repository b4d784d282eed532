"""Set-up of a step of the predictive controller, and its settings by the names they have in C."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
from scipy.special import chdtri

from tepm_opt.control.actuation.actuators import BELIEF, EXPLAINED, FARTHEST, LASTING, TELLING, WHOLE, InputEffects
from tepm_opt.control.actuation.delay_line import whole_periods
from tepm_opt.control.actuation.pressure_planner import PERIODS, PressurePlanner
from tepm_opt.control.actuation.regulator_lags import (
    AS_COMMANDED,
    AT_ONCE,
    DOUBT,
    DRIFT,
    FORGOTTEN,
    JUMP,
    KNOWN,
    LEAST,
    MISFIT,
    MOVING_RANGE,
    NOISY_MONITOR,
    OFFSET,
    READING,
    RegulatorLags,
)
from tepm_opt.control.diagnostics.sensors import LARGEST, LATE, NOISY, OFF, QUICKER, SLOWEST, STAYS
from tepm_opt.control.estimation.kalman_filter import FilterSettings
from tepm_opt.control.mpc.compiled.layout import Sizes
from tepm_opt.control.mpc.lag_factor import (
    CAUTION,
    COLOURED,
    FACTOR_DRIFT,
    FACTOR_STD,
    FIRST,
    LEAST_FACTOR,
    MOST_FACTOR,
    MOST_MOVE,
    QUICK_FACTOR,
)
from tepm_opt.control.mpc.prediction import NOTHING, RIDGE
from tepm_opt.control.mpc.settings import MpcSettings, Use
from tepm_opt.control.references.path_following import PathFollowingReference
from tepm_opt.control.references.reference import Reference
from tepm_opt.hw.rig import Command
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.devices import Devices
from tepm_opt.solvers.linear.modal_model import NEAR, ModalModel, fixed_part, modal_model

STEADY = 4.0  # times as long unknown forces last where the reference stops: in 28 runs on random machines the error is 4 % less

Told = dict[str, float | np.ndarray]
"""Settings by name: numbers, or an array with one for each actuator."""


FITS = "a model in C, both kinds of actuators, no obstacles, a path with time, 2 stages or more"
"""Conditions for a step in C."""


@dataclass(frozen=True, eq=False)
class StepSetup:
    """Model, reference, settings and sizes that a step in C or in Python is made of.

    Attributes:
        model: compiled.
        reference: what is followed.
        controller, filter: settings.
        devices: how fast they are.
        planner: of the pressures.
        tension_max: of the motors, (actuators,) in N.
        ahead: periods from a sample to when a command acts, as declared.
        noise: of a tracked coordinate as declared in m.
        first: commands under which the robot rests.
        start: modal model about the reference's first equilibrium.
        effects: of the model on its inputs, at rest under the first commands.
    """

    model: CompiledModel
    reference: Reference
    controller: MpcSettings
    filter: FilterSettings
    devices: Devices
    planner: PressurePlanner
    tension_max: np.ndarray
    ahead: int
    noise: float
    first: Command
    start: ModalModel
    effects: InputEffects

    @staticmethod
    def from_model(model: CompiledModel, reference: Reference, settings: MpcSettings, computing: float) -> StepSetup:
        """Set-up for a model and settings, with the reference at its start.

        Args:
            model: compiled.
            reference: targets of the tip.
            settings: of the controller.
            computing: time in s from a sample to its command, which counts as delay.
        """
        robot, half, reference = model.robot, model.layout.inputs // 2, reference.rewind()
        believed = settings.filter or replace(FilterSettings(), **model.model.filter)
        if reference.stops:
            believed = replace(believed, force_correlation_time=STEADY * believed.force_correlation_time)
        devices, tracker, period = Devices.from_model(model), robot.tracker, reference.period
        pressure_max, tension_max = robot.input_max[:half], robot.input_max[half:]
        late = (tracker.latency_s if tracker else 0.0) + devices.delay
        ahead = whole_periods(late + computing, period)
        noise = max((tracker.noise_rms_m if tracker else 1e-3) / np.sqrt(3), 1e-6)
        first = _first_command(model, reference.forces[0], settings)
        start = modal_model(reference.equilibria[0]).scale_damping(settings.damping)
        filtering = believed.with_friction_prior(model.tendon_friction, settings.mid_range * float(tension_max[0]))
        planner = PressurePlanner(pressure_max, robot.actuation.pressure_step, settings.pressure_planner)
        if half := model.pressure_hysteresis * model.values["A"]:
            filtering = replace(filtering, hysteresis=half, hysteresis_std=min(filtering.hysteresis_std, half / 2))
        effects = InputEffects(model, np.concatenate([first.pressures, first.tensions]))
        return StepSetup(model, reference, settings, filtering, devices, planner, tension_max, ahead, noise, first, start, effects)

    def __repr__(self) -> str:
        return f"{self.model!r}, {self.controller!r}"

    @property
    def area(self) -> float:
        """Area by which pressure pulls in m²."""
        return self.model.values["A"]

    @property
    def fits(self) -> bool:
        """Whether there is a step in C for it."""
        asked = self.controller
        plain = self.reference.keep_out is None and not isinstance(self.reference, PathFollowingReference)
        return plain and asked.use is Use.BOTH and self.model.is_c and asked.stages > 1

    @property
    def sizes(self) -> Sizes:
        """Sizes of the step."""
        planner = self.controller.pressure_planner
        function = self.input_motion
        memory = 0 if function is None else function.numel_in(2)
        return Sizes.from_model(self.model, self.controller.stages, planner.preview, planner.slope_window, self.ahead, memory)

    @property
    def input_motion(self) -> ca.Function | None:
        """The model's function of that name (see `models.dynamics`); None without effects on inputs."""
        return None if self.effects.none else self.model.reference_stepper.dynamics.functions["input_motion"]

    @property
    def source(self) -> str:
        """The C text of the step."""
        return self.sizes.source(self.told, self.input_motion)

    @cached_property
    def told(self) -> Told:
        """Settings by name."""
        period, rest = self.reference.period, rest_tension(self.controller, self.tension_max)
        more: Told = {"area": self.area, "middle": float(rest[0]), "rest_tension": rest, "first_extra": self.effects.forces}
        doubts = told_of_doubts(self.model.robot.input_max[: len(rest)], self.tension_max, self.noise)
        devices = told_of_devices(self.devices, self.planner, period, self.tension_max)
        return devices | told_of_settings(self.controller, self.filter, period) | doubts | more

    @property
    def values(self) -> np.ndarray:
        """Values of the settings, one after the other."""
        return np.concatenate([np.ravel(value) for value in self.told.values()]).astype(float)

    def course(self) -> dict[str, np.ndarray]:
        """Arrays of the structure `course`, by name."""
        model, reference, fixed, start = self.model, self.reference, fixed_part(self.model), self.start
        at = reference.equilibria
        arrays = {
            "levels": [each.x for each in at], "inputs": [each.inputs for each in at], "loads": [each.loads for each in at],
            "forces": reference.forces, "lengths": reference.lengths, "tips": reference.tips, "points": [each.points for each in at],
            "theta": model.theta, "masses": fixed.masses, "by": fixed.observe, "basis": start.basis,
            "values": np.append(start.stiffness, np.zeros(start.basis.shape[1] - len(start.stiffness))), "free": self.effects.theta,
        }  # fmt: skip
        found = {name: np.ascontiguousarray(array, dtype=float) for name, array in arrays.items()}
        return found | {"mapped": np.array([each.mapped for each in at], dtype=ctypes.c_int)}


def rest_tension(settings: MpcSettings, tension_max: np.ndarray) -> np.ndarray:
    """Tensions to which mid-ranging returns, (actuators,) in N; 0 without motors."""
    return settings.mid_range * tension_max if settings.use is not Use.PRESSURE else np.zeros(len(tension_max))


def _first_command(model: CompiledModel, forces: np.ndarray, settings: MpcSettings) -> Command:
    """Set points under which the robot rests at forces, (actuators,) in N."""
    half, area = len(forces), model.values["A"]
    pressure_max, tension_max = model.robot.input_max[:half], model.robot.input_max[half:]
    pressure = np.clip((forces + rest_tension(settings, tension_max)) / area, 0.0, pressure_max)
    pressure, on = model.robot.actuation.pressures_on_grid(pressure), settings.use is not Use.PRESSURE
    return Command(pressure, np.clip(area * pressure - forces, 0.0, tension_max) * on, np.full(half, on))


def told_of_devices(devices: Devices, planner: PressurePlanner, period: float, tension_max: np.ndarray) -> Told:
    """Settings of the devices.

    Args:
        devices: how fast they are.
        planner: with the pressures' range and grid.
        period: of control in s.
        tension_max: of the motors, (actuators,) in N.
    """
    lags, rate = RegulatorLags(devices, period, planner.limits), devices.tension_rate
    filling, exhausting = lags.shares[:, 0].tolist()
    return {
        "period": period, "filling": filling, "exhausting": exhausting, "lag_variance": DOUBT**2, "lag_drift": DRIFT,
        "lag_least": LEAST, "lag_noise": READING * planner.limits, "at_once": AT_ONCE, "as_commanded": AS_COMMANDED, "lag_known": KNOWN,
        "lag_misfit": MISFIT * planner.limits, "lag_jump": JUMP, "lag_forgotten": FORGOTTEN,
        "lag_offset": OFFSET * planner.limits, "monitor_noisy": NOISY_MONITOR * planner.limits, "moving_range": MOVING_RANGE,
        "factor_first": FIRST, "factor_std": FACTOR_STD, "factor_drift": FACTOR_DRIFT, "factor_least": LEAST_FACTOR,
        "factor_most": MOST_FACTOR, "factor_quick": QUICK_FACTOR,
        "factor_move": MOST_MOVE, "factor_coloured": COLOURED, "factor_caution": CAUTION,
        "pull": rate * period, "pull_stage": PERIODS * rate * period,
        "pressure_max": planner.limits, "grid": planner.step, "tension_max": tension_max,
        "belief": BELIEF, "lasting": LASTING, "telling": TELLING, "whole": WHOLE, "explained": EXPLAINED,
        "farthest": FARTHEST,
    }  # fmt: skip


def told_of_settings(settings: MpcSettings, filtering: FilterSettings, period: float) -> Told:
    """Settings of controller and filter by their names in C, for a control period in s."""
    weights, planner = settings.weights, settings.pressure_planner
    same = (
        *("force_drift", "strength_std", "strength_drift", "friction", "friction_std", "friction_drift", "reversal_noise", "load_share"),
        *("hysteresis", "hysteresis_std", "hysteresis_drift", "bias_std", "bias_drift", "tip_bias_drift"),
        *("blind_force_drift", "blind_bias_drift"),
    )
    return {
        **{name: float(getattr(filtering, name)) for name in same},
        "presliding": filtering.presliding_distance, "width": filtering.hysteresis_width,
        "rate_share": 1 - math.exp(-period / filtering.rate_time), "force_keeps": math.exp(-period / filtering.force_correlation_time),
        "blind_force_keeps": math.exp(-period / filtering.blind_force_correlation_time),
        "bias_keeps": math.exp(-period / filtering.bias_correlation_time), "kick": math.sqrt(period) * filtering.force_noise,
        "gate": float(chdtri(3, filtering.gate_probability)), "most_rejections": float(filtering.most_rejections),
        "tip": weights.tip, "blind_tip": weights.blind_tip, "shape": weights.shape, "force": weights.force, "change": weights.change,
        "ridge": RIDGE, "nothing": NOTHING, "near": NEAR, "damping": settings.damping,
        "mid_ranging": float(settings.mid_ranging), "deadband": planner.deadband, "slow_lag": planner.slow_lag,
        "full_feedback_speed": planner.full_feedback_speed, "slow_share": 1 - math.exp(-period / planner.disturbance_time),
        "feedback_share": 1 - math.exp(-period / planner.feedback_time),
    }  # fmt: skip


def told_of_doubts(pressure_max: np.ndarray, tension_max: np.ndarray, noise: float) -> Told:
    """When doubts are told, by ranges of pressures in Pa and tensions in N, (actuators,) each, and the noise declared in m."""
    return {
        "declared_noise": noise, "slowest": SLOWEST, "largest": LARGEST, "late_told": LATE, "noisy": NOISY, "stays": float(STAYS),
        "quicker_told": math.log(QUICKER),
        "pressure_off": OFF["pressure"] * pressure_max, "tension_off": OFF["tension"] * tension_max,
    }  # fmt: skip
