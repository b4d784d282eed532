"""What one step of the predictive controller did, what was ready before it, and what it looks ahead to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tepm_opt.control.actuation.actuators import Actuators
from tepm_opt.control.controller import Value
from tepm_opt.control.estimation.kalman_filter import Estimator, Operating, StateEstimate
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


@dataclass(frozen=True, eq=False)
class Prepared:
    """What is ready before a sample.

    Attributes:
        row: of the reference, at which the sample is expected; `ahead` periods later a new command can act.
        ahead: as of then.
        rows: of the reference at stages −1, 0, 1, …, (preview + 3,).
        estimator, actuators: brought up to the sample's time.
        then: operating point when a new command can act.
        directions: which way friction pulls after each period until then, (ahead, actuators).
        courses: and over the coming stages, (preview, actuators).
        foreseen: friction there as far as known before the sample, (preview, actuators) in N.
        factor: of the tensions by it, (preview, actuators).
    """

    row: int
    ahead: int
    rows: np.ndarray
    estimator: Estimator
    actuators: Actuators
    then: Operating
    directions: np.ndarray
    courses: np.ndarray
    foreseen: np.ndarray
    factor: np.ndarray


@dataclass(frozen=True, eq=False)
class Ahead:
    """What will be when a new command can act: [q, q'] about the operating point, the actuators, which way hysteresis pulls."""

    motion: np.ndarray
    actuators: Actuators
    turning: np.ndarray


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
