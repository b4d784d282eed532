"""Speed of regulators and tendon motors by robot file and model, which controllers and plans reckon with."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tepm_opt.models.compile import CompiledModel


@dataclass(frozen=True)
class Devices:
    """Speed of the devices between commands and forces.

    Attributes:
        filling, exhausting: time constants of the regulators in s; 0 is at once.
        tension_rate: of the motors in N/s; infinite is at once.
        delay: by which commands act late in s.
    """

    filling: float
    exhausting: float
    tension_rate: float
    delay: float

    @staticmethod
    def from_model(model: CompiledModel) -> Devices:
        """Devices of the robot file; a lag or delay that an effect of the model declares goes before it."""
        data, lag, delay = model.robot.actuation, model.pressure_lag, model.command_delay
        filling, exhausting = (data.filling_time_s, data.exhausting_time_s) if lag is None else lag
        rate = data.tension_rate_N_per_s or np.inf
        return Devices(filling, exhausting, rate, data.command_delay_s if delay is None else delay)

    def lag(self, pressure: np.ndarray, command: np.ndarray, duration: float) -> np.ndarray:
        """Pressure in Pa that a constant command leads to after a time in s."""
        filling, exhausting = (math.exp(-duration / time) if time > 0 else 0.0 for time in (self.filling, self.exhausting))
        more = pressure - command
        return command + more * np.where(more < 0, filling, exhausting)
