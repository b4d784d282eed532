"""What one would simulate with otherwise: CVODES through CasADi on the whole network, and the network in MuJoCo."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import casadi as ca
import mujoco
import numpy as np

from benchmarks.scene import Scene, free
from benchmarks.workshop import Workshop
from tepm_opt.hw.simulation.imperfections.base import Body
from tepm_opt.hw.simulation.mujoco_network import MujocoNetwork

TOLERANCES: dict[str, dict[str, float]] = {
    "1e-4": {"reltol": 1e-4, "abstol": 1e-4},
    "default tolerances": {},
    "1e-8": {"reltol": 1e-8, "abstol": 1e-8},
}


def cvodes_name(tolerance: str, compiled: bool = True) -> str:
    """Name of a CVODES contender."""
    return f"CVODES, {tolerance}, {'generated C' if compiled else 'virtual machine'}"


def cvodes(scene: Scene, workshop: Workshop, times: np.ndarray, quick: bool) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Names and calls; a call returns the state at all times but the first.

    CVODES' Newton matrix is exact and sparse, factorised by CSparse, which takes two thirds of the time of CasADi's default. The
    right-hand side and its Jacobian are compiled once for all tolerances, which `jit` would not do.
    """
    network = scene.network
    state = ca.vertcat(network.x, network.v)
    ode = ca.vertcat(network.v, network.acceleration)
    start, force = np.concatenate([free(scene.rest), np.zeros(network.v.numel())]), scene.forces(scene.bent.inputs)
    written = {"x": state, "p": network.force, "ode": ode}
    time, none = ca.SX.sym("t"), ca.SX(0, 1)
    arguments = [time, state, ca.SX.sym("z", 0), network.force, ca.SX.sym("u", 0)]
    names = ["t", "x", "z", "p", "u"], ["ode", "alg", "quad", "zero"]
    dae = ca.Function("dae", arguments, [ode, none, none, none], *names)
    compiled = ca.external("dae", str(workshop.link("dae", [workshop.compiled_object("dae", [dae, dae.jacobian()])])))

    for is_compiled, equations in ((True, compiled), (False, written)):
        for name, tolerance in TOLERANCES.items():
            if not (quick and not is_compiled):
                options = {"linear_solver": "csparse", **tolerance}
                solver = ca.integrator("cvodes", "cvodes", equations, times[0], times[1:].tolist(), options)
                yield cvodes_name(name, is_compiled), lambda solver=solver: solver(x0=start, p=force)["xf"]


class MujocoRun:
    """The motion in MuJoCo with RK4: one call a sample, no Python in a step."""

    def __init__(self, scene: Scene, step: float, sample: float, samples: int) -> None:
        self._network = MujocoNetwork(Body.from_robot(scene.model.robot), step)
        self._start = free(scene.rest) - self._network.rest[1:].ravel()
        self._force = scene.forces(scene.bent.inputs)
        self._sample, self._samples, self._steps = sample, samples, round(sample / step)

    def simulate(self) -> np.ndarray:
        """Displacements from the rest geometry at all samples but the first, (samples, coordinates) in m."""
        network = self._network
        mujoco.mj_resetData(network.model, network.data)  # type: ignore[attr-defined]
        network.data.qpos[:] = self._start
        network.drive(network.push(np.array([self._force, self._force]), None), self._sample)
        found = np.empty((self._samples, len(self._start)))
        for row in found:
            network.advance(self._steps)
            row[:] = network.data.qpos
        return found

    def coordinates(self, displacements: np.ndarray) -> np.ndarray:
        """Coordinates of the free nodes as the peers order them."""
        return displacements + self._network.rest[1:].ravel()
