"""Interface of the time steppers in C and in Python: arguments and results."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from tepm_opt.models.backends.interface import Status

if TYPE_CHECKING:
    from tepm_opt.models.dynamics import Dynamics


@dataclass(frozen=True, eq=False)
class Drive:
    """Inputs, forces and parameters by which a network moves over time, and the directions in which to differentiate.

    Attributes:
        time: of the samples in s, increasing, (samples,).
        rows: inputs u and external forces on the points in G, (samples, inputs + 3 · points).
        hold: whether a row holds until the next sample, instead of changing linearly.
        theta: parameters, (parameters,) in SI; where effects ask what time it is, the clock is that of each moment, `began` as given.
        d_theta: changes of the parameters, (directions, parameters).
        d_rows: changes of the rows, (samples, directions, inputs + 3 · points); None for none.
        knots: times in s at which adaptive steps end, as the rows jump or bend there, increasing.
    """

    time: np.ndarray
    rows: np.ndarray
    hold: bool
    theta: np.ndarray
    d_theta: np.ndarray
    d_rows: np.ndarray | None = None
    knots: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __repr__(self) -> str:
        return f"Drive({len(self.time)} samples, {'held' if self.hold else 'linear'}, {len(self.d_theta)} directions)"


@dataclass(frozen=True)
class Scheme:
    """Settings of the integration in time.

    Attributes:
        kind: IMPLICIT or EXPLICIT.
        step: longest step in s; 0 where steps adapt.
        error: of the nodes in m at which adaptive steps aim.
        smooth: whether the order of the scheme can be relied on for estimates; else adaptive steps count on order 1.
        tolerance: of Newton's residuals in N, at which its iterations end in any case.
    """

    kind: int
    step: float
    error: float = 0.0
    smooth: bool = True
    tolerance: float = 1e-6


@dataclass(frozen=True, eq=False)
class Record:
    """Motion at the samples, as a time stepper records it.

    Attributes:
        observed: points in G, then lengths, (samples, 3 · points + lengths) in m.
        trajectory: levels in m and their velocities in m/s, (samples, 2, n + 1, block).
        d_observed: the observed along each direction, (samples, 3 · points + lengths, directions).
    """

    observed: np.ndarray
    trajectory: np.ndarray
    d_observed: np.ndarray

    def __repr__(self) -> str:
        return f"Record({len(self.observed)} samples, {self.d_observed.shape[-1]} directions)"

    @staticmethod
    def empty(dynamics: Dynamics, samples: int, directions: int) -> Record:
        """A record filled with NaN."""
        layout = dynamics.layout
        observed = 3 * layout.points + layout.inputs // 2
        shapes = (samples, observed), (samples, 2, layout.levels + 1, layout.block), (samples, observed, directions)
        return Record(*(np.full(shape, np.nan) for shape in shapes))


@dataclass
class Effort:
    """Work of a time stepper: steps, Newton iterations, factorisations, halved steps, time reached in s; of adaptive steps the
    estimated error in m so far; the longest step in s."""

    steps: float = 0
    iterations: float = 0
    factors: float = 0
    halvings: float = 0
    reached: float = 0
    error: float = 0
    longest: float = 0


class TimeStepper(Protocol):
    """Integrator of the motion in time, as a backend has it."""

    dynamics: Dynamics

    def start(self, x: np.ndarray, directions: int) -> Any:
        """State at rest in an equilibrium x, (n + 1, block)."""
        ...

    def integrate(self, state: Any, drive: Drive, first: int, last: int, scheme: Scheme, record: Record) -> tuple[Status, Effort]:
        """Move the state from one sample to a later one; returns status and effort.

        Rows first + 1 … last are recorded, and row 0 when `first` is 0.

        Args:
            state: what `start` or the last call has left; changed in place.
            drive: inputs and forces at all samples, parameters and directions.
            first, last: numbers of the samples, from 0.
            scheme: how to step.
            record: what is filled.
        """
        ...
