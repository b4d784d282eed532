"""Offline: the motion and the unknown forces of a recorded run, from all of its samples, before and after.

A moving-horizon estimator whose horizon is the run, or a window of it: the states s and disturbances w that minimise

    |s_0 − s̄|²_P⁻¹ + Σ |w_k|² + Σ |z_k − C s_k|² / σ²     with     s_{k+1} = A_k s_k + u_k + G_k w_k     and friction ≥ 0,

with model, noise and outliers as the Kalman filter has them, which runs ahead and linearises. A sparse quadratic program: its optimality
conditions are solved directly, the bounds by a primal-dual active set (Hintermüller, Ito, Kunisch, SIAM J. Optim. 13, 2003). Without
active bounds it is the Rauch-Tung-Striebel smoother. Rao, Rawlings, Mayne, IEEE TAC 48 (2003), p. 246.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from tepm_opt.control.estimator import DEFAULT, Estimator, FilterSettings, Operating, Transition
from tepm_opt.control.loop import LoopRecord
from tepm_opt.errors import InputError
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.solvers.modal_model import modal_model

SETS = 40  # active sets that are tried


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """What is known of a run, a control period apart.

    Attributes:
        operating: about which it is linearised, one a sample.
        points: tracked, (samples, points, 3) in m in G; NaN where lost.
        forces: known axial forces, linear between samples, (samples, actuators) in N.
        tensions: at the motors, (samples, actuators) in N.
        rates: of the actuators' lengths from each sample to the next, as the reference has them, (samples − 1, actuators) in m/s.
    """

    operating: Sequence[Operating]
    points: np.ndarray
    forces: np.ndarray
    tensions: np.ndarray
    rates: np.ndarray

    def __repr__(self) -> str:
        lost = int((~np.isfinite(self.points).all(axis=2)).sum())
        return f"RecordedMotion(samples={len(self.operating)}, points lost={lost})"

    @staticmethod
    def of(done: LoopRecord, area: float) -> RecordedMotion:
        """A closed loop, linearised about its reference, with pressures and tensions as measured; area of a muscle in m².

        Raises:
            InputError: fewer than two samples, a period without a sample, or inputs that were not measured.
        """
        rows, inputs, reference = np.array(done.rows, dtype=int), np.array(done.measured), done.reference
        if len(rows) < 2 or (np.diff(rows) != 1).any() or not np.isfinite(inputs).all():
            raise InputError("run: valid: one with a sample in every period, at least 2, and measured inputs")
        pressures, tensions = np.split(inputs, 2, axis=1)
        rates = np.diff(reference.lengths[rows], axis=0) / reference.period
        operating, before = [], None
        for row in rows:
            before = modal_model(reference.equilibria[row], before)
            operating.append(Operating.of(before, reference.forces[row], reference.period))
        return RecordedMotion(operating, np.array(done.points), area * pressures - tensions, tensions, rates)

    def between(self, start: int, end: int) -> RecordedMotion:
        """A window from one sample to another, which is left out."""
        part = slice(start, end)
        return RecordedMotion(self.operating[part], self.points[part], self.forces[part], self.tensions[part], self.rates[start : end - 1])


@dataclass(frozen=True, eq=False)
class Smoothed:
    """The arm at every sample.

    Attributes:
        motion: [q, q'] about the sample's operating point, (samples, 2 · modes).
        unknown: axial forces that nobody commanded, (samples, actuators) in N.
        strength: by what part of p A the muscles pull more, (samples, actuators).
        friction: of the muscles, (samples, actuators) in N, not negative.
        hysteresis: of the muscles, half of it, (samples, actuators) in N.
        bias: of the reference points, (samples, points, 3) in m.
        points: where they are, bias included, (samples, points, 3) in m in G.
        filtered: where the filter had them, (samples, points, 3) in m in G.
        outcome: whether the active set was found.
    """

    motion: np.ndarray
    unknown: np.ndarray
    strength: np.ndarray
    friction: np.ndarray
    hysteresis: np.ndarray
    bias: np.ndarray
    points: np.ndarray
    filtered: np.ndarray
    outcome: Outcome

    @property
    def solved(self) -> bool:
        """Whether the active set was found."""
        return self.outcome.solved

    def __repr__(self) -> str:
        return f"Smoothed({self.outcome}, samples={len(self.motion)})"


def smooth(recorded: RecordedMotion, noise: float, middle: float, settings: FilterSettings = DEFAULT, bounded: bool = True) -> Smoothed:
    """Smooth a run or a window.

    Args:
        recorded: what is known.
        noise, middle, settings: as for `Estimator`.
        bounded: whether friction cannot be negative.

    Raises:
        InputError: shapes that do not fit.
    """
    count = len(recorded.operating)
    points, drive = recorded.operating[0].model.equilibrium.points.shape, recorded.operating[0].model.drive
    given = [np.shape(part) for part in (recorded.points, recorded.forces, recorded.tensions, recorded.rates)]
    modes, actuators = drive.shape
    wanted = [(count, *points), (count, actuators), (count, actuators), (count - 1, actuators)]
    if given != wanted or count < 2:
        raise InputError(f"recorded: shapes {given}; valid: {wanted}, at least 2 samples")
    size = 2 * modes + 4 * actuators + recorded.points[0].size
    filtered = Estimator(recorded.operating[0], noise, middle, settings)
    scale, first = np.sqrt(np.diag(filtered.covariance)), filtered.mean
    hessian, pull, moved, seen = [], [], [], []
    for k, operating in enumerate(recorded.operating):
        if k:
            moved.append(filtered.predict(recorded.forces[k - 1 : k + 1], recorded.tensions[k - 1], recorded.rates[k - 1], operating))
        estimate = filtered.update(recorded.points[k])
        seen.append(estimate.points)
        good = np.isfinite(recorded.points[k]).all(axis=1) & ~estimate.refused
        C = np.hstack([operating.model.observe, np.zeros((len(good) * 3, size - modes - 3 * len(good))), np.eye(3 * len(good))])
        C = C[np.repeat(good, 3)] / noise
        off = (recorded.points[k] - operating.model.equilibrium.points)[good].ravel() / noise
        hessian.append(C.T @ C + (np.diag(scale**-2.0) if k == 0 else 0.0))
        pull.append(C.T @ off + (first / scale**2 if k == 0 else 0.0))
    states, solved = _minimised(hessian, pull, moved, scale, slice(2 * modes + 2 * actuators, 2 * modes + 3 * actuators), bounded)
    motion, unknown, strength, friction, hysteresis, bias = np.split(states, 2 * modes + actuators * np.arange(5), axis=1)
    models = [operating.model for operating in recorded.operating]
    at = [model.equilibrium.points.ravel() + model.observe @ q[:modes] for model, q in zip(models, motion, strict=True)]
    there, bias = (np.array(at) + bias).reshape(count, *points), bias.reshape(count, *points)
    outcome = Outcome(Ending.SOLVED) if solved else Outcome(Ending.NOT_CONVERGED, f"no active set after {SETS} tries")
    return Smoothed(motion, unknown, strength, friction, hysteresis, bias, there, np.array(seen), outcome)


def _minimised(
    hessian: list[np.ndarray], pull: list[np.ndarray], moved: list[Transition], scale: np.ndarray, bounded_part: slice, bounded: bool
) -> tuple[np.ndarray, bool]:
    """States (samples, states) and whether the active set was found; unknowns are [s / scale, w] and multipliers of the motion."""
    count, size, kicks = len(hessian), len(scale), moved[0].kick.shape[1]
    H = sp.block_diag([scale[:, None] * part * scale for part in hessian] + [sp.eye_array(kicks * (count - 1))])
    f = np.concatenate([scale * part for part in pull] + [np.zeros(kicks * (count - 1))])
    along = sp.block_diag([one.A * scale / scale[:, None] for one in moved])
    stay = sp.eye_array(size * (count - 1))
    empty = sp.csr_array((size * (count - 1), size))
    motion = sp.hstack([empty, stay]) - sp.hstack([along, empty])
    R = sp.hstack([motion, -sp.block_diag([one.kick / scale[:, None] for one in moved])])
    right = np.concatenate([one.push / scale for one in moved])
    whole, target = sp.csr_array(sp.block_array([[H, R.T], [R, None]])), np.concatenate([f, right])
    inside = (size * np.arange(count)[:, None] + np.arange(size)[bounded_part]).ravel()
    fixed, x = np.zeros(len(target), dtype=bool), np.zeros(len(target))
    for _ in range(SETS):
        x[fixed] = 0.0
        x[~fixed] = splu(whole[~fixed][:, ~fixed].tocsc()).solve(target[~fixed])
        wrong = np.zeros(len(target), dtype=bool)
        if bounded:
            pressed = (whole[inside] @ x - target[inside]) > 0
            wrong[inside] = np.where(fixed[inside], ~pressed, x[inside] < -1e-9)
        if not wrong.any():
            return x[: size * count].reshape(count, size) * scale, True
        fixed ^= wrong
    return x[: size * count].reshape(count, size) * scale, False
