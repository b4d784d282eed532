"""Linear-quadratic-Gaussian control about the reference: the peer that a control engineer would write, and no more.

Gains of python-control's `dlqr` and `dlqe` on the slow modes, scheduled along the reference; unknown axial forces and biases of the
points in the filter, so that no offset remains; what accelerates the arm along the reference fed forward; pressures planned as for the
predictive controller, ahead of the regulators' lag and on their grid; tensions within their range and rate, which the state counts
with as they really are (Franklin, Powell, Workman, Digital Control, 1998, chapters 9 and 12). It knows neither friction nor that limits
will be met: what the predictive controller is worth shows beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tepm_opt.control.actuation.actuators import Actuators, InputEffects
from tepm_opt.control.actuation.delay_line import CommandDelayLine, whole_periods
from tepm_opt.control.actuation.pressure_planner import PressurePlanner, PressurePlannerSettings
from tepm_opt.control.actuation.regulator_lags import RegulatorLags
from tepm_opt.control.controller import ControllerKind, ControllerSettings, NoSettings, Telemetry, Value, own_settings
from tepm_opt.control.estimation.kalman_filter import DiscreteModalModel
from tepm_opt.control.mpc.prediction import Weights, compensate_tip_bias, compute_holding_forces
from tepm_opt.control.mpc.settings import DAMPING
from tepm_opt.control.references.reference import Reference
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.devices import Devices
from tepm_opt.solvers.linear.modal_model import modal_model

SPACING = 10  # periods between the reference's points at which gains are taken
WINDOW = 2  # periods on each side over which the reference is differentiated


@dataclass(frozen=True)
class LqgSettings(NoSettings):
    """Weights of the regulator and noise model of the filter, one set for all machines.

    Attributes:
        weights: of errors and efforts, as the predictive controller's.
        force_drift: intensity of the unknown forces' random walk in N/√s, and `force_fades`, time in s over which they fade.
        bias_drift: intensity of that of the points' biases in m/√s, and `bias_fades`, time in s over which all but the tip's fade.
        tip_bias_drift: intensity of that of the tip's bias, which does not fade, in m/√s.
        force_noise: intensity of white noise on the axial forces in N √s.
        pressure_planner: settings of the pressures.
    """

    weights: Weights = field(default_factory=Weights)
    force_drift: float = 2.5
    force_fades: float = 2.0
    bias_drift: float = 2e-3
    bias_fades: float = 10.0
    tip_bias_drift: float = 1e-3
    force_noise: float = 0.005
    pressure_planner: PressurePlannerSettings = field(default_factory=PressurePlannerSettings)


DEFAULT = LqgSettings()


@dataclass(frozen=True, eq=False)
class Station:
    """A point of the reference with its gains.

    Attributes:
        operating: the slow modes there.
        A: of the filter's state [q, q', d, b] over one period, (states, states).
        correct: gain of the filter, (states, 3 · points).
        feedback: of [e, e', v], deviations of motion and axial forces, on the change of v in a period, (actuators, 2 · modes + actuators).
        rest: forces and then [e, e'] at rest by the tip's bias, (actuators + 2 · modes, 3).
        follow: forces by modal forces that they shall make, (actuators, modes).
    """

    operating: DiscreteModalModel
    A: np.ndarray
    correct: np.ndarray
    feedback: np.ndarray
    rest: np.ndarray
    follow: np.ndarray


class Lqg:
    """The controller on one reference.

    Args:
        model: compiled; its effects are compensated as the predictive controller does.
        reference: targets of the tip.
        settings: of the controller.
    """

    def __init__(self, model: CompiledModel, reference: Reference, settings: LqgSettings = DEFAULT) -> None:
        self.model, self.reference, self.settings = model, reference, settings
        robot, half = model.robot, model.layout.inputs // 2
        self.area, self.devices, self.period = model.values["A"], Devices.from_model(model), reference.period
        self._pressure_max, self._tension_max = robot.input_max[:half], robot.input_max[half:]
        age = robot.tracker.latency_s if robot.tracker else 0.0
        step, planner = robot.actuation.pressure_step, settings.pressure_planner
        self._planner = PressurePlanner(self._pressure_max, step, planner)
        self._noise = max((robot.tracker.noise_rms_m if robot.tracker else 1e-3) / np.sqrt(3), 1e-6)
        self._stations = self._schedule_gains()
        self._dynamic = self._feed_forward()
        first = self.start()
        lags = RegulatorLags(self.devices, self.period, self._pressure_max, first.pressures)
        self._actuators = Actuators(self.devices, self.area, first, lags)
        self._sent = CommandDelayLine(first, self.period, whole_periods(age + self.devices.delay, self.period))
        self._effects = InputEffects(model, np.concatenate([first.pressures, first.tensions]))
        self._at = self._stations[0]
        self._modes, self._actuated = len(self._at.operating.model.stiffness), half
        self._state, self._slow = np.zeros(len(self._at.A)), np.zeros(half)
        self._row = 0

    def __repr__(self) -> str:
        return f"Lqg({self.model.robot.name}, {self.reference!r}, stations={len(self._stations)})"

    def start(self) -> Command:
        """Set points under which the robot shall rest before the first sample."""
        forces, middle = self.reference.forces[0], self._tension_max / 2
        pressure = self.model.robot.actuation.pressures_on_grid(np.clip((forces + middle) / self.area, 0.0, self._pressure_max))
        tension = np.clip(self.area * pressure - forces, 0.0, self._tension_max)
        return Command(pressure, tension, np.ones(len(forces), dtype=bool))

    def command(self, sample: Sample) -> Command:
        """Set points for a sample, always within the limits."""
        self._observe(sample)
        then = self._station(self._row + self._sent.ahead)
        motion, actuators = self._look_ahead(then)
        unknown, bias = self._state[2 * self._modes :][: self._actuated], self._state[-3:]
        row = int(self.reference.rows_at(self._row + self._sent.ahead))
        deviation, rest = self._subtract_reference(motion, then, row), then.rest @ bias
        wanted_force, wanted = rest[: self._actuated], rest[self._actuated :]
        known = self.reference.forces[row] + self._dynamic[row]
        v = actuators.forces + self._effects.forces + unknown - known
        pressures = self._pressures(unknown, wanted_force, actuators)
        change = -then.feedback @ np.concatenate([deviation - wanted, v - wanted_force])
        later = int(self.reference.rows_at(self._row + self._sent.ahead + 1))
        ahead = self.reference.forces[later] + self._dynamic[later] - unknown - self._effects.forces
        most = self.devices.tension_rate * self.period
        pressure = actuators.lags.lag(actuators.pressure, pressures)
        tension = np.clip(self.area * pressure - ahead - v - change, actuators.tension - most, actuators.tension + most)
        command = Command(pressures, np.clip(tension, 0.0, self._tension_max), np.ones(self._actuated, dtype=bool))
        self._sent.send(sample.time, command)
        return command

    def telemetry(self) -> Telemetry:
        """Estimate of the tip and of the unknown forces at the last sample."""
        at, names = self._at.operating.model, self.model.layout.actuator_names
        tip = at.equilibrium.points[-1] + at.observe[-3:] @ self._state[: self._modes] + self._state[-3:]
        columns: dict[str, Value] = {f"estimated_tip_{axis}_m": float(tip[k]) for k, axis in enumerate("xyz")}
        return Telemetry(columns | {f"unknown_force_{name}_N": float(self._state[2 * self._modes + k]) for k, name in enumerate(names)})

    def _station(self, row: int) -> Station:
        return self._stations[min(int(self.reference.rows_at(row)) // SPACING, len(self._stations) - 1)]

    def _schedule_gains(self) -> Sequence[Station]:
        """Gains along the reference, each from the modes of the one before."""
        newest, found = None, []
        for row in range(0, len(self.reference), SPACING):
            newest = modal_model(self.reference.equilibria[row], newest)
            found.append(
                self._gains(DiscreteModalModel.from_modal_model(newest.scale_damping(DAMPING), self.reference.forces[row], self.period))
            )
        return found

    def _gains(self, operating: DiscreteModalModel) -> Station:
        """Gains of regulator and filter at an operating point."""
        from control import dlqe, dlqr  # takes a second to import

        settings, model, weights = self.settings, operating.model, self.settings.weights
        modes, actuators = model.drive.shape
        moved, outputs = 2 * modes, len(model.observe)
        by = (operating.start + operating.end) @ model.drive
        fades = np.exp(-self.period / np.array([settings.force_fades] * actuators + [settings.bias_fades] * (outputs - 3)))
        A = np.diag(np.concatenate([np.zeros(moved), fades, np.ones(3)]))
        A[:moved, :moved], A[:moved, moved : moved + actuators] = operating.A, by
        C = np.zeros((outputs, len(A)))
        C[:, :modes], C[:, moved + actuators :] = model.observe, np.eye(outputs)
        drift = [settings.force_drift] * actuators + [settings.bias_drift] * (outputs - 3) + [settings.tip_bias_drift] * 3
        G = np.zeros((len(A), actuators + len(drift)))
        G[modes:moved, :actuators], G[moved:, actuators:] = model.drive, np.eye(len(drift))
        intensity = self.period * np.concatenate([np.full(actuators, settings.force_noise), drift]) ** 2
        covariance = np.asarray(dlqe(A, G, C, np.diag(intensity), self._noise**2 * np.eye(outputs))[1])
        correct = np.linalg.solve(C @ covariance @ C.T + self._noise**2 * np.eye(outputs), C @ covariance).T

        full = np.eye(moved + actuators)
        full[:moved, :moved], full[:moved, moved:] = operating.A, by
        enter = np.vstack([operating.end @ model.drive, np.eye(actuators)])
        rows = np.vstack([model.observe[-3:] / weights.tip, model.observe[:-3] / weights.shape])
        cost = np.zeros_like(full)
        cost[:modes, :modes], cost[moved:, moved:] = rows.T @ rows, np.eye(actuators) / weights.force**2
        feedback = np.asarray(dlqr(full, enter, cost, np.eye(actuators) / (weights.change / 2) ** 2)[0])

        force = compensate_tip_bias(model, np.eye(3))
        rest = np.vstack([force, (model.drive @ force) / model.stiffness[:, None], np.zeros((modes, 3))])
        return Station(operating, A, correct, feedback, rest, compute_holding_forces(model) @ (model.observe / model.stiffness))

    def _feed_forward(self) -> np.ndarray:
        """Forces that accelerate the arm along the reference, (periods, actuators) in N."""
        count, found = len(self.reference), []
        for row in range(count):
            station = self._station(row)
            levels = self.reference.levels[self.reference.rows_at(row + WINDOW * np.array([-1, 0, 1]))]
            before, now, after = levels @ station.operating.model.weights.T
            step = WINDOW * self.period
            bend, rate = (after - 2 * now + before) / step**2, (after - before) / (2 * step)
            found.append(station.follow @ (bend + station.operating.model.damping @ rate))
        return np.array(found)

    def _observe(self, sample: Sample) -> None:
        """Bring filter and actuators up to the sample; a point that is not there corrects nothing."""
        row = self._sent.take_time(sample.time)
        for passed in range(self._row, row):
            self._actuators.command = self._sent.command_at(passed)
            moved, forces = slice(0, 2 * self._modes), self._actuators.advance() + self._effects.forces
            pushed = self._at.operating.advance(np.zeros(2 * self._modes), forces)
            self._state = self._at.A @ self._state
            self._state[moved] += pushed
            self._turn(self._station(passed + 1))
        passed, self._row = max(row - self._row, 0), max(row, self._row)
        self._actuators.correct(sample, passed * self.period)
        self._sent.postpone(self._actuators.adopt_delay(self.period))
        self._effects.advance(self._actuators, self.period)
        model, bias = self._at.operating.model, self._state[2 * self._modes + self._actuated :]
        expected = model.equilibrium.points.ravel() + model.observe @ self._state[: self._modes] + bias
        missed = np.nan_to_num(sample.points.ravel() - expected)
        self._state = self._state + self._at.correct @ missed

    def _turn(self, then: Station) -> None:
        """Go on about another operating point."""
        if then is not self._at:
            self._state[: 2 * self._modes] = self._at.operating.transform_motion_to(self._state[: 2 * self._modes], then.operating)
            self._at = then

    def _look_ahead(self, then: Station) -> tuple[np.ndarray, Actuators]:
        """Motion [q, q'] about the station and actuators when a new command can act."""
        motion, actuators, now = self._state[: 2 * self._modes], self._actuators.copy(), self._at.operating
        unknown = self._state[2 * self._modes :][: self._actuated]
        for at in range(self._row, self._row + self._sent.ahead):
            actuators.command = self._sent.command_at(at)
            motion = now.advance(motion, actuators.advance() + self._effects.forces + unknown)
        return now.transform_motion_to(motion, then.operating), actuators

    def _subtract_reference(self, motion: np.ndarray, at: Station, row: int) -> np.ndarray:
        """Deviation [e, e'] of a motion about a station from the reference's motion at a row."""
        levels, model = self.reference.levels[self.reference.rows_at(row + np.array([-1, 0, 1]))], at.operating.model
        before, now, after = (levels - model.levels) @ model.weights.T
        return motion - np.concatenate([now, (after - before) / (2 * self.period)])

    def _pressures(self, unknown: np.ndarray, wanted: np.ndarray, actuators: Actuators) -> np.ndarray:
        """Commands of the pressures, (actuators,) in Pa: what is needed of the forces with the tensions in their middle."""
        planner = self.settings.pressure_planner
        self._slow = self._slow + (1 - np.exp(-self.period / planner.disturbance_time)) * (unknown - self._slow)
        rows = self.reference.rows_at(self._row + self._sent.ahead + 2 * np.arange(1, planner.preview + 1))
        need = self.reference.forces[rows] + self._dynamic[rows] + wanted - self._slow - self._effects.forces + self._tension_max / 2
        return self._planner.plan(need / self.area, self._sent.last.pressures, actuators.pressure, 1, actuators.lags)[0]


def _gaussian(model: CompiledModel, reference: Reference, settings: ControllerSettings) -> Lqg:
    """The controller with its own settings."""
    return Lqg(model, reference, own_settings(settings, LqgSettings))


LQG = ControllerKind("lqg", "LQG", "linear-quadratic-Gaussian controller", _gaussian, settings=lambda options: LqgSettings())
