"""Systems of few states that move like a system of many, with a bound on the difference.

Measured is the scaled frequency response (inputs per range, see `Linear`): the largest singular value of the difference at any
frequency, in m per range. The error bound of both methods is twice the sum of the Hankel singular values of what was left out, plus
1e-6 of the largest of all for rounding errors. python-control's own reduction needs slycot, a Fortran library; this does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from tepm_opt.errors import InputError
from tepm_opt.solvers.linear.modes import modes
from tepm_opt.solvers.linear.state_space import Linear, Names

LEAST = 1e-7  # of the largest Hankel singular value: smaller ones are lost in the rounding errors of the Gramians
ROUNDING = 1e-6  # of the largest Hankel singular value: added to bounds for those errors


@dataclass(frozen=True, eq=False, kw_only=True)
class Reduced(Linear):
    """A reduced system: see `Linear`. Its states have no physical meaning; the delay is kept aside as before.

    Attributes:
        method: "balanced" or "modal".
        bound: of the difference from the full system, at any frequency, in m per range.
        hankel: Hankel singular values, largest first, in m per range: of the full system ("balanced") or of what was left out ("modal").
    """

    method: str
    bound: float
    hankel: np.ndarray

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        size = f"{len(self.A)} states, {len(self.inputs)} inputs, {len(self.outputs)} outputs"
        return f"Reduced({self.method}, {size}, within {1e3 * self.bound:.3g} mm per range)"


def balanced_reduction(
    linear: Linear, order: int | None = None, tolerance: float | None = None, inputs: Names = None, outputs: Names = None,
    exact_gain: bool = True,
) -> Reduced:  # fmt: skip
    """Balanced reduction by the square-root method (Tombs and Postlethwaite, Int. J. Control 46, 1987).

    Args:
        linear: a stable system.
        order: number of states to keep; or
        tolerance: bound on the difference in m per range, from which the order follows.
        inputs, outputs: the part of the system that matters, all where absent. The fewer, the smaller the reduced system.
        exact_gain: whether the gain at rest stays exact (singular perturbation, Liu and Anderson, Int. J. Control 50, 1989) at the cost of
            a small direct feedthrough D; else fast motions are exact. The bound holds for both.

    Raises:
        InputError: an unstable system, no such input or output, a wrong order or tolerance.
    """
    system = linear.select(inputs, outputs)
    _check_stable(system)
    if (order is None) == (tolerance is None):
        raise InputError("balanced_reduction: give either an order or a tolerance")
    hankel, left, right = _balance(system.A, system.B * system.ranges, system.C)
    tails = 2 * np.append(np.cumsum(hankel[::-1])[::-1], 0.0)
    bounds = tails + ROUNDING * hankel[0]  # by order
    if tolerance is not None:
        if not tolerance >= bounds[-1]:
            raise InputError(f"tolerance: {tolerance:g}; valid: at least {bounds[-1]:.2g}, in m per range")
        order = max(int(np.argmax(bounds <= tolerance)), 1)
    if not (isinstance(order, int | np.integer) and 1 <= order <= len(hankel)):
        raise InputError(f"order: {order!r}; valid: 1 … {len(hankel)}")
    A, B, C, D = left @ system.A @ right, left @ system.B, system.C @ right, system.D
    if exact_gain:
        A, B, C = _residual(A, B, C, order)
        D = system.gain() + C @ np.linalg.solve(A, B)
    if np.linalg.eigvals(A[:order, :order]).real.max() >= 0:  # possible only between equal Hankel singular values
        raise InputError(f"order: {order} leaves one of two equal Hankel singular values out and is unstable; valid: {order + 1}")
    return _assemble_reduced(system, (A[:order, :order], B[:order], C[:, :order], D), "balanced", bounds[order], hankel)


def modal(linear: Linear, below: float, inputs: Names = None, outputs: Names = None) -> Reduced:
    """Keep the modes slower than a frequency; the others act at once (static residual in D), so the gain at rest stays exact.

    Args:
        linear: a stable system.
        below: natural frequency |eigenvalue| / 2π in Hz up to which modes are kept.
        inputs, outputs: the part of the system that matters, all where absent.

    Raises:
        InputError: an unstable system, no such input or output, no mode below the frequency or none above.
    """
    system = linear.select(inputs, outputs)
    _check_stable(system)
    found = modes(linear)
    slow = [abs(mode.value) / (2 * np.pi) <= below for mode in found]
    if not any(slow) or all(slow):
        natural = [abs(mode.value) / (2 * np.pi) for mode in found]
        raise InputError(f"below: {below:g} Hz; valid: {natural[0]:.4g} … {natural[-1]:.4g} Hz, where modes are")
    part: dict[bool, list[np.ndarray]] = {}
    for kept in (True, False):
        chosen = [mode for mode, is_slow in zip(found, slow, strict=True) if is_slow is kept]
        right = np.column_stack([column for mode in chosen for column in _real(mode.right, mode.oscillates)])
        left = np.array([row for mode in chosen for row in _real((2 if mode.oscillates else 1) * mode.left.conj(), mode.oscillates)])
        part[kept] = [left @ system.A @ right, left @ system.B, system.C @ right]
    A, B, C = part[False]
    hankel = _balance(A, B * system.ranges, C)[0]
    D = system.D - C @ np.linalg.solve(A, B)
    return _assemble_reduced(system, (*part[True], D), "modal", 2 * hankel.sum() + ROUNDING * hankel[0], hankel)


def difference(system: Linear, reduced: Linear, frequencies: Sequence[float] | np.ndarray) -> np.ndarray:
    """Largest singular value of the difference of two scaled frequency responses, (frequencies,) in m per range; frequencies in Hz.

    The full system is narrowed to the inputs and outputs of the reduced one.
    """
    full = system.select(reduced.inputs, reduced.outputs)
    return np.linalg.norm(full.response(frequencies, scaled=True) - reduced.response(frequencies, scaled=True), ord=2, axis=(1, 2))


def _real(vector: np.ndarray, oscillates: bool) -> list[np.ndarray]:
    """Real and, of an oscillating mode, imaginary part: two real vectors that span what it and its conjugate do."""
    return [np.real(vector), np.imag(vector)] if oscillates else [np.real(vector)]


def _check_stable(system: Linear) -> None:
    worst = float(np.linalg.eigvals(system.A).real.max())
    if not worst < 0:
        raise InputError(f"reduction: the system is unstable (an eigenvalue has real part {worst:.3g} 1/s); valid: a stable equilibrium")


def _balance(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hankel singular values of a system, and left and right factors of its balanced states, left @ right = 1.

    States that cannot be told from rounding errors are left out.
    """
    _, (scale, _) = sla.matrix_balance(A, permute=False, separate=True)
    A, B, C = A * scale / scale[:, None], B / scale[:, None], C * scale
    reach = _factor(sla.solve_continuous_lyapunov(A, -B @ B.T))
    see = _factor(sla.solve_continuous_lyapunov(A.T, -C.T @ C))
    u, values, v = np.linalg.svd(see.T @ reach, full_matrices=False)
    good = values > LEAST * values[0]
    values, left, right = values[good], see @ u[:, good], reach @ v[good].T
    return values, (left / np.sqrt(values)).T / scale, scale[:, None] * (right / np.sqrt(values))


def _factor(gramian: np.ndarray) -> np.ndarray:
    """L of a Gramian L L', without its directions below 1e-14 of the largest, which are rounding errors."""
    values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
    good = values > 1e-14 * values[-1]
    return vectors[:, good] * np.sqrt(values[good])


def _residual(A: np.ndarray, B: np.ndarray, C: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C of the first states if all others follow at once."""
    kept, fast = slice(order), slice(order, None)
    by_kept, by_input = (-np.linalg.solve(A[fast, fast], matrix) for matrix in (A[fast, kept], B[fast]))
    across = A[kept, fast]
    return A[kept, kept] + across @ by_kept, B[kept] + across @ by_input, C[:, kept] + C[:, fast] @ by_kept


def _assemble_reduced(system: Linear, matrices: Sequence[np.ndarray], method: str, bound: float, hankel: np.ndarray) -> Reduced:
    A, B, C, D = matrices
    kinds, names = np.repeat("reduced", len(A)), tuple(f"state_{k + 1}" for k in range(len(A)))
    return Reduced(
        A=A, B=B, C=C, D=D, inputs=system.inputs, outputs=system.outputs, ranges=system.ranges, delay=system.delay,
        equilibrium=system.equilibrium, kinds=kinds, state_names=names, method=method, bound=float(bound), hankel=hankel,
    )  # fmt: skip
