"""What effects that any machine may have are made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import casadi as ca

from tepm_opt.discrepancy.plant import Stage


@dataclass(frozen=True)
class Quantity:
    """A parameter of an effect, in parts of the size that such a quantity has where the effect acts.

    Attributes:
        name: within the effect.
        size: what its size is made of: "force", "speed", "position", "signal", "time", a quotient of two of them, or "1".
        null: value at which the effect vanishes; where another parameter makes it vanish, a usual value.
        probes: values worth a try: decades where nobody knows.
        low, high: its range.
        shape: whether it says how the effect acts, not how strongly.
    """

    name: str
    size: str
    null: float
    probes: tuple[float, ...]
    low: float
    high: float
    shape: bool = False

    def in_units(self, sizes: Mapping[str, float]) -> Quantity:
        """The same in units, for sizes by name."""
        above, _, below = self.size.partition("/")
        unit = sizes[above] / (sizes[below] if below else 1.0)
        probes = tuple(p * unit for p in self.probes)
        return replace(self, null=self.null * unit, probes=probes, low=self.low * unit, high=self.high * unit)


@dataclass(frozen=True)
class At:
    """Where and when a law is asked.

    Attributes:
        signal: what goes in, or what is measured.
        position, speed: of an axis.
        p: the effect's parameters by name.
        z: its states.
        step: the time step in s: what is faster is not resolved.
        sizes: of quantities there, by name.
    """

    p: Mapping[str, ca.SX]
    z: list[ca.SX]
    sizes: Mapping[str, float]
    step: ca.SX = field(default_factory=lambda: ca.SX(0))
    signal: ca.SX = field(default_factory=lambda: ca.SX(0))
    position: ca.SX = field(default_factory=lambda: ca.SX(0))
    speed: ca.SX = field(default_factory=lambda: ca.SX(0))


@dataclass(frozen=True)
class Law:
    """An effect.

    Attributes:
        name: of the effect.
        stage: "input" (of a signal that goes in), "body" (a force on an axis) or "output" (of a signal that is measured).
        quantities: its parameters.
        act: what becomes of the signal, or the force on the axis; and the rates of the states.
        states: how many it has; states of signals begin as the signal, those of axes at 0.
        smooth: whether the outcome is nearly linear in the parameters from the null on.
        explains: what it is.
        reference: where the law is from.
        beside: effects one of which it needs.
        family: what it is one form of.
    """

    name: str
    stage: Stage
    quantities: tuple[Quantity, ...]
    act: Callable[[At], tuple[ca.SX, list[ca.SX]]]
    states: int = 0
    smooth: bool = True
    explains: str = ""
    reference: str = ""
    beside: tuple[str, ...] = ()
    family: str = ""
