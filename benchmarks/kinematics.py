"""Inverse kinematics of the circle of Eq. (7) and of points out of reach: ours, IPOPT on everything at once, SciPy on the forces."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import OptimizeResult, least_squares, minimize

from benchmarks.goals import Goal, faster, within
from benchmarks.parts import Session
from benchmarks.scene import Scene, free
from benchmarks.statics import IPOPT, Peers, checked, converged
from benchmarks.timing import Contender, Task
from benchmarks.workshop import Buffered
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Ending
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.allocation import force_range
from tepm_opt.solvers.kinematics.ik import Configuration, solve_ik, solve_trajectory
from tepm_opt.solvers.mechanics.statics import Equilibrium, solve_actuated_statics

OURS = "tepm_opt solve_ik"
PATH, ONE_BY_ONE = "tepm_opt solve_trajectory", "tepm_opt solve_ik, each from the last"
SIMULTANEOUS_C = "IPOPT simultaneous, generated C"
SIMULTANEOUS = "IPOPT simultaneous, virtual machine"
REGULARISATION = 1e-6  # of the sum of squared forces: converges in a third of the iterations that a zero objective takes
OUT_OF_REACH = 40  # targets
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


def tasks(session: Session) -> list[Task]:
    """A point from its neighbour and cold, a whole circle, points out of reach."""
    return [*_points(session), _path(session.scene.model), _out_of_reach(session.scene)]


def _points(session: Session) -> list[Task]:
    """From the neighbouring target and cold; the answer is the tip and the actuator lengths."""
    scene, peers = session.scene, session.peers
    model, network, simultaneous = scene.model, scene.network, _Simultaneous(scene)
    compiled = session.workshop.ipopt("simultaneous", simultaneous.problem, IPOPT, QUICK_COMPILE)
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


def _path(model: CompiledModel) -> Task:
    """All points of the circle in one call and in as many; the answer is their tips."""
    targets = np.array([_target(turn * STEP) for turn in range(round(1 / STEP))])

    def one_by_one() -> list[Configuration]:
        found: list[Configuration] = []
        for target in targets:
            found.append(solve_ik(model, target, start=found[-1] if found else None))
        return found

    def tips(found: list[Configuration]) -> np.ndarray:
        return np.concatenate([configuration.equilibrium.tip for configuration in found])

    contenders = [
        Contender(PATH, lambda: solve_trajectory(model, targets), tips, ours=True),
        Contender(ONE_BY_ONE, one_by_one, tips, ours=True),
    ]
    return Task("ik_path", f"Inverse kinematics of the circle, {len(targets)} points", targets.ravel(), contenders)


def _out_of_reach(scene: Scene) -> Task:
    """The nearest points to targets in turn; the answer is how much farther than the nearest known they are."""
    model, random = scene.model, np.random.default_rng(0)
    low, high = force_range(model, ActuationMode.HYBRID)
    targets: list[np.ndarray] = []
    while len(targets) < OUT_OF_REACH:
        target = random.uniform([-0.3, -0.3, 0.1], [0.3, 0.3, 0.5])
        if solve_ik(model, target).outcome.ending is Ending.OUT_OF_REACH:
            targets.append(target)

    def by_scipy(target: np.ndarray) -> float:
        starts = np.array([[1, 1, 1], [2, 0, 0], [0, 2, 0], [0, 0, 2]]) / 2 * 0.9
        ends = [_slsqp(scene, target, low, high, np.tile(start, 2)) for start in starts]
        return min(ends)

    nearest = [min(by_scipy(target), solve_ik(model, target).miss) for target in targets]

    def contender(name: str, miss: Callable[[np.ndarray], float], ours: bool = False, slow: bool = False) -> Contender:
        turn = itertools.cycle(range(len(targets)))

        def solve() -> tuple[int, float]:
            number = next(turn)
            return number, miss(targets[number])

        return Contender(name, solve, lambda found: np.array([max(found[1] - nearest[found[0]], 0.0)]), ours, slow)

    contenders = [
        contender(OURS, lambda target: solve_ik(model, target).miss, ours=True),
        contender("SciPy SLSQP on forces from 4 starts, derivatives of tepm_opt", by_scipy, slow=True),
    ]
    return Task("ik_out", f"Inverse kinematics, {len(targets)} points out of reach in turn", np.zeros(1), contenders)


def _slsqp(scene: Scene, target: np.ndarray, low: np.ndarray, high: np.ndarray, start: np.ndarray) -> float:
    """Distance to the nearest tip that sequential quadratic programming finds from forces `start`, in parts of their range."""
    model, scale, span = scene.model, 1e-2, high - low
    half, points = len(low), 3 * model.layout.points
    weights = np.zeros((6, points + half))
    weights[:3, points - 3 : points] = np.eye(3)
    weights[3:, points:] = np.hstack([-np.eye(3), np.eye(3)])
    loads, last = np.zeros((model.layout.points, 3)), scene.rest

    def at(part: np.ndarray) -> Equilibrium:
        nonlocal last
        effective = np.append((low + part * span) / model.values["A"], np.zeros(half))
        last = solve_actuated_statics(model, effective, loads, last)
        return last

    def errors(part: np.ndarray) -> np.ndarray:
        found = at(part)
        return np.concatenate([found.tip - target, found.lengths[1] - found.lengths[0]]) / scale

    def jacobian(part: np.ndarray) -> np.ndarray:
        found = at(part)
        by_a = model.statics.sensitivity(found.x, found.load_case, weights, False)[1]
        return by_a[:, :half] / model.values["A"] * span / scale

    found = minimize(
        lambda part: 0.5 * float(errors(part)[:3] @ errors(part)[:3]),
        start,
        jac=lambda part: jacobian(part)[:3].T @ errors(part)[:3],
        bounds=[(0.0, 1.0)] * half,
        constraints={"type": "eq", "fun": lambda part: errors(part)[3:], "jac": lambda part: jacobian(part)[3:]},
        method="SLSQP",
        options={"maxiter": 200, "ftol": 1e-12},
    )
    missed = scale * errors(np.clip(found.x, 0.0, 1.0))
    return float(np.linalg.norm(missed[:3])) if np.abs(missed[3:]).max() < 1e-7 else np.inf


def _in_one_call(task: Task, _: object) -> float:
    return task.named(ONE_BY_ONE).over(task.contenders[0])


GOALS = (
    faster("ik", "IK from the neighbour", 60, SIMULTANEOUS_C),
    faster("ik", "IK from the neighbour", 60, SIMULTANEOUS),
    faster("ik_cold", "IK, cold", 95, SIMULTANEOUS_C),
    faster("ik_cold", "IK, cold", 150, SIMULTANEOUS),
    Goal("ik_path", "IK of a path, over point by point", "faster than point by point", _in_one_call, 1.0, True),
    within("ik_out", "IK, a point out of reach, in s", 5e-3, "within 5 ms, the median"),
)
