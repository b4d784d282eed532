"""Small convex quadratic programs, one after another of one size: what a predictive controller solves in every period.

    minimise ½ xᵀ H x + fᵀ x   subject to   lower ≤ x ≤ upper,   row_lower ≤ R x ≤ row_upper

by the dual active-set method of DAQP (Arnström, Bemporad, Axehill, IEEE TAC 67(8), 2022, p. 4362) in one workspace that lives as long as
the solver and begins with the active set of the program before. Of the solvers tried (`python -m benchmarks --only control`: PIQP, OSQP,
ProxQP) it was the fastest on a controller's programs. Most of its time goes into the change of variables u = Lᵀ x + L⁻¹ f, H = L Lᵀ, which
LAPACK does faster and which stays where H does.
"""

from __future__ import annotations

import time
from ctypes import c_int
from dataclasses import dataclass

import daqp
import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp

from tepm_opt.errors import InputError
from tepm_opt.outcome import Ending, Outcome

WITHIN = 1e-6  # by which a solution may leave its bounds, beside 1 and the bound
TOLERANCE = 1e-9  # of DAQP, on rows of length 1
UNBOUNDED = 1e30  # DAQP's infinity
SINGULAR = 1e-9  # of the largest diagonal element of H: pivot below which H is regularised, first by as much
MOST = 1e-4  # of the largest diagonal element of H: beyond which regularising is no remedy
SPARSE = 0.2  # share of elements of R that are not 0, up to which it is stored sparse
SOFT = 8  # DAQP's mark of a soft row

_factor, _inverse = sla.get_lapack_funcs(("potrf", "trtri"))


_SOLVED = Outcome(Ending.SOLVED)
_NOT_RUN = Outcome(Ending.FAILED, "nothing was solved")
_INFEASIBLE = Outcome(Ending.INFEASIBLE, "no x is within all bounds")
_NOT_FINITE = Outcome(Ending.NOT_FINITE, "a coefficient or a bound is not a finite number")
_NOT_CONVEX = Outcome(Ending.NOT_CONVEX, "the Hessian is not positive semidefinite")
_NO_HESSIAN = Outcome(Ending.FAILED, "the program before had no Hessian of use")
_INEXACT = Outcome(Ending.FAILED, "the answer is outside its bounds by more than rounding")


@dataclass(frozen=True, eq=False)
class QpResult:
    """Result of `QpSolver.solve`.

    Attributes:
        x: the minimiser, (variables,), checked to be finite and within bounds; None unless solved.
        multipliers: of the bounds, then of the rows, (variables + rows,), positive at upper bounds and negative at lower ones, so that
            H x + f + multipliers[:variables] + Rᵀ multipliers[variables:] = 0; None unless solved.
        outcome: how it ended, and why.
        iterations: changes of the active set.
        violation: largest amount by which a soft row is beyond its bounds; 0 where rows are not soft.
        seconds: time taken.
    """

    x: np.ndarray | None = None
    multipliers: np.ndarray | None = None
    outcome: Outcome = _NOT_RUN
    iterations: int = 0
    violation: float = 0.0
    seconds: float = 0.0

    @property
    def solved(self) -> bool:
        """Whether there is an x."""
        return self.outcome.solved

    def __repr__(self) -> str:
        return f"QpResult({self.outcome}, iterations={self.iterations}, seconds={self.seconds:.2g})"


class QpSolver:
    """Solves programs with the same rows R, each from the active set of the one before; not for several threads at once."""

    def __init__(self, rows: np.ndarray, soft: float | np.ndarray | None = None, iterations: int = 1000) -> None:
        """A solver for programs of (variables,) = R's columns.

        Args:
            rows: R, (rows, variables); no rows where there are none.
            soft: weight w by which rows may be violated: ½ w times the squares of what they are beyond their bounds is added to the
                cost; one for all or one a row, infinite where a row is hard. None forbids it. Bounds of x are never violated.
            iterations: most changes of the active set of one solve, some microseconds each.

        Raises:
            InputError: rows not a finite matrix, weight or iterations not positive.
        """
        R = np.array(rows, dtype=float)
        if R.ndim != 2 or not R.shape[1] or not np.isfinite(R).all():
            raise InputError(f"rows: shape {R.shape}; valid: a matrix of finite numbers, a column for each variable")
        m, n = R.shape
        weights = np.full(m, np.inf) if soft is None else np.asarray(soft, dtype=float)
        if not (iterations >= 1 and weights.shape in ((), (m,)) and (weights > 0).all() and (soft is None or np.isfinite(weights).any())):
            raise InputError(f"soft: {soft!r}, iterations: {iterations!r}; valid: positive weights or None, at least 1 iteration")
        self.variables, self.rows, self.iterations = n, m, iterations
        self._soft = np.broadcast_to(weights, (m,))
        self._shapes = [(n, n), (n,), (n,), (n,), (m,), (m,)]
        self._rows = sp.csr_array(R) if np.count_nonzero(R) <= SPARSE * R.size else R
        self._sense = np.zeros(n + m, dtype=c_int)
        self._sense[n:] = np.where(np.isfinite(self._soft), SOFT, 0)
        self._identity, self._zero = np.eye(n), np.zeros(n)
        self._low, self._high, self._rest, self._M = np.zeros(n + m), np.zeros(n + m), np.zeros(n + m), np.zeros((n + m, n))
        self._inverse: np.ndarray | None = None  # L⁻¹
        self._scale, self._moved = 1.0, True  # of the cost; whether M is new to the workspace
        self._taken = _NO_HESSIAN  # how the last Hessian was taken
        self._workspace: daqp.Model | None = None

    def take(self, hessian: np.ndarray) -> None:
        """Factor the Hessian of the programs to come, which then need none of their own; what is wrong with it, their outcome tells.

        Args:
            hessian: H, positive semidefinite, (variables, variables), of which the lower triangle is read.

        Raises:
            InputError: wrong shape.
        """
        H = np.asarray(hessian, dtype=float)
        if H.shape != self._shapes[0]:
            raise InputError(f"hessian: shape {H.shape}; valid: {self._shapes[0]}")
        self._inverse, self._moved = None, True
        factor = _definite_factor(H)
        if factor is None:
            self._taken = _NOT_CONVEX if np.isfinite(H).all() else _NOT_FINITE
            return
        self._inverse = inverse = np.asarray(_inverse(factor, lower=1)[0])
        n = self.variables
        self._scale = float(factor[0, 0]) ** 2
        np.multiply(inverse.T, factor[0, 0], out=self._M[:n])  # rows neither long nor short, whatever the unit of the cost
        self._M[n:] = self._rows @ self._M[:n]
        self._taken = _SOLVED

    def solve(
        self,
        hessian: np.ndarray | None,
        gradient: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        row_lower: np.ndarray,
        row_upper: np.ndarray,
        rows: np.ndarray | None = None,
    ) -> QpResult:
        """Minimiser of one program; a program without one is an outcome, never an exception.

        A hessian singular to rounding is regularised by as little as makes it definite. What fails from the active set of the program
        before is tried once more from none.

        Args:
            hessian: H as `take` takes it; None for that of the program before, or the last one taken, which saves most of the time;
                failed where that was of no use.
            gradient: f, (variables,).
            lower, upper: of x, (variables,); infinite where there is none.
            row_lower, row_upper: of R x, (rows,); likewise.
            rows: another R of the same shape from now on; with it goes another hessian.

        Raises:
            InputError: wrong shape.
        """
        began = time.perf_counter()
        if rows is not None:
            if np.shape(rows) != (self.rows, self.variables):
                raise InputError(f"rows: shape {np.shape(rows)}; valid: {(self.rows, self.variables)}")
            self._rows = np.asarray(rows, dtype=float)
        H = self._identity if hessian is None else np.asarray(hessian, dtype=float)
        given = [H, *(np.asarray(part, dtype=float) for part in (gradient, lower, upper, row_lower, row_upper))]
        shapes = [part.shape for part in given]
        if shapes != self._shapes:
            raise InputError(f"shapes {shapes}; valid: {self._shapes}")
        n = self.variables
        self._low[:n], self._high[:n], self._low[n:], self._high[n:] = given[2:]
        if hessian is not None:
            self.take(H)
        outcome, count = self._prepare(given[1]) if self._taken.solved else self._taken, 0
        if hessian is not None and not self._taken.solved:
            self._taken = _NO_HESSIAN
        if not outcome.solved:
            return QpResult(outcome=outcome, seconds=time.perf_counter() - began)
        for warm in (True, False) if self._workspace else (False,):
            flag, u, multipliers, more = self._run(warm)
            outcome, count = self._outcome(flag), count + more
            if outcome.solved:
                x, beyond = self._clip_to_bounds(u)
                if x is not None:
                    return QpResult(x, self._scale * multipliers, outcome, count, beyond, time.perf_counter() - began)
                outcome = _INEXACT
            self._workspace = None
        return QpResult(outcome=outcome, iterations=count, seconds=time.perf_counter() - began)

    def _outcome(self, flag: int) -> Outcome:
        """Outcome that DAQP's exit flag stands for."""
        if flag in (1, 2):
            return _SOLVED
        if flag == -1:
            return _INFEASIBLE
        if flag == -4:
            return Outcome(Ending.ITERATION_LIMIT, f"no answer after {self.iterations} changes of the active set")
        return Outcome(Ending.FAILED, f"DAQP ended with flag {flag}")

    def _prepare(self, f: np.ndarray) -> Outcome:
        """The change of variables: x and its rows are M u + rest, where u = 0 is the minimiser without bounds; solved if there is one."""
        low, high, n = self._low, self._high, self.variables
        if self._inverse is None:
            return _NO_HESSIAN
        if not np.isfinite(f).all() or np.isnan(low).any() or np.isnan(high).any():
            return _NOT_FINITE
        if not ((low <= high) & (low < np.inf) & (high > -np.inf)).all():
            return _INFEASIBLE
        self._rest[:n] = free = -((self._inverse @ f) @ self._inverse)
        self._rest[n:] = self._rows @ free
        return _SOLVED if np.isfinite(self._rest).all() else _NOT_FINITE

    def _run(self, warm: bool) -> tuple[int, np.ndarray, np.ndarray, int]:
        """DAQP's flag, minimiser of |u|² / 2 within the bounds, multipliers and iterations."""
        low, high = np.maximum(self._low - self._rest, -UNBOUNDED), np.minimum(self._high - self._rest, UNBOUNDED)
        if warm and self._workspace:
            model = self._workspace
            flag = model.update(A=self._M if self._moved else None, bupper=high, blower=low)
        else:
            model = self._workspace = daqp.Model()
            flag = model.setup(self._identity, self._zero, self._M, high, low, self._sense.copy())[0]
            if flag >= 0:
                model.settings = {"primal_tol": TOLERANCE, "iter_limit": self.iterations}
        if flag < 0:
            return flag, self._zero, self._zero, 0
        self._moved = False
        if self._sense.any():
            rho = np.full(len(low), self._scale)
            rho[self.variables :] = self._scale / self._soft
            model.soft_weights(rho_l=rho, rho_u=rho)
        u, _, flag, info = model.solve()
        return flag, u, info["lam"], info["iterations"]

    def _clip_to_bounds(self, u: np.ndarray) -> tuple[np.ndarray | None, float]:
        """x moved by rounding into its bounds, None where more than that is necessary, and how far its rows are beyond theirs."""
        n, values = self.variables, self._M @ u + self._rest
        x = np.minimum(np.maximum(values[:n], self._low[:n]), self._high[:n])
        beyond = np.maximum(self._low - values, values - self._high)
        soft = np.isfinite(self._soft)
        of_x, of_rows = float(beyond[:n].max()), float(beyond[n:][~soft].max(initial=0.0))
        allowed = WITHIN * max(1.0, float(np.abs(x).max()))  # the comparisons are false where x is not finite
        return (x if max(of_x, of_rows) <= allowed < np.inf else None), float(beyond[n:][soft].max(initial=0.0))


def _definite_factor(H: np.ndarray) -> np.ndarray | None:
    """L of L Lᵀ = H, or of H with as little more on its diagonal as makes it definite; None where H is not convex or not finite."""
    largest, more = float(H.diagonal().max()), 0.0
    while more <= MOST and 0 < largest < np.inf:
        factor, failed = _factor(H + more * largest * np.eye(len(H)) if more else H, lower=1)
        if not failed and factor.diagonal().min() ** 2 >= SINGULAR * largest:
            return factor
        more = max(SINGULAR, 100 * more)
    return None
