"""Input patterns of recording plans: what a run in a plan says, and the set points it stands for."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal
from zlib import crc32

import numpy as np
from pydantic import Field

from tepm_opt.data.documents import Number, Section, require_range
from tepm_opt.data.run import Role
from tepm_opt.data.setpoints import FORCE_COLUMNS, SetPoints, read_setpoints
from tepm_opt.errors import InputError, unknown_name
from tepm_opt.models.channels import channels_of
from tepm_opt.models.robot import Robot
from tepm_opt.recording.drive import refuse_unplayable

Seconds = Annotated[float, require_range(0, 3600, "s")]
Lead = Annotated[float, require_range(0.5, 60, "s")]
Hertz = Annotated[float, require_range(1e-3, 1e3, "Hz")]
Count = Annotated[int, Field(strict=True, ge=1, le=10000, description="1 … 10000")]
Level = dict[str, Number]
"""Values of inputs and tip forces by name; see `PatternContext.level`."""


@dataclass(frozen=True)
class PatternContext:
    """Robot, sample rate and folder for which a run of a plan is worked out.

    Attributes:
        robot: that it moves.
        rate: of the samples in Hz.
        folder: of the plan.
        where: names the run in errors.
    """

    robot: Robot
    rate: float
    folder: Path
    where: str

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Pressures, tensions and the three components of the tip force: what a pattern drives."""
        return (*channels_of(self.robot).inputs, *FORCE_COLUMNS)

    @cached_property
    def _named(self) -> Mapping[str, list[int]]:
        """The columns that a name stands for."""
        named: dict[str, list[int]] = {}
        for k, column in enumerate(self.columns[:-3]):
            kind, unit = column.split("_")[0], column.split("_")[-1]
            module = k % (len(self.robot.input_max) // 2) // self.robot.actuators + 1
            for name in (f"{kind}_{unit}", f"{kind}_{module}_{unit}", column):
                named.setdefault(name, []).append(k)
        return named | {name: [self.columns.index(name)] for name in FORCE_COLUMNS}

    def level(self, values: Level, start: np.ndarray, key: str) -> np.ndarray:
        """`start` (columns,) with some values changed.

        A name is a column (`pressure_12_Pa`, `tip_force_x_N`), a module (`pressure_1_Pa`) or all (`tension_N`); the narrower one wins.

        Raises:
            InputError: a name that is none of these; `key` says where it stands.
        """
        level = start.copy()
        for name in values:
            if name not in self._named:
                raise unknown_name("input", name, self._named, f"{self.where}: {key}")
        for name in sorted(values, key=lambda name: -len(self._named[name])):
            level[self._named[name]] = values[name]
        return level


class RunPlan(Section):
    """A run of a plan; every one starts with `lead_s` of steady inputs."""

    file: Annotated[str, Field(pattern=r"^[A-Za-z0-9][\w. -]*\.csv$", description="a plain file name ending in .csv")]
    role: Role
    lead_s: Lead = 1.0

    @abstractmethod
    def setpoints(self, setup: PatternContext) -> SetPoints:
        """The set points of the run: steady for `lead_s`, then what it is about.

        Raises:
            InputError: unknown input, value outside the robot's limits.
        """


class FileRun(RunPlan):
    """A set-point file, relative to the plan."""

    inputs: Annotated[str, Field(min_length=1, description="the path of a set-point file")]

    def setpoints(self, setup: PatternContext) -> SetPoints:
        """The rows of the file; see `RunPlan.setpoints`."""
        path, robot = setup.folder / self.inputs, setup.robot
        found = read_setpoints(path, channels_of(robot).actuators, robot.input_max)
        refuse_unplayable(found, str(path))
        time = np.append(0.0, found.time - found.time[0] + self.lead_s)
        return SetPoints(time, *(np.vstack([values[:1], values]) for values in (found.inputs, found.tip_force)))


Knots = list[tuple[float, np.ndarray]]
"""Seconds since the knot before, and the values (columns,) reached then."""


class Pattern(RunPlan):
    """A built-in pattern: it starts from `rest`, returns to it and stays there for `rest_s`, all of that `repeats` times."""

    rest: Level = Field(default_factory=dict)
    rest_s: Seconds = 2.0
    repeats: Count = 1

    def setpoints(self, setup: PatternContext) -> SetPoints:
        """Linear between the pattern's knots, which stand on the grid of the samples; see `RunPlan.setpoints`."""
        rest = setup.level(self.rest, np.zeros(len(setup.columns)), "rest")
        cycle = [*self.knots(rest, setup), (self.rest_s, rest)]
        seconds, values = zip((0.0, rest), (self.lead_s, rest), *cycle * self.repeats, strict=True)
        steps = np.maximum(np.round(np.multiply(seconds, setup.rate)), 1)
        time, values = (np.cumsum(steps) - 1) / setup.rate, np.array(values)
        limits = setup.robot.input_max
        inputs, force = values[:, : len(limits)], values[:, len(limits) :]
        wrong = (inputs < -1e-9 * limits) | (inputs > limits * (1 + 1e-9))
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            found = f"{setup.columns[column]} = {inputs[row, column]:g} at {time[row]:.3g} s"
            raise InputError(f"{setup.where}: {found}; valid: 0 … {limits[column]:g}")
        return SetPoints(time, np.clip(inputs, 0.0, limits), force)

    @abstractmethod
    def knots(self, rest: np.ndarray, setup: PatternContext) -> Knots:
        """List the pattern's knots between `rest` (columns,) and `rest`."""


class HeldPattern(Pattern):
    """Base of `steps` and `random`: goes from level to level, each reached within `rise_s` and held for `hold_s`."""

    rise_s: Seconds
    hold_s: Seconds

    def knots(self, rest: np.ndarray, setup: PatternContext) -> Knots:
        """See `Pattern.knots`."""
        knots: Knots = []
        for target in self.targets(rest, setup):
            knots.append((self.rise_s, target))
            if self.hold_s:
                knots.append((self.hold_s, target))
        return [*knots, (self.rise_s, rest)]

    @abstractmethod
    def targets(self, rest: np.ndarray, setup: PatternContext) -> list[np.ndarray]:
        """The levels, (columns,) each; what a plan does not name is at `rest` (columns,)."""


class Steps(HeldPattern):
    """Levels that the plan names: steps, ramps and, with `hold_s` 0, triangles."""

    pattern: Literal["steps"] = "steps"
    levels: Annotated[list[Level], Field(min_length=1, description="at least one table of inputs")]
    rise_s: Seconds = 0.0
    hold_s: Seconds = 3.0

    def targets(self, rest: np.ndarray, setup: PatternContext) -> list[np.ndarray]:
        """See `HeldPattern.targets`."""
        return [setup.level(level, rest, f"levels entry {k + 1}") for k, level in enumerate(self.levels)]


class Random(HeldPattern):
    """`count` levels drawn evenly between `low` and `high`; `seed` and the file's name say which."""

    pattern: Literal["random"] = "random"
    low: Level = Field(default_factory=dict)
    high: Level
    count: Count = 10
    seed: Annotated[int, Field(strict=True, ge=0, le=2**32 - 1, description="0 … 2^32 − 1")] = 0
    rise_s: Seconds = 0.2
    hold_s: Seconds = 2.0

    def targets(self, rest: np.ndarray, setup: PatternContext) -> list[np.ndarray]:
        """See `HeldPattern.targets`."""
        low, high = setup.level(self.low, rest, "low"), setup.level(self.high, rest, "high")
        share = np.random.default_rng([self.seed, crc32(self.file.encode())]).random((self.count, len(rest)))
        return list(low + (high - low) * share)


class Sweep(Pattern):
    """Sines about rest from one frequency to another, as many periods in every octave, one after another for each of `amplitudes`.

    Each fades in and out over a tenth of the time. With equal frequencies it is a plain sine.
    """

    pattern: Literal["sweep"] = "sweep"
    amplitudes: Annotated[list[Level], Field(min_length=1, description="at least one table of inputs")]
    from_hz: Hertz = 0.1
    to_hz: Hertz = 2.0
    duration_s: Annotated[float, require_range(1, 3600, "s")] = 30.0

    def knots(self, rest: np.ndarray, setup: PatternContext) -> Knots:
        """See `Pattern.knots`."""
        fastest = max(self.from_hz, self.to_hz)
        if fastest > setup.rate / 4:
            raise InputError(f"{setup.where}: {fastest:g} Hz; valid: up to {setup.rate / 4:g} Hz, a quarter of the sample rate")
        time, octaves = _grid(self.duration_s, setup.rate), np.log(self.to_hz / self.from_hz)
        growth = np.expm1(octaves * time / self.duration_s) / octaves if abs(octaves) > 1e-9 else time / self.duration_s
        wave = np.sin(2 * np.pi * self.from_hz * self.duration_s * growth) * _fade(time, 0.1 * self.duration_s)
        still = np.zeros(len(rest))
        amplitudes = [setup.level(level, still, f"amplitudes entry {k + 1}") for k, level in enumerate(self.amplitudes)]
        return [(1 / setup.rate, rest + part * amplitude) for amplitude in amplitudes for part in wave]


class Circle(Pattern):
    """Pressures of a module out of phase by the angles of its actuators, so that its bending goes round; fades in and out over a turn."""

    pattern: Literal["circle"] = "circle"
    amplitude_Pa: Annotated[float, require_range(0, 2e7, "Pa")]
    modules: list[Annotated[int, Field(strict=True, ge=1, description="numbers of modules")]] | None = None
    period_s: Annotated[float, require_range(0.1, 3600, "s")] = 10.0
    turns: Annotated[float, require_range(1, 1e4, "turns")] = 3.0

    def knots(self, rest: np.ndarray, setup: PatternContext) -> Knots:
        """See `Pattern.knots`."""
        robot = setup.robot
        moved = self.modules or list(range(1, robot.modules + 1))
        if max(moved) > robot.modules:
            raise InputError(f"{setup.where}: modules = {moved}; valid: 1 … {robot.modules}")
        time = _grid(self.turns * self.period_s, setup.rate)
        waves = np.cos(2 * np.pi * time[:, None] / self.period_s - robot.angles)
        waves *= self.amplitude_Pa * _fade(time, min(self.period_s, time[-1] / 2))[:, None]
        values = np.tile(rest, (len(time), 1))
        for module in moved:
            values[:, (module - 1) * robot.actuators : module * robot.actuators] += waves
        return [(1 / setup.rate, row) for row in values]


def _grid(duration: float, rate: float) -> np.ndarray:
    """Times of samples, from the first after 0 to the end."""
    return np.arange(1, max(round(duration * rate), 2) + 1) / rate


def _fade(time: np.ndarray, within: float) -> np.ndarray:
    """From 0 to 1 and back to 0 at the last time, smoothly, (rows,)."""
    part = np.clip(np.minimum(time, time[-1] - time) / within, 0.0, 1.0)
    return part**2 * (3 - 2 * part)


PATTERNS: dict[str, type[Pattern]] = {"steps": Steps, "random": Random, "sweep": Sweep, "circle": Circle}
