"""The predictive controller's step in Python, for every setting; the twin of that in C.

At every sample the arm's motion is estimated, looked ahead until a new command can act, and the network is linearised about the
reference there. With e the deviation from the reference in modal coordinates and v that of the axial forces,

    e'' + Δ e' + Ω e = B v − r'' − Δ r',      v = F_a − F_ref + d − friction,      F_a = p A − λ,

a quadratic program in the tensions of the next stages minimises the tip's error, with pressures as they have just been planned (see
`pressure_planner`). The terminal cost is the cost-to-go of the same problem without limits, updated by one Riccati step a period.
Rawlings, Mayne, Diehl, Model Predictive Control, 2nd ed., 2017, chapters 1 and 2.
"""

from __future__ import annotations

import copy
import time
from dataclasses import replace

import numpy as np

from tepm_opt.control.actuation.actuators import Actuators
from tepm_opt.control.actuation.pressure_planner import PERIODS
from tepm_opt.control.collision.constraints import PRESSED, CollisionConstraints
from tepm_opt.control.controller import Telemetry
from tepm_opt.control.diagnostics.sensors import SensorDiagnostics
from tepm_opt.control.estimation.dahl_friction import dahl_sequence, dahl_step
from tepm_opt.control.estimation.kalman_filter import StateEstimate
from tepm_opt.control.mpc.compiled.setup import StepSetup, rest_tension
from tepm_opt.control.mpc.prediction import PredictionModel
from tepm_opt.control.mpc.qp import QpResult
from tepm_opt.control.mpc.record import LATE, Step, columns_of
from tepm_opt.control.mpc.settings import Use
from tepm_opt.control.mpc.state import Ahead, MpcState, OperatingPoints, Prepared
from tepm_opt.control.mpc.tension_qp import TensionQp
from tepm_opt.hw.rig import Command, Sample


class PythonStep:
    """The step of one controller.

    Args:
        setup: what it is made of.
        doubts: about gauges, devices and tracker.

    Attributes:
        fallbacks, last: see `ControlStep`.
    """

    def __init__(self, setup: StepSetup, doubts: SensorDiagnostics) -> None:
        settings, reference = setup.controller, setup.reference
        self._setup, self._doubts, self._points = setup, doubts, OperatingPoints(setup)
        self._state = MpcState.at_rest(setup, self._points.find(0))
        self._keep_out = None if reference.keep_out is None else CollisionConstraints(reference.keep_out, reference, settings.stages)
        kept_rows = 0 if self._keep_out is None else self._keep_out.count
        most = setup.devices.tension_rate * (PERIODS * reference.period)
        self._program = TensionQp(settings, setup.tension_max, most, kept_rows)
        self._forecast = PredictionModel(settings.weights, settings.stages)
        self._rest_tension = rest_tension(settings, setup.tension_max)
        self._ready: Prepared | None = None
        self.last: Step | None = None
        self.fallbacks: dict[str, int] = {}

    @property
    def ahead(self) -> int:
        """See `ControlStep`."""
        return self._state.sent.ahead

    @property
    def noise(self) -> float:
        """See `ControlStep`."""
        return self._state.noise.measured

    def prepare(self) -> None:
        """See `ControlStep`."""
        self._ready = self._prepare(self._state.row + (self.last is not None))

    def feedback(self, sample: Sample, deadline: float) -> Command:
        """See `ControlStep`."""
        began, state = time.perf_counter(), self._state
        row = max(state.sent.take_time(sample.time), state.row)
        ready = self._ready
        if ready is None or (ready.row, ready.ahead) != (row, self.ahead):
            ready = self._prepare(row)
        self._ready, state.taken = None, sample
        passed, state.row = row - state.row, row
        state.estimator, state.actuators, state.lag_factor = ready.estimator, ready.actuators, ready.lag_factor
        state.actuators.command = state.sent.command_at(row)
        state.actuators.correct(sample, passed * self._setup.reference.period)
        state.effects.advance(state.actuators, self._setup.reference.period)
        estimate = state.estimator.update(sample.points)
        command, step = self._decide(ready, estimate, self._look_ahead(ready, estimate), began + deadline)
        state.sent.send(sample.time, command)
        state.sent.postpone(state.actuators.adopt_delay(self._setup.reference.period))
        self.last = replace(step, seconds=(time.perf_counter() - began, step.seconds[1]))
        return command

    def distrust_monitors(self) -> None:
        """See `ControlStep`."""
        lags = self._state.actuators.lags
        lags.noise = np.full(len(lags.noise), np.inf)
        self._ready = None

    def telemetry(self) -> Telemetry:
        """See `ControlStep`."""
        step, state = self.last, self._state
        if step is None:
            return Telemetry()
        columns = columns_of(step, self._setup.model.layout.actuator_names, state.actuators) | {"tracked_noise_m": self.noise}
        if self._keep_out is not None:
            columns |= self._keep_out.keep_out.columns(step.estimate)
        columns |= {"program": step.outcome.ending.value, "iterations": float(step.iterations), "pressure_moves": float(step.moves)}
        noise, offsets = (state.noise.measured, state.noise.declared), state.actuators.offsets
        doubts = self._doubts.sentences(self._doubts.lasting, offsets, noise, state.late, state.regulators)
        return Telemetry(columns | {"program_seconds": step.seconds[1]}, dict(self.fallbacks), doubts)

    def _note(self) -> None:
        """Update noise of the tracker, doubts and the lags' factor by the last sample."""
        state = self._state
        if state.taken is not None:
            state.noise.add(state.taken.points)
            self._doubts.count(state.actuators.offsets)
            state.late, state.regulators = state.sent.late + state.actuators.late, state.actuators.lags.findings
            state.lag_factor.correct(state.estimator.correction, state.estimator, state.actuators)
            state.taken = None

    def _prepare(self, row: int) -> Prepared:
        """The preparation for a sample at a row of the reference."""
        self._note()
        state, reference, settings = self._state, self._setup.reference, self._setup.filter
        estimator, actuators, lag_factor = copy.copy(state.estimator), state.actuators.copy(), copy.copy(state.lag_factor)
        estimator.noise = state.noise.measured
        for passed in range(state.row, row):
            actuators.command = state.sent.command_at(passed)
            slopes = lag_factor.advance(actuators)
            known = actuators.advance() + state.effects.forces
            a, b = reference.rows_at(np.array([passed, passed + 1]))
            rates = (reference.lengths[b] - reference.lengths[a]) / reference.period
            now, later = estimator.operating, self._points.find(passed + 1)
            lag_factor.predict(slopes, estimator.predict(known, actuators.tension, rates, later).A, now, later)
        then, seen, directions = self._points.find(row + self.ahead), estimator.estimate(np.zeros(0)), [estimator.direction]
        for at in range(row, row + self.ahead):
            a, b = reference.rows_at(np.array([at, at + 1]))
            change = reference.lengths[b] - reference.lengths[a] + reference.period * seen.deviation
            directions.append(dahl_step(directions[-1], change, settings.presliding_distance))
        preview, stages = self._setup.controller.pressure_planner.preview, self._setup.controller.stages
        rows = reference.rows_at(row + self.ahead + PERIODS * np.arange(-1, preview + 2))
        courses = dahl_sequence(directions[-1], np.diff(reference.lengths[rows[1:]], axis=0)[:preview], settings.presliding_distance)
        foreseen = seen.friction * courses
        factor = 1 + settings.load_share / estimator.middle * foreseen
        self._forecast.horizon.is_blind = estimator.is_blind
        self._program.prepare(self._forecast.prepare(then, reference, rows), factor[:stages])
        return Prepared(row, self.ahead, rows, estimator, actuators, lag_factor, then, np.array(directions[1:]), courses, foreseen, factor)

    def _look_ahead(self, ready: Prepared, estimate: StateEstimate) -> Ahead:
        """From the sample's time to when a new command can act, under the commands that are on their way."""
        state, setup = self._state, self._setup
        now, actuators = estimate.operating, state.actuators.copy()
        actuators.area = setup.area * (1 + estimate.strength)
        motion, turning = estimate.motion, estimate.turning
        for at, direction in enumerate(ready.directions, state.row):
            actuators.command = state.sent.command_at(at)
            before, known = actuators.pressure, actuators.advance()
            turning = dahl_step(turning, setup.area * (actuators.pressure - before), setup.filter.hysteresis_width)
            friction = estimate.friction * direction * state.estimator.friction_ratio_at(actuators.tension) + estimate.hysteresis * turning
            motion = now.advance(motion, known + state.effects.forces + estimate.unknown - friction)
        return Ahead(now.transform_motion_to(motion, ready.then), actuators, turning)

    def _decide(self, ready: Prepared, estimate: StateEstimate, ahead: Ahead, until: float) -> tuple[Command, Step]:
        """Pressures, then tensions that know them, by a plan that is found until a time of the clock in s."""
        state, setup, horizon = self._state, self._setup, self._forecast.horizon
        stages, share, width = setup.controller.stages, setup.filter.load_share, setup.filter.hysteresis_width
        actuators, direction, on = ahead.actuators, ready.directions[-1], setup.first.enabled
        horizon.set_initial_state(ahead.motion, estimate.bias[-1])
        # friction over the coming stages: what is foreseen of it in proportion to the tension, all else as at the tension's middle
        pulled, factor = estimate.friction * ready.courses, ready.factor
        still = pulled - share * ready.foreseen
        before, unknown = state.sent.last.pressures, estimate.unknown + state.effects.forces
        behind = estimate.hysteresis, ahead.turning
        pressures, reached = self._plan_pressures(estimate.unknown, still + factor * self._rest_tension, actuators, behind)
        begin = actuators.forces + unknown - horizon.forces[0] - estimate.hysteresis * ahead.turning
        begin = begin - estimate.friction * direction * state.estimator.friction_ratio_at(actuators.tension)
        rises = setup.area * np.diff(np.vstack([actuators.pressure, reached]), axis=0)
        turns = dahl_sequence(ahead.turning, rises, width)
        offset = actuators.area * reached - horizon.forces[1 : stages + 1] + unknown - still[:stages] - estimate.hysteresis * turns
        about = horizon, ready.then.model, ready.rows[2 : stages + 1], estimate.bias, begin, state.planned
        soft = None if self._keep_out is None else self._keep_out.linearise(*about)
        result = self._program.solve(self._forecast.gradient(begin), offset, actuators.tension, soft)
        state.pressed = soft is not None and result.violation > PRESSED
        state.plan = plan = self._take_plan(result, offset, actuators.tension, factor[:stages], until)
        setup.reference.govern(state.row + self.ahead + 1, self._forecast.tip_errors(state.planned))
        tensions = np.clip((actuators.tension + plan[0]) / 2, 0.0, setup.tension_max) * on  # a period is half a stage
        against = unknown + setup.area * estimate.strength * actuators.pressure - estimate.friction * direction
        moves = int(np.sum(pressures != before))
        seconds = (0.0, result.seconds)
        step = Step(state.row, estimate, pressures, tensions, moves, against, plan, result.outcome, result.iterations, seconds)
        return Command(pressures, tensions, on.copy()), step

    def _take_plan(self, result: QpResult, offset: np.ndarray, tension: np.ndarray, factor: np.ndarray, until: float) -> np.ndarray:
        """Tensions of the coming stages, (stages, actuators) in N: the program's, or the last plan half a stage on.

        Args:
            result: of the program.
            offset, factor: of the forces' deviations by the tensions, (stages, actuators) each.
            tension: when the command begins to act, (actuators,) in N; it stays where there is no plan yet.
            until: time of the clock in s after which the result is too late.
        """
        state, stages = self._state, self._setup.controller.stages
        if result.x is not None and time.perf_counter() <= until:
            plan = result.x.reshape(stages, -1)
            state.planned = offset - factor * plan
            return plan
        reason = result.outcome.ending.value if result.x is None else LATE
        self.fallbacks[reason] = self.fallbacks.get(reason, 0) + 1
        state.planned = None
        if state.plan is None:
            return np.tile(tension, (stages, 1))
        later = np.vstack([state.plan[1:], state.plan[-1:]])
        return np.clip((state.plan + later) / 2, 0.0, self._setup.tension_max)

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
        state, setup, horizon = self._state, self._setup, self._forecast.horizon
        settings, period = setup.controller, setup.reference.period
        planner, stages = settings.pressure_planner, settings.stages
        state.slow = state.slow + (1 - np.exp(-period / planner.disturbance_time)) * (unknown - state.slow)
        now = state.sent.last.pressures
        if settings.use is Use.TENSION:
            return now, np.tile(now, (stages, 1))
        need = horizon.forces[1 : planner.preview + 1] + horizon.dynamic[: planner.preview] + horizon.rest_force
        if settings.mid_ranging:
            need = need - state.slow
            if state.planned is not None:
                extra = state.planned - horizon.rest_force - horizon.dynamic[:stages]
                state.extra = state.extra + (1 - np.exp(-period / planner.feedback_time)) * (extra - state.extra)
                part = 1.0 if state.pressed else min(1.0, horizon.speed / planner.full_feedback_speed)
                need[:stages] += part * np.linspace(1, 0, stages)[:, None] * state.extra
        wanted = (need - state.effects.forces + pulled) / actuators.area
        hysteresis, turning = behind
        rises = setup.area * np.diff(np.vstack([wanted[:1], wanted]), axis=0)
        wanted = wanted + hysteresis * dahl_sequence(turning, rises, setup.filter.hysteresis_width) / actuators.area
        return setup.planner.plan(wanted, now, actuators.pressure, stages, actuators.lags)
