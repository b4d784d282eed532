"""Columns of a robot's data and limits of their values: all that data need to know about a robot."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from math import inf

import numpy as np

from tepm_opt.data.setpoints import AXES, FORCE_COLUMNS, input_columns, point_columns
from tepm_opt.data.signals import Part, Regime, Signals

TIME = "time_s"
LOW_PRESSURE, HIGH_TENSION = 0.15, 0.60  # of their ranges
_ACTUATOR = re.compile(r"(?:pressure|tension)_(\d+(?:_\d+)?)_(?:Pa|N)")
_POINT = re.compile(r"s(\d+)_[xyz]_m")


@dataclass(frozen=True)
class Channels:
    """Names and magnitudes of the quantities in a robot's data.

    Attributes:
        actuators: names of the actuators, module-major ("11", "12", …).
        points: names of the reference points from the base to the tip ("s1", …).
        pressure_max: largest pressure in Pa; infinite where unknown.
        tension_max: largest tension in N; infinite where unknown.
        height: of the last reference point above the base at rest in m; None where unknown.
        base: of the robot in G in m.
        axis: unit vector in G along the robot at rest.
        quickness: how much faster it sways than the paper's robot, roughly; 1 where unknown. Two robots of one kind may differ in it.
    """

    actuators: tuple[str, ...]
    points: tuple[str, ...]
    pressure_max: float = inf
    tension_max: float = inf
    height: float | None = None
    base: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    quickness: float = field(default=1.0, compare=False)

    @staticmethod
    def from_header(names: Iterable[str]) -> Channels:
        """Read channels from the names of a file's columns; magnitudes stay unknown."""
        names = list(names)
        actuators = {found[1] for name in names if (found := _ACTUATOR.fullmatch(name))}
        count = max((int(found[1]) for name in names if (found := _POINT.fullmatch(name))), default=0)
        ordered = sorted(actuators, key=lambda name: [int(part) for part in name.split("_")])
        return Channels(tuple(ordered), tuple(f"s{k + 1}" for k in range(count)))

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """Columns of u."""
        return tuple(input_columns(self.actuators))

    @cached_property
    def limits(self) -> np.ndarray:
        """Upper limits of u in Pa and N, (inputs,)."""
        return np.repeat([self.pressure_max, self.tension_max], len(self.actuators))

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Columns of the reference points."""
        return tuple(point_columns(self.points))

    @cached_property
    def signals(self) -> Signals:
        """Inputs and outputs as the search for missing effects takes them."""
        count, parts = len(self.actuators), []
        pressures, tensions = tuple(range(count)), tuple(range(count, 2 * count))
        for k, name in enumerate(self.actuators):
            parts += [Part("actuator", f"{name} pressure", (k,), pressures), Part("actuator", f"{name} tension", (count + k,), tensions)]
        modules = [name.partition("_")[0] if "_" in name else name[:-1] for name in self.actuators]
        for module in dict.fromkeys(modules):
            parts.append(Part("module", f"module {module}", tuple(k for k, other in enumerate(2 * modules) if other == module)))
        regimes = (
            Regime("low pressure", "at low pressure", pressures, high=LOW_PRESSURE, used=True),
            Regime("high tension", "at high tension", tensions, low=HIGH_TENSION),
        )
        return Signals(self.inputs, tuple(self.limits.tolist()), self.points, AXES, "m", tuple(parts), regimes)

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """All columns of SPEC section 4 in their order."""
        return (TIME, *self.inputs, *FORCE_COLUMNS, *self.coordinates)
