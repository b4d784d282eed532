"""Static equilibrium from forces alone: downhill along the potential with a trust region, then Newton."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

TOLERANCE = 1e-9  # N; over the smallest stiffness of about 0.4 N/m that is 3 nm
_DIFFERENCE = 1e-7  # m, of the numerical stiffness matrix
_LONGEST = 0.02  # m, of one step
_NUDGE = 1e-3  # m, away from an unstable equilibrium

Force = Callable[[np.ndarray], np.ndarray]


class NoEquilibriumError(RuntimeError):
    """The network does not come to rest; the message has the numbers."""


def find_equilibrium(force: Force, start: np.ndarray, tolerance: float = TOLERANCE, iterations: int = 300) -> np.ndarray:
    """The stable equilibrium downhill from `start`.

    Levenberg's method on the potential: the work F · dx of a step, against what the stiffness promised, decides about the damping added
    to the stiffness. So the first steps follow the flow and do not run to a saddle as Newton's would; the last ones are Newton's.

    Args:
        force: of positions (places, coordinates) in m, independent of each other; (places, coordinates) in N.
        start: (coordinates,) in m.
        tolerance: on the largest force in N.
        iterations: at most.

    Raises:
        NoEquilibriumError: the force does not vanish, or only where the equilibrium is unstable.
    """
    position, now = start.copy(), force(start[None])[0]
    drag, nudged = 10.0, False  # N/m
    for _ in range(iterations):
        stiffness = _stiffness(force, position, now)
        if np.abs(now).max() <= tolerance:
            softest, shape = _softest(stiffness)
            if softest > 0:
                return position
            if nudged:
                raise NoEquilibriumError(f"the network only rests where it is unstable: smallest stiffness {softest:.3g} N/m")
            position, nudged, drag = position + _NUDGE * shape, True, 10.0
            now = force(position[None])[0]
            continue
        position, now, drag = _downhill(force, position, now, stiffness, drag)
    raise NoEquilibriumError(f"the network does not come to rest: largest force {np.abs(now).max():.3g} N after {iterations} steps")


def _downhill(
    force: Force, position: np.ndarray, now: np.ndarray, stiffness: np.ndarray, drag: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Position, force and next damping after one step that loses potential."""
    values, shapes = np.linalg.eigh((stiffness + stiffness.T) / 2)
    along = shapes.T @ now
    drag = max(drag, -2 * values[0])
    for _ in range(60):
        amount = along / (values + drag)
        move = shapes @ amount
        if np.abs(move).max() <= _LONGEST:
            after = force((position + move)[None])[0]
            gain = (now + after) @ move / 2 / (along @ amount - amount @ (values * amount) / 2)
            if gain > 0.1 or np.abs(move).max() < 1e-8:
                calmer = 0.1 if gain > 0.75 else 0.4 if gain > 0.4 else 1.5
                return position + move, after, drag * calmer if drag > 1e-6 else 0.0
        drag = max(4 * drag, 1e-2)
    raise NoEquilibriumError(f"the network does not come to rest: no step loses potential at a force of {np.abs(now).max():.3g} N")


def _softest(stiffness: np.ndarray) -> tuple[float, np.ndarray]:
    """The smallest eigenvalue in N/m and its shape with the largest entry 1, (coordinates,)."""
    values, shapes = np.linalg.eigh((stiffness + stiffness.T) / 2)
    return float(values[0]), shapes[:, 0] / np.abs(shapes[:, 0]).max()


def _stiffness(force: Force, position: np.ndarray, now: np.ndarray) -> np.ndarray:
    """−dF/dx by forward differences, (coordinates, coordinates)."""
    moved = position + _DIFFERENCE * np.eye(len(position))
    return (now - force(moved)).T / _DIFFERENCE
