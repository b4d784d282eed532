"""The loops of time_stepping.c in Python on CasADi's virtual machine: the reference for the C ones, and what runs without a compiler.

Implicit steps are Crouzeix's two-stage SDIRK: order 3, A- and B-stable, hardly any damping of the slow sway (Hairer and Wanner,
Solving Ordinary Differential Equations II, IV.6). The matrix of a stage is that of a network with stiffness
M / step² + d force / d positions, so it is as block tridiagonal as in statics. Explicit steps are the classical RK4.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.linalg import splu

from tepm_opt.models.backends.interface import (
    EXPLICIT,
    JUMP_TIME,
    MAX_CORRECTION,
    MAX_HALVINGS,
    STAGE_ITERATIONS,
    Drive,
    Effort,
    Record,
    Scheme,
    Status,
)
from tepm_opt.models.dynamics import Dynamics

GAMMA = 0.5 + np.sqrt(3) / 6


@dataclass
class _State:
    """Levels, velocities, last acceleration, inputs, internal states; `d` the same along the directions (last axis)."""

    x: np.ndarray
    v: np.ndarray
    acceleration: np.ndarray
    u: np.ndarray
    y_inputs: np.ndarray
    y_edges: np.ndarray
    depth: int = 0  # halvings the last step took
    a: np.ndarray = field(default_factory=lambda: np.zeros(0))
    d: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass
class _Stage:
    """Rates at the end of an implicit stage, and along the directions."""

    x: np.ndarray
    v: np.ndarray
    y: np.ndarray
    d: dict[str, np.ndarray]


class _Unsolved(Exception):  # noqa: N818  control flow, not an error of the caller
    """Newton's method has failed; a shorter step may do."""


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

    def start(self, x: np.ndarray, directions: int) -> _State:
        """See `TimeStepper.start`."""
        dynamics, inputs = self.dynamics, self.dynamics.layout.inputs
        edges = (self.n, dynamics.edge_states)
        sizes = {"x": x.shape, "v": x.shape, "u": (inputs,), "y_inputs": (dynamics.input_states,), "y_edges": edges}
        zero = {name: np.zeros(size) for name, size in sizes.items()}
        d = {name: np.zeros((*size, directions)) for name, size in sizes.items()} if directions else {}
        return _State(x.copy(), zero["v"], np.zeros_like(x), zero["u"], zero["y_inputs"], zero["y_edges"], d=d)

    def integrate(
        self, state: _State, drive: Drive, first: int, last: int, scheme: Scheme, theta: np.ndarray, record: Record
    ) -> tuple[Status, Effort]:
        """See `TimeStepper.integrate`."""
        run = _Run(self, drive, theta, scheme)
        run.effort.reached = float(drive.time[first])
        if first == 0:
            run.begin(state)
            run.record(state, record, 0)
        for k in range(first, last):
            span = drive.time[k + 1] - drive.time[k]
            count = int(np.ceil(span / scheme.step * (1 - 1e-9)))
            if drive.hold:
                run.move_inputs(state, drive.time[k], JUMP_TIME, left=False)
            for i in range(count):
                try:
                    run.advance(state, drive.time[k] + i * span / count, span / count, 0)
                except _Unsolved:
                    return Status.STUCK, run.effort
                if not np.abs(state.x[1:]).sum() < 1e3 * state.x[1:].size:
                    return Status.DIVERGED, run.effort
                run.effort.reached = float(drive.time[k] + (i + 1) * span / count)
            run.record(state, record, k + 1)
        return Status.SOLVED, run.effort


class _Run:
    """One integration: the time stepper's functions with what stays the same."""

    def __init__(self, of: PythonTimeStepper, drive: Drive, theta: np.ndarray, scheme: Scheme) -> None:
        self.of, self.drive, self.theta, self.scheme = of, drive, theta, scheme
        self.inputs = of.dynamics.layout.inputs
        self.thetas = np.broadcast_to(theta, (of.n, len(theta)))
        self.delay = float(of.values("delay", theta)[0].item())
        self.d_delay = (of._sparse("delay_by", theta) @ drive.d_theta.T).ravel()
        self.effort = Effort()
        self.P, self.external, self.level_0 = np.zeros((of.n, 1)), np.zeros(0), np.zeros(0)

    def look(self, t: float, left: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Row at a time, its slope, and its change along the directions (row, directions); `left`: just before a jump."""
        drive = self.drive
        if drive.hold:
            t += -JUMP_TIME if left else JUMP_TIME  # a sample's time may come with rounding
        k = int(np.clip(np.searchsorted(drive.time, t, side="right") - 1, 0, len(drive.time) - 2))
        part = (t - drive.time[k]) / (drive.time[k + 1] - drive.time[k])
        part = float(part >= 1) if drive.hold else min(max(part, 0.0), 1.0)
        change = drive.rows[k + 1] - drive.rows[k]
        slope = change / (drive.time[k + 1] - drive.time[k]) if 0 < part < 1 else np.zeros_like(change)
        along = np.zeros((len(change), len(drive.d_theta)))
        if drive.d_rows is not None:
            along = (drive.d_rows[k] + part * (drive.d_rows[k + 1] - drive.d_rows[k])).T
        return drive.rows[k] + part * change, slope, along

    def move_inputs(self, state: _State, until: float, duration: float, left: bool) -> None:
        row, slope, along = (part[: self.inputs] for part in self.look(until - self.delay, left))
        rate = (row - state.u) / duration
        arguments = row, rate, state.y_inputs, duration, self.theta
        a, y = (result.ravel() for result in self.of.values("input_motion", *arguments))
        if state.d:
            along = along - np.outer(slope, self.d_delay)
            stacked = np.concatenate([along, (along - state.d["u"]) / duration, state.d["y_inputs"], self.drive.d_theta.T])
            state.d["u"] = along
            state.d["a"], state.d["y_inputs"] = np.split(self.of._sparse("input_motion_by", *arguments) @ stacked, [self.inputs])
        state.u, state.a, state.y_inputs = row, a, y

    def set_properties(self, a: np.ndarray, t: float) -> None:
        self.external = self.look(t, False)[0][self.inputs :]
        columns, level_0 = self.of.values("properties", a, self.external.reshape(-1, 3), self.theta)
        self.P, self.level_0 = np.ascontiguousarray(columns.T), level_0.ravel()

    @property
    def mass(self) -> np.ndarray:
        return self.P[:, self.of.mass_row, None]

    def _segments(self, name: str, x: np.ndarray, v: np.ndarray, y: np.ndarray, step: float) -> list[ca.DM]:
        steps = np.full((self.of.n, 1), step)
        return self.of._call(name, x[:-1], x[1:], v[:-1], v[1:], y, steps, self.P, self.thetas)

    def forces(self, x: np.ndarray, v: np.ndarray, y: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
        """Force on the levels 1 … n and rates of the edge states."""
        force, rate = (np.array(result).T for result in self._segments("segment_motion", x, v, y, step))
        return self._gather(force), rate.reshape(y.shape)

    def _gather(self, pairs: np.ndarray) -> np.ndarray:
        """Sum over segments of values at their lower and upper level, (n, 2 · block, …), on the levels 1 … n."""
        total = pairs[:, self.of.block :].copy()
        total[:-1] += pairs[1:, : self.of.block]
        return total

    def _factor(self, blocks: np.ndarray, diagonal: np.ndarray | float) -> Any:
        """Factor of the free levels' matrix from the segments' matrices (n, 2 · block, 2 · block)."""
        free = (self.of._rows >= 0) & (self.of._columns >= 0)
        size = self.of.n * self.of.block
        entries = blocks.reshape(self.of.n, -1)[free]
        matrix = coo_array((entries, (self.of._rows[free], self.of._columns[free])), shape=(size, size))
        at = np.arange(size)
        total = matrix + coo_array((np.broadcast_to(diagonal, (self.of.n, self.of.block)).ravel(), (at, at)), shape=(size, size))
        self.effort.factors += 1
        return splu(total.tocsc())

    def tangent(self, x: np.ndarray, v: np.ndarray, y: np.ndarray, step: float) -> Any:
        columns = np.array(self._segments("segment_tangent", x, v, y, step)[2]).T
        blocks = columns.reshape(self.of.n, 2 * self.of.block, 2 * self.of.block).swapaxes(1, 2)
        return self._factor(blocks, self.mass / step**2)

    def newton(
        self, x: np.ndarray, x_0: np.ndarray, v_0: np.ndarray, y: np.ndarray, step: float, factor: Any, last_try: bool
    ) -> tuple[np.ndarray, Any]:
        """Positions at the end of a stage and the factor last used."""
        before, rate, guess = np.inf, 1.0, x
        for iteration in range(STAGE_ITERATIONS):
            v = (x - x_0) / step
            v[0] = 0
            force, _ = self.forces(x, v, y, step)
            factor = factor or self.tangent(x, v, y, step)
            residual = force + self.mass / step * (v - v_0)[1:]
            largest = float(np.abs(residual).max())
            if largest < self.scheme.tolerance:
                return x, factor
            if not largest < 1e12:
                break
            rate = largest / before if iteration else 1.0
            x = x.copy()
            x[1:] -= factor.solve(residual.ravel()).reshape(residual.shape)
            if np.abs(x - guess).max() > MAX_CORRECTION and not last_try:
                break  # too far to trust that this is the solution nearby
            factor = None if rate > 0.3 and iteration else factor
            self.effort.iterations += 1
            before = largest
            if not self.of.dynamics.edge_states and iteration and largest * rate < self.scheme.tolerance:
                return x, factor  # the step just taken has done it
        raise _Unsolved

    def differentiate(self, t: float, step: float, stage: _Stage, x: np.ndarray, v: np.ndarray, y: np.ndarray, a: np.ndarray,
                      d_a: np.ndarray, v_0: np.ndarray, factor: Any) -> dict[str, np.ndarray]:  # fmt: skip
        """Rates at a stage's end along the directions, from `stage.d` at its start; without a step, how the equilibrium moves."""
        of, d = self.of, stage.d
        directions = d["x"].shape[-1]
        outer = np.concatenate([d_a, self.look(t, False)[2][self.inputs :], self.drive.d_theta.T])
        d_outer = of._sparse("properties_by", a, self.external.reshape(-1, 3), self.theta) @ outer
        d_P, d["x"][0] = d_outer[: self.P.size].reshape(*self.P.shape, directions), d_outer[self.P.size :]
        by = of.segment_jacobian(x, v, y, step, self.P, self.thetas)
        block = of.block
        if factor is None:
            factor = self._factor(by[:, : 2 * block, : 2 * block], 0.0)

        def pairs(levels: np.ndarray) -> np.ndarray:
            return np.concatenate([levels[:-1], levels[1:]], axis=1)

        still = np.zeros((of.n, 2 * block, directions))
        thetas = np.broadcast_to(self.drive.d_theta.T, (of.n, *self.drive.d_theta.T.shape))
        known = np.concatenate([pairs(d["x"]), still, d["y"], d_P, thetas], axis=1)
        rhs = -self._gather((by @ known)[:, : 2 * block])
        if step > 0:
            rhs += (self.mass[..., None] * d["v"][1:] - d_P[:, of.mass_row, None] * (v - v_0)[1:, :, None]) / step
        moved = factor.solve(rhs.reshape(-1, directions)).reshape(rhs.shape)
        d_x = d["x"].copy()
        d_x[1:] += moved
        if not step > 0:
            return {"x": d_x}
        d_v = np.zeros_like(d_x)
        d_v[1:] = moved / step
        known[:, : 2 * block], known[:, 2 * block : 4 * block] = pairs(d_x), pairs(d_v)
        return {"x": d_v, "v": (d_v - d["v"]) / step, "y": (by @ known)[:, 2 * block :]}

    def begin(self, state: _State) -> None:
        """Rest under the first row, and how it moves along the directions."""
        t = float(self.drive.time[0])
        state.u, _, along = (part[: self.inputs] for part in self.look(t, False))
        if state.d:
            state.d["u"] = along
        self.move_inputs(state, t + self.delay, JUMP_TIME, left=False)
        self.set_properties(state.a, t)
        state.x[0] = self.level_0
        if state.d:
            rest = _Stage(
                state.x, state.v, state.y_edges, {name: np.zeros_like(state.d[key]) for name, key in (("x", "x"), ("y", "y_edges"))}
            )
            state.d["x"] = self.differentiate(t, 0.0, rest, state.x, state.v, state.y_edges, state.a, state.d["a"], state.v, None)["x"]

    def advance(self, state: _State, t: float, h: float, depth: int) -> None:
        """A step, or two halves of it where Newton fails or the step before had to be halved twice."""
        if self.scheme.kind == EXPLICIT:
            self.explicit_step(state, t, h)
            self.effort.steps += 1
            return
        if state.depth <= depth + 1:
            kept = state.u, state.y_inputs, state.a, dict(state.d)
            try:
                self.implicit_step(state, t, h, last_try=depth == MAX_HALVINGS)
            except _Unsolved:
                state.u, state.y_inputs, state.a, state.d = kept
                if depth == MAX_HALVINGS:
                    raise
                self.effort.halvings += 1
            else:
                state.depth = depth
                self.effort.steps += 1
                return
        self.advance(state, t, h / 2, depth + 1)
        self.advance(state, t + h / 2, h / 2, depth + 1)

    def implicit_step(self, state: _State, t: float, h: float, last_try: bool) -> None:
        step, times = GAMMA * h, (t + GAMMA * h, t + (1 - GAMMA) * h)
        a: list[np.ndarray] = [np.zeros(0)] * 2
        d_a: list[np.ndarray] = [np.zeros(0)] * 2
        for k, (until, duration) in enumerate(((times[1], (1 - GAMMA) * h), (times[0], (2 * GAMMA - 1) * h), (t + h, (1 - GAMMA) * h))):
            self.move_inputs(state, until, duration, left=k == 2)
            if k < 2:
                a[1 - k], d_a[1 - k] = state.a, state.d.get("a", d_a[0])
        stages: list[_Stage] = []
        factor, acceleration = None, state.acceleration
        for i in range(2):
            before = (1 - 2 * GAMMA) * h
            self.set_properties(a[i], times[i])

            def at_start(value: np.ndarray, rates: str, before: float = before) -> np.ndarray:
                return value + before * getattr(stages[0], rates) if stages else value

            x_0, v_0, y = at_start(state.x, "x"), at_start(state.v, "v"), at_start(state.y_edges, "y")
            x = x_0 + step * (v_0 + step * acceleration)
            x[0] = self.level_0
            x, factor = self.newton(x, x_0, v_0, y, step, factor, last_try)
            v = (x - x_0) / step
            v[0] = 0
            stage = _Stage(v, (v - v_0) / step, self.forces(x, v, y, step)[1], {})
            if state.d:
                start = {
                    name: state.d[key] + (before * stages[0].d[name] if stages else 0)
                    for name, key in (("x", "x"), ("v", "v"), ("y", "y_edges"))
                }
                stage.d = start
                stage.d = self.differentiate(times[i], step, stage, x, v, y, a[i], d_a[i], v_0, self.tangent(x, v, y, step))
            acceleration = stage.v
            stages.append(stage)
        state.acceleration = acceleration
        x_0 = state.x[0].copy()
        state.x = state.x + h / 2 * (stages[0].x + stages[1].x)
        state.v = state.v + h / 2 * (stages[0].v + stages[1].v)
        state.y_edges = state.y_edges + h / 2 * (stages[0].y + stages[1].y)
        state.x[0] = x_0
        if state.d:
            for name, key in (("x", "x"), ("v", "v"), ("y", "y_edges")):
                state.d[key] = state.d[key] + h / 2 * (stages[0].d[name] + stages[1].d[name])

    def explicit_step(self, state: _State, t: float, h: float) -> None:
        x, v, y = state.x, state.v, state.y_edges
        rates = [np.zeros_like(x), np.zeros_like(v), np.zeros_like(y)]
        sums = [np.zeros_like(x), np.zeros_like(v), np.zeros_like(y)]
        for i, (at, weight) in enumerate(zip((0, 0.5, 0.5, 1), (1 / 6, 1 / 3, 1 / 3, 1 / 6), strict=True)):
            if i in (1, 3):
                self.move_inputs(state, t + at * h, h / 2, left=i == 3)
            if i != 2:
                self.set_properties(state.a, t + at * h)
            here = [start + at * h * rate for start, rate in zip((x, v, y), rates, strict=True)]
            here[0][0] = self.level_0
            force, rate = self.forces(*here, 0.0)
            acceleration = np.zeros_like(v)
            acceleration[1:] = -force / self.mass
            rates = [here[1], acceleration, rate]
            sums = [total + weight * change for total, change in zip(sums, rates, strict=True)]
        state.x, state.v, state.y_edges = (start + h * total for start, total in zip((x, v, y), sums, strict=True))

    def record(self, state: _State, record: Record, k: int) -> None:
        points, lengths = self.of.values("observe", state.x.ravel(), self.theta)
        record.observed[k] = np.concatenate([points.ravel(), lengths.ravel()])
        record.trajectory[k] = state.x, state.v
        if state.d:
            stacked = np.concatenate([state.d["x"].reshape(-1, len(self.drive.d_theta)), self.drive.d_theta.T])
            record.d_observed[k] = self.of._sparse("observe_by", state.x.ravel(), self.theta) @ stacked
