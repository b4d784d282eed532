"""What time stepping takes and leaves, whichever backend does it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from tepm_opt.models.dynamics import Dynamics

DONE, DIVERGED, STUCK = range(3)
IMPLICIT, EXPLICIT = range(2)


@dataclass(frozen=True, eq=False)
class Drive:
    """What moves a network over time, and the directions in which to differentiate.

    Attributes:
        time: of the samples in s, increasing, (samples,).
        rows: inputs u and external forces on the points in G, (samples, inputs + 3 · points).
        hold: whether a row holds until the next sample, instead of changing linearly.
        d_theta: changes of the parameters, (directions, parameters).
        d_rows: changes of the rows, (samples, directions, inputs + 3 · points); None for none.
    """

    time: np.ndarray
    rows: np.ndarray
    hold: bool
    d_theta: np.ndarray
    d_rows: np.ndarray | None = None


@dataclass(frozen=True)
class Scheme:
    """How to step in time.

    Attributes:
        kind: IMPLICIT or EXPLICIT.
        step: longest step in s.
        tolerance: of Newton's residuals in N.
        farthest: in m, how far from its extrapolation a solution of Newton's method is believed; farther ones halve the step.
    """

    kind: int
    step: float
    tolerance: float = 1e-6
    farthest: float = 5e-3


@dataclass(frozen=True, eq=False)
class Record:
    """What a time stepper leaves at the samples.

    Attributes:
        observed: points in G, then lengths, (samples, 3 · points + lengths) in m.
        trajectory: levels in m and their velocities in m/s, (samples, 2, n + 1, block).
        d_observed: the observed along each direction, (samples, 3 · points + lengths, directions).
    """

    observed: np.ndarray
    trajectory: np.ndarray
    d_observed: np.ndarray

    @staticmethod
    def empty(dynamics: Dynamics, samples: int, directions: int) -> Record:
        """Filled with NaN."""
        layout = dynamics.layout
        observed = 3 * layout.points + layout.inputs // 2
        shapes = (samples, observed), (samples, 2, layout.levels + 1, layout.block), (samples, observed, directions)
        return Record(*(np.full(shape, np.nan) for shape in shapes))


@dataclass
class Effort:
    """What a time stepper took: steps, Newton iterations, factorisations, halved steps, time reached in s."""

    steps: float = 0
    iterations: float = 0
    factors: float = 0
    halvings: float = 0
    reached: float = 0


class TimeStepper(Protocol):
    """What a backend offers."""

    dynamics: Dynamics

    def start(self, x: np.ndarray, directions: int) -> Any:
        """State at rest in an equilibrium x, (n + 1, block)."""
        ...

    def integrate(
        self, state: Any, drive: Drive, first: int, last: int, scheme: Scheme, theta: np.ndarray, record: Record
    ) -> tuple[int, Effort]:
        """Move the state from sample `first` to `last`; returns a status.

        Rows first + 1 … last are recorded, and row 0 when `first` is 0.
        """
        ...
