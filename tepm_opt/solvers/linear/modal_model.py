"""The slow motion of the network about an equilibrium: its first modes, driven by axial forces; from a neighbour's in some 0.3 ms.

With δ = Φ q the displacement of the free levels and Φᵀ M Φ = 1,

    q'' + Δ q' + Ω q = B (F - F_0) + E f,      z = z_0 + C q + R (F - F_0),

where F are the axial forces of Eq. (3), f forces on the reference points z, and R what the modes that were left out contribute at
rest (static residual; Craig, Structural Dynamics, 1981, section 19). Φ are the exact modes or, from the shapes of a neighbour, those
of subspace iteration (Bathe, Finite Element Procedures, 1996, section 11.6). Internal states of effects are taken as at rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy.linalg as sla

from tepm_opt.errors import InputError
from tepm_opt.models.backends.interface import GUARDS, MODES
from tepm_opt.models.compile import CompiledModel
from tepm_opt.renamed import RenamedMethod
from tepm_opt.solvers.mechanics.statics import Equilibrium
from tepm_opt.solvers.numerics.matrices import expand_band, upper_from_band

NEAR = 0.03  # residual of a mode, of its stiffness, at which subspace iteration ends; frequencies err by its square
SWEEPS = 12  # after which a start was no neighbour: exact modes are cheaper

_factor, _solve, _reduced = sla.get_lapack_funcs(("pbtrf", "pbtrs", "sygv"))  # scipy.linalg checks for longer than these take


@dataclass(frozen=True, eq=False)
class ModalModel:
    """Slow motion about an equilibrium; see the module.

    Attributes:
        equilibrium: about which.
        basis: Φ of the modes and a few more, the start for neighbours, (coordinates of the free levels, modes + guards) in 1/√kg.
        weights: Φᵀ M of the modes, (modes, coordinates) in √kg: `weights @ (levels - model.levels)` are the q of levels.
        stiffness: Ω, the squares of the natural frequencies, ascending, (modes,) in 1/s².
        damping: Δ, (modes, modes) in 1/s.
        drive: B, (modes, modules · actuators) in 1/√kg.
        observe: C of the reference points in G, (3 · points, modes) in 1/√kg.
        gain: of the points by axial forces at rest, all modes of the network included, (3 · points, modules · actuators) in m/N.
    """

    equilibrium: Equilibrium
    basis: np.ndarray
    weights: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    drive: np.ndarray
    observe: np.ndarray
    gain: np.ndarray

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        frequencies = np.sqrt(self.stiffness) / (2 * np.pi)
        return f"ModalModel({len(frequencies)} modes from {frequencies[0]:.3g} to {frequencies[-1]:.3g} Hz)"

    @property
    def shapes(self) -> np.ndarray:
        """Φ of the modes, (coordinates, modes) in 1/√kg."""
        return self.basis[:, : len(self.stiffness)]

    @property
    def push(self) -> np.ndarray:
        """E, forces act where the points are observed, (modes, 3 · points) in 1/√kg."""
        return self.observe.T

    @property
    def residual(self) -> np.ndarray:
        """R, (3 · points, modules · actuators) in m/N."""
        return self.gain - self.observe @ (self.drive / self.stiffness[:, None])

    @property
    def levels(self) -> np.ndarray:
        """Free levels at the equilibrium in the base frame, (coordinates,) in m."""
        return self.equilibrium.x[1:].ravel()

    def scale_damping(self, factor: float) -> ModalModel:
        """Scale the damping by a factor."""
        return replace(self, damping=factor * self.damping)

    damped = RenamedMethod("scale_damping")

    def static(self, forces: np.ndarray) -> np.ndarray:
        """q at rest under changes of the axial forces (modules · actuators,) in N."""
        return (self.drive @ forces) / self.stiffness


def modal_model(at: Equilibrium, start: ModalModel | None = None, modes: int = MODES) -> ModalModel:
    """Slow motion about an equilibrium.

    Args:
        at: a stable equilibrium.
        start: the modal model at a neighbour, of the same model and as many modes: some five times faster than without, where the modes
            are found exactly. Frequencies are within 1e-3 of the exact ones; the gain is exact either way.
        modes: how many, at most the coordinates of the free levels.

    Raises:
        InputError: not a stable equilibrium, no such number of modes, or a start of another model or number of modes.
    """
    model = at.model
    if not at.solved:
        raise InputError(f"no stable equilibrium to linearise about: {at.outcome.message}")
    fixed = fixed_part(model)
    most = len(fixed.masses)
    if not 1 <= modes <= most:
        raise InputError(f"modes: {modes!r}; valid: 1 … {most}")
    if start is not None and (start.equilibrium.model is not model or len(start.stiffness) != modes):
        raise InputError("start: of another model or number of modes; valid: a modal model of the same, or None")
    stiffness, damping = model.statics.matrices(at.x, at.load_case)
    factor, indefinite = _factor(stiffness, lower=1)
    if indefinite:
        raise InputError("no stable equilibrium to linearise about: its stiffness matrix has a negative eigenvalue")
    axial = fixed.axial(at)
    settled = _solve(factor, axial, lower=1)[0]
    found = None if start is None else _iterate_subspace(factor, fixed.masses, start.basis, modes)
    values, basis = found or _exact(stiffness, fixed.masses, min(modes + GUARDS, most))
    shapes = basis[:, :modes]
    return ModalModel(
        equilibrium=at,
        basis=basis,
        weights=shapes.T * fixed.masses,
        stiffness=values[:modes],
        damping=_project(damping, shapes),
        drive=shapes.T @ axial,
        observe=fixed.observe @ shapes,
        gain=fixed.observe @ settled,
    )


def network_matrices(at: Equilibrium) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The whole network about a stable equilibrium.

    Returns:
        Forces on the free levels' coordinates by axial forces, (coordinates, modules · actuators); masses (coordinates,) in kg; stiffness
        in lower banded storage, N/m; damping (coordinates, coordinates) in N s/m.
    """
    model = at.model
    fixed = fixed_part(model)
    stiffness, damping = model.statics.matrices(at.x, at.load_case)
    return fixed.axial(at), fixed.masses, stiffness, expand_band(damping)


@dataclass(frozen=True, eq=False)
class Fixed:
    """Data that do not change with the equilibrium: masses (coordinates,) in kg, reference points by the free levels (3 · points,
    coordinates), and where the directions of the actuators' edges go in the matrix of `axial`, by segment."""

    masses: np.ndarray
    observe: np.ndarray
    actuators: int
    upper: np.ndarray
    lower: np.ndarray

    def axial(self, at: Equilibrium) -> np.ndarray:
        """Forces on the free levels' coordinates by axial forces, (coordinates, modules · actuators), column by column."""
        spans = np.diff(at.nodes, axis=0)
        spans /= np.sqrt(np.einsum("sjk,sjk->sj", spans, spans))[..., None]
        by = np.zeros((self.actuators, len(self.masses)))
        flat, along = by.reshape(-1), spans.reshape(-1)
        flat[self.upper] = along
        flat[self.lower] -= along[len(along) - len(self.lower) :]
        return by.T


@lru_cache(maxsize=8)
def fixed_part(model: CompiledModel) -> Fixed:
    """Data of a model that do not change with the equilibrium; effects on masses and points are taken without inputs."""
    layout, stepper = model.layout, model.reference_stepper
    count, block = layout.levels * layout.block, layout.block
    properties = stepper.value("properties", np.zeros(layout.inputs), np.zeros((layout.points, 3)), model.theta)
    by = stepper.jacobian("observe_by", model.rest.ravel(), model.theta)
    segment, actuator, axis = np.indices((layout.levels, layout.actuators, 3))
    upper = (segment // layout.segments * layout.actuators + actuator) * count + segment * block + 3 * actuator + axis
    return Fixed(
        masses=np.repeat(properties[stepper.mass_row], block),
        observe=np.ascontiguousarray(by[: 3 * layout.points, block : block + count]),
        actuators=layout.modules * layout.actuators,
        upper=upper.ravel(),
        lower=(upper[1:] - block).ravel(),
    )


def _exact(stiffness: np.ndarray, masses: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Squares of the lowest natural frequencies and their shapes, from the stiffness matrix in lower banded storage."""
    root = np.sqrt(masses)
    half = upper_from_band(stiffness)
    scaled = half.T / np.outer(root, root)
    values, vectors = sla.eigh(scaled, lower=True, subset_by_index=[0, count - 1], check_finite=False)
    return values, vectors / root[:, None]


def _iterate_subspace(factor: np.ndarray, masses: np.ndarray, basis: np.ndarray, modes: int) -> tuple[np.ndarray, np.ndarray] | None:
    """The same by subspace iteration from a basis with basisᵀ M basis = 1; None where it does not converge.

    The residual of a mode K φ - ω² M φ is, in the norm of 1/M, √(|c|² - ω⁴), c its coordinates in the basis before the sweep.
    """
    for _ in range(SWEEPS):
        loads = masses[:, None] * basis
        moved = _solve(factor, loads, lower=1)[0]
        values, vectors, failed = _reduced(loads.T @ moved, moved.T @ (masses[:, None] * moved))
        if failed:
            return None
        basis = moved @ vectors
        if (np.einsum("ij,ij->j", vectors, vectors)[:modes] < (1 + NEAR**2) * values[:modes] ** 2).all():
            return values, basis
    return None


def _project(band: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """shapesᵀ A shapes of a symmetric matrix A in lower banded storage."""
    half = shapes.T @ (upper_from_band(band) @ shapes)
    return half + half.T - (shapes.T * band[0]) @ shapes
