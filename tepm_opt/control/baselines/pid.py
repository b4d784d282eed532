"""PID control of several quantities at once, with limits and anti-windup."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Gains:
    """Gains of one loop; what comes out has the unit N here, what goes in is in m.

    Attributes:
        proportional: in N/m.
        integral: in N/(m s).
        derivative: in N s/m, of the measured rate.
    """

    proportional: float
    integral: float
    derivative: float


class Pid:
    """out = bias + P e + ∫ I e dt − D dy/dt, within limits that may change from step to step.

    The derivative is of the measurement behind a first-order filter, so that a jump of the set point does not kick. The integral
    stands still where the output is at a limit and the error pushes on.

    Args:
        count: quantities.
        filter_time: time constant of the filter of the measurement in s.
    """

    def __init__(self, count: int, filter_time: float) -> None:
        self.filter_time = filter_time
        self.integral = np.zeros(count)
        self.filtered: np.ndarray | None = None
        self.rate = np.zeros(count)

    def observe(self, measured: np.ndarray, duration: float) -> np.ndarray:
        """The measurement (count,) filtered, `duration` s after the last one; the first one is taken as it is."""
        before = np.array(measured, dtype=float) if self.filtered is None else self.filtered
        if duration <= 0:
            self.filtered = before
            return before
        share = 1 - np.exp(-duration / self.filter_time) if self.filter_time > 0 else 1.0
        change = share * (measured - before)
        self.rate = change / duration
        after: np.ndarray = before + change
        self.filtered = after
        return after

    def step(
        self, error: np.ndarray, bias: np.ndarray, gains: tuple[np.ndarray, np.ndarray, np.ndarray], limits: np.ndarray, duration: float
    ) -> np.ndarray:
        """The output, (count,).

        Args:
            error: set point less filtered measurement, (count,).
            bias: feed-forward, (count,).
            gains: proportional, integral and derivative, (count,) each.
            limits: lower and upper, (2, count).
            duration: since the last step.
        """
        proportional, integral, derivative = gains
        free = bias + proportional * error - derivative * self.rate
        wanted = free + self.integral
        pushes = ((wanted > limits[1]) & (error > 0)) | ((wanted < limits[0]) & (error < 0))
        self.integral = np.where(pushes, self.integral, self.integral + integral * error * duration)
        return np.clip(free + self.integral, limits[0], limits[1])
