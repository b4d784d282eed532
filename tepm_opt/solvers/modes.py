"""Small motions about an equilibrium: eigenvalues of the linearised network."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from tepm_opt.solvers.statics import Equilibrium


def full(band: np.ndarray) -> np.ndarray:
    """Symmetric matrix from its lower banded storage (SciPy's `solveh_banded` layout)."""
    size = band.shape[1]
    matrix = np.zeros((size, size))
    for offset, diagonal in enumerate(band[:size]):
        values = diagonal[: size - offset]
        matrix += np.diag(values, -offset) + (np.diag(values, offset) if offset else 0)
    return matrix


def state_matrix(equilibrium: Equilibrium) -> np.ndarray:
    """A of d/dt [x, v] = A [x, v] about an equilibrium, (6 · actuators · n)² in SI; x are the free levels."""
    model, P = equilibrium.model, equilibrium.properties
    stiffness = full(model.reference.assemble(equilibrium.x, P, model.theta).band)
    damping = full(model.reference.damping(equilibrium.x, P, model.theta))
    mass = np.repeat(P[:, model.network.property_rows["mass"]].ravel(), model.layout.block)
    zero, one = np.zeros_like(stiffness), np.eye(len(mass))
    return np.block([[zero, one], [-stiffness / mass[:, None], -damping / mass[:, None]]])


def poles(equilibrium: Equilibrium) -> np.ndarray:
    """Eigenvalues of the linearised network in 1/s, slowest first."""
    values = np.linalg.eigvals(state_matrix(equilibrium))
    return values[np.argsort(np.abs(values))]


def rk4_step_limit(values: np.ndarray) -> float:
    """Largest step in s at which the classical Runge-Kutta scheme damps all poles (Hairer and Wanner, vol. II, IV.2).

    At most 2.785 over the fastest pole, the limit on the real axis, although undamped poles would allow 1.5 % more.
    """

    def growth(step: float) -> float:
        z = step * values[np.abs(values) > 1e-9]
        return float(np.abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24).max()) - 1.0

    largest = 2.7853 / np.abs(values).max()
    return largest if growth(largest) <= 0 else float(brentq(growth, 0.2 * largest, 1.05 * largest, xtol=1e-12))  # type: ignore[arg-type]
