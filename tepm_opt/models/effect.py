"""Base of effects: a name, parameters that make it vanish at their null values, and only the hooks it needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import casadi as ca
import numpy as np

from tepm_opt.models.memories import Lag, Memory, Play
from tepm_opt.renamed import adopt_renamed_hook

if TYPE_CHECKING:
    from tepm_opt.models.layout import Edge, Layout


CLOCK, BEGAN = "clock", "began"
"""Reserved names: the time in the session, and when in it the present run began, in s; both 0 in statics."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect.

    Attributes:
        name: in full words, without unit.
        unit: SI unit.
        null: the value at which the effect vanishes exactly; of a shape parameter, which has no influence then, a usual one.
        probe: a small but visible size, for finite probes and as start of a fit; of a shape parameter the same as `null`.
        low, high: the values that make physical sense; others are refused.
        change: of a shape parameter that is 0 at its null, a small but visible change.
        finer: of a shape parameter that is not 0 at its null, whether it only shapes what refines the effect.
        spread: group of alike parameters that scatter about their null values with a spread of their own (see `identification.hierarchy`).
    """

    name: str
    unit: str
    null: float
    probe: float
    low: float = -np.inf
    high: float = np.inf
    change: float = 0.0
    spread: str = ""
    finer: bool = False

    @property
    def refines(self) -> bool:
        """Whether it refines how the effect acts, which acts without it, too: a corner, a bend."""
        return self.is_shape and (self.finer or not self.null)

    @property
    def is_shape(self) -> bool:
        """Whether it says how the effect acts, not how strongly; where a model does not give it, it has its usual value."""
        return self.null == self.probe

    @property
    def scale(self) -> float:
        """A small but visible change of it."""
        return abs(self.probe - self.null) or self.change or 0.3 * abs(self.probe)


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
    """Data that a hook may use besides its parameters.

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
        parameters: the effect's own parameters; of one whose parameters depend on the robot `parameters_of`.
        detail: what the effect's detail names: "actuator", "point" or None where there is none.
        smooth: whether outputs are differentiable in the parameters at their null values (else: probe).
        exact: whether its form follows from mechanics or geometry (a load, a shift), so that it leaves nothing but noise where it acts;
            a valve's, a material's and a gauge's is somebody's formula.
        corners: whether what it does to the properties has corners along the inputs.
        delays_forces: whether its delay is one of known forces, too.
        further_probes: values by name, where its parameters' probes are not all that one would look for it at.
        further_shapes: values by name of what says how it acts, from which it is fitted besides those that `suggest_values` gives.
        branches: states of each pressure, whose sum acts; `pressure_memory` and `pressure_begun` are given, and give, blocks of modules
            below each other, (branches · modules, actuators).
        of_device: whether a device does it, so that it acts on commands before anything else does, however effects are listed.
        feels_tension: whether its edge memory asks for the tendons' tension.
        timed: whether it asks what time it is; `parameters` then has `CLOCK` and `BEGAN`, too.
        happens: the parameter that is the instant of the session at which it begins to act for good; empty where it has none.
    """

    name: ClassVar[str]
    explains: ClassVar[str]
    reference: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    detail: ClassVar[str | None] = None
    smooth: ClassVar[bool] = True
    exact: ClassVar[bool] = False
    corners: ClassVar[bool] = False
    branches: ClassVar[int] = 1
    of_device: ClassVar[bool] = False
    feels_tension: ClassVar[bool] = False
    timed: ClassVar[bool] = False
    happens: ClassVar[str] = ""
    delays_forces: ClassVar[bool] = False
    further_probes: ClassVar[tuple[Mapping[str, float], ...]] = ()
    further_shapes: ClassVar[tuple[Mapping[str, float], ...]] = ()

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        adopt_renamed_hook(cls, "suggested", "suggest_values")

    def parameters_of(self, layout: Layout) -> tuple[Parameter, ...]:
        """The effect's parameters in a robot."""
        return self.parameters

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

    def tendon_energy(self, length: ca.SX, rest: ca.SX, tension: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        """Additional potential in J of the tendon along a vertical edge, beside tension times length.

        Args:
            length: of the edge in m.
            rest: its rest length in m.
            tension: the effective one after the input maps in N.
            parameters: the effect's own by name, SI symbols.
            context: what else it may know.
        """
        return ca.SX(0)

    def edge_drag(self, edge: Edge, length: ca.SX, rate: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        """Additional force of an edge in N that pulls its ends together, as a function of how fast its length changes; 0 at rest.

        Args:
            edge: which one of a segment.
            length: its length in m.
            rate: of its length in m/s.
            parameters: the effect's own by name, SI symbols.
            context: what else it may know.
        """
        return ca.SX(0)

    def point_energy(self, point: int, position: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        """Potential in J of a force on a reference point that depends on where it is: a wall, a hose, a spring to the ground.

        Args:
            point: its number from 0.
            position: of the point in G, (3,) in m.
            parameters: the effect's own by name, SI symbols.
            context: what else it may know.
        """
        return ca.SX(0)

    def point_drag(self, point: int, position: ca.SX, velocity: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        """Force on a reference point in G that its motion meets, (3,) in N; 0 at rest.

        Args:
            point: its number from 0.
            position: of the point in G, (3,) in m.
            velocity: of the point in G, (3,) in m/s.
            parameters: the effect's own by name, SI symbols.
            context: what else it may know.
        """
        return ca.SX.zeros(3)

    def pressure_memory(
        self, pressure: ca.SX, rate: ca.SX, state: ca.SX, parameters: Mapping[str, ca.SX], context: Context
    ) -> Memory | Play | None:
        """Internal states y of every pressure, (branches · modules, actuators) in Pa; the effective pressure is pressure + their sum.

        Args:
            pressure: what this effect's input map has left, (branches · modules, actuators) in Pa.
            rate: of this pressure, (branches · modules, actuators) in Pa/s.
            state: y before these act, (branches · modules, actuators) in Pa.
            parameters: the effect's own by name, SI symbols.
            context: what else it may know.
        """
        return None

    def pressure_begun(self, pressure: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        """States of the pressure memory in statics and where a run begins, (branches · modules, actuators) in Pa.

        Args:
            pressure: what this effect's input map has left, (branches · modules, actuators) in Pa.
            parameters: the effect's own by name, SI symbols.
            context: what else it may know.
        """
        return ca.SX.zeros(*pressure.shape)

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
    ) -> Memory | Sequence[Memory] | None:
        """Internal state y of an edge, or several, each a force in N that pulls its ends together; None where the effect leaves it alone.

        Args:
            edge: which one of a segment.
            length: its length in m.
            rate: of its length in m/s.
            properties: the edge's own, SI: "stiffness", "damping", "rest" and, of a vertical edge, "axial" and, where the effect feels
                it, "tension", the effective one after the input maps.
            parameters: the effect's own by name, SI symbols.
            context: what else it may know.
        """
        return None

    def lag(self, parameters: Mapping[str, ca.SX]) -> Lag | None:
        """Time constants, where this effect's pressure memory is a first-order lag that a controller can compensate; else None."""
        return None

    def friction(self, parameters: Mapping[str, ca.SX]) -> tuple[ca.SX, ca.SX] | None:
        """Constant part in N and share of the tension, where this effect's tension memory is dry friction of the tendons; else None.

        A memory follows reversals of the command. A controller that knows the muscles' motion lets friction follow that instead.
        """
        return None

    def friction_travel(self, values: Mapping[str, float]) -> str | None:
        """Name of the parameter with the travel in m over which friction turns over; None where it does not go by the muscles' motion.

        Args:
            values: of the parameters, in SI.
        """
        return None

    def hysteresis(self, parameters: Mapping[str, ca.SX]) -> ca.SX | None:
        """Half the width in Pa, where this effect's pressure memory is hysteresis of the muscles; else None.

        A controller foresees reversals by a hysteresis of its own, which begins with this width.
        """
        return None

    def delay(self, parameters: Mapping[str, ca.SX]) -> ca.SX:
        """Time in s by which all commands, and known forces where `delays_forces` says so, take effect late."""
        return ca.SX(0)

    def outputs(self, points: ca.SX, parameters: Mapping[str, ca.SX], context: Context) -> ca.SX:
        """Output map: reference points in G as measured from those in truth, both (3, points) in m."""
        return points

    def suggest_values(self, clock: np.ndarray, began: np.ndarray, left: np.ndarray) -> Mapping[str, float]:
        """Suggest values of shape parameters at which to look for this effect, by name, from what a model without it leaves.

        An effect that has this is nearly linear in its other parameters at such values, even if it is anything but that in these.

        Args:
            clock: time in the session of every sample, increasing, (samples,) in s.
            began: when its run began, (samples,) in s.
            left: measured less modelled coordinates over their noise, 0 where missing, (samples, coordinates).
        """
        return {}


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
