"""First derivatives of the network's motion about an equilibrium."""

from __future__ import annotations

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.outcome import Ending
from tepm_opt.solvers.mechanics.statics import Equilibrium


def linearise_network(equilibrium: Equilibrium) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Linearise d/dt s of the network, s its free levels, their velocities and the internal states of its edges.

    Args:
        equilibrium: solved or unstable.

    Returns:
        Derivatives by s, (states, states), by the effective actuation, (states, inputs), and by forces on the reference points in G,
        (states, 3 · points).

    Raises:
        InputError: not an equilibrium.
    """
    if equilibrium.outcome.ending not in (Ending.SOLVED, Ending.UNSTABLE):
        raise InputError(f"no equilibrium to linearise about: {equilibrium.outcome.message}")
    model, stepper, layout = equilibrium.model, equilibrium.model.reference_stepper, equilibrium.model.layout
    n, block, edges, size = layout.levels, layout.block, stepper.dynamics.edge_states, layout.levels * layout.block
    loads, outer = equilibrium.loads, layout.inputs + 3 * layout.points
    a, P = model.reference.prepare(equilibrium.inputs, equilibrium.mapped, loads.ravel(), model.theta)[:2]
    d_P = stepper.jacobian("properties_by", a, loads, model.theta)[: P.size, :outer].reshape(*P.shape, outer)
    jacobians = stepper.segment_jacobians(equilibrium.x, P, model.theta)
    by_x, by_v, by_y, by_P = np.split(jacobians, np.cumsum([2 * block, 2 * block, edges, P.shape[1]]), axis=2)[:4]
    driven = by_P @ d_P
    A = np.zeros((2 * size + n * edges, 2 * size + n * edges))
    B = np.zeros((len(A), outer))
    for s in range(n):
        near = np.arange(2 * block) + (s - 1) * block  # coordinates of its two levels; those of level 0, which is fixed, are negative
        free, own = near >= 0, 2 * size + s * edges + np.arange(edges)
        rows, columns = np.r_[size + near[free], own], np.r_[near[free], size + near[free], own]
        kept = np.r_[free, np.ones(edges, dtype=bool)]
        A[np.ix_(rows, columns)] += np.hstack([by_x[s][:, free], by_v[s][:, free], by_y[s]])[kept]
        B[rows] += driven[s][kept]
    mass = np.repeat(P[:, stepper.mass_row], block)[:, None]
    A[size : 2 * size] /= -mass  # until here forces, which hold the nodes back
    B[size : 2 * size] /= -mass
    A[:size, size : 2 * size] = np.eye(size)
    return A, B[:, : layout.inputs], B[:, layout.inputs :]
