"""What one step of the predictive controller did."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tepm_opt.control.estimator import StateEstimate
from tepm_opt.outcome import Outcome


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
        seconds: from the sample to the command and, of these where it is known, of the program.
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
