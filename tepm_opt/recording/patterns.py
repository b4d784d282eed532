"""Input patterns of recording plans: what a run in a plan says, and the set points it stands for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from tepm_opt.data.documents import Number, Section, between
from tepm_opt.data.run import Role
from tepm_opt.data.setpoints import SetPoints, input_columns, read_setpoints
from tepm_opt.errors import InputError, unknown_name
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import Robot

Seconds = Annotated[float, between(1e-3, 3600, "s")]
Lead = Annotated[float, between(0.5, 60, "s")]
Hertz = Annotated[float, between(1e-3, 1e3, "Hz")]
Vector = Annotated[tuple[Number, Number, Number], Field(description="three numbers")]
Levels = dict[str, Number]


def level(levels: Levels, start: np.ndarray, robot: Robot, where: str) -> np.ndarray:
    """`start` (inputs,) with some inputs changed.

    A key is a column (`pressure_12_Pa`), a module (`pressure_1_Pa`) or all (`tension_N`); the narrower one wins.

    Raises:
        InputError: a key that is none of these.
    """
    layout, value = Layout.of(robot), start.copy()
    columns = input_columns(layout.actuator_names)
    groups: dict[str, list[int]] = {}
    for k, column in enumerate(columns):
        kind, unit = column.split("_")[0], column.split("_")[-1]
        module = k % (len(columns) // 2) // robot.actuators + 1
        for key in (f"{kind}_{unit}", f"{kind}_{module}_{unit}", column):
            groups.setdefault(key, []).append(k)
    for key in levels:
        if key not in groups:
            raise unknown_name("input", key, groups, where)
    for key in sorted(levels, key=lambda name: -len(groups[name])):
        value[groups[key]] = levels[key]
    return value


class RunPlan(Section):
    """What all runs of a plan have.

    Every run starts with `lead_s` of steady inputs. `rest` are the inputs that a pattern starts from and returns to.
    """

    file: Annotated[str, Field(pattern=r"^[A-Za-z0-9][\w. -]*\.csv$", description="a plain file name ending in .csv")]
    role: Role
    lead_s: Lead = 1.0

    def setpoints(self, robot: Robot, rate: float, folder: Path, where: str) -> SetPoints:
        """The set points of the run: steady for `lead_s`, then the pattern.

        Args:
            robot: that they are for.
            rate: of the samples in Hz.
            folder: of the plan.
            where: names the run in errors.

        Raises:
            InputError: unknown input, value outside the robot's limits.
        """
        raise NotImplementedError


class FileRun(RunPlan):
    """A set-point file, relative to the plan."""

    inputs: Annotated[str, Field(min_length=1, description="the path of a set-point file")]

    def setpoints(self, robot: Robot, rate: float, folder: Path, where: str) -> SetPoints:
        """The rows of the file; see `RunPlan.setpoints`."""
        found = read_setpoints(folder / self.inputs, Layout.of(robot).actuator_names, robot.input_max)
        if not np.isfinite(found.inputs).all():
            row = int(np.argmin(np.isfinite(found.inputs).all(axis=1)))
            raise InputError(f"{where}: {self.inputs}: row {row + 1} has no inputs; a rig cannot play it")
        time = np.append(0.0, found.time - found.time[0] + self.lead_s)
        return SetPoints(time, np.vstack([found.inputs[:1], found.inputs]), np.vstack([found.tip_force[:1], found.tip_force]))


class Pattern(RunPlan):
    """What all built-in patterns have; `tip_force_N` acts throughout."""

    rest: Levels = Field(default_factory=dict)
    tip_force_N: Vector = (0.0, 0.0, 0.0)

    def setpoints(self, robot: Robot, rate: float, folder: Path, where: str) -> SetPoints:
        """See `RunPlan.setpoints`."""
        rest = level(self.rest, np.zeros(len(robot.input_max)), robot, f"{where}: rest")
        time, inputs = self.shape(rest, robot, rate, where)
        time, inputs = np.append(0.0, time + self.lead_s), np.vstack([rest, inputs])
        columns = input_columns(Layout.of(robot).actuator_names)
        wrong = (inputs < -1e-9 * robot.input_max) | (inputs > robot.input_max * (1 + 1e-9))
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            found = f"{columns[column]} = {inputs[row, column]:g} at {time[row]:.3g} s"
            raise InputError(f"{where}: {found}; valid: 0 … {robot.input_max[column]:g}")
        inputs = np.clip(inputs, 0.0, robot.input_max)
        return SetPoints(time, inputs, np.tile(self.tip_force_N, (len(time), 1)).astype(float))

    def shape(self, rest: np.ndarray, robot: Robot, rate: float, where: str) -> tuple[np.ndarray, np.ndarray]:
        """Times from 0 (rows,) in s and inputs (rows, inputs), beginning with `rest` at 0."""
        raise NotImplementedError


class Hold(Pattern):
    """`rest` and nothing else: noise, drift, creep."""

    pattern: Literal["hold"] = "hold"
    duration_s: Seconds

    def shape(self, rest: np.ndarray, robot: Robot, rate: float, where: str) -> tuple[np.ndarray, np.ndarray]:
        """See `Pattern.shape`."""
        return np.array([0.0, self.duration_s]), np.stack([rest, rest])


class Steps(Pattern):
    """From level to level, each reached within one sample (or `rise_s`) and held; what a level does not name is at rest."""

    pattern: Literal["steps"] = "steps"
    levels: Annotated[list[Levels], Field(min_length=1, description="at least one table of inputs")]
    hold_s: Seconds = 3.0
    rise_s: Seconds | None = None

    def shape(self, rest: np.ndarray, robot: Robot, rate: float, where: str) -> tuple[np.ndarray, np.ndarray]:
        """See `Pattern.shape`."""
        rise = self.rise_s or 1 / rate
        times, rows = [0.0], [rest]
        targets = [level(entry, rest, robot, f"{where}: levels entry {k + 1}") for k, entry in enumerate(self.levels)]
        for target in (*targets, rest):
            times += [times[-1] + rise, times[-1] + rise + self.hold_s]
            rows += [target, target]
        return np.array(times), np.stack(rows)


class Ramp(Pattern):
    """To a level in `rise_s`, held for `hold_s`, and back."""

    pattern: Literal["ramp"] = "ramp"
    to: Levels
    rise_s: Seconds = 5.0
    hold_s: Seconds = 2.0

    def shape(self, rest: np.ndarray, robot: Robot, rate: float, where: str) -> tuple[np.ndarray, np.ndarray]:
        """See `Pattern.shape`."""
        target = level(self.to, rest, robot, f"{where}: to")
        return np.cumsum([0.0, self.rise_s, self.hold_s, self.rise_s, self.hold_s]), np.stack([rest, target, target, rest, rest])


class Sweep(Pattern):
    """A sine about rest from one frequency to another, as many periods in every octave; it fades in and out over a tenth of the time."""

    pattern: Literal["sweep"] = "sweep"
    amplitude: Levels
    from_hz: Hertz = 0.1
    to_hz: Hertz = 2.0
    duration_s: Seconds = 30.0
    hold_s: Seconds = 2.0

    def shape(self, rest: np.ndarray, robot: Robot, rate: float, where: str) -> tuple[np.ndarray, np.ndarray]:
        """See `Pattern.shape`."""
        if max(self.from_hz, self.to_hz) > rate / 4:
            raise InputError(f"{where}: {max(self.from_hz, self.to_hz):g} Hz; valid: up to {rate / 4:g} Hz, a quarter of the sample rate")
        amplitude = level(self.amplitude, np.zeros(len(rest)), robot, f"{where}: amplitude")
        time, octaves = _grid(self.duration_s, rate), np.log(self.to_hz / self.from_hz)
        growth = np.expm1(octaves * time / self.duration_s) / octaves if abs(octaves) > 1e-9 else time / self.duration_s
        wave = np.sin(2 * np.pi * self.from_hz * self.duration_s * growth) * _fade(time, self.duration_s, 0.1 * self.duration_s)
        return _held(time, rest + wave[:, None] * amplitude, rest, self.hold_s)


class Circle(Pattern):
    """Pressures of a module out of phase by the angles of its actuators, so that its bending goes round; fades in and out over a turn."""

    pattern: Literal["circle"] = "circle"
    amplitude_Pa: Annotated[float, between(0, 2e7, "Pa")]
    modules: list[Annotated[int, Field(strict=True, ge=1, description="numbers of modules")]] | None = None
    period_s: Seconds = 10.0
    turns: Annotated[float, between(1, 1e4, "turns")] = 3.0
    hold_s: Seconds = 2.0

    def shape(self, rest: np.ndarray, robot: Robot, rate: float, where: str) -> tuple[np.ndarray, np.ndarray]:
        """See `Pattern.shape`."""
        moved = self.modules or list(range(1, robot.modules + 1))
        if max(moved) > robot.modules:
            raise InputError(f"{where}: modules = {moved}; valid: 1 … {robot.modules}")
        duration = self.turns * self.period_s
        time = _grid(duration, rate)
        fade = _fade(time, duration, min(self.period_s, duration / 2))
        inputs = np.tile(rest, (len(time), 1))
        for module in moved:
            columns = slice((module - 1) * robot.actuators, module * robot.actuators)
            phase = 2 * np.pi * time[:, None] / self.period_s - robot.angles
            inputs[:, columns] += self.amplitude_Pa * fade[:, None] * np.cos(phase)
        return _held(time, inputs, rest, self.hold_s)


def _grid(duration: float, rate: float) -> np.ndarray:
    return np.linspace(0.0, duration, max(int(np.ceil(duration * rate)), 2) + 1)


def _fade(time: np.ndarray, duration: float, within: float) -> np.ndarray:
    """From 0 to 1 and back, smoothly, (rows,)."""
    part = np.clip(np.minimum(time, duration - time) / within, 0.0, 1.0)
    return part**2 * (3 - 2 * part)


def _held(time: np.ndarray, inputs: np.ndarray, rest: np.ndarray, hold: float) -> tuple[np.ndarray, np.ndarray]:
    inputs[0] = inputs[-1] = rest
    return np.append(time, time[-1] + hold), np.vstack([inputs, rest])


PATTERNS: dict[str, type[Pattern]] = {"hold": Hold, "steps": Steps, "ramp": Ramp, "sweep": Sweep, "circle": Circle}
