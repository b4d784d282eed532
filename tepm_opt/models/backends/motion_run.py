"""One motion in Python: implicit and explicit steps with sensitivities (see motion_steps.c and motion_tangents.c)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tepm_opt.models.backends.interface import EXPLICIT, JUMP_TIME, MAX_HALVINGS, STAYS, Status
from tepm_opt.models.backends.motion_interface import Record
from tepm_opt.models.backends.motion_stages import Stage, StageEnd, Stages, State, Unsolved

GAMMA = 0.5 + np.sqrt(3) / 6


class Run(Stages):
    """One integration, step by step."""

    def take_stock(self, state: State, t: float) -> None:
        """The edges' pulls where the motion stands."""
        self.tell(t)
        arguments = state.u, 0 * state.u, state.y_inputs, JUMP_TIME, self.theta
        self.set_properties(self.of.values("input_motion", *arguments)[0].ravel(), t)
        self.forces(state.x, state.v, state.y_edges, 0.0)
        self.trusted = self.pull

    def jump(self, state: State, t: float) -> None:
        """Move to just after a jump of the inputs, where they hold; what was expected of the accelerations is void."""
        self.move_inputs(state, self.known_at(t), JUMP_TIME, left=False)
        state.past = ((), ())

    def steps_to(self, state: State, k: int, record: Record) -> Status:
        """Steps of equal length, at most the scheme's, from sample k to the next."""
        span = self.drive.time[k + 1] - self.drive.time[k]
        count = int(np.ceil(span / self.scheme.step * (1 - 1e-9)))
        if self.drive.hold:
            self.jump(state, self.drive.time[k])
        for i in range(count):
            try:
                self.advance(state, self.drive.time[k] + i * span / count, span / count, 0)
            except Unsolved:
                return Status.STUCK
            if not is_bounded(state):
                return Status.DIVERGED
            self.effort.reached = float(self.drive.time[k] + (i + 1) * span / count)
        self.record(record, k + 1, state.x, state.v, state.d.get("x"))
        return Status.SOLVED

    def differentiate(self, t: float, step: float, stage: Stage, end: StageEnd, factor: Any) -> dict[str, np.ndarray]:
        """Rates at a stage's end along the directions; without a step, how the equilibrium moves.

        Args:
            t, step: time of the stage and its length in s.
            stage: its `d` is what the directions are at its start.
            end: solution there.
            factor: of its matrix; None without a step.
        """
        of, d, (x, v, y, a, d_a, v_0) = self.of, stage.d, end
        directions = d["x"].shape[-1]
        _, slope, along = self.look(self.known_at(t, forces=True), False)
        d_external = (along - np.outer(slope, self.later(forces=True)))[self.inputs :]
        outer = np.concatenate([d_a, d_external, self.drive.d_theta.T])
        d_outer = of._sparse("properties_by", a, self.external.reshape(-1, 3), self.theta) @ outer
        d_P, d["x"][0] = d_outer[: self.P.size].reshape(*self.P.shape, directions), d_outer[self.P.size :]
        by = of.segment_jacobian(x, v, y, step, self.P, self.thetas)
        block = of.block
        if factor is None:
            blocks = by[:, : 2 * block, : 2 * block]
            own = np.einsum("njj->nj", blocks)
            held = own[:, block:] + np.vstack([own[1:, :block], np.zeros(block)])
            factor = self._factor(blocks, np.where(held == 0, STAYS, 0.0))

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

    def set_initial_state(self, state: State) -> None:
        """Set a state to rest under the first row, with its derivatives along the directions."""
        t = float(self.drive.time[0])
        state.u, _, along = (part[: self.inputs] for part in self.look(t, False))
        if state.d:
            state.d["u"] = along
        self.tell(t)
        self.move_inputs(state, t, JUMP_TIME, left=False)
        self.set_properties(state.a, t)
        state.x[0] = self.level_0
        if state.d:
            rest = Stage(
                state.x, state.v, state.y_edges, {name: np.zeros_like(state.d[key]) for name, key in (("x", "x"), ("y", "y_edges"))}
            )
            end = StageEnd(state.x, state.v, state.y_edges, state.a, state.d["a"], state.v)
            state.d["x"] = self.differentiate(t, 0.0, rest, end, None)["x"]

    def advance(self, state: State, t: float, h: float, depth: int) -> None:
        """Take a step, or two halves of it where Newton fails or the step before had to be halved twice.

        Args:
            state: what is moved.
            t, h: start and length in s.
            depth: halvings until here.
        """
        if self.scheme.kind == EXPLICIT:
            self.explicit_step(state, t, h)
            self.effort.steps += 1
            self.effort.longest = max(self.effort.longest, h)
            return
        if state.depth <= depth + 1:
            kept = replace(state, d=dict(state.d))
            try:
                self.implicit_step(state, state, t, h, last_try=depth == MAX_HALVINGS)
            except Unsolved:
                vars(state).update(vars(kept))
                if depth == MAX_HALVINGS:
                    raise
                self.effort.halvings += 1
            else:
                state.depth = depth
                self.effort.steps += 1
                self.effort.longest = max(self.effort.longest, h)
                return
        self.advance(state, t, h / 2, depth + 1)
        self.advance(state, t + h / 2, h / 2, depth + 1)

    def implicit_step(self, state: State, guide: State, t: float, h: float, last_try: bool) -> None:
        """One step, its iterations started from what another motion, or itself, expects.

        Args:
            state: what is moved.
            guide: whose past tells what to expect.
            t, h: start and length in s.
            last_try: whether a solution far from what is expected is taken, too.
        """
        step, times = GAMMA * h, (t + GAMMA * h, t + (1 - GAMMA) * h)
        a: list[np.ndarray] = [np.zeros(0)] * 2
        d_a: list[np.ndarray] = [np.zeros(0)] * 2
        for k, (until, duration) in enumerate(((times[1], (1 - GAMMA) * h), (times[0], (2 * GAMMA - 1) * h), (t + h, (1 - GAMMA) * h))):
            self.move_inputs(state, self.known_at(until), duration, left=k == 2)
            if k < 2:
                a[1 - k], d_a[1 - k] = state.a, state.d.get("a", d_a[0])
        stages: list[Stage] = []
        acceleration = state.acceleration
        for i in range(2):
            before = (1 - 2 * GAMMA) * h
            self.set_properties(a[i], times[i])

            def at_start(value: np.ndarray, rates: str, before: float = before) -> np.ndarray:
                return value + before * getattr(stages[0], rates) if stages else value

            x_0, v_0, y = at_start(state.x, "x"), at_start(state.v, "v"), at_start(state.y_edges, "y")
            x = x_0 + step * (v_0 + step * extrapolate_acceleration(guide.past[i], acceleration, times[i]))
            x[0] = self.level_0
            x, rate = self.newton(x, x_0, v_0, y, step, last_try)
            self.trusted, v = self.pull, self.velocities(x, x_0, step)
            stage = Stage(v, (v - v_0) / step, rate, {})
            past = ((times[i], stage.v), *state.past[i][:1])
            state.past = (past, state.past[1]) if i == 0 else (state.past[0], past)
            if state.d:
                start = {
                    name: state.d[key] + (before * stages[0].d[name] if stages else 0)
                    for name, key in (("x", "x"), ("v", "v"), ("y", "y_edges"))
                }
                stage.d = start
                self.forces(x, v, y, step)  # the pulls at the solution, for the exact matrix
                self.trusted = self.pull
                end = StageEnd(x, v, y, a[i], d_a[i], v_0)
                stage.d = self.differentiate(times[i], step, stage, end, self.tangent(x, v, y, step))
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

    def explicit_step(self, state: State, t: float, h: float) -> None:
        """Take a step of RK4 of length h from t."""
        x, v, y = state.x, state.v, state.y_edges
        rates = [np.zeros_like(x), np.zeros_like(v), np.zeros_like(y)]
        sums = [np.zeros_like(x), np.zeros_like(v), np.zeros_like(y)]
        for i, (at, weight) in enumerate(zip((0, 0.5, 0.5, 1), (1 / 6, 1 / 3, 1 / 3, 1 / 6), strict=True)):
            if i in (1, 3):
                self.move_inputs(state, self.known_at(t + at * h), h / 2, left=i == 3)
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

    def record(self, record: Record, k: int, x: np.ndarray, v: np.ndarray, d_x: np.ndarray | None) -> None:
        """Fill a row.

        Args:
            record: whose.
            k: number of the row.
            x, v: levels and velocities.
            d_x: change of the levels along the directions; None without.
        """
        self.tell(float(self.drive.time[k]))
        points, lengths = self.of.values("observe", x.ravel(), self.theta)
        record.observed[k] = np.concatenate([points.ravel(), lengths.ravel()])
        record.trajectory[k] = x, v
        if d_x is not None:
            stacked = np.concatenate([d_x.reshape(-1, len(self.drive.d_theta)), self.drive.d_theta.T])
            record.d_observed[k] = self.of._sparse("observe_by", x.ravel(), self.theta) @ stacked


def extrapolate_acceleration(past: tuple[tuple[float, np.ndarray], ...], latest: np.ndarray, t: float) -> np.ndarray:
    """Extrapolate a stage's acceleration from the same stage of the steps before; the latest stage's without them."""
    if len(past) < 2:
        return past[0][1] if past else latest
    (t_0, a_0), (t_1, a_1) = past
    return a_0 + (t - t_0) / (t_0 - t_1) * (a_0 - a_1)


def is_bounded(state: State) -> bool:
    """Whether a motion is within all bounds."""
    return bool(np.abs(state.x[1:]).sum() < 1e3 * state.x[1:].size)
