"""What the search for missing effects asks of a model of a machine besides what identification asks (see `solvers.plant`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

from tepm_opt.data.signals import Signals
from tepm_opt.solvers.plant import Plant

Stage = Literal["input", "body", "output"]


@dataclass(frozen=True)
class Candidate:
    """An effect that may be missing. Two with the same name and detail are the same.

    Attributes:
        name: of the effect.
        detail: the actuator, reference point or other part it acts on, where it has a detail.
        null: values of its parameters, by full name, at which it vanishes.
        probes: small but visible values by full name: one set, or several where nobody knows how large it may be.
        stage: whether it stands between the commands and what presses and pulls (so that measured inputs may show it), in the body, or
            between the body and what is measured.
        smooth: whether outputs are differentiable at the null and nearly linear in the parameters from there; false: probes tell more.
        shapes: full names of the parameters that say how it acts, not how strongly; a probe is tried in any strength with its shape.
        beside: names of effects one of which it needs: it is looked for only where one of them was found.
        family: what it is one form of, besides others that do nearly the same: "friction". Forms neither stand beside each other nor are
            rivals; the form that fits best stands for all.
        explains: what it is, in words.
        part: what the detail is: "actuator".
        reference: where its form is from.
        gauge: whether a gauge that measures an input may have it, too: an offset, a gain.
    """

    name: str
    detail: str | None = None
    null: Mapping[str, float] = field(default_factory=dict, compare=False, repr=False)
    probes: tuple[Mapping[str, float], ...] = field(default=(), compare=False, repr=False)
    stage: Stage = field(default="body", compare=False, repr=False)
    smooth: bool = field(default=True, compare=False, repr=False)
    shapes: tuple[str, ...] = field(default=(), compare=False, repr=False)
    beside: tuple[str, ...] = field(default=(), compare=False, repr=False)
    family: str = field(default="", compare=False, repr=False)
    explains: str = field(default="", compare=False, repr=False)
    part: str = field(default="", compare=False, repr=False)
    reference: str = field(default="", compare=False, repr=False)
    gauge: bool = field(default=False, compare=False, repr=False)

    @property
    def label(self) -> str:
        """Name of the candidate with its detail: "actuator_gain[13]"."""
        return self.name if self.detail is None else f"{self.name}[{self.detail}]"

    @property
    def form_of(self) -> str:
        """What forms of the same thing at the same place have in common: "friction[slide]"; its label where it is of no family."""
        return f"{self.family}[{self.detail}]" if self.family else self.label

    @property
    def parameters(self) -> tuple[str, ...]:
        """Full names of its parameters."""
        return tuple(sorted(self.null))


class SearchablePlant(Plant, Protocol):
    """A plant with the effects that may be missing in it, all at their null values.

    Attributes:
        name: of the machine.
        signals: what is put in and what is measured.
        known: full names of the parameters that are known within their ranges; they are fitted with whatever effects.
        candidates: effects that may be missing.
        derivatives_apart: time in s between samples at which derivatives say enough; 0: every one.
    """

    @property
    def derivatives_apart(self) -> float: ...

    @property
    def name(self) -> str: ...

    @property
    def signals(self) -> Signals: ...

    @property
    def known(self) -> tuple[str, ...]: ...

    @property
    def candidates(self) -> tuple[Candidate, ...]: ...

    def with_values(self, values: Mapping[str, float]) -> SearchablePlant: ...

    def corrected(self, kept: Sequence[Candidate]) -> object:
        """The model with these effects only and the values it has, in the form that people go on with."""
