"""The paper's test bench (Fig. 5): one actuator in a guide, a tracking sensor on each of its ends."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from pathlib import Path
from types import TracebackType

import numpy as np
from scipy.linalg import expm

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.commands import check_command, check_setpoints
from tepm_opt.hw.rig import Command, Sample, Simulated
from tepm_opt.hw.simulation.actuation import ActuationDynamics
from tepm_opt.hw.simulation.devices import Lens
from tepm_opt.hw.simulation.imperfections.base import Body
from tepm_opt.hw.simulation.rigfile import DEFAULT, RigFile, load_rig_file
from tepm_opt.hw.simulation.timeline import Timeline, knots
from tepm_opt.models.robot import Robot


class BenchRig:
    """One actuator that a guide keeps straight, lying, with the devices and frictions of a simulated rig's actuators.

    It is a row of n_e equal parts that has its share of a module's mass. Between ticks the motion is exact (matrix exponential).
    Commands hold one pressure, one tension, one ENA.

    Args:
        file: of the rig whose actuator it is; a `RigFile`, the name of a built-in one or a path.
        wait: called with the time in s until each next sample.

    Attributes:
        robot: one actuator with the limits and nominal parameters of the rig's robot; what a controller may know.
        time: in s since the start.

    Raises:
        InputError: as for `load_rig_file`.
    """

    def __init__(self, file: RigFile | str | Path = DEFAULT, wait: Callable[[float], None] = lambda _: None) -> None:
        self.file = _one_actuator(file if isinstance(file, RigFile) else load_rig_file(file))
        if self.file.faults:
            raise InputError(f"rig {self.file.name}: the bench simulates no [[faults]]; valid: none of them, or --rig sim:FILE")
        self.robot = one_actuator(self.file.nominal)
        self.time = 0.0
        true = one_actuator(self.file.true_robot)
        body = Body.from_robot(true, self.file.seed)
        imperfections = self.file.imperfections.active
        self.actuation = ActuationDynamics(self.file, true)
        self._edges = [stage for item in imperfections.values() if (stage := item.edge_stage(body)) is not None]
        longest = min([self.file.simulation.tick_s, *(item.longest_tick(body) for item in imperfections.values())])
        self._tick = 1 / (self.file.tracker.rate_hz * np.ceil(1 / (self.file.tracker.rate_hz * longest) - 1e-9))
        self._line = _Line(body, self._tick)
        self._lens = Lens(self.file.tracker, 2, self.file.seed)
        self._commands = Timeline(np.zeros(3), self._tick)
        self._delay = round(self.file.imperfections.time_delay.delay_s / self._tick)
        self._wait = wait
        self._frame = 0
        self._settled = False
        self._now = 0

    def __repr__(self) -> str:
        return f"BenchRig({self.file.name!r}, {self.time:.3f} s)"

    def reseed(self, noise: int, began: float = 0.0) -> None:
        """Draw other noise for the same machine; 0 is the rig file's own. A bench starts each session anew."""
        self._lens = Lens(self.file.tracker, 2, self.file.seed, noise)

    def read(self) -> Sample:
        """Advance to the tracker's next frame; its points are the actuator's two ends, its length their distance."""
        if not self._settled:
            self._settled = True
            self._settle()
        tracker = self.file.tracker
        until = round(self._frame / tracker.rate_hz / self._tick)
        while self._now < until:
            self._advance()
        self._frame += 1
        before, self.time = self.time, until * self._tick + tracker.latency_s
        self._wait(self.time - before)
        points = self._lens.look(self.true_points)
        lost = bool(np.isnan(points).any())
        length = np.array([np.linalg.norm(points[1] - points[0])])
        return Sample(until * self._tick, points, lengths=length, status="tracker lost an end" if lost else "ok")

    def read_many(self, count: int) -> list[Sample]:
        """The next sample: nothing is gained by more at once."""
        return [self.read()]

    def apply(self, command: Command) -> None:
        """New set points, held until the next ones; before the first `read`, where the actuator rests.

        Raises:
            InputError: a value is NaN or outside the robot's limits; nothing changes then.
        """
        self._commands.set(self._change(), check_command(command, self.robot))

    def schedule(self, setpoints: SetPoints, linear: bool = True) -> None:
        """Give set points in advance, from now on: the first row is for the present, whatever its time.

        Args:
            setpoints: inputs (rows, 2) in Pa and N; there are no tip forces.
            linear: linear between the rows, or each row held until the next.

        Raises:
            InputError: a value is NaN, outside the robot's limits, or a force; nothing changes then.
        """
        values, steps = check_setpoints(setpoints, self.robot), knots(setpoints.time, self._tick)
        self.push(setpoints.tip_force)
        now = self._change()
        if not self._frame:
            self._commands.set(0, values[0])
            now += self._delay
        self._commands.follow(now + steps, values, linear)

    def push(self, forces: np.ndarray) -> None:
        """Refuse forces: nothing can push an actuator in its guide.

        Raises:
            InputError: one is not zero.
        """
        if np.any(forces):
            raise InputError(f"forces: {np.asarray(forces).tolist()} N; valid: 0, the bench cannot push its actuator")

    def stop(self) -> None:
        """Motor off, pressure to zero."""
        if self._frame:
            self._commands.set(self._change(), np.zeros(3))

    @property
    def simulated(self) -> Simulated:
        """The rig itself."""
        return self

    @property
    def true_points(self) -> np.ndarray:
        """The actuator's two ends at the last sample's time, (2, 3) in m."""
        return np.array([[0.0, 0.0, 0.0], [0.0, 0.0, self.true_lengths[0]]])

    @property
    def true_nodes(self) -> np.ndarray:
        """Ends of its parts at the last sample's time, (n + 1, 1, 3) in m."""
        nodes = np.zeros((len(self._line.lengths) + 1, 1, 3))
        nodes[1:, 0, 2] = np.cumsum(self._line.lengths)
        return nodes

    @property
    def true_lengths(self) -> np.ndarray:
        """Length of the actuator at the last sample's time, (1,) in m."""
        return np.array([self._line.lengths.sum()])

    def __enter__(self) -> BenchRig:
        """The rig itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Stop."""
        self.stop()

    def _change(self) -> int:
        """The tick from which a command given now acts; before time has started the actuator has to settle anew."""
        self._settled = self._frame > 0
        return round(self.time / self._tick) + self._delay if self._frame else 0

    def _settle(self) -> None:
        """Rest under the first command; what depends on the length settles with it."""
        self.actuation.settle(self._commands.evaluate_between(0, 0)[0])
        for _ in range(60):
            axial = self.actuation.force_at_rest(self.true_lengths)
            lengths = self._line.lengths[:, None]
            force = reduce(np.add, (stage.settle(lengths) for stage in self._edges)) if self._edges else np.zeros_like(lengths)
            self._line.rest(axial[0] + force[:, 0])

    def _advance(self) -> None:
        line, edges = self._line, None
        lengths, rates = line.lengths[:, None], line.rates[:, None]
        if self._edges:
            edges = reduce(np.add, (stage.step(lengths, rates, self._tick) for stage in self._edges))[:, :, 0]
        command = self._commands.evaluate_between(self._now, self._now + 1)
        axial = self.actuation.step(command, lengths.sum(axis=0), rates.sum(axis=0), self._tick)
        push = np.repeat(axial, len(lengths), axis=1)
        line.advance(push if edges is None else push + edges)
        self._now += 1
        self._commands.forget(self._now)


class _Line:
    """Masses in a row, joined by springs and dampers; forces on the edges are linear in a tick.

    Attributes:
        lengths, rates: of the edges, (n,) in m and m/s.
    """

    def __init__(self, body: Body, tick: float) -> None:
        count = body.layout.segments
        stiffness, damping = body.stiffness[:count, 0], body.damping[:count, 0]
        self.rests, self.stiffness = body.rest[:count, 0], stiffness
        mass = body.mass[:count, 0]
        spread = np.eye(count) - np.eye(count, k=-1)  # edge = spread @ nodes
        pull = -spread.T / mass[:, None]
        system = np.zeros((4 * count, 4 * count))  # displacements, velocities, forces, their slopes
        system[:count, count : 2 * count] = np.eye(count)
        system[count : 2 * count, :count] = pull @ np.diag(stiffness) @ spread
        system[count : 2 * count, count : 2 * count] = pull @ np.diag(damping) @ spread
        system[count : 2 * count, 2 * count : 3 * count] = -pull
        system[2 * count : 3 * count, 3 * count :] = np.eye(count)
        self._step = expm(system * tick)[: 2 * count]
        self._spread, self._count, self._tick = spread, count, tick
        self._state = np.zeros(2 * count)

    @property
    def lengths(self) -> np.ndarray:
        return self.rests + self._spread @ self._state[: self._count]

    @property
    def rates(self) -> np.ndarray:
        return self._spread @ self._state[self._count :]

    def rest(self, push: np.ndarray) -> None:
        """Stand still under forces on the edges (n,) in N."""
        self._state[: self._count] = np.cumsum(push / self.stiffness)
        self._state[self._count :] = 0.0

    def advance(self, push: np.ndarray) -> None:
        """One tick under forces on the edges at its start and end, (2, n) in N."""
        self._state = self._step @ np.concatenate([self._state, push[0], (push[1] - push[0]) / self._tick])


def one_actuator(robot: Robot) -> Robot:
    """A robot of a single actuator with another robot's parameters and limits; its mass is a third of a module's for three actuators."""
    parameters = robot.parameters.model_copy(update={"m_d": robot.parameters.m_d / robot.actuators})
    geometry = robot.geometry.model_copy(update={"modules": 1, "actuator_angles_deg": robot.geometry.actuator_angles_deg[:1]})
    return robot.model_copy(update={"name": f"{robot.name}: one actuator", "geometry": geometry, "parameters": parameters})


def _one_actuator(file: RigFile) -> RigFile:
    """A rig file without what only a whole arm has."""
    kept = file.imperfections.only(lambda imperfection: imperfection.of_one_actuator)
    return file.model_copy(update={"name": f"bench of {file.name}", "imperfections": kept})
