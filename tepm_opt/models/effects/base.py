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
        null: the value at which the effect vanishes exactly.
        probe: a small but visible size, for finite probes and as start of a fit.
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

    def inputs(self, pressure: ca.SX, tension: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> tuple[ca.SX, ca.SX]:
        """Input map: commanded to effective pressure (Pa) and tension (N), both of shape (modules, actuators)."""
        return pressure, tension

    def properties(self, properties: Properties, parameters: Mapping[str, ca.SX], context: Context) -> None:
        """Change stiffness, damping, rest length and mass in place."""

    def loads(self, properties: Properties, external: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        """Force on every level in the base frame, (3, n) in N; `external` are the known forces on the points in G, (3, points)."""
        return ca.SX.zeros(3, context.layout.levels)

    def edge_energy(self, edge: Edge, length: ca.SX, rest: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        """Additional potential of an edge in J as a function of its length in m."""
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
