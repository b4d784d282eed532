"""Statics, warm and cold: ours, CasADi's root finders, IPOPT and SciPy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import OptimizeResult, minimize, root

from benchmarks.goals import faster, near_limit
from benchmarks.parts import Session
from benchmarks.scene import Scene, free
from benchmarks.timing import Contender, Task
from benchmarks.workshop import Buffered, Workshop
from tepm_opt.models.backends.interface import LoadCase
from tepm_opt.solvers.mechanics.statics import DEFAULT, Equilibrium, solve_statics

TOLERANCE = DEFAULT.tolerance
OURS = "tepm_opt solve_statics"
FAST_NEWTON = "CasADi fast_newton, generated C"
IPOPT = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": TOLERANCE, "ipopt.max_iter": 1000}


@dataclass(frozen=True)
class Peers:
    """The network's functions and the solvers on them.

    Attributes:
        objects: object file of energy, residual and its Jacobian.
        energy, residual, hessian: the same, compiled; (x, force) → J, N and N/m, the last one dense.
        fast, fast_unbuffered: fast_newton, all of it generated C.
        fast_on_c: fast_newton of CasADi on the compiled residual, to embed in expressions.
        fast_interpreted: fast_newton on the virtual machine, to embed in expressions.
        plain: newton on the virtual machine; full steps, since its line search triples its iterations.
        ipopt: IPOPT on the energy, its functions compiled.
    """

    objects: Path
    energy: Buffered
    residual: Buffered
    hessian: Callable[[np.ndarray, np.ndarray], np.ndarray]
    fast: Buffered
    fast_unbuffered: ca.Function
    fast_on_c: ca.Function
    fast_interpreted: ca.Function
    plain: ca.Function
    ipopt: ca.Function

    @staticmethod
    def of(scene: Scene, workshop: Workshop) -> Peers:
        """Write and compile."""
        network, options = scene.network, {"abstol": TOLERANCE, "max_iter": 200}
        arguments = [network.x, network.force]
        energy, residual = ca.Function("energy", arguments, [network.energy]), ca.Function("residual", arguments, [network.residual])
        functions = [energy, residual, residual.jacobian()]
        objects = workshop.compiled_object("network", functions)
        library = str(workshop.link("network", [objects]))
        compiled = ca.external("residual", library)
        on_c = ca.rootfinder("fast_newton", "fast_newton", compiled, options)
        fast = workshop.external(on_c, objects)
        return Peers(
            objects=objects,
            energy=Buffered(ca.external("energy", library)),
            residual=Buffered(compiled),
            hessian=_dense(compiled.jacobian()),
            fast=Buffered(fast),
            fast_unbuffered=fast,
            fast_on_c=on_c,
            fast_interpreted=ca.rootfinder("fast_newton", "fast_newton", residual, options),
            plain=ca.rootfinder("newton", "newton", residual, options | {"line_search": False}),
            ipopt=workshop.ipopt("ipopt", {"x": network.x, "p": network.force, "f": network.energy}, IPOPT),
        )


def _dense(jacobian: ca.Function) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """A sparse matrix function of two arguments made dense."""
    rows, columns = (np.array(indices) for indices in jacobian.sparsity_out(0).get_triplet())
    buffered, shape = Buffered(jacobian), jacobian.size_out(0)

    def dense(x: np.ndarray, force: np.ndarray) -> np.ndarray:
        matrix = np.zeros(shape)
        matrix[rows, columns] = buffered(x, force)
        return matrix

    return dense


def checked(solver: ca.Function, x: Any) -> Any:
    """What a solver found, where it does not itself report failure."""
    statistics = solver.stats()
    if not statistics["success"]:
        raise RuntimeError(statistics.get("return_status") or "did not converge")
    return x


def converged(result: OptimizeResult) -> np.ndarray:
    if not result.success:
        raise RuntimeError(" ".join(result.message.split()))
    return result.x


def _scipy(peers: Peers, x: np.ndarray, force: np.ndarray) -> tuple[Callable[[], Any], Callable[[], Any]]:
    """SciPy's trust region minimiser and hybrid root finder with compiled functions and the exact Hessian."""

    def energy(at: np.ndarray) -> float:
        return float(peers.energy(at, force)[0])

    def residual(at: np.ndarray) -> np.ndarray:
        return peers.residual(at, force)

    def hessian(at: np.ndarray) -> np.ndarray:
        return peers.hessian(at, force)

    def trust() -> OptimizeResult:
        options = {"gtol": TOLERANCE * np.sqrt(len(x)), "maxiter": 1000}  # a Euclidean norm
        return minimize(energy, x, jac=residual, hess=hessian, method="trust-exact", options=options)

    def hybrid() -> OptimizeResult:
        return root(residual, x, jac=hessian, method="hybr", options={"xtol": 1e-12, "maxfev": 2000})

    return trust, hybrid


def tasks(session: Session) -> list[Task]:
    """A small step from an equilibrium, and a large one from rest."""
    scene, peers = session.scene, session.peers
    return [
        _task("warm", "Statics, warm: +1 kPa in p_11 and p_21", scene, peers, scene.bent, scene.nudged),
        _task("cold", "Statics, cold: rest to 0.15 MPa in p_11 and p_21", scene, peers, scene.rest, scene.bent),
    ]


GOALS = (
    faster("warm", "statics, warm", 5, FAST_NEWTON),
    near_limit("warm", "statics, warm", 3),
    faster("cold", "statics, cold", 5, FAST_NEWTON),
    near_limit("cold", "statics, cold", 3),
)


def _task(key: str, title: str, scene: Scene, peers: Peers, start: Equilibrium, goal: Equilibrium) -> Task:
    """From one equilibrium to another; the answer is the tip."""
    model, x, force = scene.model, free(start), scene.forces(goal.inputs)
    case = LoadCase(goal.inputs, False, np.zeros(goal.loads.size), model.theta)
    newton = Buffered(peers.plain)
    trust, hybrid = _scipy(peers, x, force)

    def statics() -> Any:
        return model.statics.statics(start.x, case, TOLERANCE, DEFAULT.max_iterations)

    def peer(name: str, solve: Callable[[], Any], found: Callable[[Any], Any] = lambda x: x, slow: bool = False) -> Contender:
        return Contender(name, solve, lambda result: scene.tip_of(found(result)), slow=slow)

    contenders = [
        Contender(OURS, lambda: solve_statics(model, goal.inputs, start=start), lambda result: result.tip, ours=True),
        Contender("tepm_opt model.statics.statics", statics, lambda result: scene.tip_of(result.x[1:].ravel()), ours=True),
        peer(FAST_NEWTON, lambda: peers.fast(x, force)),
        peer(f"{FAST_NEWTON}, plain call", lambda: peers.fast_unbuffered(x, force)),
        peer("CasADi newton, virtual machine", lambda: newton(x, force)),
        peer("IPOPT on the energy, generated C", lambda: peers.ipopt(x0=x, p=force), lambda found: checked(peers.ipopt, found["x"])),
        peer("SciPy trust-exact on the energy", trust, converged, slow=True),
        peer("SciPy root hybr", hybrid, converged, slow=True),
    ]
    return Task(key, title, goal.tip, contenders)
