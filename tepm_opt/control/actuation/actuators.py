"""State of regulators and tendon motors, as far as a controller knows: lags, slew, delay, and the model's input effects."""

from __future__ import annotations

import copy
import math

import numpy as np

from tepm_opt.control.actuation.regulator_lags import RegulatorLags
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.devices import Devices

BELIEF = 0.5  # how far a measured pressure or tension moves the estimate
LASTING = 1.0  # s over which a difference that stays is taken for the gauge's own
TELLING = 10.0  # N²/s, of squared rates over time: motion of the motors that tells how late they are, some tenths of a second of it
EXPLAINED = 0.25  # of what dynamometers read beside the commands, that motors which are late have to explain
FARTHEST = 0.5  # N, that a motor may be from where its commands have it: what is read beyond is the gauge's, which is not believed then
WHOLE = 0.6  # of a period, by which commands have to act later or sooner than assumed before that is assumed


class Actuators:
    """Pressures in the muscles and tensions at the motors.

    Args:
        devices: how fast motors are.
        area: by which pressure pulls, of all muscles or (actuators,) in m².
        command: under which they are at rest.
        lags: of the regulators.

    Attributes:
        pressure: (actuators,) in Pa.
        tension: (actuators,) in N.
        command: in force now.
        lags: of the regulators, as far as monitors have told.
        area: by which pressure pulls, of all muscles or (actuators,) in m².
        pressure_offset, tension_offset: what monitors and dynamometers read above what devices do by their commands alone, on average over
            `LASTING`, (actuators,) in Pa and N. A command is relative to the present tension: taken for the tension's, such a difference
            would add up period by period.
    """

    def __init__(self, devices: Devices, area: float | np.ndarray, command: Command, lags: RegulatorLags) -> None:
        self.devices, self.area, self.command, self.lags = devices, area, command, lags
        self.pressure, self.tension = command.pressures.astype(float), command.tensions * command.enabled
        self.pressure_offset, self.tension_offset = np.zeros(len(self.pressure)), np.zeros(len(self.tension))
        self._told = self.pressure, self.tension  # what devices do by their commands alone
        self._rate, self._late, self._weight, self._spread = np.zeros(len(self.tension)), 0.0, 0.0, 0.0

    def copy(self) -> Actuators:
        """A copy for looking ahead; arrays are replaced, never changed."""
        other = copy.copy(self)
        other.lags = copy.copy(self.lags)
        return other

    @property
    def forces(self) -> np.ndarray:
        """F_a = p A − λ, (actuators,) in N."""
        return self.area * self.pressure - self.tension

    @property
    def offsets(self) -> dict[str, np.ndarray]:
        """Offsets of monitors ("pressure", Pa) and dynamometers ("tension", N), (actuators,) each."""
        return {"pressure": self.pressure_offset, "tension": self.tension_offset}

    def advance(self) -> np.ndarray:
        """Advance by a control period under the command in force; F_a at its start and end, (2, actuators) in N."""
        before, period = self.forces, self.lags.period
        self.pressure, self.tension = self._predict_one_period(self.pressure, self.tension)
        self.lags.advance(self.command.pressures)
        told, self._told = self._told, self._predict_one_period(*self._told)
        self._rate = (self._told[1] - told[1]) / period
        return np.array([before, self.forces])

    def shift_pressures(self, by: np.ndarray) -> None:
        """Shift pressures by what another lag makes of them, (actuators,) in Pa; never below zero."""
        pressure, tension = self._told
        self.pressure, self._told = np.maximum(self.pressure + by, 0.0), (np.maximum(pressure + by, 0.0), tension)

    def _predict_one_period(self, pressure: np.ndarray, tension: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        command, most = self.command, self.devices.tension_rate * self.lags.period
        wound = tension + np.minimum(np.maximum(command.tensions - tension, -most), most)
        return self.lags.lag(pressure, command.pressures), np.where(command.enabled, wound, 0.0)  # off, a motor lets go at once

    def correct(self, sample: Sample, passed: float) -> None:
        """Take what the rig measures of pressures and tensions, where it does, a time in s after the last sample.

        Monitors may read a period early or late beside the tracked points, which matters where valves are quick.
        """
        share = 1 - math.exp(-passed / LASTING)
        pressure, tension = self._told
        timing = self.lags.timing_error(self.command.pressures)
        if sample.pressures is not None:
            self.lags.correct(np.asarray(sample.pressures, dtype=float), passed, timing)
        off = _reduce_by_error(_subtract_expected(sample.pressures, pressure + self.pressure_offset), timing)
        self.pressure_offset = self.pressure_offset + share * off
        read = _subtract_expected(sample.tensions, tension + self.tension_offset)
        missed = np.minimum(np.maximum(read, -FARTHEST), FARTHEST)
        self.tension_offset = self.tension_offset + (read - missed) + share * missed
        if sample.tensions is not None:
            there = np.isfinite(sample.tensions)
            self._late = (1 - share) * self._late - passed * float(missed[there] @ self._rate[there])
            self._weight = (1 - share) * self._weight + passed * float(self._rate[there] @ self._rate[there])
            self._spread = (1 - share) * self._spread + passed * float(missed[there] @ missed[there])
        off = _reduce_by_error(_subtract_expected(sample.pressures, self.pressure + self.pressure_offset), timing)
        self.pressure = np.where(self.lags.unmonitored, self.pressure, np.maximum(self.pressure + BELIEF * off, 0.0))
        corrected = np.maximum(self.tension + BELIEF * _subtract_expected(sample.tensions, self.tension + self.tension_offset), 0.0)
        self.tension = np.where(np.abs(self.tension_offset) > FARTHEST, self.tension, corrected)

    @property
    def late(self) -> float:
        """Time in s by which motors follow later than assumed: what dynamometers read less, by how fast tensions rise (least squares over
        `LASTING`); 0 as long as they hardly move, or where that explains little of what they read."""
        explains = self._late**2 >= EXPLAINED * self._weight * self._spread
        return self._late / self._weight if self._weight > TELLING and explains else 0.0

    def adopt_delay(self, period: float) -> int:
        """Take for known from now on by how many periods in s commands act later than assumed; the number."""
        count = round(self.late / period) if abs(self.late) > WHOLE * period else 0
        if count:
            self._late = self._weight = self._spread = 0.0
        return count


def _subtract_expected(measured: np.ndarray | None, expected: np.ndarray) -> np.ndarray:
    """Differences of measured and expected values, 0 where nothing is measured, (actuators,) each."""
    return np.zeros(len(expected)) if measured is None else np.nan_to_num(np.asarray(measured) - expected, nan=0.0, posinf=0.0, neginf=0.0)


def _reduce_by_error(off: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Part of differences that exceeds a possible error, (actuators,) each."""
    return np.copysign(np.maximum(np.abs(off) - error, 0.0), off)


class InputEffects:
    """Forces by the model's effects on pressures and tensions, on top of p A − λ.

    Maps (a weaker muscle, crosstalk, a dead zone) and memories (hysteresis) alike; lags and delays are the `Devices`' business and left
    out here, and so is friction of the tendons: it follows the muscles' motion, which the filter knows.

    Attributes:
        forces: extra axial forces now, (actuators,) in N.
        none: whether the model has no such effect.
        theta: values of the model's parameters with its lags and delays left out, (parameters,).
    """

    def __init__(self, model: CompiledModel, inputs: np.ndarray) -> None:
        self.model = model
        self._area, self._half = model.values["A"], model.layout.inputs // 2
        self.theta = model.theta_without_devices
        self._inputs, self._memory = inputs, np.zeros(model.reference_stepper.dynamics.input_states)
        probes = model.input_max * np.array([[0.1], [0.9]])
        direct = all(np.array_equal(model.statics.actuation(probe, self.theta), probe) for probe in probes)
        self.none = direct and not len(self._memory)
        self.forces = self._extra(model.statics.actuation(inputs, self.theta), inputs)

    def advance(self, actuators: Actuators, duration: float) -> None:
        """Advance to the actuators' present pressures and tensions, a time in s after the last call."""
        if self.none:
            return
        inputs = np.concatenate([actuators.pressure, actuators.tension])
        rate = (inputs - self._inputs) / duration
        found = self.model.reference_stepper.values("input_motion", inputs, rate, self._memory, duration, self.theta)
        effective, self._memory = (value.ravel() for value in found)
        self._inputs, self.forces = inputs, self._extra(effective, inputs)

    def _extra(self, effective: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        more = effective - inputs
        return self._area * more[: self._half] - more[self._half :]
