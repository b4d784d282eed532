"""The paper's controllers (IV.A): the length of every actuator by PID, by pressure alone or with the tendon for fine adjustment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from tepm_opt.control.baselines.pid import Gains, Pid
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command, Rig, Sample
from tepm_opt.models.robot import Robot
from tepm_opt.progress import Progress, silent

Measure = Callable[[Sample], np.ndarray]


class TendonUse(IntEnum):
    """The two modes of IV.A."""

    FOLLOWS = 1
    """Mode 1: the motor is disabled (ENA off), the tendon follows, λ = 0."""
    ADJUSTS = 2
    """Mode 2: the motor is enabled while the length error is small."""


@dataclass(frozen=True)
class LengthSettings:
    """Settings of the length controllers, the same on every rig.

    Tuned by hand on the perfect rig, whose sway nothing damps, and on the virtual prototype: more integral or less derivative action
    lets the sway grow on the former (ω about 5.6 rad/s, so D has to outweigh I / ω²), less of all tracks worse on both.

    Attributes:
        pressure_gains: while pressure makes the force.
        tension_gains: while the tendon adjusts it.
        filter_time: time constant in s of the filter of the measured lengths.
        enable_below: length error in m below which a motor is enabled (the paper's 3 mm).
        disable_above: length error in m above which it is disabled again.
        mid_tension: tension in N about which the tendon adjusts.
        low_tension: mean tension in N below which the held pressure rises slowly, so that the tendon keeps its authority (mid-ranging).
        high_tension: mean tension in N above which it falls slowly.
        mid_ranging_rate: how fast it does, in N/s of the muscle's force.
    """

    pressure_gains: Gains = field(default_factory=lambda: Gains(60.0, 250.0, 25.0))
    tension_gains: Gains = field(default_factory=lambda: Gains(60.0, 375.0, 25.0))
    filter_time: float = 0.04
    enable_below: float = 3e-3
    disable_above: float = 4e-3
    mid_tension: float = 1.5
    low_tension: float = 0.8
    high_tension: float = 3.0
    mid_ranging_rate: float = 1.0


DEFAULT = LengthSettings()


@dataclass(frozen=True, eq=False)
class LengthTarget:
    """Lengths that a controller shall hold, with the forces expected there.

    Attributes:
        lengths: of the actuators, (actuators,) in m.
        forces: axial forces that the model expects there, (actuators,) in N: the feed-forward.
    """

    lengths: np.ndarray
    forces: np.ndarray


class LengthController:
    """Axial forces by PID on the lengths, one loop an actuator, made by pressure or, in mode 2, by pressure and tension.

    F_a = p A − λ. With the motor off the pressure makes F_a. When the error becomes small the pressure moves to where the tendon has
    authority in both directions, and rests on the regulator's grid; the tension then makes the difference.

    Args:
        robot: limits, resolutions and the muscles' area.
        use: mode 1 or 2.
        settings: gains and thresholds.

    Attributes:
        enabled: ENA of every motor, (actuators,).
    """

    def __init__(self, robot: Robot, use: TendonUse = TendonUse.ADJUSTS, settings: LengthSettings = DEFAULT) -> None:
        self.use, self.settings = TendonUse(use), settings
        count = robot.modules * robot.actuators
        self._area = robot.parameters.A
        self._pressure_max, self._tension_max = robot.input_max[:count], robot.input_max[count:]
        self._actuation = robot.actuation
        self._pid = Pid(count, settings.filter_time)
        self._time: float | None = None
        self._held = np.zeros(count)
        self.enabled = np.zeros(count, dtype=bool)

    def command(self, time: float, lengths: np.ndarray, target: LengthTarget) -> Command:
        """Set points for a sample.

        Args:
            time: of the sample in s.
            lengths: measured or estimated, (actuators,) in m; NaN where unknown: that loop waits.
            target: what to hold.

        Raises:
            InputError: lengths or target of another shape.
        """
        shape = self.enabled.shape
        if np.shape(lengths) != shape or np.shape(target.lengths) != shape or np.shape(target.forces) != shape:
            raise InputError(f"lengths: shapes {np.shape(lengths)} and {np.shape(target.lengths)}; valid: {shape}")
        duration = 0.0 if self._time is None else max(time - self._time, 0.0)
        self._time = time
        last = target.lengths if self._pid.filtered is None else self._pid.filtered
        error = target.lengths - self._pid.observe(np.where(np.isfinite(lengths), lengths, last), duration)
        self._switch(error, target)
        self._follow(target, duration)
        held = self._actuation.pressures_on_grid(self._held)
        high = np.where(self.enabled, held, self._pressure_max) * self._area
        low = np.where(self.enabled, high - self._tension_max, 0.0)
        forces = self._pid.step(error, target.forces, self._gains(), np.array([low, high]), duration)
        tension = np.where(self.enabled, np.clip(held * self._area - forces, 0.0, self._tension_max), 0.0)
        pressure = np.where(self.enabled, held, np.clip(forces / self._area, 0.0, self._pressure_max))
        return Command(pressure, tension, self.enabled.copy())

    def _gains(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        far, close = self.settings.pressure_gains, self.settings.tension_gains
        pairs = ((far.proportional, close.proportional), (far.integral, close.integral), (far.derivative, close.derivative))
        proportional, integral, derivative = (np.where(self.enabled, fine, coarse) for coarse, fine in pairs)
        return proportional, integral, derivative

    def _switch(self, error: np.ndarray, target: LengthTarget) -> None:
        """Motors on where the error is small, off where it has grown; the pressure is held where one comes on."""
        if self.use is TendonUse.FOLLOWS:
            return
        before = self.enabled
        self.enabled = np.abs(error) < np.where(before, self.settings.disable_above, self.settings.enable_below)
        wanted = (target.forces + self._pid.integral + self.settings.mid_tension) / self._area
        self._held = np.where(self.enabled & ~before, np.clip(wanted, 0.0, self._pressure_max), self._held)

    def _follow(self, target: LengthTarget, duration: float) -> None:
        """Move a held pressure slowly where the tension, without its quick parts, has left the band in which it can act both ways."""
        settings = self.settings
        tension = self._held * self._area - target.forces - self._pid.integral
        missing = np.maximum(settings.low_tension - tension, 0.0) - np.maximum(tension - settings.high_tension, 0.0)
        most = settings.mid_ranging_rate * duration
        moved = np.clip(self._held + np.clip(missing, -most, most) / self._area, 0.0, self._pressure_max)
        self._held = np.where(self.enabled, moved, self._held)


@dataclass(frozen=True, eq=False)
class HoldRecord:
    """Record of a rig while its lengths were controlled.

    Attributes:
        time: of the samples in s, (samples,).
        target: which target was to be held, (samples,).
        lengths: measured or estimated, (samples, actuators) in m.
        points: tracked, (samples, points, 3) in m in G.
        inputs: commanded u, (samples, 2 · actuators) in Pa and N.
        enabled: ENA, (samples, actuators).
    """

    time: np.ndarray
    target: np.ndarray
    lengths: np.ndarray
    points: np.ndarray
    inputs: np.ndarray
    enabled: np.ndarray

    def __repr__(self) -> str:
        return f"HoldRecord({self.time[-1]:.2f} s, samples={len(self.time)}, targets={int(self.target.max()) + 1})"


@dataclass(frozen=True, eq=False)
class HoldTask:
    """Lengths to be held one after the other.

    Attributes:
        targets: in their order.
        seconds: for each target.
        approach: seconds before, in which the first target is approached along a straight line from the first sample's lengths.
    """

    targets: Sequence[LengthTarget]
    seconds: float
    approach: float = 0.0


def hold(rig: Rig, controller: LengthController, measure: Measure, task: HoldTask, progress: Progress = silent) -> HoldRecord:
    """Hold one target after the other on a rig, each for some seconds; works on every rig.

    Args:
        rig: which; it is not stopped here.
        controller: of the lengths.
        measure: lengths of a sample, measured or estimated.
        task: targets and times.
        progress: told the time in s that has passed.
    """
    targets, seconds, approach = task.targets, task.seconds, task.approach
    rows: list[tuple] = []
    start: float | None = None
    first: LengthTarget | None = None
    whole = approach + seconds * len(targets)
    while True:
        sample = rig.read()
        lengths = measure(sample)
        start = sample.time if start is None else start
        first = LengthTarget(lengths, np.zeros_like(lengths)) if first is None else first
        passed = sample.time - start
        number = int((passed - approach + 1e-9) // seconds) if passed >= approach - 1e-9 else -1
        if number >= len(targets):
            break
        target = targets[number] if number >= 0 else _interpolate_targets(first, targets[0], passed / approach)
        command = controller.command(sample.time, lengths, target)
        rig.apply(command)
        inputs = np.concatenate([command.pressures, command.tensions])
        rows.append((passed, number, np.array(lengths), sample.points, inputs, command.enabled))  # a copy: views keep their owners
        progress("lengths held", passed, whole)
    return HoldRecord(*(np.array(column) for column in zip(*rows, strict=True)))


def _interpolate_targets(first: LengthTarget, last: LengthTarget, part: float) -> LengthTarget:
    return LengthTarget(first.lengths + part * (last.lengths - first.lengths), first.forces + part * (last.forces - first.forces))
