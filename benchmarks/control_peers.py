"""Other solvers of the controller's quadratic program, each kept from step to step, and do-mpc on the problem itself.

Packages that are not installed are left out.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from ctypes import c_int
from importlib.util import find_spec
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from benchmarks.control_problem import CHANGE, HIGHEST, RATE, SPREAD, STAGE, STAGES, TIP, Problem, Program
from tepm_opt.control.mpc.qp import QpSolver

Step = Callable[[Program], np.ndarray]
PRECISE = 1e-7  # of the solvers that approach the answer step by step


def ours(problem: Problem, again: bool = False) -> Step:
    """The package's; `again`: as do-mpc it knows that only the state and what is wanted are new."""
    solver, (low, high) = QpSolver(problem.rows), _bounds(problem)
    hessian = problem.hessian

    def step(program: Program) -> np.ndarray:
        nonlocal hessian
        x = solver.solve(hessian, program.gradient, low, high, program.row_low, program.row_high).x
        hessian = None if again else hessian
        return np.full(len(low), np.nan) if x is None else x

    return step


def _bounds(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros(len(problem.rows)), np.full(len(problem.rows), HIGHEST)


def daqp(problem: Problem, warm: bool, anew: bool = False) -> Step:
    """DAQP called directly: from the active set before, from none, or with a new object for each program."""
    import daqp

    (low, high), nothing = _bounds(problem), np.zeros(2 * len(problem.rows), dtype=c_int)
    model: Any = None

    def step(program: Program) -> np.ndarray:
        nonlocal model
        lower, upper = np.concatenate([low, program.row_low]), np.concatenate([high, program.row_high])
        if model is None or anew:
            model = daqp.Model()
            model.setup(problem.hessian, program.gradient, problem.rows, upper, lower, nothing.copy())
        else:
            sense = {} if warm else {"sense": nothing.copy()}
            model.update(H=problem.hessian, f=program.gradient, bupper=upper, blower=lower, **sense)
        return model.solve()[0]

    return step


def piqp(problem: Problem) -> Step:
    """PIQP, dense: an interior-point method, which knows no warm start."""
    import piqp

    (low, high), solver = _bounds(problem), None

    def step(program: Program) -> np.ndarray:
        nonlocal solver
        change = {"P": problem.hessian, "c": program.gradient, "h_l": program.row_low, "h_u": program.row_high}
        if solver is None:
            solver = piqp.DenseSolver()
            solver.settings.verbose = False
            solver.settings.eps_abs = solver.settings.eps_rel = PRECISE
            solver.setup(G=problem.rows, x_l=low, x_u=high, **change)
        else:
            solver.update(**change)
        solver.solve()
        return solver.result.x

    return step


def proxqp(problem: Problem, warm: bool) -> Step:
    """ProxQP, dense: an augmented Lagrangian method."""
    from proxsuite import proxqp

    low, high = _bounds(problem)
    solver = proxqp.dense.QP(len(low), 0, len(low), True)
    solver.settings.eps_abs = PRECISE
    solver.settings.initial_guess = proxqp.WARM_START_WITH_PREVIOUS_RESULT if warm else proxqp.NO_INITIAL_GUESS
    begun = False

    def step(program: Program) -> np.ndarray:
        nonlocal begun
        if begun:
            solver.update(H=problem.hessian, g=program.gradient, l=program.row_low, u=program.row_high)
        else:
            sides = program.row_low, program.row_high, low, high
            solver.init(problem.hessian, program.gradient, None, None, problem.rows, *sides)
            begun = True
        solver.solve()
        return solver.results.x

    return step


def osqp(problem: Problem, warm: bool) -> Step:
    """OSQP, sparse: an operator splitting."""
    import osqp

    (low, high), solver = _bounds(problem), None
    rows = sp.csc_matrix(np.vstack([np.eye(len(low)), problem.rows]))
    upper_half = np.triu(np.ones_like(problem.hessian, dtype=bool)).T  # column by column

    def step(program: Program) -> np.ndarray:
        nonlocal solver
        lower, upper = np.concatenate([low, program.row_low]), np.concatenate([high, program.row_high])
        if solver is None:
            solver = osqp.OSQP()
            settings = {"verbose": False, "eps_abs": PRECISE, "eps_rel": PRECISE, "max_iter": 20_000, "warm_starting": warm}
            solver.setup(sp.csc_matrix(np.triu(problem.hessian)), program.gradient, rows, lower, upper, **settings)
        else:
            solver.update(q=program.gradient, l=lower, u=upper)
            solver.update(Px=problem.hessian.T[upper_half])
        return solver.solve().x

    return step


def do_mpc(problem: Problem) -> Step:
    """do-mpc with IPOPT; the tensions are states, their changes inputs, so that bounds of both are mere bounds."""
    warnings.filterwarnings("ignore", category=FutureWarning, module="casadi")  # of functions that do-mpc calls
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about features that are not installed
        from do_mpc.controller import MPC
        from do_mpc.model import Model
    model = Model("discrete")
    state, tensions = model.set_variable("_x", "state", (len(problem.A), 1)), model.set_variable("_x", "tensions", (len(problem.rest), 1))
    change = model.set_variable("_u", "change", (len(problem.rest), 1))
    model.set_variable("_tvp", "wanted", (3, 1))
    new = tensions + change
    model.set_rhs("state", ca.mtimes(ca.DM(problem.A), state) + ca.mtimes(ca.DM(problem.B), new - problem.rest))
    model.set_rhs("tensions", new)
    model.setup()
    controller = MPC(model)
    controller.settings.n_horizon, controller.settings.t_step = STAGES, STAGE
    controller.settings.store_full_solution = False
    controller.settings.supress_ipopt_output()
    change, new = model.u["change"], model.x["tensions"] + model.u["change"]
    off = ca.sumsqr(ca.mtimes(ca.DM(problem.tip), model.x["state"]) - model.tvp["wanted"]) / TIP**2
    controller.set_objective(mterm=off, lterm=off + ca.sumsqr(new - problem.rest) / SPREAD**2 + ca.sumsqr(change) / CHANGE**2)
    controller.set_rterm(change=0.0)
    for side, tension, rate in (("lower", 0.0, -RATE), ("upper", HIGHEST, RATE)):
        controller.bounds[side, "_x", "tensions"] = tension
        controller.bounds[side, "_u", "change"] = rate
    template = controller.get_tvp_template()
    controller.set_tvp_fun(lambda _: template)
    controller.setup()
    begun = False

    def step(program: Program) -> np.ndarray:
        nonlocal begun
        template["_tvp", 0, "wanted"] = np.zeros(3)  # where the tip is now cannot be changed
        for stage, tip in enumerate(program.wanted):
            template["_tvp", stage + 1, "wanted"] = tip
        now = np.concatenate([program.state, program.before])[:, None]
        if not begun:
            controller.x0 = now
            controller.set_initial_guess()
            begun = True
        return program.before + controller.make_step(now).ravel()

    return step


def peers(problem: Problem) -> Iterator[tuple[str, Step]]:
    """All that are installed."""
    yield "DAQP, persistent, warm", daqp(problem, True)
    yield "DAQP, persistent, cold", daqp(problem, False)
    yield "DAQP, a new object for each program", daqp(problem, False, anew=True)
    if find_spec("proxsuite"):
        yield "ProxQP, warm", proxqp(problem, True)
        yield "ProxQP, cold", proxqp(problem, False)
    if find_spec("piqp"):
        yield "PIQP", piqp(problem)
    if find_spec("osqp"):
        yield "OSQP, warm", osqp(problem, True)
        yield "OSQP, cold", osqp(problem, False)
