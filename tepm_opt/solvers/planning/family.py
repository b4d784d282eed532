"""The equal-curvature configurations about a task as polynomials, and the axial forces that move the robot along them.

All modules have the same three actuator lengths z (IV.E), so the configurations are a family x(z) of three coordinates, smoother in the
lengths than in the tip's place. A motion z(t) along it needs

    F = F_eq(z) + H(z) z'' + D(z) z' + Q(z)[z', z'],

where the last three make, in the least-squares sense of the static response, up for M x'' + C x' (inverse dynamics; Siciliano et al.,
Robotics, 2009, section 7.5). With six forces they hold the slow modes exactly and leave a little of the fast ones.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from tepm_opt.models.backends.interface import Status
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.modal_model import modal_model
from tepm_opt.solvers.statics import Equilibrium, equilibrium
from tepm_opt.solvers.text import shortened

PAIRS = tuple(itertools.combinations_with_replacement(range(3), 2))
MODES = 30  # of the network, the slowest, that count in the least squares: softer ones count more, stiffer ones hardly move
BOX_MARGIN = 0.25  # parts of the task's size by which the box goes beyond it: the way between its ends may bulge
MIN_BOX_MARGIN = 0.004  # m by which it does at least, where a length hardly changes along the task


@dataclass(frozen=True)
class FamilyFit:
    """How the polynomials are made.

    Attributes:
        degree, nodes: total degree, and Chebyshev nodes along each length, of the configurations.
        dynamics_degree, dynamics_nodes: the same of the matrices H, D and Q and of the smallest eigenvalue.
        validation_samples: random configurations at which errors are measured.
    """

    degree: int = 5
    nodes: int = 7
    dynamics_degree: int = 3
    dynamics_nodes: int = 5
    validation_samples: int = 60


class FamilyError(RuntimeError):
    """No family about this task: some of the configurations in its box are not stable."""


@dataclass(frozen=True, eq=False)
class Family:
    """Configurations of equal curvature about a task; y in -1 … 1 are the lengths in their box.

    Attributes:
        model: of which.
        low, high: the box of lengths, (3,) in m.
        middle: equilibrium in its middle.
        forces: y to F_eq, (modules · 3,) in N.
        points: y to the reference points in G, (3 · points,) in m.
        moving: y, y', y'' to F, (modules · 3,) in N; primes are derivatives by time in s.
        stability: y to the smallest eigenvalue of the stiffness in N/m.
        point_error, force_error, stability_error: largest errors of the polynomials in the box, as measured, in m, N and N/m.
    """

    model: CompiledModel
    low: np.ndarray
    high: np.ndarray
    middle: Equilibrium
    forces: ca.Function
    points: ca.Function
    moving: ca.Function
    stability: ca.Function
    point_error: float
    force_error: float
    stability_error: float

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        errors = f"points within {1e3 * self.point_error:.2g} mm, forces within {self.force_error:.2g} N"
        return f"Family({shortened(self.model.robot.name, 40)}, {errors})"

    def within(self, lengths: np.ndarray) -> np.ndarray:
        """Lengths (…, 3) in m as y."""
        return (2 * lengths - self.low - self.high) / (self.high - self.low)

    def exact(self, y: np.ndarray, start: Equilibrium | None = None) -> Equilibrium:
        """The equilibrium itself.

        Raises:
            FamilyError: there is none.
        """
        return _exact(self.model, (self.low + self.high + y * (self.high - self.low)) / 2, start or self.middle)


def axial(at: Equilibrium) -> np.ndarray:
    """Axial forces (modules · 3,) in N that hold an equilibrium of the family."""
    return at.inputs[: at.model.layout.inputs // 2] * at.model.values["A"]


def _exact(model: CompiledModel, lengths: np.ndarray, start: Equilibrium) -> Equilibrium:
    half, observed = model.layout.inputs // 2, 3 * model.layout.points
    weights = np.hstack([np.zeros((half, observed)), np.eye(half)])
    targets, area = np.tile(lengths, model.layout.modules), model.values["A"]
    status, x, pressures, _ = model.statics.inverse(
        start.x, start.inputs[:half], np.zeros(observed), model.theta, weights, targets, 8.0 / area, 1e-10, 1e-9, 40
    )
    if status == Status.SOLVED:
        effective = np.concatenate([pressures, np.zeros(half)])
        found = equilibrium(model, effective, np.zeros((observed // 3, 3)), replace(start, x=x), mapped=True, explain=False)
        if found.solved and np.abs(found.lengths - lengths).max() < 1e-7:
            return found
    raise FamilyError(f"no stable configuration of equal curvature with lengths of {', '.join(f'{1e3 * v:.1f}' for v in lengths)} mm")


def _exponents(degree: int) -> np.ndarray:
    return np.array([e for e in itertools.product(range(degree + 1), repeat=3) if sum(e) <= degree])


def _basis(y: np.ndarray, exponents: np.ndarray, by: tuple[int, ...] = ()) -> np.ndarray:
    """Monomials of y (rows, 3), or their derivatives by some of the coordinates, (rows, terms)."""
    powers, factor = exponents.copy(), np.ones(len(exponents))
    for k in by:
        factor *= powers[:, k]
        powers[:, k] = np.maximum(powers[:, k] - 1, 0)
    return factor * np.prod(y[:, None] ** powers, axis=2)


def _nodes(count: int) -> np.ndarray:
    along = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    return np.array(list(itertools.product(along, repeat=3)))


def _fitted(y: np.ndarray, values: np.ndarray, degree: int) -> np.ndarray:
    return np.linalg.lstsq(_basis(y, _exponents(degree)), values, rcond=None)[0]


def _polynomial(y: ca.SX, coefficients: np.ndarray, degree: int) -> ca.SX:
    """Symbolic value of fitted polynomials, (columns,)."""
    powers = [[ca.SX(1), y[k]] for k in range(3)]
    for row in powers:
        for _ in range(degree - 1):
            row.append(row[-1] * row[1])
    terms = ca.vertcat(*[powers[0][i] * powers[1][j] * powers[2][k] for i, j, k in _exponents(degree)])
    return ca.mtimes(ca.DM(coefficients.T), terms)


def make_family(model: CompiledModel, lengths: np.ndarray, start: Equilibrium, fit: FamilyFit) -> Family:
    """The family in a box about the lengths of a task.

    Args:
        model: compiled model.
        lengths: actuator lengths of the modules along the task, (n, 3) in m.
        start: an equilibrium nearby.
        fit: degrees and nodes of the polynomials.

    Raises:
        FamilyError: some configurations of the box do not exist.
    """
    low, high = lengths.min(axis=0), lengths.max(axis=0)
    pad = np.maximum(BOX_MARGIN * (high - low), MIN_BOX_MARGIN)
    low, high = low - pad, high + pad
    half, middle = (high - low) / 2, _exact(model, (low + high) / 2, start)

    def solved(y: np.ndarray) -> list[Equilibrium]:
        return [_exact(model, (low + high) / 2 + half * row, middle) for row in y]

    y, degree = _nodes(fit.nodes), fit.degree
    found = solved(y)
    forces = _fitted(y, np.array([axial(at) for at in found]), degree)
    points = _fitted(y, np.array([at.points.ravel() for at in found]), degree)
    levels = _fitted(y, np.array([at.x[1:].ravel() for at in found]), degree)

    y_slow = _nodes(fit.dynamics_nodes)
    first = np.stack([_basis(y_slow, _exponents(degree), (k,)) @ levels for k in range(3)], axis=2)
    second = np.stack([_basis(y_slow, _exponents(degree), pair) @ levels for pair in PAIRS], axis=2)
    slow_found = solved(y_slow)
    maps = np.array([_maps(at, a, b) for at, a, b in zip(slow_found, first, second, strict=True)])
    moving = _fitted(y_slow, maps.reshape(len(maps), -1), fit.dynamics_degree)
    stability = _fitted(y_slow, np.array([[at.smallest_eigenvalue] for at in slow_found]), fit.dynamics_degree)

    place, speed, change = ca.SX.sym("y", 3), ca.SX.sym("v", 3), ca.SX.sym("a", 3)
    squares = ca.vertcat(*[(1 if i == j else 2) * speed[i] * speed[j] for i, j in PAIRS])
    held = _polynomial(place, forces, degree)
    matrix = ca.reshape(_polynomial(place, moving, fit.dynamics_degree), 3 + 3 + len(PAIRS), -1).T
    functions = (
        ca.Function("forces", [place], [held]),
        ca.Function("points", [place], [_polynomial(place, points, degree)]),
        ca.Function("moving", [place, speed, change], [held + ca.mtimes(matrix, ca.vertcat(change, speed, squares))]),
        ca.Function("stability", [place], [_polynomial(place, stability, fit.dynamics_degree)]),
    )
    checks = np.random.default_rng(0).uniform(-1.0, 1.0, (fit.validation_samples, 3))
    at = solved(checks)
    errors = [
        float(np.abs(np.array([np.asarray(function(row)).ravel() - exact for row, exact in zip(checks, exacts, strict=True)])).max())
        for function, exacts in (
            (functions[1], [e.points.ravel() for e in at]),
            (functions[0], [axial(e) for e in at]),
            (functions[3], [e.smallest_eigenvalue for e in at]),
        )
    ]
    return Family(model, low, high, middle, *functions, *errors)


def _maps(at: Equilibrium, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """[H, D, Q] at an equilibrium, (modules · 3, 3 + 3 + 6), from dx/dy (coordinates, 3) and d²x/dy² (coordinates, 6)."""
    local = modal_model(at, modes=min(MODES, len(first)))
    inertia, curvature = local.weights @ first, local.weights @ second
    needed = np.hstack([inertia, local.damping @ inertia, curvature])
    softness = 1 / local.stiffness[:, None]
    return np.linalg.lstsq(softness * local.drive, softness * needed, rcond=None)[0]
