"""The simulated rig: virtual time, a robot that is not the model, imperfect devices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import TracebackType

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.hw.commands import check_command, check_setpoints
from tepm_opt.hw.freshness import DeclaredNoise, FreshnessMonitor
from tepm_opt.hw.rig import Command, Sample, Simulated
from tepm_opt.hw.simulation.devices import Lens, generator
from tepm_opt.hw.simulation.faults import FaultInjector
from tepm_opt.hw.simulation.imperfections.base import Imperfection, Sighting
from tepm_opt.hw.simulation.machine import Diverged, Frames
from tepm_opt.hw.simulation.machines import machine_of
from tepm_opt.hw.simulation.rigfile import DEFAULT, RigFile, load_rig_file
from tepm_opt.hw.simulation.timeline import Timeline, knots
from tepm_opt.models.layout import Layout

AT_ONCE = 100  # frames in one call of the engine, which Ctrl-C does not interrupt


class SimulatedRig:
    """A rig whose time passes only in `read`.

    What is commanded before the first `read` is where the robot rests when time starts: it settles there. After that a command takes
    effect `time_delay` after the time at which it was given, which is when the last sample was read: `latency_s` after its pose.

    Args:
        file: what the rig is made of; a `RigFile`, the name of a built-in one or a path.
        wait: called with the time in s until each next sample, as `time.sleep` where time shall not run faster than real time.
        watched: whether samples pass the monitor of freshness, as a real rig's do; studies that need raw ones save half of their time.

    Attributes:
        file: what the rig is made of.
        robot: as its file says, without the rig's parameter errors: what a controller may know.
        time: in s since the start.
        machine: what moves, as it is at the last sample's time; for looking inside.

    Raises:
        InputError: as for `load_rig_file` and `machine_of`, or imperfections that do not fit the robot.
    """

    def __init__(self, file: RigFile | str | Path = DEFAULT, wait: Callable[[float], None] = lambda _: None, watched: bool = True) -> None:
        self.file = file if isinstance(file, RigFile) else load_rig_file(file)
        self.robot = self.file.nominal
        self.layout = Layout.from_robot(self.robot)
        self.time = 0.0
        self.machine = machine_of(self.file)
        self._distortions = [item for item in self.machine.imperfections.values() if type(item).measure is not Imperfection.measure]
        self._lens = Lens(self.file.tracker, self.layout.points, self.file.seed)
        self._random = {name: generator(self.file.seed, name) for name in ("pressure_monitor", "dynamometer")}
        self._jitter = generator(self.file.seed, "jitter")
        self._faults = FaultInjector(self.file.faults, self.layout, self.file.seed)
        self._freshness = FreshnessMonitor(self.layout, self.robot.input_max, self._declared_noise(), self.file.tracker.rate_hz)
        self._delay = round(self.file.imperfections.time_delay.delay_s / self.machine.step)
        self._commands = Timeline(np.zeros(3 * self.machine.network.count), self.machine.step)
        self._forces = Timeline(np.zeros((self.layout.points, 3)), self.machine.step)
        self._wait, self._watched = wait, watched
        self._frame = 0
        self._settled = False

    def __repr__(self) -> str:
        return f"SimulatedRig({self.file.name!r}, robot {self.robot.name!r}, {self.time:.3f} s)"

    def reseed(self, noise: int, began: float = 0.0) -> None:
        """Draw other noise for the same machine, before its first `read`; its masses stay. 0 is the rig file's own.

        `began` is the time in the session in s at which this rig starts.
        """
        seed = self.file.seed
        self.machine.began = began
        self._jitter = generator(seed, "jitter", noise)
        self._lens.random = generator(seed, "tracker", noise)
        self._faults.restart(seed, noise)
        self._random = {name: generator(seed, name, noise) for name in self._random}

    def read(self) -> Sample:
        """Advance to when the tracker's next frame has arrived and return it; its pose is `latency_s` old then.

        Raises:
            NoEquilibriumError, Diverged: the robot does not come to rest before the start, or the simulation leaves all bounds.
        """
        return self.read_many(1)[0]

    def read_many(self, count: int) -> list[Sample]:
        """The next samples, as `read` gives them one by one, for as long as nothing is commanded between them; in less time.

        Fewer than `count`, at least one, where the simulation leaves all bounds before a later one.

        Raises:
            NoEquilibriumError, Diverged: as for `read`.
        """
        self._start()
        samples: list[Sample] = []
        while (left := count - len(samples)) > 0:
            try:
                samples += self._samples(min(left, AT_ONCE))
            except Diverged:
                if not samples:
                    raise
                break
        return samples

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
        steps = knots(setpoints.time, self.machine.step)
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
            self._commands.set(self._change() + self._delay, np.zeros(3 * self.machine.network.count))

    @property
    def simulated(self) -> Simulated:
        """The rig itself."""
        return self

    @property
    def true_points(self) -> np.ndarray:
        """True reference points at the last sample's time, in the assumed frame G, (points, 3) in m."""
        self._start()
        return self._present[1].copy()

    @property
    def true_nodes(self) -> np.ndarray:
        """True places of all nodes at the last sample's time, in G, (n + 1, actuators, 3) in m."""
        self._start()
        return self.machine.network.in_tracker_frame(self._present[0])

    @property
    def true_lengths(self) -> np.ndarray:
        """Lengths of the actuators at the last sample's time, (modules · actuators,) in m."""
        self._start()
        return self.machine.network.of_actuators(np.linalg.norm(np.diff(self._present[0], axis=0), axis=-1))

    def __enter__(self) -> SimulatedRig:
        """The rig itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Stop."""
        self.stop()

    def _start(self) -> None:
        """Settle, once, before time starts."""
        if not self._settled:
            self.machine.settle(self._commands.evaluate_between(0, 0)[0], self._forces.evaluate_between(0, 0)[0])
            frames = self.machine.record([0], self._commands, self._forces)
            self._present = (frames.nodes[0], frames.points[0])
            self._settled = True

    def _change(self) -> int:
        """The present step, before something changes: if time has not started the robot has to settle anew."""
        self._settled = self._frame > 0
        return round(self.time / self.machine.step)

    def _samples(self, count: int) -> list[Sample]:
        """The next samples; fewer than `count`, at least one, where the simulation diverges before a later one.

        Raises:
            Diverged: it diverges before the first one.
        """
        step, tracker, first = self.machine.step, self.file.tracker, self._frame
        told = [round(frame / tracker.rate_hz / step) for frame in range(first, first + count)]
        at = self._find_exposures(told)
        frames = self.machine.record(at, self._commands, self._forces)
        self._present, done = (frames.nodes[-1], frames.points[-1]), len(frames.points)
        self._frame += done
        half = 2 * self.machine.network.count
        commands = [self._commands.evaluate_between(step, step)[0] for step in at[:done]]
        self._commands.forget(at[done - 1])
        self._forces.forget(at[done - 1])
        before, self.time = self.time, told[done - 1] * step + tracker.latency_s
        self._wait(self.time - before)
        pressures, tensions = self._measure_pressures(frames.pressures), self._measure_tensions(frames.tensions)
        samples = []
        for k in range(done):
            points = self._lens.look(self._distort_points(frames, k, at[k] * step))
            pressure, tension = (None if of is None else of[k] for of in (pressures, tensions))
            sample = self._faults.apply(Sample(told[k] * step, points, pressure, tension))
            if np.isnan(sample.points).any():
                sample = replace(sample, status=f"tracker lost {', '.join(self._name_lost_points(sample.points))}")
            pulled = commands[k][half // 2 : half] * commands[k][half:]
            command = np.concatenate([commands[k][: half // 2], pulled])
            samples.append(self._freshness.look(sample, command) if self._watched else sample)
        return samples

    def _find_exposures(self, told: list[int]) -> list[int]:
        """Find the steps at which frames are exposed that tell these steps: a clock that runs apart, jitter. None is before the last."""
        imperfections, step = self.file.imperfections, self.machine.step
        skew, jitter = imperfections.clock_skew, imperfections.sample_jitter
        if not (skew.active or jitter.active):
            return told
        time = np.array(told) * step
        late = skew.rate * time + skew.bend_per_s * time**2 / 2 + jitter.up_to_s * self._jitter.random(len(told))
        steps = np.maximum(np.round((time - late) / step).astype(int), self.machine.now)
        return np.maximum.accumulate(steps).tolist()

    def _distort_points(self, frames: Frames, k: int, time: float) -> np.ndarray:
        """Distort a frame's reference points as the tracker sees them but for its noise, a time in s since the start, (points, 3) in m."""
        network, points = self.machine.network, frames.points[k]
        if self._distortions:
            nodes = network.in_tracker_frame(frames.nodes[k])
            for imperfection in self._distortions:
                points = imperfection.measure(Sighting(points, nodes, network.rest, self.layout, self.machine.began + time))
        return points

    def _declared_noise(self) -> DeclaredNoise:
        """Noise of the rig's own devices, whose readings are on no grid."""
        file = self.file
        gauges = file.pressure_monitor.noise_rms_Pa, file.dynamometer.noise_rms_N
        return DeclaredNoise(file.tracker.noise_rms_m / np.sqrt(3), *gauges, point_grid=0.0)

    def _name_lost_points(self, points: np.ndarray) -> list[str]:
        return [name for name, point in zip(self.layout.point_names, points, strict=True) if np.isnan(point).any()]

    def _measure_pressures(self, pressures: np.ndarray) -> np.ndarray | None:
        monitor = self.file.pressure_monitor
        noise = monitor.noise_rms_Pa * self._random["pressure_monitor"].normal(size=pressures.shape)
        return pressures + monitor.offset_Pa + noise if monitor.fitted else None

    def _measure_tensions(self, tensions: np.ndarray) -> np.ndarray | None:
        meter = self.file.dynamometer
        noise = meter.noise_rms_N * self._random["dynamometer"].normal(size=tensions.shape)
        return tensions + meter.offset_N + noise if meter.fitted else None
