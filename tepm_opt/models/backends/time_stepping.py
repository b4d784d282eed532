"""The loops of time_stepping.c and motion_*.c in Python on CasADi's virtual machine: the reference, and what runs without a compiler.

Implicit steps are Crouzeix's two-stage SDIRK: order 3, A- and B-stable, hardly any damping of the slow sway (Hairer and Wanner,
Solving Ordinary Differential Equations II, IV.6). The matrix of a stage is that of a network with stiffness
M / step² + d force / d positions, so it is as block tridiagonal as in statics. Explicit steps are the classical RK4.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import csr_array

from tepm_opt.models.backends.interface import Status
from tepm_opt.models.backends.motion_adaptive import Carried, adapt
from tepm_opt.models.backends.motion_interface import Drive, Effort, Record, Scheme
from tepm_opt.models.backends.motion_run import Run
from tepm_opt.models.backends.motion_stages import State
from tepm_opt.models.backends.step_control import FIRST_STEP
from tepm_opt.models.dynamics import Dynamics


class PythonTimeStepper:
    """Reference backend."""

    def __init__(self, dynamics: Dynamics) -> None:
        self.dynamics = dynamics
        layout = dynamics.layout
        self.n, self.block = layout.levels, layout.block
        self.mass_row = dynamics.functions["properties"].size1_out(0) - 1
        window = np.arange(2 * self.block)
        at = [window + (s - 1) * self.block for s in range(self.n)]  # free levels only; level 0 has negative numbers
        self._rows = np.array([np.repeat(index, 2 * self.block) for index in at])
        self._columns = np.array([np.tile(index, 2 * self.block) for index in at])

    @cached_property
    def _mapped(self) -> dict[str, ca.Function]:
        return {name: function.map(self.n) for name, function in self.dynamics.functions.items() if name.startswith("segment_")}

    def _call(self, name: str, *arguments: Any) -> list[ca.DM]:
        function = self._mapped.get(name) or self.dynamics.functions[name]
        return function.call([ca.DM(argument.T if np.ndim(argument) == 2 else argument) for argument in arguments])

    def values(self, name: str, *arguments: Any) -> list[np.ndarray]:
        """Results of a function of the motion that is not one of a segment."""
        return [np.array(result) for result in self._call(name, *arguments)]

    def _sparse(self, name: str, *arguments: Any) -> csr_array:
        """Jacobian of a function that is not one of a segment."""
        pattern = self.dynamics.functions[name].sparsity_out(0)
        return csr_array((self._call(name, *arguments)[0].nonzeros(), (pattern.row(), pattern.get_col())), shape=pattern.shape)

    def value(self, name: str, *arguments: Any) -> np.ndarray:
        """First result of a function of the motion that is not one of a segment."""
        return self.values(name, *arguments)[0]

    def jacobian(self, name: str, *arguments: Any) -> np.ndarray:
        """Jacobian of a function that is not one of a segment, as a full matrix."""
        return self._sparse(name, *arguments).toarray()

    def segment_jacobians(self, x: np.ndarray, P: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """`segment_by` of all segments at rest in an equilibrium: (n, 2 · block + edge states, arguments)."""
        still, y = np.zeros_like(x), np.zeros((self.n, self.dynamics.edge_states))
        return self.segment_jacobian(x, still, y, 0.0, P, np.broadcast_to(theta, (self.n, len(theta))))

    def segment_jacobian(self, x: np.ndarray, v: np.ndarray, y: np.ndarray, step: float, P: np.ndarray, thetas: np.ndarray) -> np.ndarray:
        """`segment_by` of all segments, full matrices (n, 2 · block + edge states, arguments).

        Args:
            x, v: levels and velocities, (n + 1, block) in m and m/s.
            y, step: edge states (n, edge states), and length of the stage in s.
            P, thetas: properties (n, rows), and parameters of each segment (n, parameters).
        """
        pattern = self.dynamics.functions["segment_by"].sparsity_out(0)
        values = self._call("segment_by", x[:-1], x[1:], v[:-1], v[1:], y, np.full((self.n, 1), step), P, thetas)[0]
        by = np.zeros((self.n, *pattern.shape))
        by[:, pattern.row(), pattern.get_col()] = np.array(values.nonzeros()).reshape(self.n, -1)
        return by

    def start(self, x: np.ndarray, directions: int) -> Carried:
        """See `TimeStepper.start`."""
        dynamics, inputs = self.dynamics, self.dynamics.layout.inputs
        edges = (self.n, dynamics.edge_states)
        sizes = {"x": x.shape, "v": x.shape, "u": (inputs,), "y_inputs": (dynamics.input_states,), "y_edges": edges}
        zero = {name: np.zeros(size) for name, size in sizes.items()}
        d = {name: np.zeros((*size, directions)) for name, size in sizes.items()} if directions else {}
        state = State(x.copy(), zero["v"], np.zeros_like(x), zero["u"], zero["y_inputs"], zero["y_edges"], d=d)
        return Carried(state, state)

    def integrate(self, state: Carried, drive: Drive, first: int, last: int, scheme: Scheme, record: Record) -> tuple[Status, Effort]:
        """See `TimeStepper.integrate`."""
        run = Run(self, drive, scheme)
        run.effort.reached = float(drive.time[first])
        if first == 0:
            run.set_initial_state(state.fine)
            run.record(record, 0, state.fine.x, state.fine.v, state.fine.d.get("x"))
            state.coarse, state.step, state.ratio = replace(state.fine, d=dict(state.fine.d)), FIRST_STEP, 1.0
        run.take_stock(state.fine, float(drive.time[first]))
        if not scheme.step > 0:
            status = adapt(run, state, first, last, record)
            run.effort.error = state.error
            return status, run.effort
        for k in range(first, last):
            status = run.steps_to(state.fine, k, record)
            if status != Status.SOLVED:
                return status, run.effort
        return Status.SOLVED, run.effort
