"""One motion in Python: inputs over time, forces, stages solved (see time_stepping.c and motion_network.c)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import casadi as ca
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu

from tepm_opt.models.backends.interface import JUMP_TIME, MAX_CORRECTION, STAGE_ITERATIONS
from tepm_opt.models.backends.motion_interface import Drive, Effort, Scheme
from tepm_opt.models.backends.rotations import move
from tepm_opt.models.backends.step_control import CLOSE, RICHARDSON, SLOW
from tepm_opt.models.effect import BEGAN, CLOCK

if TYPE_CHECKING:
    from tepm_opt.models.backends.time_stepping import PythonTimeStepper


@dataclass
class State:
    """Levels, velocities, last acceleration, inputs, internal states; `d` the same along the directions (last axis).

    `past` holds, for both stages, times and accelerations at the two latest steps, the latest first.
    """

    x: np.ndarray
    v: np.ndarray
    acceleration: np.ndarray
    u: np.ndarray
    y_inputs: np.ndarray
    y_edges: np.ndarray
    depth: int = 0  # halvings the last step took
    past: tuple[tuple[tuple[float, np.ndarray], ...], ...] = ((), ())
    a: np.ndarray = field(default_factory=lambda: np.zeros(0))
    d: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass
class Stage:
    """Rates at the end of an implicit stage, and along the directions."""

    x: np.ndarray
    v: np.ndarray
    y: np.ndarray
    d: dict[str, np.ndarray]


class StageEnd(NamedTuple):
    """Solution at the end of an implicit stage, for its derivatives.

    Attributes:
        x, v, y: positions and velocities there, edge states at the stage's start.
        a, d_a: effective actuation, and along the directions.
        v_0: velocities at the stage's start.
    """

    x: np.ndarray
    v: np.ndarray
    y: np.ndarray
    a: np.ndarray
    d_a: np.ndarray
    v_0: np.ndarray


class Unsolved(Exception):  # noqa: N818  control flow, not an error of the caller
    """Newton's method has failed; a shorter step may do."""


class Stages:
    """One integration: the time stepper's functions with what stays the same.

    Args:
        of: the time stepper.
        drive: inputs, forces and parameters.
        scheme: how to step.
    """

    def __init__(self, of: PythonTimeStepper, drive: Drive, scheme: Scheme) -> None:
        self.of, self.drive, self.theta, self.scheme = of, drive, drive.theta.copy(), scheme
        self.inputs = of.dynamics.layout.inputs
        self.thetas = np.broadcast_to(self.theta, (of.n, len(self.theta)))
        self.timed = [of.dynamics.parameter_names.index(name) for name in (CLOCK, BEGAN) if name in of.dynamics.parameter_names]
        self.effort = Effort()
        self.P, self.external, self.level_0 = np.zeros((of.n, 1)), np.zeros(0), np.zeros(0)
        self.divisor = RICHARDSON / 2 if scheme.smooth else 1.0
        self.close = 0.0 if scheme.step > 0 else CLOSE * scheme.error
        self.pull = self.trusted = np.zeros((of.n, len(of.dynamics.layout.edges)))

    def tell(self, t: float) -> None:
        """Tell functions what time it is, where an effect asks."""
        if self.timed:
            clock, began = self.timed
            self.theta[clock] = self.theta[began] + (t - self.drive.time[0])

    def known_at(self, t: float, forces: bool = False) -> float:
        """When what acts at a time was commanded, or when forces that act then are known of."""
        self.tell(t)
        return t - float(self.of.values("delay", self.theta)[0][int(forces)].item())

    def later(self, forces: bool = False) -> np.ndarray:
        """Derivatives of the delay of commands, or of known forces, along the directions at the time that functions know, (directions,)."""
        return np.asarray(self.of._sparse("delay_by", self.theta) @ self.drive.d_theta.T)[int(forces)]

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

    def move_inputs(self, state: State, at: float, duration: float, left: bool) -> None:
        """Move the inputs and their internal states on.

        Args:
            state: what is moved.
            at, duration: time of the inputs, and how long they take to move there, in s.
            left: whether to stop just before a jump at that time.
        """
        row, slope, along = (part[: self.inputs] for part in self.look(at, left))
        rate = (row - state.u) / duration
        arguments = row, rate, state.y_inputs, duration, self.theta
        a, y = (result.ravel() for result in self.of.values("input_motion", *arguments))
        if state.d:
            along = along - np.outer(slope, self.later())
            stacked = np.concatenate([along, (along - state.d["u"]) / duration, state.d["y_inputs"], self.drive.d_theta.T])
            state.d["u"] = along
            state.d["a"], state.d["y_inputs"] = np.split(self.of._sparse("input_motion_by", *arguments) @ stacked, [self.inputs])
        state.u, state.a, state.y_inputs = row, a, y

    def set_properties(self, a: np.ndarray, t: float) -> None:
        """P and level 0 under an effective actuation and the forces at a time."""
        self.external = self.look(self.known_at(t, forces=True), False)[0][self.inputs :]
        columns, level_0 = self.of.values("properties", a, self.external.reshape(-1, 3), self.theta)
        self.P, self.level_0 = np.ascontiguousarray(columns.T), level_0.ravel()

    @property
    def mass(self) -> np.ndarray:
        return self.P[:, self.of.mass_row, None]

    def _segments(self, name: str, x: np.ndarray, v: np.ndarray, y: np.ndarray, step: float, *more: np.ndarray) -> list[ca.DM]:
        steps = np.full((self.of.n, 1), step)
        return self.of._call(name, x[:-1], x[1:], v[:-1], v[1:], y, steps, self.P, self.thetas, *more)

    def forces(self, x: np.ndarray, v: np.ndarray, y: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
        """Force on the levels 1 … n and rates of the edge states.

        Args:
            x, v: positions and velocities, (n + 1, block).
            y: edge states at the start of a stage.
            step: its length in s; 0 takes y as they are.
        """
        force, rate, self.pull = (np.array(result).T for result in self._segments("segment_motion", x, v, y, step))
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
        """Factor of a stage's matrix.

        Args:
            x, v: positions and velocities, (n + 1, block).
            y: edge states at the start of the stage.
            step: its length in s.
        """
        columns = np.array(self._segments("segment_tangent", x, v, y, step, self.trusted)[3]).T
        blocks = columns.reshape(self.of.n, 2 * self.of.block, 2 * self.of.block).swapaxes(1, 2)
        return self._factor(blocks, self.mass / step**2)

    def newton(
        self, x: np.ndarray, x_0: np.ndarray, v_0: np.ndarray, y: np.ndarray, step: float, last_try: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Positions at the end of a stage and the rates of the edge states there.

        The matrix, written where the solution is expected but with the edges' pulls of the last stage that was solved, serves while
        it contracts.

        Args:
            x: positions to expect, (n + 1, block) in m.
            x_0, v_0, y: positions, velocities and edge states at the start of the stage.
            step: its length in s.
            last_try: whether a solution far from x is taken, too.

        Raises:
            Unsolved: none found.
        """
        factor, before, guess = None, np.inf, x
        for iteration in range(STAGE_ITERATIONS):
            force, rate = self.forces(x, self.velocities(x, x_0, step), y, step)
            factor = factor or self.tangent(x, self.velocities(x, x_0, step), y, step)
            residual = force + self.mass / step * (self.velocities(x, x_0, step) - v_0)[1:]
            largest = float(np.abs(residual).max())
            if largest < self.scheme.tolerance:
                return x, rate
            if not largest < 1e12:
                break
            change = np.zeros_like(x)
            change[1:] = factor.solve(residual.ravel()).reshape(residual.shape)
            x = move(x, -change)
            if np.abs(x - guess).max() > MAX_CORRECTION and not last_try:
                break  # too far to trust that this is the solution nearby
            self.effort.iterations += 1
            size = float(np.abs(change).max())
            contraction = size / before if iteration else 1.0
            before = size
            if contraction > SLOW and iteration:
                factor, self.trusted = None, self.pull
            if size * contraction < self.close or (iteration and largest * contraction < self.scheme.tolerance):  # this step has done it
                if self.of.dynamics.edge_states:
                    _, rate = self.forces(x, self.velocities(x, x_0, step), y, step)
                return x, rate
        raise Unsolved

    def velocities(self, x: np.ndarray, x_0: np.ndarray, step: float) -> np.ndarray:
        """Velocities of a stage that began at x_0."""
        v = (x - x_0) / step
        v[0] = 0
        return v
