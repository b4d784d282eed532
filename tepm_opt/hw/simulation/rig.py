"""The simulated rig: virtual time, a MuJoCo robot, imperfect devices."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import TracebackType

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.commands import check_command, check_setpoints
from tepm_opt.hw.rig import Command, Sample, Simulated
from tepm_opt.hw.simulation.devices import Lens, generator
from tepm_opt.hw.simulation.imperfections.base import Sighting
from tepm_opt.hw.simulation.machine import Machine
from tepm_opt.hw.simulation.mujoco_network import MujocoNetwork
from tepm_opt.hw.simulation.rigfile import DEFAULT, RigFile, load_rig_file
from tepm_opt.hw.simulation.timeline import Timeline, knots
from tepm_opt.models.layout import Layout


class SimulatedRig:
    """A rig whose time passes only in `read`.

    What is commanded before the first `read` is where the robot rests when time starts: it settles there. After that a command takes
    effect `time_delay` after the time at which it was given, which is when the last sample was read: `latency_s` after its pose.

    Args:
        file: what the rig is made of; a `RigFile`, the name of a built-in one or a path.
        wait: called with the time in s until each next sample, as `time.sleep` where time shall not run faster than real time.

    Attributes:
        file: what the rig is made of.
        robot: as its file says, without the rig's parameter errors: what a controller may know.
        time: in s since the start.

    Raises:
        InputError: as for `load_rig_file`, or imperfections that do not fit the robot.
    """

    def __init__(self, file: RigFile | str | Path = DEFAULT, wait: Callable[[float], None] = lambda _: None) -> None:
        self.file = file if isinstance(file, RigFile) else load_rig_file(file)
        self.robot = self.file.nominal
        self.layout = Layout.of(self.robot)
        self.time = 0.0
        self._machine = Machine(self.file)
        self._lens = Lens(self.file.tracker, self.layout.points, self.file.seed)
        self._random = {name: generator(self.file.seed, name) for name in ("pressure_monitor", "dynamometer")}
        self._delay = round(self.file.imperfections.time_delay.delay_s / self._machine.step)
        self._commands = Timeline(np.zeros(3 * self._machine.network.count), self._machine.step)
        self._forces = Timeline(np.zeros((self.layout.points, 3)), self._machine.step)
        self._wait = wait
        self._frame = 0
        self._settled = False

    def __repr__(self) -> str:
        return f"SimulatedRig({self.file.name!r}, robot {self.robot.name!r}, {self.time:.3f} s)"

    def reseed(self, noise: int) -> None:
        """Other noise of the same machine: what was drawn once (its masses) stays. 0 is the rig file's own."""
        seed = self.file.seed
        self._lens.random = generator(seed, "tracker", noise)
        self._random = {name: generator(seed, name, noise) for name in self._random}

    def read(self) -> Sample:
        """Advance to when the tracker's next frame has arrived and return it; its pose is `latency_s` old then.

        Raises:
            NoEquilibriumError, Diverged: the robot does not come to rest before the start, or the simulation leaves all bounds.
        """
        self._start()
        step, tracker = self._machine.step, self.file.tracker
        at = round(self._frame / tracker.rate_hz / step)
        self._machine.advance(at, self._commands, self._forces)
        self._commands.forget(at)
        self._forces.forget(at)
        self._frame += 1
        before, self.time = self.time, at * step + tracker.latency_s
        self._wait(self.time - before)
        points = self._lens.look(self._seen())
        lost = [name for name, point in zip(self.layout.point_names, points, strict=True) if np.isnan(point).any()]
        status = f"tracker lost {', '.join(lost)}" if lost else "ok"
        return Sample(at * step, points, self._monitored(), self._weighed(), status=status)

    def apply(self, command: Command) -> None:
        """New set points, held until the next ones; before the first `read`, where the robot rests.

        Raises:
            InputError: a value is NaN or outside the robot's limits; nothing changes then.
        """
        value = check_command(command, self.robot)
        self._commands.set(self._change() + (self._delay if self._frame else 0), value)

    def schedule(self, setpoints: SetPoints, linear: bool = True) -> None:
        """Give set points in advance, from now on: the first row is for the present, whatever its time.

        Args:
            setpoints: inputs (rows, 2 · modules · actuators) and tip forces (rows, 3), which act without delay. All motors are enabled.
            linear: linear between the rows, as in experiment data (SPEC section 4), or each row held until the next.

        Raises:
            InputError: a value is NaN or outside the robot's limits; nothing changes then.
        """
        values = check_setpoints(setpoints, self.robot)
        forces = np.zeros((len(values), self.layout.points, 3))
        forces[:, -1] = setpoints.tip_force
        steps = knots(setpoints.time, self._machine.step)
        now = self._change()
        if not self._frame:
            self._commands.set(0, values[0])
        self._commands.follow(steps + now + self._delay, values, linear)
        self._forces.follow(steps + now, forces, linear)

    def push(self, forces: np.ndarray) -> None:
        """Known forces on the reference points in G from now on, (points, 3) in N, or (3,) for the tip.

        Raises:
            InputError: wrong shape, or not finite.
        """
        forces = np.asarray(forces, dtype=float)
        if forces.shape == (3,):
            forces = np.vstack([np.zeros((self.layout.points - 1, 3)), forces])
        if forces.shape != (self.layout.points, 3) or not np.isfinite(forces).all():
            raise InputError(
                f"forces: {forces.tolist()}; valid: finite numbers of the shape ({self.layout.points}, 3), or (3,) for the tip"
            )
        self._forces.set(self._change(), forces)

    def stop(self) -> None:
        """Motors off, pressure to zero; the robot then moves under its own weight if it is read on."""
        if self._frame:
            self._commands.set(self._change() + self._delay, np.zeros(3 * self._machine.network.count))

    @property
    def simulated(self) -> Simulated:
        """The rig itself."""
        return self

    @property
    def network(self) -> MujocoNetwork:
        """MuJoCo's model and data, as they are at the last sample's time; for rendering and for looking inside."""
        self._start()
        return self._machine.network

    @property
    def true_points(self) -> np.ndarray:
        """Where the reference points were in truth at the last sample's time, in the assumed frame G, (points, 3) in m."""
        return self.network.points(self.network.nodes)

    @property
    def true_nodes(self) -> np.ndarray:
        """Where all nodes were in truth at the last sample's time, in G, (n + 1, actuators, 3) in m."""
        return self.network.in_tracker_frame(self.network.nodes)

    @property
    def true_lengths(self) -> np.ndarray:
        """Lengths of the actuators at the last sample's time, (modules · actuators,) in m."""
        return self.network.of_actuators(self.network.verticals()[0])

    def __enter__(self) -> SimulatedRig:
        """The rig itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Stop."""
        self.stop()

    def _start(self) -> None:
        """Settle, once, before time starts."""
        if not self._settled:
            self._settled = True
            self._machine.settle(self._commands.between(0, 0)[0], self._forces.between(0, 0)[0])

    def _change(self) -> int:
        """The present step, before something changes: if time has not started the robot has to settle anew."""
        self._settled = self._frame > 0
        return round(self.time / self._machine.step)

    def _seen(self) -> np.ndarray:
        """Reference points as the tracker sees them but for its noise, (points, 3) in m."""
        network, points = self._machine.network, self.true_points
        for imperfection in self._machine.imperfections.values():
            points = imperfection.measure(Sighting(points, self.true_nodes, network.rest, self.layout))
        return points

    def _monitored(self) -> np.ndarray | None:
        monitor, pressure = self.file.pressure_monitor, self._machine.actuation.pressure
        noise = monitor.noise_rms_Pa * self._random["pressure_monitor"].normal(size=pressure.shape)
        return pressure + monitor.offset_Pa + noise if monitor.fitted else None

    def _weighed(self) -> np.ndarray | None:
        meter, tension = self.file.dynamometer, self._machine.actuation.tension
        noise = meter.noise_rms_N * self._random["dynamometer"].normal(size=tension.shape)
        return tension + meter.offset_N + noise if meter.fitted else None
