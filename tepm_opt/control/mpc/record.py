"""Steps of the predictive controller: what each offers, and the record that it leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tepm_opt.control.actuation.actuators import Actuators
from tepm_opt.control.controller import Telemetry, Value
from tepm_opt.control.estimation.kalman_filter import StateEstimate
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.outcome import Outcome

LATE = "late"  # why a plan that was found is not used


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


class ControlStep(Protocol):
    """The step of one controller: prepared without a sample, then fed with one; in C or in Python, with the same commands."""

    fallbacks: dict[str, int]
    """Number of steps that went on with an older plan, by the reason."""

    def prepare(self) -> None:
        """Do what the next sample is not needed for, should it come a period after the last one.

        Raises:
            InputError: an equilibrium of the reference is not stable.
        """
        ...

    def feedback(self, sample: Sample, deadline: float) -> Command:
        """Command for a sample; a plan found later than a deadline in s is not used. What is not prepared is prepared first.

        Raises:
            InputError: points of another shape, or an equilibrium of the reference is not stable.
        """
        ...

    def distrust_monitors(self) -> None:
        """Believe no pressure monitor from now on; readings must not be given any more."""
        ...

    def telemetry(self) -> Telemetry:
        """Record of the last step for the log, with noise and doubts as of the last preparation."""
        ...

    @property
    def last(self) -> Step | None:
        """Record of the last step; None before the first one."""
        ...

    @property
    def ahead(self) -> int:
        """Periods from a sample to when a new command acts, as far as is known."""
        ...

    @property
    def noise(self) -> float:
        """Measured noise of a tracked coordinate in m; the declared one at first."""
        ...


def columns_of(step: Step, names: Sequence[str], actuators: Actuators) -> dict[str, Value]:
    """Columns of the log that tell the estimate, by the actuators' names."""
    estimate = step.estimate
    columns: dict[str, Value] = {f"estimated_tip_{axis}_m": float(estimate.points[-1, k]) for k, axis in enumerate("xyz")}
    for k, name in enumerate(names):
        columns[f"unknown_force_{name}_N"] = float(step.unknown[k])
        columns[f"friction_{name}_N"] = float(estimate.friction[k])
        columns[f"tension_offset_{name}_N"] = float(actuators.tension_offset[k])
        columns[f"pressure_offset_{name}_Pa"] = float(actuators.pressure_offset[k])
    return columns | {"nis": float(estimate.nis), "coordinates_seen": float(estimate.seen), "points_refused": float(estimate.refused.sum())}
