"""The loops of statics.c in Python on CasADi's virtual machine: the reference for the C ones, and what runs without a compiler."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import scipy.linalg as sla

from tepm_opt.models.backends.interface import ENERGY_NOISE, PLAIN_NEWTON, LoadCase, Solution, Status
from tepm_opt.models.backends.rotations import move
from tepm_opt.models.network import ROWS, Network


@dataclass(frozen=True)
class Assembly:
    """Energy, force (levels 1 … n) and stiffness of the free levels in lower banded storage, with its coupling to level 0."""

    energy: float
    force: np.ndarray
    band: np.ndarray
    base_coupling: np.ndarray


def assemble_band(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Assemble lower banded storage (2 · block, n · block) from segments' block columns (n, 2 · block, block), (n, block, block)."""
    count, block = len(first), first.shape[2]
    band = np.zeros((2 * block, count * block))
    diagonal = second.copy()
    diagonal[:-1] += first[1:, :block]
    for column in range(block):
        at = slice(column, None, block)
        band[: block - column, at] = diagonal[:, column:, column].T
        band[block - column : 2 * block - column, column : (count - 1) * block : block] = first[1:, block:, column].T
    return band


class PythonStatics:
    """Reference backend."""

    def __init__(self, network: Network) -> None:
        self.network = network

    @cached_property
    def _mapped(self) -> dict[str, ca.Function]:
        n = self.network.layout.levels
        names = [name for name in self.network.functions if name.startswith("segment_")]
        return {name: self.network.functions[name].map(n) for name in names}

    def _call(self, name: str, *arguments: np.ndarray) -> list[np.ndarray]:
        function = self._mapped.get(name) or self.network.functions[name]
        results = function.call([ca.DM(np.asarray(argument).T if np.ndim(argument) == 2 else argument) for argument in arguments])
        return [np.array(result) for result in results]

    def actuation(self, u: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """See `StaticsBackend.actuation`."""
        return self._call("input_map", u, theta)[0].ravel()

    def prepare(self, u: np.ndarray, mapped: bool, external: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Effective actuation (inputs,), properties (n, rows) and level 0 (block,).

        Args:
            u: inputs, (inputs,) in Pa and N.
            mapped: whether `u` is already the effective actuation behind the effects' input maps.
            external: forces on the points in G, (3 · points,) in N.
            theta: parameters, (parameters,) in SI.
        """
        a = u if mapped else self.actuation(u, theta)
        columns, level_0 = self._call("properties", a, external.reshape(-1, 3), theta)
        return a, np.ascontiguousarray(columns.T), level_0.ravel()

    def energy(self, x: np.ndarray, P: np.ndarray, theta: np.ndarray) -> float:
        """Potential Π in J."""
        return float(self._call("segment_energy", x[:-1], x[1:], P, self._repeat(theta))[0].sum())

    def _repeat(self, theta: np.ndarray) -> np.ndarray:
        return np.broadcast_to(theta, (self.network.layout.levels, len(theta)))

    def assemble(self, x: np.ndarray, P: np.ndarray, theta: np.ndarray, convex: bool = False) -> Assembly:
        """Energy, force and stiffness at x.

        Args:
            x: levels, (n + 1, block) in m.
            P: properties, (n, rows).
            theta: parameters, (parameters,) in SI.
            convex: whether to leave out the geometric stiffness of compressed edges, so that the stiffness is positive definite.
        """
        n, block = self.network.layout.levels, self.network.layout.block
        name = "segment_convex" if convex else "segment_stiffness"
        energy, force, first, second = self._call(name, x[:-1], x[1:], P, self._repeat(theta))
        first, second = first.reshape(2 * block, n, block).transpose(1, 0, 2), second.reshape(block, n, block).transpose(1, 0, 2)
        total = force.T[:, block:].copy()
        total[:-1] += force.T[1:, :block]
        return Assembly(float(energy.sum()), total, assemble_band(first, second), first[0, block:])

    def assemble_damping(self, x: np.ndarray, P: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Assemble the damping matrix of the free levels at x in lower banded storage."""
        n, block = self.network.layout.levels, self.network.layout.block
        first, second = self._call("segment_damping", x[:-1], x[1:], P, self._repeat(theta))
        return assemble_band(first.reshape(2 * block, n, block).transpose(1, 0, 2), second.reshape(block, n, block).transpose(1, 0, 2))

    def _factor_safely(self, at: Assembly, x: np.ndarray, P: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, bool]:
        try:
            return sla.cholesky_banded(at.band, lower=True), False
        except np.linalg.LinAlgError:
            band, shift = self.assemble(x, P, theta, convex=True).band, 1e-6
        while True:
            try:
                shifted = band.copy()
                shifted[0] += shift
                return sla.cholesky_banded(shifted, lower=True), True
            except np.linalg.LinAlgError:
                shift *= 100
                if shift > 1e12:
                    raise

    def statics(self, x: np.ndarray, case: LoadCase, tolerance: float, max_iterations: int) -> Solution:
        """See `StaticsBackend.statics`; the algorithm is described in docs/explanation/architecture.md."""
        status, x, *info = self._newton(x, *self.prepare(*case)[1:], case.theta, tolerance, max_iterations)
        return Solution(status, x, self.observe(x, case.theta), *info)

    def observe(self, x: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Reference points in G and actuator lengths (3 · points + lengths,) of levels x."""
        return np.concatenate([result.ravel() for result in self._call("observe", x.ravel(), theta)])

    def edges(self, x: np.ndarray, P: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Axial force (pulling positive) and length of every edge, (n, edges) each."""
        force, length = self._call("segment_edges", x[:-1], x[1:], P, self._repeat(theta))
        return force.T, length.T

    def _newton(
        self, x: np.ndarray, P: np.ndarray, level_0: np.ndarray, theta: np.ndarray, tolerance: float, max_iterations: int
    ) -> tuple[Status, np.ndarray, int, float, float]:
        x = np.concatenate([level_0[None], x[1:]])
        at = self.assemble(x, P, theta)
        for iteration in range(max_iterations + 1):
            largest = float(np.abs(at.force).max())
            if not largest < 1e300:
                return Status.STALLED, x, iteration, largest, at.energy
            factor, indefinite = self._factor_safely(at, x, P, theta)
            if largest < tolerance:
                return (Status.UNSTABLE if indefinite else Status.SOLVED), x, iteration, largest, at.energy
            step = np.zeros_like(x)
            step[1:] = sla.cho_solve_banded((factor, True), -at.force.ravel()).reshape(at.force.shape)
            plain = not indefinite and largest < PLAIN_NEWTON
            moved = x + step if plain else self._search(x, step, at, P, theta)
            if moved is None:
                return Status.STALLED, x, iteration, largest, at.energy
            x, at = moved, self.assemble(moved, P, theta)
            largest = float(np.abs(at.force).max())
            if plain and largest < tolerance:  # stable: so was the factor a step before
                return Status.SOLVED, x, iteration + 1, largest, at.energy
        return Status.EXHAUSTED, x, max_iterations, float(np.abs(at.force).max()), at.energy

    def _search(self, x: np.ndarray, step: np.ndarray, at: Assembly, P: np.ndarray, theta: np.ndarray) -> np.ndarray | None:
        """Rotation-aware line search on the energy (Armijo); None where no length of the step lowers it."""
        slope, t = float(at.force.ravel() @ step[1:].ravel()), 1.0
        for _ in range(40):
            trial = move(x, t * step)
            there = self.energy(trial, P, theta)
            if there <= at.energy + 1e-4 * t * slope + ENERGY_NOISE * (1 + abs(at.energy)):
                return trial
            shorter = -slope * t * t / 2 / (there - at.energy - slope * t)
            t = min(max(shorter, 0.1 * t), 0.5 * t) if shorter > 0 else 0.1 * t
        return None

    def sensitivity(
        self, x: np.ndarray, case: LoadCase, weights: np.ndarray, by_theta: bool
    ) -> tuple[Status, np.ndarray, np.ndarray, np.ndarray | None]:
        """See `StaticsBackend.sensitivity`: one factorisation, one adjoint solve a row."""
        layout, (u, mapped, external, theta) = self.network.layout, case
        a, P, level_0 = self.prepare(*case)
        x = np.concatenate([level_0[None], x[1:]])
        at = self.assemble(x, P, theta)
        shapes = (len(u), external.size, len(theta))
        results = [np.zeros((len(weights), size)) for size in shapes]
        try:
            factor = sla.cholesky_banded(at.band, lower=True)
        except np.linalg.LinAlgError:
            return Status.INDEFINITE, results[0], results[1], results[2] if by_theta else None
        for row, weight in enumerate(weights):
            by_x, direct = self._call("observe_adjoint", x.ravel(), theta, weight[: 3 * layout.points], weight[3 * layout.points :])
            total = direct.ravel()
            by_x = by_x.reshape(x.shape)
            adjoint = np.zeros_like(x)
            adjoint[1:] = -sla.cho_solve_banded((factor, True), by_x[1:].ravel()).reshape(by_x[1:].shape)
            by_level_0 = by_x[0] + at.base_coupling.T @ adjoint[1]
            pairs = np.concatenate([adjoint[:-1], adjoint[1:]], axis=1)
            weights_of_row = np.zeros((len(pairs) * ROWS, pairs.shape[1]))  # the kernel takes ROWS weights; one is used
            weights_of_row[::ROWS] = pairs
            by_P, part = self._call("segment_theta_adjoint", x[:-1], x[1:], P, self._repeat(theta), weights_of_row)
            by_P, total = by_P[:, ::ROWS], total + part[:, ::ROWS].sum(axis=1)
            outer = (a, external.reshape(-1, 3), theta)
            driven = by_P[list(self.network.driven)].T
            by_a, by_external = (result.ravel(order="F") for result in self._call("properties_adjoint", *outer, driven))
            if not mapped:
                by_a, part = (result.ravel() for result in self._call("input_map_adjoint", u, theta, by_a))
                total = total + part
            if by_theta:
                total = total + self._call("properties_theta_adjoint", *outer, by_P.T, by_level_0)[0].ravel()
            results[0][row], results[1][row], results[2][row] = by_a, by_external, total
        return Status.SOLVED, results[0], results[1], results[2] if by_theta else None

    def matrices(self, x: np.ndarray, case: LoadCase) -> tuple[np.ndarray, np.ndarray]:
        """See `StaticsBackend.matrices`."""
        _, P, level_0 = self.prepare(*case)
        x = np.concatenate([level_0[None], x[1:]])
        return self.assemble(x, P, case.theta).band, self.assemble_damping(x, P, case.theta)
