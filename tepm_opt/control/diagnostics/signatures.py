"""Signatures of changes of the machine in tracked points and gauges: rows of regressions, one for a block of samples.

Tracked points are compared with where the model has the arm under the pressures and tensions that are measured, linearised about the
reference; what the arm's own motion makes of it (inertia, damping) is taken from the points themselves. Gauges are compared with what
devices do by their commands: tensions with those that motors have been told, pressures by the rate at which they follow,
dp/dt = (command - p) / time constant.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from tepm_opt.control.estimation.dahl_friction import dahl_step
from tepm_opt.control.references.reference import Reference
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.devices import Devices
from tepm_opt.solvers.linear.modal_model import ModalModel, modal_model

BLOCK = 10  # samples in a row of the regressions
ATMOSPHERE = 101_325.0  # Pa
PRESLIDING = np.array([[5e-4], [5e-3]])  # m over which dry friction turns over: that of the tendons, and of what gives more
WIDTH = np.array([[0.5], [2.5]])  # N of p A over which hysteresis turns over
SHARE = 0.8  # of the friction that is in proportion to the tension
SMALL = 1e-5  # of the squares by which points tell modes, below which they do not
DIFFERS = {
    "strength": 0.08, "stiffness": 0.06, "tension": 0.1, "force": 0.3, "friction": 0.6, "elastic": 0.4, "hysteresis": 0.4, "wide": 0.4,
    "load": 0.01, "tilt": 0.005, "mass": 0.05, "points": 4e-3,
}  # fmt: skip
"""Standard deviations by which machines differ from their model from the start, in the units of `FaultRegressors.body`."""


@dataclass(frozen=True, eq=False)
class Rows:
    """One block.

    Attributes:
        time: of its middle in s.
        gain: of the points by axial forces, (3 · points, actuators) in m/N.
        points: what is measured beside the model and the columns of `FaultRegressors.body`, (3 · points, 1 + columns).
        pressures: rise of the pressure and its columns (what fills and what empties in Pa s, time in s, what a leak takes in Pa s),
            (actuators, 1 + 4); None without pressure monitors.
        tensions: what dynamometers read beside the motors and its columns (1, minus the motors' rate in N/s), (actuators, 1 + 2); None
            without dynamometers.
        place: where the tip shall be and how fast, (6,) in m and m/s.
    """

    time: float
    gain: np.ndarray
    points: np.ndarray
    pressures: np.ndarray | None
    tensions: np.ndarray | None
    place: np.ndarray


@dataclass(frozen=True, eq=False)
class _Block:
    """Means over a block: time, row of the reference, points, pressures, tensions; then rows of the gauges."""

    time: float
    row: int
    points: np.ndarray
    pressure: np.ndarray
    tension: np.ndarray
    pressures: np.ndarray | None
    tensions: np.ndarray | None


class FaultRegressors:
    """Regressors by which faults of the machine show in a loop, row by row.

    Args:
        model: the controller's.
        reference: that the loop follows, by its time.
        first: the command under which the robot rests at the start.

    Attributes:
        body: slices of the points' columns by what they are of, one a muscle: "strength" (part of p A that it pulls less), "stiffness"
            (part by which it is stiffer), "tension" (part that is lost), "force" (N), "friction" (N at the tension's middle), "elastic"
            (likewise, of what gives more before it slides), "hysteresis" and "wide" (N); "load" (kg at the tip), "tilt" (rad, x and y),
            "mass" (part of the arm's) and "points" (m, each coordinate).
        spreads: of these columns from the start, (columns,).
    """

    def __init__(self, model: CompiledModel, reference: Reference, first: Command) -> None:
        self._reference, count, robot = reference, len(first.tensions), model.robot
        self._area, self._stiffness, self._length = (model.values[name] for name in ("A", "K_a", "L_0"))
        self._devices, self._middle = Devices.from_model(model), robot.input_max[count:] / 2
        self._late = (robot.tracker.latency_s if robot.tracker else 0.0) + self._devices.delay
        self._turn, self._gravity = robot.mount.rotation, np.array(robot.mount.gravity_m_per_s2, dtype=float)
        self._tilts = [self._turn.T @ -np.cross(axis, self._gravity) for axis in np.eye(3)[:2]]
        self._sent: deque[tuple[float, Command]] = deque([(-np.inf, first)])
        self._told = first.pressures.astype(float), first.tensions * first.enabled  # what devices do by their commands
        self._near: ModalModel | None = None
        self._directions, self._turning = np.zeros((2, count)), np.zeros((2, count))
        self._before: tuple[np.ndarray, np.ndarray] | None = None  # lengths and pressures a block ago
        self._time: float | None = None
        self._gathered: list[tuple[Sample, Command]] = []
        self._blocks: deque[_Block] = deque(maxlen=3)
        self._run, self._level = np.zeros((4, count)), np.zeros((0, count))
        ends = np.cumsum([0, *([count] * 8), 1, 2, 1, 3 * model.layout.points])
        self.body = {name: slice(ends[k], ends[k + 1]) for k, name in enumerate(DIFFERS)}
        self.spreads = np.repeat(list(DIFFERS.values()), np.diff(ends))

    def add(self, sample: Sample, command: Command, row: int) -> Rows | None:
        """Take a sample, what was commanded for it and its row of the reference; rows of the block before the last, where one is whole.

        Blocks in which a point was never seen are left out.
        """
        self._gathered.append((sample, command))
        if len(self._gathered) < BLOCK:
            return None
        block = self._block(int(self._reference.rows_at(row - BLOCK // 2)))
        self._gathered = []
        if block is None:
            self._blocks.clear()
            return None
        self._blocks.append(block)
        return self._rows() if len(self._blocks) == 3 else None

    def _block(self, row: int) -> _Block | None:
        """Means over the samples gathered."""
        samples = [sample for sample, _ in self._gathered]
        time = np.array([sample.time for sample in samples])
        durations = np.diff(time, prepend=time[0] if self._time is None else self._time)
        self._time, told = time[-1], [self._told]
        acting = []
        for (sample, command), duration in zip(self._gathered, durations.tolist(), strict=True):
            acting.append(self._advance(sample.time, duration).pressures)
            told.append(self._told)
            self._sent.append((sample.time + self._late, command))
        expected, motors = (np.array(each) for each in zip(*told, strict=True))
        monitored, weighed = (
            all(each is not None for each in gauge) for gauge in zip(*((s.pressures, s.tensions) for s in samples), strict=True)
        )
        pressures = np.array([sample.pressures for sample in samples]) if monitored else expected[1:]
        tension = np.array([sample.tensions for sample in samples], dtype=float).mean(axis=0) if weighed else motors[1:].mean(axis=0)
        behind = np.array(acting) - pressures
        flows = np.array([np.maximum(behind, 0.0), np.minimum(behind, 0.0), np.ones_like(behind), -np.maximum(pressures, 0.0) - ATMOSPHERE])
        runs = self._run[:, None] + np.cumsum(durations[:, None] * flows, axis=1)
        points = np.array([sample.points.ravel() for sample in samples])
        pressure, before = pressures.mean(axis=0), self._level
        self._run, self._level = runs[:, -1], np.vstack([pressure, runs.mean(axis=1)])
        whole = np.isfinite(points).any(axis=0).all() and np.isfinite(pressure).all() and np.isfinite(tension).all()
        if not whole or not len(before):
            return None
        took = durations.sum()
        rates = (motors[-1] - motors[0]) / took if took > 0 else np.zeros(len(tension))
        beside = np.column_stack([tension - motors[1:].mean(axis=0), np.ones(len(tension)), -rates])
        rise = (self._level - before).T if monitored else None
        return _Block(float(time.mean()), row, np.nanmean(points, axis=0), pressure, tension, rise, beside if weighed else None)

    def _advance(self, time: float, duration: float) -> Command:
        """Let devices do what they are told for a duration until a time, in s; the command in force."""
        while len(self._sent) > 1 and self._sent[1][0] <= time - duration / 2:
            self._sent.popleft()
        command, most = self._sent[0][1], self._devices.tension_rate * duration
        pressure, tension = self._told
        wound = tension + np.minimum(np.maximum(command.tensions - tension, -most), most)
        self._told = self._devices.lag(pressure, command.pressures, duration), np.where(command.enabled, wound, 0.0)
        return command

    def _rows(self) -> Rows:
        """Rows of the middle one of three blocks."""
        reference, (earlier, block, later) = self._reference, self._blocks
        now, levels, span = block.row, reference.levels, BLOCK * reference.period
        self._near = near = modal_model(reference.equilibria[now], self._near)
        gain, soft, inverse = near.gain, near.observe / near.stiffness, self._modes(near)
        modes = [inverse @ (each.points - reference.equilibria[each.row].points.ravel()) for each in self._blocks]
        start, end = (near.weights @ (levels[each.row] - levels[now]) + modes[k] for k, each in ((0, earlier), (2, later)))
        inertia, rubbed = (start - 2 * modes[1] + end) / span**2, near.damping @ (end - start) / (2 * span)
        known = gain @ (self._area * block.pressure - block.tension - reference.forces[now])
        left = block.points - near.equilibrium.points.ravel() - known + soft @ (inertia + rubbed)
        lengths = reference.lengths[now] + near.drive.T @ modes[1]
        if self._before is not None:
            self._directions = dahl_step(self._directions, lengths - self._before[0], PRESLIDING)
            self._turning = dahl_step(self._turning, self._area * (block.pressure - self._before[1]), WIDTH)
        self._before = lengths, block.pressure
        loaded = 1 - SHARE + SHARE * block.tension / self._middle
        tilts = [self._compute_sag(near, soft, tilt) for tilt in self._tilts]
        heavier = self._compute_sag(near, soft, self._turn.T @ self._gravity)
        stretched = self._stiffness * (reference.lengths[now] - self._length)
        columns = [
            left[:, None], -gain * (self._area * block.pressure), -gain * stretched, gain * block.tension, gain,
            *(-gain * (each * loaded) for each in self._directions), *(-gain * each for each in self._turning),
            (soft @ (near.observe[-3:].T @ self._gravity))[:, None], np.array(tilts).T, heavier[:, None], np.eye(len(left)),
        ]  # fmt: skip
        speed = (reference.tips[later.row] - reference.tips[earlier.row]) / (2 * span)
        place = np.concatenate([reference.tips[now], speed])
        return Rows(block.time, gain, np.hstack(columns), block.pressures, block.tensions, place)

    @staticmethod
    def _modes(near: ModalModel) -> np.ndarray:
        """Modal coordinates that points are seen with, the smallest that do it, (modes, 3 · points)."""
        squares = near.observe @ near.observe.T
        return np.linalg.solve(squares + SMALL * np.trace(squares) * np.eye(len(squares)), near.observe).T

    @staticmethod
    def _compute_sag(near: ModalModel, soft: np.ndarray, gravity: np.ndarray) -> np.ndarray:
        """Displacement of the points at rest by additional gravity, (3,) in m/s² in the base frame, (3 · points,) in m."""
        return soft @ (near.weights.reshape(len(near.weights), -1, 3).sum(axis=1) @ gravity)
