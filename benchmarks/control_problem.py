"""A predictive controller's problem, in states and inputs and condensed to the inputs, and the programs of a closed loop.

The slow motion of robot kang2017 at a point of the circle (`modal_model`), six tensions held for 20 ms each, N = 15 of them; the tip
follows a reference, tensions stay within 0 … 7 N and change by at most 0.2 N a stage.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from tepm_opt.control.mpc.qp import QpSolver
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode
from tepm_opt.solvers.kinematics.ik import solve_trajectory
from tepm_opt.solvers.linear.modal_model import modal_model
from tepm_opt.solvers.planning.trajectories import circle

STAGE, STAGES = 0.02, 15  # s
HIGHEST, RATE = 7.0, 0.2  # N; N a stage
TIP, SPREAD, CHANGE = 1e-3, 2.0, 0.3  # m, N, N: a deviation of the tip, of a tension, and a change that cost the same
STEPS = 100  # of the closed loop that the contenders go through again and again
LAP, RADIUS = 4.0, 0.02  # s and m, of the small circle about the point that the tip shall follow
UNKNOWN = 0.5  # N, amplitude of forces that the controller does not know of


@dataclass(frozen=True)
class Program:
    """What changes from step to step, and the answer.

    Attributes:
        state: of the reduced model at its beginning, (2 · modes,).
        before: tensions before, (6,) in N.
        wanted: displacement of the tip after each stage, (STAGES, 3) in m.
        gradient, row_low, row_high: of the condensed program.
        best: its first tensions, (6,) in N.
    """

    state: np.ndarray
    before: np.ndarray
    wanted: np.ndarray
    gradient: np.ndarray
    row_low: np.ndarray
    row_high: np.ndarray
    best: np.ndarray


@dataclass(frozen=True)
class Problem:
    """The controller's problem and the programs of a closed loop.

    Attributes:
        A, B: state after a stage from that before and the tensions, less those at the point.
        tip: of the states, (3, 2 · modes).
        rest: tensions at the point, (6,) in N.
        hessian, rows: of the condensed program.
        programs: of the steps, each 20 ms after the one before.
    """

    A: np.ndarray
    B: np.ndarray
    tip: np.ndarray
    rest: np.ndarray
    hessian: np.ndarray
    rows: np.ndarray
    programs: list[Program]

    @staticmethod
    def of(model: CompiledModel, modes: int) -> Problem:
        """At the first point of the circle; disturbed, so that some tensions meet their bounds."""
        at = solve_trajectory(model, circle().positions[:1], ActuationMode.HYBRID)[0].equilibrium
        local = modal_model(at, modes=modes)
        actuators = local.drive.shape[1]
        continuous = np.block([[np.zeros((modes, modes)), np.eye(modes)], [-np.diag(local.stiffness), -local.damping]])
        enter = np.concatenate([np.zeros((modes, actuators)), -local.drive])
        held = sla.expm(STAGE * np.block([[continuous, enter], [np.zeros((actuators, 2 * modes + actuators))]]))
        A, B = held[: 2 * modes, : 2 * modes], held[: 2 * modes, 2 * modes :]
        tip = np.hstack([local.observe[-3:], np.zeros((3, modes))])
        rest = np.full(actuators, HIGHEST / 2)
        size = STAGES * actuators
        response = np.zeros((STAGES, 3, STAGES, actuators))
        pulse = B
        for delay in range(STAGES):
            for stage in range(STAGES - delay):
                response[stage + delay, :, stage] = tip @ pulse
            pulse = A @ pulse
        flat = response.reshape(STAGES * 3, size)
        rows = np.eye(size) - np.eye(size, k=-actuators)
        hessian = flat.T @ flat / TIP**2 + np.eye(size) / SPREAD**2 + rows.T @ rows / CHANGE**2
        problem = Problem(A, B, tip, rest, hessian, rows, [])
        problem.programs.extend(problem._closed_loop(flat))
        return problem

    def _closed_loop(self, response: np.ndarray) -> Iterator[Program]:
        actuators, solver = len(self.rest), QpSolver(self.rows)
        free = np.concatenate([self.tip @ np.linalg.matrix_power(self.A, stage + 1) for stage in range(STAGES)])
        state, before = np.zeros(len(self.A)), self.rest
        low, high = np.zeros(len(self.rows)), np.full(len(self.rows), HIGHEST)
        for k in range(STEPS):
            turned = 2 * np.pi * STAGE / LAP * np.arange(k + 1, k + 1 + STAGES)
            wanted = RADIUS * np.stack([np.cos(turned) - 1, np.sin(turned), np.zeros(STAGES)], axis=1)
            ahead = (free @ state - wanted.ravel()) / TIP**2
            spread = np.tile(self.rest, STAGES)
            first = np.concatenate([before, np.zeros(len(self.rows) - actuators)])
            gradient = response.T @ (ahead - response @ spread / TIP**2) - spread / SPREAD**2 - self.rows.T @ first / CHANGE**2
            row_low, row_high = first - RATE, first + RATE
            found = solver.solve(self.hessian, gradient, low, high, row_low, row_high)
            if found.x is None:
                raise RuntimeError(f"step {k} of the closed loop: {found.outcome}")
            best = found.x[:actuators]
            yield Program(state, before, wanted, gradient, row_low, row_high, best)
            push = UNKNOWN * np.sin(0.3 * k + np.arange(actuators))
            state, before = self.A @ state + self.B @ (best - self.rest + push), best
