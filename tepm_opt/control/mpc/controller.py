"""Predictive control of the tip: pressures coarsely, tensions finely, in one control step.

At every sample the arm's motion is estimated, looked ahead until a new command can act, and the network is linearised about the
reference there. With e the deviation from the reference in modal coordinates and v that of the axial forces,

    e'' + Δ e' + Ω e = B v − r'' − Δ r',      v = F_a − F_ref + d − friction,      F_a = p A − λ,

a quadratic program in the tensions of the next stages minimises the tip's error, with pressures as they have just been planned (see
`pressure_planner`). What lies beyond the last stage is valued by the Riccati equation of the same problem without limits, one step of
which is taken in every period. Rawlings, Mayne, Diehl, Model Predictive Control, 2nd ed., 2017, chapters 1 and 2.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tepm_opt.control.actuation.actuators import Actuators, InputEffects, Sent
from tepm_opt.control.actuation.pressure_planner import PERIODS, PressurePlanner
from tepm_opt.control.actuation.regulator_lags import RegulatorLags
from tepm_opt.control.collision.constraints import PRESSED, KeepOutRows
from tepm_opt.control.controller import ControllerKind, ControllerSettings, Telemetry, own_settings
from tepm_opt.control.diagnostics.marker_slip import Markers
from tepm_opt.control.diagnostics.sensors import Doubts, TrackerNoise
from tepm_opt.control.estimation.dahl_friction import course, turned
from tepm_opt.control.estimation.kalman_filter import Estimator, Operating, StateEstimate
from tepm_opt.control.mpc.compiled.layout import MOST_LATE, kept
from tepm_opt.control.mpc.compiled.record import Ahead, Prepared, Step, columns_of
from tepm_opt.control.mpc.compiled.setup import StepSetup
from tepm_opt.control.mpc.compiled.step import LATE, CompiledStep
from tepm_opt.control.mpc.compiled.timing import computing_time
from tepm_opt.control.mpc.nonlinear_prediction import NonlinearForecast
from tepm_opt.control.mpc.prediction import Forecast, LinearForecast
from tepm_opt.control.mpc.settings import MpcSettings, Use
from tepm_opt.control.mpc.tension_qp import TensionProgram
from tepm_opt.control.references.reference import Reference
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.devices import Devices
from tepm_opt.solvers.modal_model import ModalModel, modal_model

SLACK = 0.05  # of a period, by which computing time may go beyond whole ones


DEFAULT = MpcSettings()


class Mpc:
    """The controller on one reference.

    Args:
        model: compiled; its effects are compensated.
        reference: targets of the tip.
        settings: of the controller.

    Attributes:
        setup: what a step in C is made of.

    Raises:
        InputError: `backend="c"` where the step cannot be in C.
    """

    def __init__(self, model: CompiledModel, reference: Reference, settings: MpcSettings = DEFAULT) -> None:
        self.model, self.settings = model, settings
        self.reference = reference = reference.begun()
        robot, half = model.robot, model.layout.inputs // 2
        self.area, self.devices = model.values["A"], Devices.of(model)
        self.period, self.stage = reference.period, PERIODS * reference.period
        self._pressure_max, self._tension_max = robot.input_max[:half], robot.input_max[half:]
        self.middle = settings.mid_range * self._tension_max if settings.use is not Use.PRESSURE else np.zeros(half)
        late = (robot.tracker.latency_s if robot.tracker else 0.0) + self.devices.delay
        took = settings.computing
        if took is None:
            took = computing_time(Mpc(model, reference, replace(settings, deadline=np.inf, computing=0.0)))
        self._ahead = int(max(np.ceil(late / self.period - 1e-9), np.ceil((late + took) / self.period - SLACK)))
        self._declared = self._ahead
        step = robot.actuation.pressure_step
        self._pressure_planner = PressurePlanner(self._pressure_max, step, settings.pressure_planner)
        keep_out = reference.keep_out
        self._keep_out = None if keep_out is None else KeepOutRows(keep_out, reference, settings.stages)
        kept_rows = 0 if self._keep_out is None else self._keep_out.count
        self._program = TensionProgram(settings, self._tension_max, self.devices.tension_rate * self.stage, kept_rows)
        weights, stages, linear = settings.weights, settings.stages, not settings.nonlinear
        self._forecast: Forecast = LinearForecast(weights, stages) if linear else NonlinearForecast(weights, stages, settings.damping)
        self._operating: dict[int, tuple[int, Operating]] = {}
        self._newest: ModalModel | None = None
        self._plan: np.ndarray | None = None
        self._slow, self._extra = np.zeros(half), np.zeros((settings.stages, half))
        self._planned: np.ndarray | None = None
        self._pressed = False  # into a margin, so that pressures help at once
        self._fallbacks: dict[str, int] = {}
        self._last: Step | None = None
        first = self.start()
        inputs = np.concatenate([first.pressures, first.tensions])
        self._enabled = first.enabled.copy()
        lags = RegulatorLags(self.devices, self.period, self._pressure_planner.limits, first.pressures)
        self._actuators, self._sent = Actuators(self.devices, self.area, first, lags), Sent(first)
        self._effects = InputEffects(model, inputs)
        self._noise = TrackerNoise(max((robot.tracker.noise_rms_m if robot.tracker else 1e-3) / np.sqrt(3), 1e-6))
        self._doubts = Doubts(model.layout.actuator_names, (self._pressure_max, self._tension_max))
        self._doubted: Mapping[str, str] = {}
        self._markers = Markers(model.layout.point_names, self.period)
        middle = settings.mid_range * float(self._tension_max[0])
        self._filter = settings.filter.knowing(model.tendon_friction, middle)
        self._estimator = Estimator(self._point(0), self._noise.declared, middle, self._filter)
        self._zero: float | None = None
        self._row = 0
        self._ready: Prepared | None = None
        self._taken: Sample | None = None  # of which noise and doubts have not been told yet
        self._fresh: Sample | None = None  # of which nobody has looked whether a point slipped
        self.setup = StepSetup(
            model, reference, settings, self._filter, self.devices, self._pressure_planner, self._tension_max, self._ahead,
            self._noise.declared, first, self._point(0).model, self._effects,
        )  # fmt: skip
        self._compiled = CompiledStep.of(self.setup, self._doubts)

    def __repr__(self) -> str:
        kind, steps = "nonlinear" if self.settings.nonlinear else "linear", "C" if self.is_c else "Python"
        return f"Mpc({self.model.robot.name}, {kind} in {steps}, {self.reference!r}, fallbacks={self.fallbacks})"

    @property
    def is_c(self) -> bool:
        """Whether it steps in compiled C."""
        return self._compiled is not None

    @property
    def ahead(self) -> int:
        """Periods from a sample to when a new command acts, as far as is known."""
        return self._compiled.ahead if self._compiled else self._ahead

    @property
    def last(self) -> Step | None:
        """Record of the last step; None before the first one."""
        return self._compiled.last if self._compiled else self._last

    @property
    def fallbacks(self) -> dict[str, int]:
        """Number of steps that went on with an older plan, by the reason."""
        return self._compiled.fallbacks if self._compiled else self._fallbacks

    def start(self) -> Command:
        """Set points under which the robot shall rest before the first sample."""
        forces = self.reference.forces[0]
        pressure = np.clip((forces + self.middle) / self.area, 0.0, self._pressure_max)
        pressure = self.model.robot.actuation.pressures_on_grid(pressure)
        free = self.settings.use is not Use.PRESSURE
        tension = np.clip(self.area * pressure - forces, 0.0, self._tension_max) * free
        return Command(pressure, tension, np.full(len(forces), free))

    def command(self, sample: Sample) -> Command:
        """Set points for a sample; never NaN, always within the limits. What `prepare` has not prepared is prepared first."""
        self._look()
        sample = self._fresh = self._markers.placed(sample)
        if self._compiled:
            return self._compiled.feedback(sample, self.settings.deadline)
        began = time.perf_counter()
        self._zero = sample.time if self._zero is None else self._zero
        row = max(round((sample.time - self._zero) / self.period), self._row)
        ready = self._ready
        if ready is None or (ready.row, ready.ahead) != (row, self._ahead):
            ready = self._prepared(row)
        self._ready, self._taken = None, sample
        return self._feedback(ready, sample, began)

    def prepare(self) -> None:
        """Do what the next sample is not needed for, should it come a period after the last one; best as soon as a command is sent."""
        self._look()
        if self._compiled:
            self._compiled.prepare()
        else:
            self._ready = self._prepared(self._row + (self._last is not None))

    def telemetry(self) -> Telemetry:
        """Estimate, quadratic program and moves of the last step, and how often an older plan went on."""
        self._look()
        told = self._compiled.telemetry() if self._compiled else self._telemetry()
        slipped = self._markers.told()
        return replace(told, doubts={**told.doubts, **slipped}) if slipped else told

    def _look(self) -> None:
        """Look once whether a tracked point of the last sample has slipped."""
        if self._fresh is not None:
            self._markers.look(self._fresh, self._compiled.noise if self._compiled else self._noise.measured)
            self._fresh = None

    def _telemetry(self) -> Telemetry:
        step, names = self._last, self.model.layout.actuator_names
        if step is None:
            return Telemetry()
        self._note()
        columns = columns_of(step, names, self._actuators) | {"tracked_noise_m": self._noise.measured}
        if self._keep_out is not None:
            columns |= self._keep_out.keep_out.columns(step.estimate)
        columns |= {"program": step.outcome.ending.value, "iterations": float(step.iterations), "pressure_moves": float(step.moves)}
        return Telemetry(columns | {"program_seconds": step.seconds[1]}, dict(self.fallbacks), self._doubted)

    def _point(self, period: int) -> Operating:
        """Local model of the network about the reference at a period."""
        row = int(self.reference.at(period))
        slot = row % kept(self._declared)
        at, found = self._operating.get(slot, (-1, None))
        if found is None or at != row:
            self._newest = modal_model(self.reference.equilibria[row], self._newest)
            found = Operating.of(self._newest.damped(self.settings.damping), self.reference.forces[row], self.period)
            self._operating[slot] = row, found
        return found

    def _note(self) -> None:
        """Noise of the tracker and doubts by the last sample."""
        if self._taken is not None:
            self._noise.add(self._taken.points)
            late = (self._ahead - self._declared) * self.period + self._actuators.late
            self._doubted, self._taken = self._doubts.told(self._actuators, self._noise, late), None

    def _acting(self, row: int) -> Command:
        """The command in force over a period."""
        start = (self._zero or 0.0) + row * self.period
        return self._sent.between(start, start + self.period)

    def _prepared(self, row: int) -> Prepared:
        """Prepare for a row's sample."""
        self._note()
        reference, settings = self.reference, self._filter
        estimator, actuators = copy.copy(self._estimator), self._actuators.copy()
        estimator.noise = self._noise.measured
        for passed in range(self._row, row):
            actuators.command = self._acting(passed)
            known = actuators.advance() + self._effects.forces
            a, b = reference.at(np.array([passed, passed + 1]))
            rates = (reference.lengths[b] - reference.lengths[a]) / self.period
            estimator.predict(known, actuators.tension, rates, self._point(passed + 1))
        then, seen, directions = self._point(row + self._ahead), estimator.estimate(np.zeros(0)), [estimator.direction]
        for at in range(row, row + self._ahead):
            a, b = reference.at(np.array([at, at + 1]))
            change = reference.lengths[b] - reference.lengths[a] + self.period * seen.deviation
            directions.append(turned(directions[-1], change, settings.presliding_distance))
        preview, stages = self.settings.pressure_planner.preview, self.settings.stages
        rows = reference.at(row + self._ahead + PERIODS * np.arange(-1, preview + 2))
        courses = course(directions[-1], np.diff(reference.lengths[rows[1:]], axis=0)[:preview], settings.presliding_distance)
        foreseen = seen.friction * courses
        factor = 1 + settings.load_share / estimator.middle * foreseen
        self._forecast.horizon.is_blind = estimator.is_blind
        self._program.prepare(self._forecast.prepare(then, reference, rows), factor[:stages])
        return Prepared(row, self._ahead, rows, estimator, actuators, then, np.array(directions[1:]), courses, foreseen, factor)

    def _feedback(self, ready: Prepared, sample: Sample, began: float) -> Command:
        """From a sample to the command."""
        passed, self._row = ready.row - self._row, ready.row
        self._estimator, self._actuators = ready.estimator, ready.actuators
        self._actuators.correct(sample, passed * self.period)
        self._effects.advance(self._actuators, self.period)
        estimate = self._estimator.update(sample.points)
        command, step = self._decide(ready, estimate, self._look_ahead(ready, estimate), began)
        self._sent.add(sample.time + self._ahead * self.period, command)
        self._sent.forget(sample.time - MOST_LATE * self.period)
        before, self._ahead = self._ahead, min(max(self._ahead + self._actuators.later(self.period), 1), self._declared + MOST_LATE)
        self._sent.shift((self._ahead - before) * self.period)
        self._last = replace(step, seconds=(time.perf_counter() - began, step.seconds[1]))
        return command

    def _look_ahead(self, ready: Prepared, estimate: StateEstimate) -> Ahead:
        """From the sample's time to when a new command can act, under the commands that are on their way."""
        now, actuators = estimate.operating, self._actuators.copy()
        actuators.area = self.area * (1 + estimate.strength)
        motion, turning = estimate.motion, estimate.turning
        for at, direction in enumerate(ready.directions, self._row):
            actuators.command = self._acting(at)
            before, known = actuators.pressure, actuators.advance()
            turning = turned(turning, self.area * (actuators.pressure - before), self._filter.hysteresis_width)
            friction = estimate.friction * direction * self._estimator.loaded(actuators.tension) + estimate.hysteresis * turning
            motion = now.advance(motion, known + self._effects.forces + estimate.unknown - friction)
        return Ahead(now.turned(motion, ready.then), actuators, turning)

    def _decide(self, ready: Prepared, estimate: StateEstimate, ahead: Ahead, began: float) -> tuple[Command, Step]:
        """Pressures, then tensions that know them."""
        settings, horizon, share = self.settings, self._forecast.horizon, self._filter.load_share
        stages, actuators, direction = settings.stages, ahead.actuators, ready.directions[-1]
        self._forecast.about(ahead.motion, estimate.bias[-1])
        self._enabled = self._switched(ready.then, ahead.motion)
        # friction over the coming stages: what is foreseen of it in proportion to the tension, all else as at the tension's middle
        pulled, factor = estimate.friction * ready.courses, ready.factor
        still = pulled - share * ready.foreseen
        before, unknown = self._sent.last.pressures, estimate.unknown + self._effects.forces
        behind = estimate.hysteresis, ahead.turning
        pressures, reached = self._plan_pressures(estimate.unknown, still + factor * self.middle * self._enabled, actuators, behind)
        begin = actuators.forces + unknown - horizon.forces[0] - estimate.hysteresis * ahead.turning
        begin = begin - estimate.friction * direction * self._estimator.loaded(actuators.tension)
        rises = self.area * np.diff(np.vstack([actuators.pressure, reached]), axis=0)
        turns = course(ahead.turning, rises, self._filter.hysteresis_width)
        offset = actuators.area * reached - horizon.forces[1 : stages + 1] + unknown - still[:stages] - estimate.hysteresis * turns
        about = horizon, ready.then.model, ready.rows[2 : stages + 1], estimate.bias, begin, self._planned
        soft = None if self._keep_out is None else self._keep_out.about(*about)
        result = self._program.solve(self._forecast, begin, offset, actuators.tension, self._enabled, soft)
        self._pressed = soft is not None and result.violation > PRESSED
        if result.x is not None and time.perf_counter() - began <= settings.deadline:
            plan = result.x.reshape(stages, -1)
            self._planned = offset - factor[:stages] * plan
        else:
            reason = result.outcome.ending.value if result.x is None else LATE
            self._fallbacks[reason] = self._fallbacks.get(reason, 0) + 1
            plan, self._planned = self._shifted(actuators.tension), None
        self._forecast.take(self._planned)
        self.reference.govern(self._row + self._ahead + 1, horizon.tip_errors(self._planned))
        self._plan = plan
        tensions = np.clip((actuators.tension + plan[0]) / 2, 0.0, self._tension_max) * self._enabled  # a period is half a stage
        against = unknown + self.area * estimate.strength * actuators.pressure - estimate.friction * direction
        moves = int(np.sum(pressures != before))
        seconds = (0.0, result.seconds)
        step = Step(self._row, estimate, pressures, tensions, moves, against, plan, result.outcome, result.iterations, seconds)
        return Command(pressures, tensions, self._enabled.copy()), step

    def _shifted(self, tension: np.ndarray) -> np.ndarray:
        """The last plan, half a stage on; as it is where there was none."""
        if self._plan is None:
            return np.tile(tension, (self.settings.stages, 1))
        later = np.vstack([self._plan[1:], self._plan[-1:]])
        return np.clip((self._plan + later) / 2, 0.0, self._tension_max)

    def _switched(self, then: Operating, motion: np.ndarray) -> np.ndarray:
        """ENA, (actuators,): by the rule of mode 2, from the lengths; all on in free mode."""
        settings, count = self.settings, len(self.middle)
        if settings.use is Use.PRESSURE or not settings.switching:
            return np.full(count, settings.use is not Use.PRESSURE)
        drive = then.model.drive  # lengths follow the modes as the modes follow the axial forces
        return np.abs(drive.T @ motion[: len(drive)]) < np.where(self._enabled, settings.disable_above, settings.enable_below)

    def _plan_pressures(
        self, unknown: np.ndarray, pulled: np.ndarray, actuators: Actuators, behind: tuple[np.ndarray, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Commands (actuators,) and pressures that they lead to, (stages, actuators), in Pa.

        Args:
            unknown: forces that nobody commanded, (actuators,) in N.
            pulled: what tensions and friction shall take away over the preview, (preview, actuators) in N.
            actuators: when the command begins to act.
            behind: hysteresis in N and which way the pressures went then, (actuators,) each.
        """
        settings, horizon, planner = self.settings, self._forecast.horizon, self.settings.pressure_planner
        self._slow = self._slow + (1 - np.exp(-self.period / planner.disturbance_time)) * (unknown - self._slow)
        now = self._sent.last.pressures
        if settings.use is Use.TENSION:
            return now, np.tile(now, (settings.stages, 1))
        need = horizon.forces[1 : planner.preview + 1] + horizon.dynamic[: planner.preview] + horizon.rest_force
        if settings.mid_ranging:
            need = need - self._slow
            if self._planned is not None:
                extra = self._planned - horizon.rest_force - horizon.dynamic[: settings.stages]
                self._extra = self._extra + (1 - np.exp(-self.period / planner.feedback_time)) * (extra - self._extra)
                part = 1.0 if self._pressed else min(1.0, horizon.speed / planner.full_feedback_speed)
                need[: settings.stages] += part * np.linspace(1, 0, settings.stages)[:, None] * self._extra
        wanted = (need - self._effects.forces + pulled) / actuators.area
        hysteresis, turning = behind
        rises = self.area * np.diff(np.vstack([wanted[:1], wanted]), axis=0)
        wanted = wanted + hysteresis * course(turning, rises, self._filter.hysteresis_width) / actuators.area
        return self._pressure_planner.plan(wanted, now, actuators.pressure, settings.stages, actuators.lags)


def _predictive(model: CompiledModel, reference: Reference, settings: ControllerSettings) -> Mpc:
    """The controller with its own settings."""
    return Mpc(model, reference, own_settings(settings, MpcSettings))


MPC = ControllerKind("mpc", "MPC", "predictive controller", _predictive, ("rule", "nonlinear", "use"), MpcSettings.of)
