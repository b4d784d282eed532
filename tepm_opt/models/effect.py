"""What an effect is: a name, parameters that make it vanish at their null values, and only the hooks it needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import casadi as ca
import numpy as np

if TYPE_CHECKING:
    from tepm_opt.models.layout import Edge, Layout


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect.

    Attributes:
        name: in full words, without unit.
        unit: SI unit.
        null: the value at which the effect vanishes exactly; of a shape parameter, which has no influence then, a usual one.
        probe: a small but visible size, for finite probes and as start of a fit; of a shape parameter the same as `null`.
        low, high: the values that make physical sense; others are refused.
    """

    name: str
    unit: str
    null: float
    probe: float
    low: float = -np.inf
    high: float = np.inf


@dataclass
class Properties:
    """The network's properties while it is written, as CasADi symbols; effects change them in place.

    A segment is a column, numbered from the base; edges are in `Layout.edges` order; SI units.

    Attributes:
        stiffness, damping, rest: of every edge, shape (edges, n).
        mass: of a node of each upper level, shape (n, 1).
        pressure, tension: the effective ones after the input maps, shape (modules, actuators).
    """

    stiffness: ca.SX
    damping: ca.SX
    rest: ca.SX
    mass: ca.SX
    pressure: ca.SX
    tension: ca.SX


@dataclass(frozen=True)
class Context:
    """What a hook may know besides its parameters.

    Attributes:
        layout: the network's geometry.
        detail: index of the actuator (module-major) or reference point an effect with a detail acts on.
        rotation, position: base plate in the tracker frame G, (3, 3) and (3,).
        gravity: in the base frame, (3,) in m/s².
    """

    layout: Layout
    detail: int | None
    rotation: np.ndarray
    position: np.ndarray
    gravity: np.ndarray


@dataclass(frozen=True)
class Lag:
    """A first-order lag of all pressures.

    Attributes:
        filling, exhausting: time constants of rising and of falling pressures in s, as CasADi symbols; 0 is at once.
    """

    filling: ca.SX
    exhausting: ca.SX


@dataclass(frozen=True)
class Memory:
    """An internal state y that is 0 at rest and forgets: dy/dt = drive - decay / scale * y, elementwise.

    `decay` and `scale` stand apart because either may vanish: a lag has decay 1 and its time constant as scale, a
    rate-independent memory the absolute rate of its signal as decay and a distance as scale.
    """

    drive: ca.SX
    decay: ca.SX
    scale: ca.SX

    def rate(self, state: ca.SX, step: ca.SX | float) -> ca.SX:
        """dy/dt at the end of an implicit stage of length `step` that starts at `state`; at `state` itself for step 0."""
        return (self.scale * self.drive - self.decay * state) / (self.scale + step * self.decay)

    def after(self, state: ca.SX, time: ca.SX) -> ca.SX:
        """y after a time over which drive and decay stay as they are: the exact solution, for any scale down to 0."""
        z = time * self.decay / (self.scale + SHORTEST) + TINY
        return ca.exp(-z) * state - ca.expm1(-z) / z * time * self.drive


@dataclass(frozen=True)
class Play:
    """An internal state of an input that goes against the input's changes until it reaches a limit, where it stays, elementwise.

    The play or backlash operator, its corner rounded: with the part e that is left to the limit,
    de/ds = -(1 - exp(-e / corner)) over the path s of the input.

    Attributes:
        limit: for the way the input goes now.
        rising: whether the input rises, so that the state falls.
        pace: the input's absolute rate.
        corner: over which sticking turns into following, above 0, in the input's unit.
    """

    limit: ca.SX
    rising: ca.SX
    pace: ca.SX
    corner: ca.SX

    def after(self, state: ca.SX, time: ca.SX) -> ca.SX:
        """y after a time at whose end the limit is this one: exact for a limit that stays."""
        sense = ca.if_else(self.rising, 1.0, -1.0)
        left, path = sense * (state - self.limit) / self.corner, time * self.pace / self.corner
        top = ca.fmax(left - path, 0)  # keeps the exponentials finite
        left = top + ca.log(ca.exp(-top) + ca.exp(left - path - top) - ca.exp(-path - top))
        return self.limit + sense * self.corner * left


SHORTEST = 1e-12  # keeps quotients finite where a scale vanishes
TINY = 1e-30


class Effect:
    """A physical effect. Subclasses set the class attributes and override only the hooks they need.

    Hooks are called once, when a model is compiled, with CasADi symbols; `parameters` maps names to symbols.

    Attributes:
        name: identifier (SPEC section 5).
        explains: one line for people.
        reference: where the physics is from.
        parameters: the effect's own parameters.
        detail: what the effect's detail names: "actuator", "point" or None where there is none.
        smooth: whether outputs are differentiable in the parameters at their null values (else: probe).
    """

    name: ClassVar[str]
    explains: ClassVar[str]
    reference: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    detail: ClassVar[str | None] = None
    smooth: ClassVar[bool] = True

    @classmethod
    def has(cls, hook: str) -> bool:
        """Whether this effect has a hook of its own, by the name of the method."""
        return getattr(cls, hook) is not getattr(Effect, hook)

    def inputs(self, pressure: ca.SX, tension: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> tuple[ca.SX, ca.SX]:
        """Input map: commanded to effective pressure (Pa) and tension (N), both of shape (modules, actuators).

        Args:
            pressure: what the effects before have left, (modules, actuators) in Pa.
            tension: what the effects before have left, (modules, actuators) in N.
            parameters: the effect's own by name, SI symbols.
            context: what else it may know.
        """
        return pressure, tension

    def properties(self, properties: Properties, parameters: Mapping[str, ca.SX], context: Context) -> None:
        """Change stiffness, damping, rest length and mass in place."""

    def loads(self, properties: Properties, external: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        """Force on every level in the base frame, (3, n) in N.

        Args:
            properties: the network's, with the changes of all effects.
            external: known forces on the reference points in G, (3, points) in N.
            parameters: the effect's own by name, SI symbols.
            context: what else it may know.
        """
        return ca.SX.zeros(3, context.layout.levels)

    def edge_energy(self, edge: Edge, length: ca.SX, rest: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        """Additional potential of an edge in J as a function of its length.

        Args:
            edge: which one of a segment.
            length: its length in m.
            rest: its rest length in m.
            parameters: the effect's own by name, SI symbols.
            context: what else it may know.
        """
        return ca.SX(0)

    def pressure_memory(
        self, pressure: ca.SX, rate: ca.SX, state: ca.SX, parameters: Mapping[str, ca.SX], context: Context
    ) -> Memory | Play | None:
        """Internal state y of every pressure, (modules, actuators) in Pa; the effective pressure is pressure + y.

        Args:
            pressure: what this effect's input map has left, (modules, actuators) in Pa.
            rate: of this pressure, (modules, actuators) in Pa/s.
            state: y before these act, (modules, actuators) in Pa.
            parameters: the effect's own by name, SI symbols.
            context: what else it may know.
        """
        return None

    def tension_memory(
        self, tension: ca.SX, rate: ca.SX, state: ca.SX, parameters: Mapping[str, ca.SX], context: Context
    ) -> Memory | Play | None:
        """Internal state y of every tension, (modules, actuators) in N; the effective tension is tension + y.

        Args:
            tension: what this effect's input map has left, (modules, actuators) in N.
            rate: of this tension, (modules, actuators) in N/s.
            state: y before these act, (modules, actuators) in N.
            parameters: the effect's own by name, SI symbols.
            context: what else it may know.
        """
        return None

    def edge_memory(
        self, edge: Edge, length: ca.SX, rate: ca.SX, properties: Mapping[str, ca.SX], parameters: Mapping[str, ca.SX], context: Context
    ) -> Memory | None:
        """Internal state y of an edge, a force in N that pulls its ends together; None for edges the effect leaves alone.

        Args:
            edge: which one of a segment.
            length: its length in m.
            rate: of its length in m/s.
            properties: the edge's own, SI: "stiffness", "damping", "rest" and, of a vertical edge, "axial".
            parameters: the effect's own by name, SI symbols.
            context: what else it may know.
        """
        return None

    def lag(self, parameters: Mapping[str, ca.SX]) -> Lag | None:
        """Time constants, where this effect's pressure memory is a first-order lag that a controller can compensate; else None."""
        return None

    def delay(self, parameters: Mapping[str, ca.SX]) -> ca.SX:
        """Time in s by which all commands take effect late."""
        return ca.SX(0)

    def outputs(self, points: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        """Output map: reference points in G as measured from those in truth, both (3, points) in m."""
        return points


@dataclass(frozen=True)
class ActiveEffect:
    """An effect in a model: plain data.

    Attributes:
        name: of the effect.
        detail: which actuator ("23") or reference point ("s3"), for effects that have one.
        parameters: values by parameter name, SI.
    """

    name: str
    detail: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Name with the detail: "actuator_gain[13]"."""
        return f"{self.name}[{self.detail}]" if self.detail else self.name
