"""Lags of the regulators, estimated from their pressure monitors while a controller runs.

A regulator brings its pressure nearer to the command by a share of what is missing in every period, one share while it fills and one
while it exhausts. The logarithms of both, and what the monitor reads too much, are found by an extended Kalman filter on the pressures
that commands alone lead to (Ljung, System Identification, 2nd ed., 1999, section 11.4). It begins with the robot file's lags and a doubt
about them. The file's lags stay where readings do not fit what was learned: a monitor that lies must not throw the arm. Without a monitor,
or with one that is noisy, they are multiplied by a factor that others may find (see `mpc.lag_factor`); so are lags that a monitor shows to
be shorter than a period: its readings then tell more of when they were taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tepm_opt.models.devices import Devices

DOUBT = math.log(4.0)  # of the logarithm of a share before anything was measured, 1 sigma; regulators may be 12 times quicker
DRIFT = 0.02  # of it in 1/√s: how fast a regulator changes
READING = 0.005  # of the pressure range: 1 sigma by which a reading may be off what lags and offset explain
JUMP = 1.0  # most by which a reading moves the logarithm of a share, for its slope holds nearby only
LEAST = 0.5  # times the share by the robot file: the least that is believed, for a lead over a lag that is not there is unstable
MISFIT = 0.004  # of the pressure range: root mean square of readings beside what lags and offset explain, beyond which they do not fit
FORGOTTEN = 0.5  # s over which that is averaged
OFFSET = 0.03  # of the pressure range: 1 sigma of what a monitor reads too much
KNOWN = 0.25  # 1 sigma of the logarithm up to which a lag counts as known
NOISY_MONITOR = 0.008  # of the pressure range: noise of a monitor, 1 sigma, beyond which it is not believed
MOVING_RANGE = 2 / math.sqrt(math.pi)  # mean absolute difference of two readings with noise of 1 sigma each
AS_COMMANDED = 0.86  # share of what is missing in a period from which a reading tells nothing but when it was taken: lags of 5 ms
AT_ONCE = 1e-9  # left of a difference after a period, by a regulator without lag


@dataclass(frozen=True, eq=False)
class RegulatorFindings:
    """Regulators and pressure monitors that differ from the robot file.

    Attributes:
        quicker: declared time constants over those found, filling and exhausting, (2, actuators); 1 where they are not known well.
        noise: of monitors that are too noisy to be believed, 0 elsewhere, (actuators,) in Pa.
        common: declared time constants over those of regulators without monitors, as near to 1 as the doubt about them allows.
    """

    quicker: np.ndarray
    noise: np.ndarray
    common: float


class RegulatorLags:
    """Shares of what is missing by which pressures near their commands in a period, and how well they are known.

    Arrays are replaced, never changed, so that a shallow copy looks ahead on its own.

    Args:
        devices: lags as the robot file or the model has them.
        period: s.
        ranges: of the pressures, (actuators,) in Pa.
        pressure: at rest, (actuators,) in Pa.

    Attributes:
        shares: while filling and while exhausting as learned, (2, actuators).
        offset: of the monitors, (actuators,) in Pa.
        covariance: of the logarithms of the shares and of the offset, (3, 3, actuators).
        noise: of the monitors, 1 sigma, from the mean absolute difference of successive readings beside what commands alone lead to (moving
            range; Montgomery, Introduction to Statistical Quality Control, 2009, section 6.4), (actuators,) in Pa.
        factor: on the declared time constants of regulators without a monitor that is believed.
        lead_factor: the same for the lead over these lags.
        nearest_factor: the factor as near to 1 as the doubt about it allows.
    """

    def __init__(self, devices: Devices, period: float, ranges: np.ndarray, pressure: np.ndarray | float = 0.0) -> None:
        self.period, count = period, len(ranges)
        shares = [1 - math.exp(-period / time) if time > 0 else 1 - AT_ONCE for time in (devices.filling, devices.exhausting)]
        self.shares = np.repeat(np.array(shares)[:, None], count, axis=1)
        self._declared, self._least, self._noise = self.shares, LEAST * self.shares, (READING * ranges) ** 2
        doubts, self.offset = np.array([DOUBT, DOUBT, 1.0])[:, None] ** 2 * np.ones(count), np.zeros(count)
        doubts[2] *= (OFFSET * ranges) ** 2
        self.covariance = np.eye(3)[:, :, None] * doubts
        self._slope = np.vstack([np.zeros((2, count)), np.ones(count)])  # of the readings, by commands alone
        self._path = np.zeros(count) + pressure  # by commands alone, with the lags as learned
        self._rise = self._turned = np.zeros(count)  # of the path in its last period, and its change from the period before
        self._most = (MISFIT * ranges) ** 2
        self._misfit = 2 * self._most  # mean square
        self._off, self.noise, self._noisy = np.full(count, np.nan), np.zeros(count), NOISY_MONITOR * ranges
        self.factor = self.lead_factor = self.nearest_factor = 1.0

    @property
    def noisy(self) -> np.ndarray:
        """Whether a monitor is too noisy to be believed, (actuators,) of bool."""
        return self.noise > self._noisy

    @property
    def believed(self) -> np.ndarray:
        """Whether a monitor has read something and is not too noisy, (actuators,) of bool."""
        return ~(np.isnan(self._off) | self.noisy)

    @property
    def unmonitored(self) -> np.ndarray:
        """Whether no monitor of a regulator is believed, or it shows that the valve is quick, (actuators,) of bool."""
        return ~self.believed | (self.shares.min(axis=0) > AS_COMMANDED)

    @property
    def used(self) -> np.ndarray:
        """Shares that are reckoned with, (2, actuators): as learned where readings fit, else as declared; with the factor unmonitored."""
        return self._shares_with(self.factor)

    @property
    def times(self) -> np.ndarray:
        """Time constants by which pressures lead while filling and while exhausting, (2, actuators) in s."""
        return -self.period / np.log1p(-self._shares_with(self.lead_factor))

    def _shares_with(self, factor: float) -> np.ndarray:
        fits = (self._misfit < self._most) & (np.abs(self.offset) ** 2 < 36 * self._most)
        monitored = np.where(fits, self.shares, self._declared)
        return np.where(self.unmonitored, np.minimum(1 - (1 - self._declared) ** (1 / factor), 1 - AT_ONCE), monitored)

    @property
    def quicker(self) -> np.ndarray:
        """Declared time constants over those found, filling and exhausting, (2, actuators); 1 where they are not known well."""
        known = (np.diagonal(self.covariance).T[:2] < KNOWN**2) & self.believed
        found = np.where(self.unmonitored, self.shares, self.used)
        return np.where(known, np.log1p(-found) / np.log1p(-self._declared), 1.0)

    @property
    def findings(self) -> RegulatorFindings:
        """Differences from the robot file, as diagnostics take them."""
        common = 1.0 if self.believed.all() else 1 / self.nearest_factor
        return RegulatorFindings(self.quicker, np.where(self.noisy, self.noise, 0.0), common)

    def lag(self, pressure: np.ndarray, command: np.ndarray, periods: int = 1) -> np.ndarray:
        """Pressures that constant commands lead to after some periods, (actuators,) in Pa each."""
        missing = command - pressure
        return command - missing * (1 - np.where(missing > 0, *self.used)) ** periods

    def advance(self, command: np.ndarray) -> None:
        """Carry what commands alone lead to, (actuators,) in Pa, a period on."""
        missing = command - self._path
        filling = missing > 0
        share = np.where(filling, *self.shares)
        self._slope = np.vstack([(1 - share) * self._slope[:2] + share * missing * np.array([filling, ~filling]), np.ones(len(command))])
        before, self._rise, self._path = self._rise, share * missing, command - missing * (1 - share)
        self._turned = np.abs(self._rise - before)

    def timing_error(self, command: np.ndarray) -> np.ndarray:
        """Largest error of readings that are a period early or late, (actuators,) in Pa.

        Args:
            command: in force, (actuators,) in Pa.
        """
        missing = command - self._path
        return np.maximum(self._turned, np.abs(np.where(missing > 0, *self.shares) * missing - self._rise))

    def correct(self, readings: np.ndarray, passed: float, timing_error: np.ndarray | float = 0.0) -> None:
        """Take readings of the monitors.

        Args:
            readings: (actuators,) in Pa, NaN where there is none.
            passed: time in s since the last ones.
            timing_error: part of what they miss that tells of no lag, (actuators,) in Pa.
        """
        measured = np.isfinite(readings)
        covariance = self.covariance + measured * passed * DRIFT**2 * np.diag([1.0, 1.0, 0.0])[:, :, None]
        seen = np.einsum("ijn,jn->in", covariance, self._slope)
        off = np.where(measured, readings - self._path - self.offset, 0.0)
        gain = measured * seen / (self._noise + np.einsum("in,in->n", self._slope, seen))
        new = np.maximum(np.abs(off - self._off) - timing_error, 0.0)
        again = measured & np.isfinite(new)
        self.noise = self.noise + (1 - math.exp(-passed / FORGOTTEN)) * np.where(again, new / MOVING_RANGE - self.noise, 0.0)
        self._off = np.where(measured, off, self._off)
        self.covariance = covariance - gain[:, None] * seen[None]
        missed = np.maximum(np.abs(off) - timing_error, 0.0)
        self._misfit = self._misfit + measured * (1 - math.exp(-passed / FORGOTTEN)) * (missed**2 - self._misfit)
        moved = gain * off
        moved[:2] = np.minimum(np.maximum(moved[:2], -JUMP), JUMP)
        self.offset = self.offset + moved[2]
        self.shares = np.minimum(np.maximum(self.shares * np.exp(moved[:2]), self._least), 1 - AT_ONCE)
        self._path = self._path + (self._slope[:2] * moved[:2]).sum(axis=0)
