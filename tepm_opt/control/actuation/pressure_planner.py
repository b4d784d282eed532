"""Coarse pressures: what they shall be, on the regulators' grid, so that the tensions can do the rest from the middle of their range.

Pressure and tension act on the same force, F_a = p A − λ, so the pressure can be planned for each muscle by itself: ahead of the
regulator's lag it follows what is needed of F_a with the tension at its middle (mid-ranging; Allison and Isaksson, Design and
performance of mid-ranging controllers, J. Process Control 8, 1998), and moves by whole steps, only when it is worth a move. The tensions
are decided after that, knowing what the pressures will really do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tepm_opt.control.actuation.regulator_lags import RegulatorLags
from tepm_opt.models.robot import on_grid

PERIODS = 2  # of control in a stage of the prediction


@dataclass(frozen=True)
class PressurePlannerSettings:
    """Settings of the pressure planner.

    Attributes:
        preview: stages for which the need is known ahead.
        slope_window: stages over which the slope of the need is taken, for the lead over the regulators' lag.
        deadband: steps of the regulator by which a pressure has to be off before it moves.
        slow_lag: time constant in s from which that deadband is whole. It shrinks in proportion below, down to one step: the force of a
            whole deadband comes too suddenly for the motors then, whose 10 N/s make up for 0.6 N of it in 0.06 s.
        quantised: whether the regulators' grid is known and moves are spared; else pressures are continuous and move in every period.
        full_feedback_speed: speed of the reference's tip in m/s from which the pressures take their whole part in the planned feedback, in
            proportion below; where the reference stands, the tensions alone react and the regulators are spared.
        feedback_time: time constant in s with which that part is smoothed.
        disturbance_time: time constant in s with which the pressures take over the unknown forces (mid-ranging).
    """

    preview: int = 26
    slope_window: int = 2
    deadband: float = 3.0
    slow_lag: float = 0.06
    quantised: bool = True
    full_feedback_speed: float = 0.2
    feedback_time: float = 0.025
    disturbance_time: float = 0.3


class PressurePlanner:
    """Planner of the coarse pressures, period by period.

    Args:
        limits: largest pressure of each muscle, (actuators,) in Pa.
        step: of the regulators' grid in Pa, 0 where continuous.
        settings: of the planner.
    """

    def __init__(self, limits: np.ndarray, step: float, settings: PressurePlannerSettings) -> None:
        self.settings = settings
        self.step = step if settings.quantised else 0.0
        self.limits = np.floor(limits / self.step * (1 + 1e-12)) * self.step if self.step else limits

    def plan(
        self, wanted: np.ndarray, command: np.ndarray, pressure: np.ndarray, stages: int, lags: RegulatorLags
    ) -> tuple[np.ndarray, np.ndarray]:
        """New commands (actuators,) in Pa and the pressures in the muscles that they lead to, (stages, actuators) in Pa.

        Args:
            wanted: pressures at the coming stages, (preview, actuators) in Pa.
            command: in force, (actuators,) in Pa.
            pressure: in the muscles, (actuators,) in Pa.
            stages: how far ahead.
            lags: of the regulators.
        """
        window = self.settings.slope_window
        slope = (wanted[window:] - wanted[:-window]) / (window * PERIODS * lags.period)
        led = (wanted[window:] + wanted[:-window]) / 2 + np.where(slope > 0, *lags.times) * slope
        lead = np.minimum(np.maximum(led, 0.0), self.limits)
        new = self._round_moves(lead[0], command, lags)
        reached = np.empty((stages, len(command)))
        for k in range(stages):  # later moves are not decided yet: they will follow the need
            goal = np.minimum(np.maximum(new + lead[min(k, len(lead) - 1)] - lead[0], 0.0), self.limits)
            pressure = lags.lag(pressure, goal, PERIODS)
            reached[k] = pressure
        return new, reached

    def _round_moves(self, wanted: np.ndarray, command: np.ndarray, lags: RegulatorLags) -> np.ndarray:
        if not self.step:
            return wanted
        most, lag = self.settings.deadband, np.where(wanted > command, *lags.times)
        deadband = np.minimum(np.maximum(most * lag / self.settings.slow_lag, min(most, 1.0)), most)
        rounded = on_grid(wanted, self.step, self.limits)
        return np.where(np.abs(wanted - command) > deadband * self.step, rounded, command)
