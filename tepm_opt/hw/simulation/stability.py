"""The longest step of RK4 that a network's stiffest motion bears."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csr_array, diags_array

from tepm_opt.hw.simulation.imperfections.base import Body

MARGIN = 0.9  # edges turn and the mass of what moves together changes with the shape
_REAL, _ROUND = (
    2.785,
    2.61,
)  # how far RK4 is stable along the negative real axis, and in all of the left half plane (Hairer, Wanner II, IV.2)


def longest_step(body: Body) -> float:
    """Longest stable step in s, with a margin.

    From the modes of M⁻¹C and of M⁻¹K at the rest geometry: each moves as q̈ + c q̇ + k q = 0 with the other matrix' Rayleigh quotient.
    """
    damping, stiffness = (_over_mass(body, of) for of in (body.damping, body.stiffness))
    roots = []
    for one, other, swapped in ((damping, stiffness, False), (stiffness, damping, True)):
        values, shapes = eigh(one)
        quotients = np.einsum("ij,ij->j", shapes, other @ shapes)
        c, k = (quotients, values) if swapped else (values, quotients)
        roots.append((c + np.emath.sqrt(c**2 - 4 * k)) / 2)
    fastest = np.concatenate(roots)
    size = np.abs(fastest)
    return float(MARGIN * np.min(np.where(np.abs(np.imag(fastest)) > 1e-3 * size, _ROUND, _REAL) / np.maximum(size, 1e-9)))


def _over_mass(body: Body, weights: np.ndarray) -> np.ndarray:
    """M^−½ Bᵀ W B M^−½ for weights (n, edges) of the edges' elongations B x, (3 n actuators, 3 n actuators)."""
    layout, count = body.layout, body.layout.actuators
    nodes = layout.rest_positions(body.robot.parameters.r, body.robot.parameters.L_0).reshape(-1, 3)
    steps = np.arange(layout.levels)[:, None] * count
    lower, upper = (
        (np.array([end[0] * count + end[1] for end in ends]) + steps).ravel()
        for ends in zip(*[(e.a, e.b) for e in layout.edges], strict=True)
    )
    spans = nodes[upper] - nodes[lower]
    along = spans / np.linalg.norm(spans, axis=1, keepdims=True)
    rows = np.repeat(np.arange(len(along)), 6)
    columns = np.concatenate([3 * upper[:, None] + np.arange(3), 3 * lower[:, None] + np.arange(3)], axis=1)
    elongation = csr_array((np.concatenate([along, -along], axis=1).ravel(), (rows, columns.ravel())), shape=(len(along), nodes.size))
    light = diags_array(np.repeat(body.mass.ravel() ** -0.5, 3))
    moving = elongation[:, 3 * count :] @ light
    return (moving.T @ diags_array(weights.ravel()) @ moving).toarray()
