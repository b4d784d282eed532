"""Common factor of the regulators' lags, estimated from the tracked points where no pressure monitor teaches the lags.

The factor f on the declared time constants is taken for a constant. It enters the filter's motion through the modelled pressures alone,
so its estimate runs beside the filter, which is not changed by it (two-stage filter; Friedland, Treatment of bias in recursive filtering,
IEEE TAC 14, 1969). With V = d(state)/df, h = C V the slope of the predicted points, e their innovation and S its covariance,

    V ← A V + B dF/df,      δ = P hᵀ S⁻¹ e / (1 + P hᵀ S⁻¹ h),      P ← P / (1 + P hᵀ S⁻¹ h),      V ← (I − K C) V,      f ← f + δ.

This is the recursive prediction-error method with one parameter (Ljung, System Identification, 2nd ed., 1999, chapter 11): f is in the
inputs only, so that the filter's gain K does not depend on it.

The estimate begins short: linearised about a lag that is too long, quick motion has the wrong sign. Pressures lead by less than the
estimated lag as long as it is uncertain, for a lead over a lag that is not there makes the loop unstable.
"""

from __future__ import annotations

import math

import numpy as np

from tepm_opt.control.actuation.actuators import Actuators
from tepm_opt.control.actuation.regulator_lags import RegulatorLags
from tepm_opt.control.estimation.kalman_filter import Correction, DiscreteModalModel, Estimator

FIRST = 0.5  # factor before anything was seen
FACTOR_STD = 0.7  # its 1 sigma then
FACTOR_DRIFT = 0.05  # of it in 1/√s: how fast regulators change
LEAST_FACTOR, MOST_FACTOR = 0.05, 2.5  # bounds of the estimate; the least is at once, but for a period
QUICK_FACTOR = 0.25  # the most where monitors show quick valves
MOST_MOVE = 0.3  # most by which a sample moves it
COLOURED = 3.0  # times the innovations' covariance that is reckoned with: what friction leaves of them is not white
CAUTION = 2.0  # standard deviations by which pressures lead less


class LagFactor:
    """Estimate of the factor, as long as the regulators' lags are not known from monitors.

    Arrays are replaced, never changed, so that a shallow copy looks ahead on its own.

    Args:
        actuators: how many.
        states: of the filter, how many.

    Attributes:
        value: of the factor.
        variance: of it.
    """

    def __init__(self, actuators: int, states: int) -> None:
        self.value, self.variance = FIRST, FACTOR_STD**2
        self._by_pressure, self._by_state = np.zeros(actuators), np.zeros(states)  # slopes of pressures in Pa and states by the factor

    def tell(self, lags: RegulatorLags) -> None:
        """Let lags go by the factor: as estimated, led by the least within its doubt."""
        doubt = CAUTION * math.sqrt(self.variance)
        lags.factor, lags.lead_factor = self.value, max(self.value - doubt, LEAST_FACTOR)
        lags.nearest_factor = min(max(1.0, self.value - doubt), self.value + doubt)

    def advance(self, actuators: Actuators) -> np.ndarray:
        """Carry the pressures' slopes a period on, before the actuators are; slopes of the axial forces at its start and end in N,
        (2, actuators)."""
        lags, start = actuators.lags, self._by_pressure
        missing = actuators.command.pressures - actuators.pressure
        left = 1 - np.where(missing > 0, *lags.used)
        self._by_pressure = left * start + np.where(lags.unmonitored, left * np.log(left) / self.value, 0.0) * missing
        return actuators.area * np.array([start, self._by_pressure])

    def predict(self, slopes: np.ndarray, A: np.ndarray, now: DiscreteModalModel, then: DiscreteModalModel) -> None:
        """Carry the states' slopes a period on.

        Args:
            slopes: of the axial forces at its start and end, (2, actuators) in N.
            A: transition of the state, (states, states).
            now, then: operating points at its start and end.
        """
        (turn, _), pushed = then.seen_from(now), slopes @ now.model.drive.T
        moved = (now.start @ pushed[0] + now.end @ pushed[1]).reshape(2, -1) @ turn.T
        self._by_state = A @ self._by_state
        self._by_state[: moved.size] += moved.ravel()

    def correct(self, found: Correction | None, estimator: Estimator, actuators: Actuators) -> None:
        """Take the filter's last correction, and let estimator and actuators go by the factor that it leads to."""
        if found is None:
            return
        seen = found.observe @ self._by_state
        weighed = np.linalg.solve(found.covariance, seen) / COLOURED
        variance = self.variance + estimator.operating.period * FACTOR_DRIFT**2
        gain = variance / (1 + variance * float(seen @ weighed))
        moved = min(max(gain * float(weighed @ found.innovation), -MOST_MOVE), MOST_MOVE)
        before, self.variance = self.value, gain
        longest = QUICK_FACTOR if (actuators.lags.believed & actuators.lags.unmonitored).any() else MOST_FACTOR
        self.value = min(max(before + moved, LEAST_FACTOR), longest)
        self._by_state = self._by_state - found.gain @ seen
        estimator.mean = estimator.mean + (self.value - before) * self._by_state
        actuators.shift_pressures((self.value - before) * self._by_pressure)
        self.tell(actuators.lags)
