"""The equal-curvature configurations about a task as polynomials, and the axial forces that move the robot along them.

All modules have the same actuator lengths (IV.E): the three lengths z, or with more actuators what lies on the plane that z describes. So
the configurations are a family x(z) of three coordinates, smoother in the lengths than in the tip's place. A motion z(t) along it needs

    F = F_eq(z) + H(z) z'' + D(z) z' + Q(z)[z', z'],

where the last three make, in the least-squares sense of the static response, up for M x'' + C x' (inverse dynamics; Siciliano et al.,
Robotics, 2009, section 7.5). With two modules' six forces they hold the slow modes exactly and leave a little of the fast ones.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla

from tepm_opt.models.backends.interface import InverseNewton, LoadCase, Status
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.linear.modal_model import network_matrices
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_actuated_statics
from tepm_opt.solvers.numerics.text import shorten

PAIRS = tuple(itertools.combinations_with_replacement(range(3), 2))
BOX_MARGIN = 0.25  # parts of the task's size by which the box goes beyond it: the way between its ends may bulge
NEWTON = 6  # steps, of which two or three are enough where polynomials are close
MIN_BEND_MARGIN = 0.2  # rad of the whole arm's bend by which it does at least, where a length hardly changes along the task


@dataclass(frozen=True)
class FamilyFit:
    """Settings of the fit of the polynomials.

    Attributes:
        degree, nodes: total degree, and Chebyshev nodes along each length, of the configurations.
        dynamics_degree, dynamics_nodes: the same of the matrices H, D and Q and of the smallest eigenvalue.
        validation_samples: random configurations at which errors are measured.
    """

    degree: int = 5
    nodes: int = 6
    dynamics_degree: int = 3
    dynamics_nodes: int = 5
    validation_samples: int = 20


class FamilyError(RuntimeError):
    """No family about this task: some of the configurations in its box are not stable."""


class Polynomials:
    """Polynomials of y, all of one total degree, fitted to values at nodes."""

    def __init__(self, y: np.ndarray, values: np.ndarray, degree: int) -> None:
        """Least squares.

        Args:
            y: nodes, (n, 3).
            values: there, (n, columns).
            degree: total degree.
        """
        self.exponents = np.array([e for e in itertools.product(range(degree + 1), repeat=3) if sum(e) <= degree])
        self.coefficients = np.linalg.lstsq(self._basis(y), values, rcond=None)[0]

    def __call__(self, y: np.ndarray, *by: int) -> np.ndarray:
        """Values at y (n, 3), or their derivatives by some of its coordinates one after another, (n, columns)."""
        return self._basis(y, by) @ self.coefficients

    def slopes(self, y: np.ndarray) -> np.ndarray:
        """Derivatives by y at y (n, 3), (n, columns, 3)."""
        return np.stack([self(y, k) for k in range(3)], axis=2)

    def _basis(self, y: np.ndarray, by: tuple[int, ...] = ()) -> np.ndarray:
        """Monomials, or derivatives of them, (n, terms)."""
        powers, factor = self.exponents.copy(), np.ones(len(self.exponents))
        for k in by:
            factor *= powers[:, k]
            powers[:, k] = np.maximum(powers[:, k] - 1, 0)
        steps = y[:, :, None] ** np.arange(powers.max() + 1)
        return factor * steps[:, 0, powers[:, 0]] * steps[:, 1, powers[:, 1]] * steps[:, 2, powers[:, 2]]


@dataclass(frozen=True, eq=False)
class Family:
    """Configurations of equal curvature about a task; y in -1 … 1 are the lengths in their box.

    Attributes:
        model: of which.
        low, high: the box of z, (3,) in m, see `plane`.
        middle: equilibrium in its middle.
        forces: y to F_eq, (modules · 3,) in N.
        points: y to the reference points in G, (3 · points,) in m.
        maps: y to [H, D, Q], (modules · 3, 3 + 3 + 6) row by row.
        stability: y to the smallest eigenvalue of the stiffness in N/m; where it was asked for.
        point_error, force_error: largest errors of the polynomials in the box, as measured, in m and N.
    """

    model: CompiledModel
    low: np.ndarray
    high: np.ndarray
    middle: Equilibrium
    forces: Polynomials
    points: Polynomials
    maps: Polynomials
    stability: Polynomials | None
    point_error: float
    force_error: float

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        errors = f"points within {1e3 * self.point_error:.2g} mm, forces within {self.force_error:.2g} N"
        return f"Family({shorten(self.model.robot.name, 40)}, {errors})"

    def normalise(self, lengths: np.ndarray) -> np.ndarray:
        """Scale coordinates z (…, 3) in m to y, which is −1 … 1 over their range."""
        return (2 * lengths - self.low - self.high) / (self.high - self.low)

    def compute_motion_forces(self, y: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Axial forces F (n, modules · 3) in N of motions y, y', y'' (n, 3) each, and their derivatives by all nine, (n, modules · 3, 9).

        Primes are derivatives by time in s.
        """
        n, first = len(y), [(i, j) for i, j in PAIRS]
        squares = np.stack([(1 if i == j else 2) * v[:, i] * v[:, j] for i, j in first], axis=1)
        by = np.hstack([a, v, squares])
        maps = self.maps(y).reshape(n, -1, by.shape[1])
        forces = self.forces(y) + np.einsum("nfk,nk->nf", maps, by)
        of_squares = np.zeros((n, len(first), 3))
        for k, (i, j) in enumerate(first):
            of_squares[:, k, i] += 2 * v[:, j]
            of_squares[:, k, j] += 2 * v[:, i] if i != j else 0.0
        slopes = np.empty((*forces.shape, 9))
        slopes[..., :3] = self.forces.slopes(y)
        for k in range(3):
            slopes[..., k] += np.einsum("nfk,nk->nf", self.maps(y, k).reshape(maps.shape), by)
        slopes[..., 3:6] = maps[..., 3:6] + maps[..., 6:] @ of_squares
        slopes[..., 6:] = maps[..., :3]
        return forces, slopes

    def reach_targets(self, targets: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Coordinates y (n, 3) near the given ones at which the polynomials' tip is at targets (n, 3) in m, by Newton's method."""
        for _ in range(NEWTON):
            slopes = self.points.slopes(y)[:, -3:]
            y = y + np.linalg.solve(slopes, (targets - self.points(y)[:, -3:])[..., None])[..., 0]
        return y

    def exact(self, y: np.ndarray, start: Equilibrium | None = None) -> Equilibrium:
        """The equilibrium itself.

        Raises:
            FamilyError: there is none.
        """
        return _exact(self.model, (self.low + self.high + y * (self.high - self.low)) / 2, start or self.middle)


def axial(at: Equilibrium) -> np.ndarray:
    """Axial forces (modules · 3,) in N that hold an equilibrium of the family."""
    return at.inputs[: at.model.layout.inputs // 2] * at.model.values["A"]


def plane(model: CompiledModel) -> np.ndarray:
    """Lengths of a module's actuators over z, (actuators, 3): z itself with three, else a mean and what is more along x and along y."""
    angles = np.array(model.layout.angles)
    return np.eye(3) if len(angles) == 3 else np.stack([np.ones_like(angles), np.cos(angles), np.sin(angles)], axis=1)


def coordinates(model: CompiledModel, lengths: np.ndarray) -> np.ndarray:
    """Coordinates z (…, 3) in m of lengths (…, actuators), by least squares where there are more than three."""
    return lengths if model.layout.actuators == 3 else lengths @ np.linalg.pinv(plane(model)).T


def _exact(model: CompiledModel, z: np.ndarray, start: Equilibrium) -> Equilibrium:
    lengths = plane(model) @ z
    half, observed = model.layout.inputs // 2, 3 * model.layout.points
    weights = np.hstack([np.zeros((half, observed)), np.eye(half)])
    targets, area = np.tile(lengths, model.layout.modules), model.values["A"]
    case = LoadCase(start.inputs, True, np.zeros(observed), model.theta)
    status, x, pressures, _ = model.statics.inverse(start.x, case, weights, targets, InverseNewton(8.0 / area, 1e-10, 1e-9, 40))
    if status == Status.SOLVED:
        effective = np.concatenate([pressures, np.zeros(half)])
        found = solve_actuated_statics(model, effective, np.zeros((observed // 3, 3)), replace(start, x=x))
        if found.solved and np.abs(found.lengths - lengths).max() < 1e-7:
            return found
    raise FamilyError(f"no stable configuration of equal curvature with lengths of {', '.join(f'{1e3 * v:.1f}' for v in lengths)} mm")


def _nodes(count: int) -> np.ndarray:
    along = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    return np.array(list(itertools.product(along, repeat=3)))


def make_family(model: CompiledModel, lengths: np.ndarray, start: Equilibrium, fit: FamilyFit, stability: bool = False) -> Family:
    """The family in a box about the lengths of a task.

    Args:
        model: compiled model.
        lengths: coordinates z of the modules along the task, (n, 3) in m.
        start: an equilibrium nearby.
        fit: degrees and nodes of the polynomials.
        stability: whether the smallest eigenvalue is needed, which takes longest.

    Raises:
        FamilyError: some configurations of the box do not exist.
    """
    low, high = lengths.min(axis=0), lengths.max(axis=0)
    pad = np.maximum(BOX_MARGIN * (high - low), MIN_BEND_MARGIN * model.values["r"] / model.layout.modules)
    low, high = low - pad, high + pad
    half, middle = (high - low) / 2, _exact(model, (low + high) / 2, start)

    def solve_rows(y: np.ndarray) -> list[Equilibrium]:
        return [_exact(model, (low + high) / 2 + half * row, middle) for row in y]

    y, slow = _nodes(fit.nodes), _nodes(fit.dynamics_nodes)
    found, slow_found = solve_rows(y), solve_rows(slow)
    forces = Polynomials(y, np.array([axial(at) for at in found]), fit.degree)
    points = Polynomials(y, np.array([at.points.ravel() for at in found]), fit.degree)
    levels = Polynomials(y, np.array([at.x[1:].ravel() for at in found]), fit.degree)
    first, second = levels.slopes(slow), np.stack([levels(slow, *pair) for pair in PAIRS], axis=2)
    maps = np.array([_maps(at, a, b) for at, a, b in zip(slow_found, first, second, strict=True)])
    moving = Polynomials(slow, maps.reshape(len(maps), -1), fit.dynamics_degree)
    margin = Polynomials(slow, np.array([[at.smallest_eigenvalue] for at in slow_found]), fit.dynamics_degree) if stability else None
    checks = np.random.default_rng(0).uniform(-1.0, 1.0, (fit.validation_samples, 3))
    at = solve_rows(checks)
    errors = [
        float(np.abs(fitted(checks) - exact).max())
        for fitted, exact in ((points, np.array([e.points.ravel() for e in at])), (forces, np.array([axial(e) for e in at])))
    ]
    return Family(model, low, high, middle, forces, points, moving, margin, *errors)


def _maps(at: Equilibrium, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """[H, D, Q] at an equilibrium, (modules · 3, 3 + 3 + 6), from dx/dy (coordinates, 3) and d²x/dy² (coordinates, 6).

    What M x'' + C x' would move at rest is what the forces have to move back, in the least squares weighted by the masses.
    """
    by_forces, masses, stiffness, damping = network_matrices(at)
    needed = np.hstack([masses[:, None] * first, damping @ first, masses[:, None] * second])
    moved = sla.solveh_banded(stiffness, np.hstack([by_forces, needed]), lower=True, check_finite=False)
    moved *= np.sqrt(masses)[:, None]
    driven = by_forces.shape[1]
    return np.linalg.lstsq(moved[:, :driven], moved[:, driven:], rcond=None)[0]
