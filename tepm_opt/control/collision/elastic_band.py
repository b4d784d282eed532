"""Leading a reference round obstacles before it is driven, smoothly and with the whole arm: an elastic band of axial forces.

    minimise  Σ_k |Δ_k|²_W + (τ / h)⁴ Σ_k |Δ_{k+1} − 2 Δ_k + Δ_{k−1}|²_W + ρ Σ max(0, margin − d)²      over the changes Δ of the forces

with W the tip's displacement and, far less, the forces themselves: where the arm touches and not the tip, the forces that do not move
the tip bend it away (Quinlan and Khatib, Elastic bands, ICRA 1993). Distances are linearised again at the equilibria of each iteration.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla
from scipy.interpolate import CubicSpline

from tepm_opt.control.collision.model import CollisionModel
from tepm_opt.control.references.reference import Reference
from tepm_opt.errors import InputError
from tepm_opt.models.compile import CompiledModel
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.allocation import force_range
from tepm_opt.solvers.linear.modal_model import ModalModel, modal_model
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_actuated_statics

TIP, FORCE = 1e-3, 1.0  # m and N that cost the same
STIFF = 3e3  # how much more a millimetre within the margin costs than one of the tip; likewise a newton beyond the range
SMOOTH = 0.5  # s, τ
SPACING = 0.05  # s, h: changes are cubic splines through knots that far apart
REACH = 1.5  # s before and after a touch in which forces are changed
CLOSE = 2e-4  # m by which a margin may be missed in the end
STEP = 1.5  # N, most by which a force changes in an iteration
FREE, CALMER = 6, 0.7  # iterations after which that falls, and the part it falls to
ITERATIONS, SETTLES = 30, 40


@dataclass(frozen=True, eq=False)
class _Sensed:
    """Constraints on the forces of a period: rows a·ΔF + room ≥ 0."""

    rows: np.ndarray
    room: np.ndarray


def detour(model: CompiledModel, reference: Reference, keep_out: CollisionModel, progress: Progress = silent) -> Reference:
    """The reference with every watched point out of the margins, its tips moved as little and as smoothly as that allows.

    Args:
        model: of the reference.
        reference: whatever it may touch.
        keep_out: what of.
        progress: told how far the worst stretch is.

    Raises:
        InputError: no forces within the range keep the margin; says when, how near, and to what. The way round has no equilibrium.
    """
    found = replace(reference, keep_out=keep_out, moved=np.zeros(len(reference)))
    margins = keep_out.obstacles.margins
    watched = keep_out.locate_watched_points(reference.equilibria)
    room = (keep_out.obstacles.nearest(watched.reshape(-1, 3))[0] - margins).reshape(len(reference), -1).min(axis=1)
    stretches = list(_stretches(room < 0, round(REACH / reference.step)))
    if not stretches:
        return found
    tips, forces, equilibria = reference.tips.copy(), reference.forces.copy(), list(reference.equilibria)
    for number, stretch in enumerate(stretches):
        progress("round the obstacles", number, len(stretches))
        band = _Band(model, keep_out, reference, stretch)
        band.settle()
        forces[stretch] += band.changes()
        for k in range(stretch.start, stretch.stop):
            equilibria[k] = _balance(model, forces[k], equilibria[k])
            if not equilibria[k].solved:
                raise InputError(f"keep out: at {k * reference.step:.2f} s of the way round the arm has no stable equilibrium")
            tips[k] = equilibria[k].tip
    moved = np.linalg.norm(tips - reference.tips, axis=1)
    return replace(found, tips=tips, forces=forces, equilibria=equilibria, moved=moved)


def _balance(model: CompiledModel, forces: np.ndarray, start: Equilibrium) -> Equilibrium:
    """The equilibrium of axial forces (actuators,) in N, from one nearby."""
    inputs = np.concatenate([forces / model.values["A"], np.zeros(len(forces))])
    return solve_actuated_statics(model, inputs, model.check_loads(None), start)


def _stretches(touches: np.ndarray, reach: int) -> Iterator[slice]:
    """Periods with a touch within reach, in one piece each."""
    near = (
        np.convolve(touches, np.ones(2 * reach + 1), mode="same") > 0 if len(touches) > 2 * reach else np.full(len(touches), touches.any())
    )
    edges = np.flatnonzero(np.diff(np.concatenate([[0], near.astype(int), [0]])))
    yield from (slice(int(a), int(b)) for a, b in edges.reshape(-1, 2))


class _Band:
    """One stretch of a reference that is led round obstacles, at knots `SPACING` apart; its ends join what is before and after."""

    def __init__(self, model: CompiledModel, keep_out: CollisionModel, reference: Reference, stretch: slice) -> None:
        self._model, self._keep_out, self._period = model, keep_out, reference.step
        self._stretch, self._free = stretch, (stretch.start == 0, stretch.stop == len(reference))
        apart = max(1, round(SPACING / reference.step))
        self._knots = np.arange(stretch.start, stretch.stop - 1 + apart, apart)
        at = np.minimum(self._knots, len(reference) - 1)
        self._first, self.forces = reference.forces[at], reference.forces[at].copy()
        self.equilibria = [reference.equilibria[k] for k in at]
        self._low, self._high = force_range(model, ActuationMode.HYBRID)
        self._modal: list[ModalModel] = []
        self._linearise()
        count = self.forces.shape[1]
        self._weights = np.array([(by := modal.gain[-3:] / TIP).T @ by for modal in self._modal]) + np.eye(count) / FORCE**2

    def changes(self) -> np.ndarray:
        """By what the forces of all periods of the stretch change, (periods, actuators) in N."""
        spline = CubicSpline(self._knots, self.forces - self._first)
        return spline(np.arange(self._stretch.start, self._stretch.stop))

    def settle(self) -> None:
        """Iterate until margins are kept and nothing changes any more.

        Raises:
            InputError: they are not.
        """
        most = STEP
        for k in range(ITERATIONS):
            change = self._step(most)
            most *= CALMER if k >= FREE else 1.0
            room = min(float(sensed.room.min()) for sensed in self._sensed)
            if room > -CLOSE and change < 0.05:
                return
        worst = int(np.argmin([sensed.room.min() for sensed in self._sensed]))
        if self._sensed[worst].room.min() > -CLOSE:
            return
        near = self._keep_out.nearest(self._keep_out.locate_watched_points([self.equilibria[worst]])[0])
        raise InputError(
            f"keep out: at {self._knots[worst] * self._period:.2f} s of the path no forces within the range keep the margin: "
            f"{near.point} is {1e3 * near.distance:.0f} mm from {near.obstacle!r}; valid: another path, or a smaller margin"
        )

    def _step(self, most: float) -> float:
        """One iteration, in which no force changes by more than `most` in N; the largest change."""
        wanted = self._solve_forces()
        change = wanted - self.forces
        part = min(1.0, most / max(float(np.abs(change).max()), 1e-12))
        for _ in range(6):
            found = self._solve_equilibria(self.forces + part * change)
            if found is not None:
                break
            part /= 2
        else:
            return 0.0
        self.forces, self.equilibria = self.forces + part * change, found
        self._linearise()
        return part * float(np.abs(change).max())

    def _solve_equilibria(self, forces: np.ndarray) -> list[Equilibrium] | None:
        """Equilibria of forces, each from the one before it was changed; None where one has none."""
        found = []
        for row, start in zip(forces, self.equilibria, strict=True):
            found.append(_balance(self._model, row, start))
            if not found[-1].solved:
                return None
        return found

    def _linearise(self) -> None:
        """Distances to obstacles and to the ends of the forces' range, by the forces."""
        watched, before = self._keep_out.locate_watched_points(self.equilibria), None
        self._modal, self._sensed = [], []
        for places, at in zip(watched, self.equilibria, strict=True):
            before = modal_model(at, before)
            self._modal.append(before)
            distances, normals = self._keep_out.obstacles.nearest(places)
            gain = self._keep_out.observe(before) @ (before.drive / before.stiffness[:, None])
            gain[: len(before.gain) // 3] = before.gain.reshape(-1, 3, gain.shape[-1])
            rows = np.einsum("pox,pxi->poi", normals, gain).reshape(-1, gain.shape[-1])
            room = (distances - self._keep_out.obstacles.margins).ravel()
            self._sensed.append(_Sensed(rows, room))

    def _solve_forces(self) -> np.ndarray:
        """Forces of least cost with distances as they are linearised, (periods, actuators) in N."""
        count, inputs = self.forces.shape
        shift = self.forces - self._first
        rows, room = np.array([s.rows for s in self._sensed]), np.array([s.room for s in self._sensed])
        room = room - np.einsum("kri,ki->kr", rows, shift)  # of no change at all
        rows = np.concatenate([TIP**-1 * rows, np.broadcast_to(np.eye(inputs), (count, inputs, inputs))], axis=1)
        rows = np.concatenate([rows, -np.broadcast_to(np.eye(inputs), (count, inputs, inputs))], axis=1)
        room = np.concatenate([room / TIP, self._first - self._low, self._high - self._first], axis=1)
        smooth = self._smooth(count, inputs)
        active = room + np.einsum("kri,ki->kr", rows, shift) < 0
        found = shift
        for _ in range(SETTLES):
            held = rows * active[..., None]
            blocks = self._weights + STIFF**2 * np.einsum("kri,krj->kij", held, rows)
            band = smooth.copy()
            for i in range(inputs):
                for j in range(i + 1):
                    band[i - j, j::inputs] += blocks[:, i, j]
            push = -(STIFF**2) * np.einsum("kri,kr->ki", held, room)
            found = sla.solveh_banded(band, push.ravel(), lower=True).reshape(count, inputs)
            now = room + np.einsum("kri,ki->kr", rows, found) < 0
            if (now == active).all():
                break
            active = now
        return self._first + found

    def _smooth(self, count: int, inputs: int) -> np.ndarray:
        """The cost of second differences, nothing changed before and after the stretch unless the path ends there, in lower banded
        storage."""
        weight = (SMOOTH / SPACING) ** 4 * self._weights.mean(axis=0)
        differences = np.diff(np.eye(count + 4)[:, 2:-2], 2, axis=0)[2 * self._free[0] : count + 2 - 2 * self._free[1]]
        squares = differences.T @ differences
        band = np.zeros((3 * inputs, count * inputs))
        for distance in range(min(3, count)):
            for i in range(inputs):
                for j in range(inputs):
                    if (row := distance * inputs + i - j) >= 0:
                        band[row, j : (count - distance) * inputs : inputs] += np.diagonal(squares, -distance) * weight[i, j]
        return band
