"""Predictive control of the tip: pressures coarsely, tensions finely, in one control step.

At every sample the arm's motion is estimated, looked ahead until a new command can act, and the network is linearised about the
reference there. With e the deviation from the reference in modal coordinates and v that of the axial forces,

    e'' + Δ e' + Ω e = B v − r'' − Δ r',      v = F_a − F_ref + d − friction,      F_a = p A − λ,

a quadratic program in the tensions of the next stages minimises the tip's error, with pressures as they have just been planned (see
`pressure_planner`). What lies beyond the last stage is valued by the Riccati equation of the same problem without limits, one step of
which is taken in every period. Rawlings, Mayne, Diehl, Model Predictive Control, 2nd ed., 2017, chapters 1 and 2.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.control.actuators import Actuators, InputEffects, Sent
from tepm_opt.control.controllers.base import ControllerKind, ControllerSettings, Telemetry, Value, own_settings
from tepm_opt.control.doubts import Doubts, TrackerNoise
from tepm_opt.control.estimator import Estimator, Operating, StateEstimate
from tepm_opt.control.forecast import Forecast, LinearForecast
from tepm_opt.control.friction import course, turned
from tepm_opt.control.keep_out import PRESSED, WEIGHT, KeepOutRows
from tepm_opt.control.markers import Markers
from tepm_opt.control.mpc_settings import MpcSettings, Use
from tepm_opt.control.nonlinear import NonlinearForecast
from tepm_opt.control.pressure_planner import PressurePlanner
from tepm_opt.control.qp import QpResult, QpSolver
from tepm_opt.control.reference import Reference
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.devices import Devices
from tepm_opt.outcome import Outcome
from tepm_opt.solvers.modal_model import ModalModel, modal_model

PERIODS = 2  # of control in a stage of the prediction
MOST_LATE = 8  # periods by which commands may act later than the robot file says
LATE = "late"  # why a plan that was found is not used


DEFAULT = MpcSettings()


@dataclass(frozen=True, eq=False)
class Step:
    """Record of one control step.

    Attributes:
        period: number of the sample's reference row.
        estimate: at the sample's time.
        pressures, tensions: commanded, (actuators,) in Pa and N.
        moves: how many pressures were moved.
        unknown: forces with friction that stand against the known ones, (actuators,) in N.
        plan: tensions of the coming stages, (stages, actuators) in N.
        outcome: of the quadratic program; the last plan goes on where it is not solved.
        iterations: of the program.
        seconds: of the whole step and, of these, of the program.
    """

    period: int
    estimate: StateEstimate
    pressures: np.ndarray
    tensions: np.ndarray
    moves: int
    unknown: np.ndarray
    plan: np.ndarray
    outcome: Outcome
    iterations: int
    seconds: tuple[float, float]

    def __repr__(self) -> str:
        took = f"{1e3 * self.seconds[0]:.2g} ms"
        return f"Step({self.outcome}, period={self.period}, moves={self.moves}, iterations={self.iterations}, took={took})"


@dataclass(frozen=True, eq=False)
class _Ahead:
    """What will be when a new command can act: the operating point, [q, q'] about it, the actuators, which way friction and hysteresis
    pull."""

    operating: Operating
    motion: np.ndarray
    actuators: Actuators
    direction: np.ndarray
    turning: np.ndarray


class Mpc:
    """The controller on one reference.

    Args:
        model: compiled; its effects are compensated.
        reference: targets of the tip.
        settings: of the controller.

    Attributes:
        last: record of the last step; None before the first one.
        fallbacks: number of steps that went on with an older plan, by the reason.
    """

    def __init__(self, model: CompiledModel, reference: Reference, settings: MpcSettings = DEFAULT) -> None:
        self.model, self.settings = model, settings
        self.reference = reference = reference.begun()
        robot, half = model.robot, model.layout.inputs // 2
        self.area, self.devices = model.values["A"], Devices.of(model)
        self.period, self.stage = reference.period, PERIODS * reference.period
        self._pressure_max, self._tension_max = robot.input_max[:half], robot.input_max[half:]
        self.middle = settings.mid_range * self._tension_max if settings.use is not Use.PRESSURE else np.zeros(half)
        age = robot.tracker.latency_s if robot.tracker else 0.0
        self.ahead = int(np.ceil((age + self.devices.delay) / self.period - 1e-9))
        self._declared = self.ahead
        step = robot.actuation.pressure_step
        self._pressure_planner = PressurePlanner(self.devices, self._pressure_max, step, self.stage, settings.pressure_planner)
        variables = settings.stages * half
        self._rates = np.eye(variables) - np.eye(variables, k=-half)
        keep_out = reference.keep_out
        self._keep_out = None if keep_out is None else KeepOutRows(keep_out, reference, settings.stages)
        kept = 3 * (settings.stages - 1) if np.isfinite(settings.corridor) else 0
        kept += 0 if self._keep_out is None else self._keep_out.count
        soft = np.append(np.full(variables, np.inf), np.full(kept, (WEIGHT / settings.weights.tip) ** 2)) if kept else None
        self._solver = QpSolver(np.vstack([self._rates, np.zeros((kept, variables))]), soft)
        weights, stages = settings.weights, settings.stages
        linear = not settings.nonlinear
        self._forecast: Forecast = LinearForecast(weights, stages) if linear else NonlinearForecast(weights, stages, settings.damping)
        self._operating: dict[int, Operating] = {}
        self._newest: ModalModel | None = None
        self._plan: np.ndarray | None = None
        self._slow, self._extra = np.zeros(half), np.zeros((settings.stages, half))
        self._planned: np.ndarray | None = None
        self._pressed = False  # into a margin, so that pressures help at once
        self.fallbacks: dict[str, int] = {}
        self.last: Step | None = None
        first = self.start()
        inputs = np.concatenate([first.pressures, first.tensions])
        self._enabled = first.enabled.copy()
        self._actuators, self._sent = Actuators(self.devices, self.area, first), Sent(first)
        self._effects = InputEffects(model, inputs)
        self._noise = TrackerNoise(max((robot.tracker.noise_rms_m if robot.tracker else 1e-3) / np.sqrt(3), 1e-6))
        self._doubts = Doubts(model.layout.actuator_names, (self._pressure_max, self._tension_max))
        self._doubted: Mapping[str, str] = {}
        self._markers = Markers(model.layout.point_names)
        middle = settings.mid_range * float(self._tension_max[0])
        self._filter = settings.filter.knowing(model.tendon_friction, middle)
        self._estimator = Estimator(self._point(0), self._noise.declared, middle, self._filter)
        self._zero: float | None = None
        self._row = 0

    def __repr__(self) -> str:
        kind = "nonlinear" if self.settings.nonlinear else "linear"
        return f"Mpc({self.model.robot.name}, {kind}, {self.reference!r}, fallbacks={self.fallbacks})"

    def start(self) -> Command:
        """Set points under which the robot shall rest before the first sample."""
        forces = self.reference.forces[0]
        pressure = np.clip((forces + self.middle) / self.area, 0.0, self._pressure_max)
        pressure = self.model.robot.actuation.pressures_on_grid(pressure)
        free = self.settings.use is not Use.PRESSURE
        tension = np.clip(self.area * pressure - forces, 0.0, self._tension_max) * free
        return Command(pressure, tension, np.full(len(forces), free))

    def command(self, sample: Sample) -> Command:
        """Set points for a sample; never NaN, always within the limits."""
        began = time.perf_counter()
        estimate = self._observe(sample)
        ahead = self._look_ahead(estimate)
        command, step = self._decide(estimate, ahead, began)
        self._sent.add(sample.time + self.ahead * self.period, command)
        self._sent.forget(sample.time - MOST_LATE * self.period)
        self.last = replace(step, seconds=(time.perf_counter() - began, step.seconds[1]))
        return command

    def telemetry(self) -> Telemetry:
        """Estimate, quadratic program and moves of the last step, and how often an older plan went on."""
        step, names = self.last, self.model.layout.actuator_names
        if step is None:
            return Telemetry()
        estimate = step.estimate
        columns: dict[str, Value] = {f"estimated_tip_{axis}_m": float(estimate.points[-1, k]) for k, axis in enumerate("xyz")}
        for k, name in enumerate(names):
            columns[f"unknown_force_{name}_N"] = float(step.unknown[k])
            columns[f"friction_{name}_N"] = float(estimate.friction[k])
            columns[f"tension_offset_{name}_N"] = float(self._actuators.tension_offset[k])
            columns[f"pressure_offset_{name}_Pa"] = float(self._actuators.pressure_offset[k])
        columns |= {"nis": float(estimate.nis), "coordinates_seen": float(estimate.seen), "points_refused": float(estimate.refused.sum())}
        columns |= {"tracked_noise_m": self._noise.measured}
        if self._keep_out is not None:
            columns |= self._keep_out.keep_out.columns(estimate)
        columns |= {"program": step.outcome.ending.value, "iterations": float(step.iterations), "pressure_moves": float(step.moves)}
        return Telemetry(columns | {"program_seconds": step.seconds[1]}, dict(self.fallbacks), self._doubted)

    def _point(self, period: int) -> Operating:
        """Local model of the network about the reference at a period."""
        row = int(self.reference.at(period))
        found = self._operating.get(row)
        if found is None:
            self._newest = modal_model(self.reference.equilibria[row], self._newest)
            local = self._newest.damped(self.settings.damping)
            found = self._operating[row] = Operating.of(local, self.reference.forces[row], self.period)
        for old in list(self._operating)[: -2 * self.ahead - 8]:
            del self._operating[old]
        return found

    def _observe(self, sample: Sample) -> StateEstimate:
        """Bring estimator and actuators up to the sample."""
        reference = self.reference
        self._zero = sample.time if self._zero is None else self._zero
        row = round((sample.time - self._zero) / self.period)
        for passed in range(self._row, row):
            start = self._zero + passed * self.period
            self._actuators.command = self._sent.between(start, start + self.period)
            known = self._actuators.advance(self.period) + self._effects.forces
            a, b = reference.at(np.array([passed, passed + 1]))
            rates = (reference.lengths[b] - reference.lengths[a]) / self.period
            self._estimator.predict(known, self._actuators.tension, rates, self._point(passed + 1))
        passed, self._row = max(row - self._row, 0), max(row, self._row)
        self._actuators.correct(sample, passed * self.period)
        before, self.ahead = self.ahead, min(max(self.ahead + self._actuators.later(self.period), 1), self._declared + MOST_LATE)
        self._sent.shift((self.ahead - before) * self.period)
        self._effects.advance(self._actuators, self.period)
        self._estimator.noise = self._noise.add(sample.points)
        late = (self.ahead - self._declared) * self.period + self._actuators.late
        points = self._markers.placed(sample.points, self._noise.measured)
        self._doubted = {**self._doubts.told(self._actuators, self._noise, late), **self._markers.told()}
        return self._estimator.update(points)

    def _look_ahead(self, estimate: StateEstimate) -> _Ahead:
        """From the sample's time to when a new command can act, under the commands that are on their way."""
        then, now, actuators = self._point(self._row + self.ahead), estimate.operating, self._actuators.copy()
        actuators.area = self.area * (1 + estimate.strength)
        motion, direction, turning, lengths = estimate.motion, estimate.direction, estimate.turning, self.reference.lengths
        settings = self._filter
        for at in range(self._row, self._row + self.ahead):
            start = (self._zero or 0.0) + at * self.period
            actuators.command = self._sent.between(start, start + self.period)
            a, b = self.reference.at(np.array([at, at + 1]))
            change = lengths[b] - lengths[a] + self.period * estimate.deviation
            direction = turned(direction, change, settings.presliding_distance)
            before, known = actuators.pressure, actuators.advance(self.period)
            turning = turned(turning, self.area * (actuators.pressure - before), settings.hysteresis_width)
            friction = estimate.friction * direction * self._estimator.loaded(actuators.tension) + estimate.hysteresis * turning
            motion = now.advance(motion, known + self._effects.forces + estimate.unknown - friction)
        return _Ahead(then, now.turned(motion, then), actuators, direction, turning)

    def _decide(self, estimate: StateEstimate, ahead: _Ahead, began: float) -> tuple[Command, Step]:
        """Pressures, then tensions that know them."""
        reference, settings, horizon = self.reference, self.settings, self._forecast.horizon
        stages, preview, actuators = settings.stages, settings.pressure_planner.preview, ahead.actuators
        rows = reference.at(self._row + self.ahead + PERIODS * np.arange(-1, preview + 2))
        self._forecast.about(ahead.operating, reference, rows, ahead.motion, estimate.bias[-1])
        self._enabled = self._switched(ahead)
        # friction over the coming stages: a part that does not depend on the tension and one in proportion to it
        steps, share = np.diff(reference.lengths[rows[1:]], axis=0)[:preview], self._filter.load_share
        pulled = estimate.friction * course(ahead.direction, steps, self._filter.presliding_distance)
        still, factor = (1 - share) * pulled, 1 + share / self._estimator.middle * pulled
        before, unknown = self._sent.last.pressures, estimate.unknown + self._effects.forces
        behind = estimate.hysteresis, ahead.turning
        pressures, reached = self._plan_pressures(estimate.unknown, still + factor * self.middle * self._enabled, actuators, behind)
        begin = actuators.forces + unknown - horizon.forces[0] - estimate.hysteresis * ahead.turning
        begin = begin - estimate.friction * ahead.direction * self._estimator.loaded(actuators.tension)
        rises = self.area * np.diff(np.vstack([actuators.pressure, reached]), axis=0)
        turns = course(ahead.turning, rises, self._filter.hysteresis_width)
        offset = actuators.area * reached - horizon.forces[1 : stages + 1] + unknown - still[:stages] - estimate.hysteresis * turns
        about = horizon, ahead.operating.model, rows[2 : stages + 1], estimate.bias, begin, self._planned
        kept = None if self._keep_out is None else self._keep_out.about(*about)
        result = self._solve(begin, offset, factor[:stages], actuators.tension, kept)
        self._pressed = kept is not None and result.violation > PRESSED
        if result.x is not None and time.perf_counter() - began <= settings.deadline:
            plan = result.x.reshape(stages, -1)
            self._planned = offset - factor[:stages] * plan
        else:
            reason = result.outcome.ending.value if result.x is None else LATE
            self.fallbacks[reason] = self.fallbacks.get(reason, 0) + 1
            plan, self._planned = self._shifted(actuators.tension), None
        self._forecast.take(self._planned)
        reference.govern(self._row + self.ahead + 1, horizon.tip_errors(self._planned))
        self._plan = plan
        tensions = np.clip((actuators.tension + plan[0]) / 2, 0.0, self._tension_max) * self._enabled  # a period is half a stage
        against = unknown + self.area * estimate.strength * actuators.pressure - estimate.friction * ahead.direction
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

    def _switched(self, ahead: _Ahead) -> np.ndarray:
        """ENA, (actuators,): by the rule of mode 2, from the lengths; all on in free mode."""
        settings, count = self.settings, len(self.middle)
        if settings.use is Use.PRESSURE or not settings.switching:
            return np.full(count, settings.use is not Use.PRESSURE)
        drive = ahead.operating.model.drive  # lengths follow the modes as the modes follow the axial forces
        return np.abs(drive.T @ ahead.motion[: len(drive)]) < np.where(self._enabled, settings.disable_above, settings.enable_below)

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
        return self._pressure_planner.plan(wanted, now, actuators.pressure, settings.stages)

    def _solve(
        self,
        begin: np.ndarray,
        offset: np.ndarray,
        factor: np.ndarray,
        tension: np.ndarray,
        kept: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> QpResult:
        """The program in the tensions λ of the stages: v = offset − factor λ.

        Args:
            begin: v at stage 0, (actuators,) in N.
            offset, factor: (stages, actuators) in N and without unit.
            tension: now, (actuators,) in N.
            kept: R and r of soft rows R v ≥ r, see `KeepOutRows`.
        """
        stages, most = self.settings.stages, self.devices.tension_rate * self.stage
        H, f = self._forecast.cost(begin)
        scale = -factor.ravel()
        low = np.zeros(H.shape[0])
        high = np.tile(self._tension_max * self._enabled, stages)
        if self.settings.use is Use.PRESSURE:
            low, high = np.tile(-self._tension_max, stages), np.tile(self._tension_max, stages)  # what pressure shall make
        rate_low, rate_high = np.full(len(low), -most), np.full(len(low), most)
        count = len(tension)
        tension = np.clip(tension, 0.0, self._tension_max)  # a gauge may say what no motor does
        first = tension * self._enabled if self.settings.use is not Use.PRESSURE else tension
        rate_low[:count] += first
        rate_high[:count] += first
        H, f = H * scale[:, None] * scale, scale * (f + H @ offset.ravel())
        horizon, width = self._forecast.horizon, self.settings.corridor
        soft = [(horizon.tip_answer, -width - horizon.tip_free, width - horizon.tip_free)] if np.isfinite(width) else []
        soft += [] if kept is None else [(*kept, np.full(len(kept[1]), np.inf))]
        if not soft:
            return self._solver.solve(H, f, low, high, rate_low, rate_high)
        by, least, most = (np.concatenate(parts) for parts in zip(*soft, strict=True))
        known = by @ offset.ravel()
        rows, row_low, row_high = (
            np.vstack([self._rates, by * scale]),
            np.append(rate_low, least - known),
            np.append(rate_high, most - known),
        )
        return self._solver.solve(H, f, low, high, row_low, row_high, rows)


def _predictive(model: CompiledModel, reference: Reference, settings: ControllerSettings) -> Mpc:
    """The controller with its own settings."""
    return Mpc(model, reference, own_settings(settings, MpcSettings))


MPC = ControllerKind("mpc", "MPC", "#1b7f4b", "predictive controller", _predictive, ("rule", "nonlinear", "use"), MpcSettings.of)
