"""Inverse kinematics of a point of the circle of Eq. (7): ours, IPOPT on everything at once, SciPy on the forces."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from benchmarks.scene import Scene, free
from benchmarks.statics import IPOPT, Peers, checked, converged
from benchmarks.timing import Contender, Task
from benchmarks.workshop import Buffered, Workshop
from tepm_opt.solvers.choices import ActuationMode
from tepm_opt.solvers.kinematics import Configuration, solve_ik

OURS = "tepm_opt solve_ik"
SIMULTANEOUS_C = "IPOPT simultaneous, generated C"
SIMULTANEOUS = "IPOPT simultaneous, virtual machine"
REGULARISATION = 1e-6  # of the sum of squared forces: converges in a third of the iterations that a zero objective takes
STEP = 1 / 32  # of a turn between neighbouring targets
QUICK_COMPILE = ("-O1", "-march=native")  # the Hessian of all constraints takes -O2 thrice as long and runs no faster


def _target(turn: float) -> np.ndarray:
    """Point of the circle in G."""
    return np.array([0.15 * np.cos(2 * np.pi * turn), 0.15 * np.sin(2 * np.pi * turn), 0.35])


class _Simultaneous:
    """Unknown coordinates and forces; constraints equilibrium, tip at the target, same lengths in both modules."""

    def __init__(self, scene: Scene) -> None:
        network, half = scene.network, scene.network.lengths.numel() // 2
        self.target = ca.SX.sym("target", 3)
        self.mismatch = ca.vertcat(network.tip - self.target, network.lengths[:half] - network.lengths[half:])
        self.problem = {
            "x": ca.vertcat(network.x, network.force),
            "p": self.target,
            "f": REGULARISATION * ca.sumsqr(network.force),
            "g": ca.vertcat(network.residual, self.mismatch),
        }


def _on_forces(scene: Scene, peers: Peers, mismatch: Buffered, start: Configuration | None, target: np.ndarray) -> Callable[[], Any]:
    """Least squares by finite differences over the forces; each statics solve starts from the last one."""
    first = free(scene.rest if start is None else start.equilibrium)
    forces = np.zeros(scene.network.force.numel()) if start is None else start.forces

    def solve() -> tuple[OptimizeResult, np.ndarray]:
        x = first

        def errors(force: np.ndarray) -> np.ndarray:
            nonlocal x
            x = peers.fast(x, force)
            return mismatch(x, target)

        return least_squares(errors, forces, method="trf", xtol=1e-10, ftol=1e-12, gtol=1e-14), x

    return solve


def tasks(scene: Scene, peers: Peers, workshop: Workshop) -> list[Task]:
    """From the neighbouring target and cold; the answer is the tip and the actuator lengths."""
    model, network, simultaneous = scene.model, scene.network, _Simultaneous(scene)
    compiled = workshop.ipopt("simultaneous", simultaneous.problem, IPOPT, QUICK_COMPILE)
    interpreted = ca.nlpsol("simultaneous_interpreted", "ipopt", simultaneous.problem, IPOPT)
    mismatch = Buffered(ca.Function("mismatch", [network.x, simultaneous.target], [simultaneous.mismatch]))
    observe = ca.Function("observe", [network.x], [ca.vertcat(network.tip, network.lengths)])
    target, half = _target(5 * STEP), network.lengths.numel() // 2
    neighbour = solve_ik(model, _target(4 * STEP), ActuationMode.HYBRID)

    def answer(x: Any) -> np.ndarray:
        return observe(x).full().ravel()

    def one(key: str, title: str, start: Configuration | None) -> Task:
        if start is None:
            guess = np.concatenate([free(scene.rest), np.zeros(2 * half)])
        else:
            guess = np.concatenate([free(start.equilibrium), start.forces])

        def ipopt(name: str, solver: ca.Function) -> Contender:
            def found(result: dict[str, ca.DM]) -> np.ndarray:
                return answer(checked(solver, result["x"])[: network.x.numel()])

            return Contender(name, lambda: solver(x0=guess, p=target, lbg=0, ubg=0), found)

        def on_forces(result: tuple[OptimizeResult, np.ndarray]) -> np.ndarray:
            converged(result[0])
            return answer(result[1])

        found = solve_ik(model, target, ActuationMode.HYBRID, start=start)
        expected = np.concatenate([target, np.tile(found.equilibrium.lengths[0], 2)])
        contenders = [
            Contender(
                OURS,
                lambda: solve_ik(model, target, ActuationMode.HYBRID, start=start),
                lambda result: answer(free(result.equilibrium)),
                ours=True,
            ),
            ipopt(SIMULTANEOUS_C, compiled),
            ipopt(SIMULTANEOUS, interpreted),
            Contender(
                "SciPy least_squares on forces, fast_newton inside",
                _on_forces(scene, peers, mismatch, start, target),
                on_forces,
                slow=True,
            ),
        ]
        return Task(key, title, expected, contenders)

    return [
        one("ik", "Inverse kinematics, from the neighbour 1/32 turn away", neighbour),
        one("ik_cold", "Inverse kinematics, cold", None),
    ]
