"""Largest steps at which explicit integration of the network is stable."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from threadpoolctl import threadpool_limits

from tepm_opt.solvers.mechanics.statics import Equilibrium
from tepm_opt.solvers.mechanics.tangent import linearise_network


def rk4_step_limit(values: np.ndarray) -> float:
    """Largest step in s at which the classical Runge-Kutta scheme damps all poles (Hairer and Wanner, vol. II, IV.2).

    At most 2.785 over the fastest pole, the limit on the real axis, although undamped poles would allow 1.5 % more.
    """

    def growth(step: float) -> float:
        z = step * values[np.abs(values) > 1e-9]
        return float(np.abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24).max()) - 1.0 - 1e-9  # rounding of undamped poles

    largest = 2.7853 / np.abs(values).max()
    return largest if growth(largest) <= 0 else float(brentq(growth, 0.2 * largest, 1.05 * largest, xtol=1e-12))  # type: ignore[arg-type]


def stable_step(equilibrium: Equilibrium) -> float:
    """Largest step in s at which RK4 is stable for small motions about an equilibrium, effects included."""
    with threadpool_limits(1, "blas"):  # threads would wait for each other on a matrix of this size
        return rk4_step_limit(np.linalg.eigvals(linearise_network(equilibrium)[0]))
