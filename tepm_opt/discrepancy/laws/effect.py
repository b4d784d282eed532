"""Effects that any machine may have: quantities, laws, and the place where a law acts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import casadi as ca

from tepm_opt.discrepancy.problem.plant import Candidate, Stage
from tepm_opt.solvers.mechanics.plant import Free


@dataclass(frozen=True)
class Quantity:
    """A parameter of an effect, in parts of the size that such a quantity has where the effect acts.

    Attributes:
        name: within the effect.
        size: kind of its size: "force", "speed", "position", "mass", "signal", "time", a quotient of two of them, or "1".
        null: value at which the effect vanishes; where another parameter makes it vanish, a usual value.
        probes: values worth a try: decades where nobody knows.
        low, high: its range, in which the law is passive where it is a passive element: fits stay within it.
        shape: whether it changes the form of the effect, not its strength.
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

    def unit(self, units: Mapping[str, str]) -> str:
        """The parameter's unit, for units of sizes by name; empty where one is not known."""
        above, _, below = self.size.partition("/")
        if not units[above] or (below and not units[below]):
            return ""
        return f"{units[above]}/{units[below]}" if below else units[above]


@dataclass(frozen=True)
class At:
    """Place and time at which a law is evaluated: in symbols of CasADi, or in arrays.

    Attributes:
        signal: an input or an output; of a long body the quantity that varies along it.
        position, speed: of an axis; of a vessel its level and the known part of the level's rate.
        along: parts of the body's length from its base, 0 … 1.
        turned: angle in rad by which the body has bent from its base to there.
        p: the effect's parameters by name.
        z: its states.
        step: the time step in s; anything faster is not resolved.
        earlier: function from a delay in s to the command delayed by it; None where only the present is known.
        sizes: of quantities there, by name.
    """

    p: Mapping[str, Any]
    z: list[ca.SX]
    sizes: Mapping[str, float]
    step: Any = 0.0
    signal: Any = 0.0
    position: Any = 0.0
    speed: Any = 0.0
    along: Any = 0.0
    turned: Any = 0.0
    earlier: Callable[[Any], Any] | None = None


@dataclass(frozen=True)
class Law:
    """An effect.

    Attributes:
        name: of the effect.
        stage: "input" (of a signal that goes in), "body" (a force on an axis) or "output" (of a signal that is measured).
        quantities: its parameters.
        act: its outcome (the signal after it, the force on the axis, or the losses and overflow of a vessel) and the rates of its states.
            The signal itself where absent: the machine's own function asks for the parameters.
        states: their number; states of signals begin at the signal, those of axes at 0.
        smooth: whether the outcome is nearly linear in the parameters from the null on.
        explains: the effect in words.
        reference: source of the law.
        beside: effects one of which it needs.
        family: name of the effect of which it is one form.
        place: the kind of part it acts on, where the stage does not tell: "vessel", "mass".
        gauge: whether a gauge that measures an input may have it, too: an offset, a gain.
        delays: whether it asks for the command's past (`At.earlier`): it acts before all other effects on an input.
    """

    name: str
    stage: Stage
    quantities: tuple[Quantity, ...]
    act: Callable[[At], tuple[Any, list[Any]]] = lambda at: (at.signal, [])
    states: int = 0
    smooth: bool = True
    explains: str = ""
    reference: str = ""
    beside: tuple[str, ...] = ()
    family: str = ""
    place: str = ""
    gauge: bool = False
    delays: bool = False

    @property
    def part(self) -> str:
        """Kind of part it acts on: "input", "axis", "output", "vessel", "mass"."""
        return self.place or ("axis" if self.stage == "body" else self.stage)

    def place_on(self, part: str, sizes: Mapping[str, float], units: Mapping[str, str]) -> tuple[Candidate, dict[str, Free]]:
        """The effect on a part of a machine, for sizes of its quantities by name, and its parameters by their names within it."""
        label = f"{self.name}[{part}]"
        quantities = {f"{label}.{q.name}": q.in_units(sizes) for q in self.quantities}
        free = {}
        for name, q in quantities.items():
            scale = abs(q.probes[0] - q.null) or 0.3 * abs(q.probes[0]) or 1.0
            free[q.name] = Free(name, q.unit(units), q.null, q.low, q.high, scale)
        null = {name: q.null for name, q in quantities.items()}
        shapes = tuple(name for name, q in quantities.items() if q.shape)
        candidate = Candidate(
            self.name, part, null, _probes(quantities), self.stage, self.smooth, shapes, self.beside, self.family, self.explains,
            self.part, self.reference, self.gauge,
        )  # fmt: skip
        return candidate, free


def _probes(quantities: Mapping[str, Quantity]) -> tuple[dict[str, float], ...]:
    """Sets of values worth a try: every strength in every shape; all strengths grow together."""
    strengths = {name: q.probes for name, q in quantities.items() if not q.shape}
    shapes = {name: q.probes for name, q in quantities.items() if q.shape}
    count = max(len(values) for values in strengths.values())
    strong = [{name: values[min(k, len(values) - 1)] for name, values in strengths.items()} for k in range(count)]
    return tuple(dict(zip(shapes, shape, strict=True)) | probe for shape in product(*shapes.values()) for probe in strong)
