"""Small motions about an equilibrium: eigenvalues, modes with their shapes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tepm_opt.errors import InputError
from tepm_opt.solvers.linear.state_space import Linear
from tepm_opt.solvers.mechanics.statics import Equilibrium
from tepm_opt.solvers.numerics.matrices import choose_independent_columns, expand_band
from tepm_opt.solvers.numerics.text import shorten

SAME = 1e-6  # relative: eigenvalues nearer to each other belong together
STILL = 1e-9  # relative: displacements and frequencies below it are rounding errors
ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")


def state_matrix(equilibrium: Equilibrium) -> np.ndarray:
    """A of d/dt [x, v] = A [x, v] about an equilibrium, (6 · actuators · n)² in SI; x are the free levels.

    Internal states are left out (see `linearise`), so this needs no functions of motion, only those of statics.
    """
    model, P = equilibrium.model, equilibrium.properties
    stiffness = expand_band(model.reference.assemble(equilibrium.x, P, model.theta).band)
    damping = expand_band(model.reference.assemble_damping(equilibrium.x, P, model.theta))
    mass = np.repeat(P[:, model.network.property_rows["mass"]].ravel(), model.layout.block)
    zero, one = np.zeros_like(stiffness), np.eye(len(mass))
    return np.block([[zero, one], [-stiffness / mass[:, None], -damping / mass[:, None]]])


def poles(equilibrium: Equilibrium) -> np.ndarray:
    """Eigenvalues of the linearised network in 1/s, slowest first."""
    values = np.linalg.eigvals(state_matrix(equilibrium))
    return values[np.argsort(np.abs(values))]


@dataclass(frozen=True, eq=False)
class Mode:
    """A motion s(t) = Re(right · exp(value · t)) that keeps its shape; an oscillating one stands for its conjugate, too.

    Attributes:
        linear: of which; without `held` states.
        value: eigenvalue in 1/s, imaginary part ≥ 0.
        right: eigenvector, (states,); of unit and real displacement where a node goes farthest.
        left: row with left @ right = 1, by which states and inputs drive the mode, (states,).
        multiplicity: number of modes with this eigenvalue. Two is the sway of a straight arm, which has no direction of its own:
            shapes are then chosen along the axes of the base as far as they can be.
    """

    linear: Linear
    value: complex
    right: np.ndarray
    left: np.ndarray
    multiplicity: int

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        motion = f"{self.frequency:.4g} Hz, damping {self.damping:.3g}" if self.oscillates else f"{self.time_constant:.4g} s"
        return f"Mode({motion}, {shorten(self.words, 60)})"

    @property
    def oscillates(self) -> bool:
        """Whether it swings, rather than creeps back (or away)."""
        return self.value.imag > 0

    @property
    def frequency(self) -> float:
        """Frequency in Hz at which it swings; 0 where it does not."""
        return self.value.imag / (2 * np.pi)

    @property
    def damping(self) -> float:
        """Damping ratio: 1 where it does not swing, negative where it grows."""
        return -self.value.real / abs(self.value)

    @property
    def time_constant(self) -> float:
        """Time in s in which its amplitude falls by e; negative where it grows."""
        return -1.0 / self.value.real if self.value.real else np.inf

    @cached_property
    def levels(self) -> np.ndarray:
        """Displacement of levels 0 … n in the base frame at its most, (n + 1, actuators, 3); 1 where a node goes farthest."""
        layout = self.linear.equilibrium.model.layout
        moved = np.real(self.right[: self.linear.coordinates]).reshape(layout.levels, layout.actuators, 3)
        return np.concatenate([np.zeros((1, layout.actuators, 3)), moved])

    @cached_property
    def points(self) -> np.ndarray:
        """Displacement of the reference points in G at the same time, (points, 3)."""
        count = 3 * self.linear.equilibrium.model.layout.points
        return np.real(self.linear.C[:count] @ self.right).reshape(-1, 3)

    @cached_property
    def steady(self) -> np.ndarray:
        """Its part of the gain at rest, (outputs, inputs) in m/Pa and m/N; the parts of all modes add up to it."""
        part = -np.outer(self.linear.C @ self.right, self.left @ self.linear.B) / self.value
        return (2.0 if self.oscillates else 1.0) * np.real(part)

    def _share(self, kind: str) -> float:
        """Share of a kind of states in it (participation factors, Pérez-Arriaga et al., IEEE PAS-101, 1982), about 0 … 1."""
        return float(np.real(self.left * self.right)[self.linear.kinds == kind].sum())

    @cached_property
    def words(self) -> str:
        """Its shape in words."""
        shape = shape_in_words(self.linear.equilibrium, self.levels)
        if self.memory:
            return f"{self.memory}, {shape}"
        return f"sway: {shape}" if self.oscillates and shape.startswith("first bending") else shape

    @property
    def memory(self) -> str:
        """Owner of the memory, for a mode of internal states rather than of motion; empty for the others."""
        of_edges, of_inputs = self._share("edge"), self._share("input")
        return "" if of_edges + of_inputs < 0.5 else "memory of the muscles" if of_edges > of_inputs else "memory of the actuation"


def modes(linear: Linear) -> tuple[Mode, ...]:
    """All modes, slowest first; those with an eigenvalue 0 (`linear.held`) are not among them.

    Raises:
        InputError: a reduced system.
        numpy.linalg.LinAlgError: eigenvectors that do not span all motions.
    """
    if not linear.coordinates:
        raise InputError("modes: a reduced system has no motions of nodes; valid: a system of `linearise`")
    moving = linear.without_held_states()
    values, vectors = np.linalg.eig(moving.A)
    for k in np.flatnonzero((np.imag(values) > 0) & (np.imag(values) < STILL * np.abs(values))):  # one real eigenvalue, twice
        values[k : k + 2] = np.real(values[k])
        vectors[:, k : k + 2] = np.stack([np.real(vectors[:, k]), np.imag(vectors[:, k])], axis=1)
    order = [int(k) for k in np.argsort(np.abs(values), kind="stable") if np.imag(values[k]) >= 0]
    groups: list[list[int]] = []
    for k in order:
        near = groups[-1:] and abs(values[groups[-1][0]] - values[k]) < SAME * abs(values[k])
        groups[-1].append(k) if near else groups.append([k])
    shaped = [_normalise_eigenvectors(moving, vectors[:, group]) for group in groups]
    right = np.hstack(shaped)
    swings = np.array([np.imag(values[k]) > 0 for group in groups for k in group])
    left = np.linalg.inv(np.hstack([right, right[:, swings].conj()]))[: right.shape[1]]
    members = [(k, len(group)) for group in groups for k in group]
    return tuple(Mode(moving, complex(values[k]), right[:, i], left[i], count) for i, (k, count) in enumerate(members))


def _normalise_eigenvectors(linear: Linear, vectors: np.ndarray) -> np.ndarray:
    """Eigenvectors (states, multiplicity) of one eigenvalue, chosen and normalised as `Mode` says."""
    size, count = linear.coordinates, vectors.shape[1]
    x, y = vectors[:size], vectors[2 * size :]
    if count == 2 and _independent(x):
        part = np.linalg.svd(x, full_matrices=False)[0]  # orthonormal motions the pair can make: one as much along x as can be, then y
        along = np.tile(np.arange(3.0), size // 3)[:, None]
        turned = np.linalg.eigh(part.conj().T @ (along * part))[1]
        vectors = vectors @ np.linalg.lstsq(x, part @ turned, rcond=None)[0]
    elif count > 1 and len(y) and _independent(y):
        vectors = vectors @ np.linalg.inv(y[np.sort(choose_independent_columns(y.T, count))])  # an internal state each
    vectors = vectors * np.exp(-0.5j * np.angle(np.sum(vectors[:size] ** 2, axis=0)))
    x = np.real(vectors[:size])
    farthest = np.linalg.norm(x.reshape(-1, 3, count), axis=1).max(axis=0)
    most = x[np.argmax(np.abs(x).round(9), axis=0), np.arange(count)]
    whole = np.abs(vectors).max(axis=0)
    return vectors * np.where(most < 0, -1.0, 1.0) / np.where(farthest > STILL * whole, farthest, whole)


def _independent(columns: np.ndarray) -> bool:
    values = np.linalg.svd(columns, compute_uv=False)
    return bool(values[-1] > STILL * values[0])


def shape_in_words(equilibrium: Equilibrium, levels: np.ndarray) -> str:
    """A displacement of levels 0 … n in the base frame, (n + 1, actuators, 3), in words: what most of it is, and its order along the arm.

    Each level's displacement is a translation across and along the backbone, a turn about it, a tilt (bending, too), and a rest
    that deforms its ring. The order is the number of changes of sign from base to tip, plus one.
    """
    nodes = equilibrium.nodes
    centres = nodes.mean(axis=1)
    tangent = np.gradient(centres, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    moved = levels.mean(axis=1)
    along = np.einsum("ij,ij->i", moved, tangent)
    across = moved - along[:, None] * tangent
    arms, local = nodes - centres[:, None], levels - moved[:, None]
    turns = np.array([_rotation(arm, change) for arm, change in zip(arms, local, strict=True)])
    turned = np.cross(turns[:, None], arms)
    twist = np.einsum("ij,ij->i", turns, tangent)
    twisted = np.cross((twist[:, None] * tangent)[:, None], arms)
    count = levels.shape[1]
    parts = {
        "bending": count * np.sum(across**2) + np.sum((turned - twisted) ** 2),
        "lengthening": count * np.sum(along**2),
        "twist": np.sum(twisted**2),
        "ring deformation": np.sum((local - turned) ** 2),
    }
    kind = max(parts, key=lambda name: parts[name])
    if kind == "ring deformation":
        return kind
    direction = np.linalg.svd(across)[2][0]
    profile = {"bending": across @ direction, "lengthening": along, "twist": twist}[kind]
    order = _changes_of_sign(profile)
    number = ORDINALS[order] if order < len(ORDINALS) else f"{order + 1}th"
    if kind != "bending":
        return f"{number} {kind}"
    return f"{number} bending along {direction_in_words(equilibrium.model.robot.mount.rotation @ direction)}"


def _rotation(arms: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Small rotation (3,) that moves the arms (actuators, 3) most like the change."""
    cross = np.concatenate([-np.cross(arms, axis) for axis in np.eye(3)]).reshape(3, -1).T
    return np.linalg.lstsq(cross, change.ravel(), rcond=None)[0]


def _changes_of_sign(profile: np.ndarray) -> int:
    seen = profile[np.abs(profile) > 0.05 * np.abs(profile).max()]
    return int(np.sum(seen[1:] * seen[:-1] < 0))


def direction_in_words(direction: np.ndarray) -> str:
    """An axis (3,) without a sign in words: "x", "30° from x towards y" or, where it is far from level, by its components."""
    unit = direction / np.linalg.norm(direction)
    unit = unit * (1.0 if unit[np.argmax(np.abs(unit).round(9))] > 0 else -1.0)
    nearest = int(np.argmax(np.abs(unit)))
    if abs(unit[nearest]) > np.cos(np.deg2rad(8)):
        return "xyz"[nearest]
    if abs(unit[2]) < 0.3:
        angle = np.rad2deg(np.arctan2(unit[1], unit[0]))
        angle = angle - 180 if angle > 90 else angle + 180 if angle < -90 else angle
        return f"{abs(angle):.0f}° from x towards {'y' if angle > 0 else '-y'}"
    return "(" + ", ".join(f"{value + 0.0:.2f}" for value in unit.round(2)) + ")"
