"""Interface of the backends of statics in C and in Python, with statuses and constants of all backends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Protocol

import numpy as np

from tepm_opt.outcome import Ending

LANES = 4
"""Doubles in a vector of the C: segments or directions that go through a kernel together."""
PLAIN_NEWTON = 1e-6
"""N: residual below which statics take plain Newton steps."""
ENERGY_NOISE = 1e-14
"""Relative rounding noise of the energy."""
ALLOCATION_STEPS = 200
"""Steps after which an allocation ends, whatever it misses."""
ALLOCATION_PRECISION = 1e-10
"""N: missing or moved force below which an allocation ends."""
SEED_STEPS = 100
"""Newton steps of the statics that precede a cold inverse."""
SEED_TOLERANCE = 0.1
"""N: residual to which they go; the inverse's own steps go further."""
LIMIT_SLACK = 1e-9
"""Parts of its range by which a force may be beyond its limits."""
JUMP_TIME = 1e-9
"""s: time that a jump of the inputs takes."""
STAGE_ITERATIONS = 25
"""Newton iterations of a stage before its step is halved."""
MAX_HALVINGS = 10
"""Halvings of a step before time stepping gives up."""
MAX_CORRECTION = 5e-3
"""m from its extrapolation within which a solution of Newton's method is believed; farther ones halve the step."""
STAYS = 1e12
"""N/m of what nothing holds in a motion's first equilibrium: its derivatives say that it stays where it begins."""
IMPLICIT, EXPLICIT, MODES, GUARDS = 0, 1, 10, 4  # schemes; modes of the slow motion, and shapes beyond them that are carried along


class Status(IntEnum):
    """Status with which a call of a backend ended."""

    SOLVED = 0
    UNSTABLE = 1
    """An equilibrium whose stiffness has a negative eigenvalue."""
    STALLED = 2
    """No step lowers the energy, or numbers beyond all bounds."""
    EXHAUSTED = 3
    """The largest number of iterations."""
    INDEFINITE = 4
    """The stiffness is not positive definite where it has to be."""
    DIVERGED = 5
    """A motion beyond all bounds."""
    STUCK = 6
    """A stage without a solution nearby, however short the step."""
    BEYOND = 7
    """A configuration whose forces are beyond their limits."""

    @property
    def ending(self) -> Ending:
        """The same in the words of all long work."""
        return _ENDINGS[self]


STATUSES = tuple(Status)
"""Statuses by their number."""

_ENDINGS: Mapping[Status, Ending] = {
    Status.SOLVED: Ending.SOLVED,
    Status.UNSTABLE: Ending.UNSTABLE,
    Status.STALLED: Ending.NOT_CONVERGED,
    Status.EXHAUSTED: Ending.NOT_CONVERGED,
    Status.INDEFINITE: Ending.UNSTABLE,
    Status.DIVERGED: Ending.FAILED,
    Status.STUCK: Ending.FAILED,
    Status.BEYOND: Ending.OUT_OF_REACH,
}

SHARED: Mapping[str, float] = {
    "LANES": LANES, "PLAIN_NEWTON": PLAIN_NEWTON, "ENERGY_NOISE": ENERGY_NOISE, "JUMP_TIME": JUMP_TIME,
    "ALLOCATION_STEPS": ALLOCATION_STEPS, "ALLOCATION_PRECISION": ALLOCATION_PRECISION,
    "STAYS": STAYS, "SEED_STEPS": SEED_STEPS, "SEED_TOLERANCE": SEED_TOLERANCE, "LIMIT_SLACK": LIMIT_SLACK,
    "STAGE_ITERATIONS": STAGE_ITERATIONS, "MAX_HALVINGS": MAX_HALVINGS, "IMPLICIT": IMPLICIT, "EXPLICIT": EXPLICIT,
    **{status.name: status.value for status in Status},
}  # fmt: skip
"""Constants that the C gets as macros."""


class LoadCase(NamedTuple):
    """Inputs, forces and parameters under which a network is in equilibrium.

    Attributes:
        u: inputs, (inputs,) in Pa and N.
        mapped: whether `u` is already the effective actuation behind the effects' input maps.
        external: forces on the points in G, (3 · points,) in N.
        theta: parameters, (parameters,) in SI.
    """

    u: np.ndarray
    mapped: bool
    external: np.ndarray
    theta: np.ndarray


class Solution(NamedTuple):
    """Result of `StaticsBackend.statics`: status, levels (n + 1, block), observations (points in G, then lengths), iterations,
    largest residual force in N, energy in J."""

    status: Status
    x: np.ndarray
    observed: np.ndarray
    iterations: float
    residual: float
    energy: float


@dataclass(frozen=True, eq=False)
class Allotment:
    """Rule by which axial forces become inputs, F_a = p A − λ (Eq. (3)), through the effects' input maps.

    Attributes:
        area: A in m².
        start: inputs to begin with, (inputs,) in Pa and N.
        limit: largest inputs, (inputs,); the smallest are 0.
        grid: resolutions of the inputs, (inputs,); 0 where continuous.
        fine: whether pressures go on their grid and tensions make up for it.
    """

    area: float
    start: np.ndarray
    limit: np.ndarray
    grid: np.ndarray
    fine: bool


@dataclass(frozen=True)
class InverseNewton:
    """Step and tolerances of Newton's method on levels and pressures together.

    Attributes:
        max_step: largest change of a pressure in a step in Pa; steps beyond it are shortened.
        target_tolerance: of the sums in m.
        tolerance: of the forces in N.
        max_iterations: most iterations.
    """

    max_step: float
    target_tolerance: float
    tolerance: float
    max_iterations: int


@dataclass(frozen=True, eq=False)
class InverseProblem:
    """Problem that the inverse kinematics of many targets have in common, with as many weighted sums as actuators.

    Attributes:
        external: forces on the points in G, (3 · points,) in N.
        theta: parameters, (parameters,) in SI.
        weights: of the observations (points in G, then lengths) in the sums, (actuators, observations); all but the first three
            sums have the target 0.
        low, high: limits of the axial forces, (actuators,) in N.
        shortest: length in m below which the network counts as collapsed.
        allotment: from axial forces to inputs.
        max_step: largest change of an axial force in a step in N.
        tolerance: of the sums in m.
        force_tolerance: of the equilibrium in N.
        max_iterations: of Newton's method on levels and forces together.
    """

    external: np.ndarray
    theta: np.ndarray
    weights: np.ndarray
    low: np.ndarray
    high: np.ndarray
    shortest: float
    allotment: Allotment
    max_step: float
    tolerance: float
    force_tolerance: float
    max_iterations: int


class Pose(NamedTuple):
    """A configuration of `StaticsBackend.configurations`: levels (n + 1, block), effective actuation (inputs,), observations, inputs
    that hold it, those on the grids, steps, largest residual in N, largest axial force missed in N, and the room: smallest distance
    of a force to its limits over its range."""

    x: np.ndarray
    actuation: np.ndarray
    observed: np.ndarray
    inputs: np.ndarray
    rounded: np.ndarray
    steps: float
    residual: float
    missed: float
    room: float


class StaticsBackend(Protocol):
    """Backend of statics and inverse kinematics; arrays are float64 and C-contiguous, levels x have the shape (n + 1, block)."""

    def actuation(self, u: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Effective actuation a = [pressures, tensions] behind the effects' input maps."""
        ...

    def statics(self, x: np.ndarray, case: LoadCase, tolerance: float, max_iterations: int) -> Solution:
        """Equilibrium from a start, under inputs and external forces.

        Args:
            x: levels to start from, (n + 1, block) in m.
            case: inputs, forces and parameters.
            tolerance: largest residual force of a solution in N.
            max_iterations: of Newton's method.
        """
        ...

    def sensitivity(
        self, x: np.ndarray, case: LoadCase, weights: np.ndarray, by_theta: bool
    ) -> tuple[Status, np.ndarray, np.ndarray, np.ndarray | None]:
        """Status, and gradients of weighted observations by u, external forces and parameters (None without `by_theta`), (rows, …) each.

        Args:
            x: levels of an equilibrium, (n + 1, block) in m.
            case: inputs, forces and parameters.
            weights: of the observations (points in G, then lengths), (rows, 3 · points + lengths).
            by_theta: whether to differentiate by the parameters, too.
        """
        ...

    def matrices(self, x: np.ndarray, case: LoadCase) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness in N/m and damping matrix in N s/m of the free levels in lower banded storage, (2 · block, n · block) each.

        Args:
            x: levels at which to evaluate, (n + 1, block) in m.
            case: inputs, forces and parameters.
        """
        ...

    def inverse(
        self, x: np.ndarray, case: LoadCase, weights: np.ndarray, targets: np.ndarray, newton: InverseNewton
    ) -> tuple[Status, np.ndarray, np.ndarray, int]:
        """Status, levels, effective pressures (tensions are 0) and iterations at which weighted observations have their targets.

        Newton on levels and pressures together, from a start nearby.

        Args:
            x: levels to start from, (n + 1, block) in m.
            case: mapped, with effective pressures to start from; its tensions are not looked at.
            weights: of the observations (points in G, then lengths) in as many sums as actuators, (actuators, observations).
            targets: of the sums, (actuators,).
            newton: step and tolerances.
        """
        ...

    def response(
        self, x: np.ndarray, case: LoadCase, weights: np.ndarray, tolerance: float, max_iterations: int
    ) -> tuple[Status, np.ndarray, np.ndarray, np.ndarray]:
        """Status, levels and observations in equilibrium, and the derivatives of weighted observations by the actuation, (rows, inputs).

        `statics` and `sensitivity` in one call; there are no derivatives where the status is not SOLVED.

        Args:
            x: levels to start from, (n + 1, block) in m.
            case: mapped.
            weights: of the observations (points in G, then lengths), (rows, 3 · points + lengths).
            tolerance: largest residual force of a solution in N.
            max_iterations: of Newton's method.
        """
        ...

    def allocate(self, forces: np.ndarray, allotment: Allotment, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Inputs that make axial forces, the same on their grids, (inputs,) in Pa and N, and the largest force missed in N.

        Effects bend the way from inputs to forces, so it is inverted by iterating with the nominal one, F_a = p A − λ;
        that contracts as long as effects change forces by less than their own size. Where an input does not answer (a dead
        zone), its steps double until it does.
        """
        ...

    def configurations(
        self, problem: InverseProblem, targets: np.ndarray, x: np.ndarray, actuation: np.ndarray, cold: bool
    ) -> tuple[list[Pose], Status]:
        """Configurations at the first of the targets, and how what came after them ended: SOLVED where only the call was full.

        Each starts from the one before; a call takes as many as keep it short, and ends at the first without a configuration.

        Args:
            problem: what the targets have in common.
            targets: of the first three sums, (targets, 3) in m, at least one.
            x: levels to start from, (n + 1, block) in m.
            actuation: effective actuation to start from, (inputs,); its tensions are 0.
            cold: whether to bring levels into equilibrium under the actuation before.
        """
        ...
