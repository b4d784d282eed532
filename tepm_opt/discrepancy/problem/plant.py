"""Candidate effects, and the interface of a plant in which they may be missing (extends `solvers.mechanics.plant.Plant`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import singledispatch
from typing import Literal, Protocol, cast

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.mechanics.plant import Free, Plant, Prediction

Stage = Literal["input", "body", "output"]


@dataclass(frozen=True)
class Candidate:
    """An effect that may be missing. Two with the same name, detail and runs are the same.

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
        acts: through what it acts: "axial" forces of the actuators, a "force" on the body, the "measurement".
        exact: whether its form is known exactly, so that it leaves nothing but noise where it alone is missing.
        runs: files of the runs in which it acts; none for all of them.
        ranges: lowest and highest value by full name, of parameters that the plant knows within a narrower range or does not free.
        happens: full name of the parameter that is the instant at which it begins to act for good; empty where it has none.
        timed: whether it changes with the session's time, so that runs before or after all others say something new of it.
        scatters: whether its parameters are alike and scatter about their null values with a spread of their own.
        suggested: values by full name of what says how it acts, from what a model leaves (see `models.effect.Effect.suggest_values`).
        further_shapes: such values from which it is fitted besides.
    """

    name: str
    detail: str | None = None
    runs: tuple[str, ...] = field(default=(), kw_only=True)
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
    acts: tuple[str, ...] = field(default=(), compare=False, repr=False)
    exact: bool = field(default=False, compare=False, repr=False)
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict, compare=False, repr=False)
    happens: str = field(default="", compare=False, repr=False)
    timed: bool = field(default=False, compare=False, repr=False)
    scatters: bool = field(default=False, compare=False, repr=False)
    suggested: Callable[[np.ndarray, np.ndarray, np.ndarray], Mapping[str, float]] | None = field(default=None, compare=False, repr=False)
    further_shapes: tuple[Mapping[str, float], ...] = field(default=(), compare=False, repr=False)

    @property
    def label(self) -> str:
        """Name of the candidate with its detail: "actuator_gain[13]"."""
        return self.name if self.detail is None else f"{self.name}[{self.detail}]"

    @property
    def full_label(self) -> str:
        """Its label with the runs in which it acts, where that is not all of them."""
        return f"{self.label} in {', '.join(self.runs)}" if self.runs else self.label

    @property
    def form_of(self) -> str:
        """Key shared by all forms of one family at one place: "friction[slide]"; the label of a candidate without a family."""
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
        modules: alike modules side by side, whose parameters may scatter from one to the next; 1 where it has none.
        without_candidates: the same machine without them, which is simulated faster.
        equilibria: `without_candidates` for equilibria, where these are had much faster than motions; else None.
    """

    @property
    def without_candidates(self) -> Plant: ...

    @property
    def equilibria(self) -> Plant | None: ...

    @property
    def derivatives_apart(self) -> float: ...

    @property
    def modules(self) -> int: ...

    @property
    def name(self) -> str: ...

    @property
    def signals(self) -> Signals: ...

    @property
    def known(self) -> tuple[str, ...]: ...

    @property
    def candidates(self) -> tuple[Candidate, ...]: ...

    def with_values(self, values: Mapping[str, float]) -> SearchablePlant: ...

    def corrected_model(self, kept: Sequence[Candidate]) -> object:
        """The model with these effects only and the values it has, in the form that people go on with."""


class Network(Plant, Protocol):
    """A plant that is a network of masses and springs, in which free-form laws can act.

    Attributes:
        model: compiled, with the values of the parameters.
    """

    @property
    def model(self) -> CompiledModel: ...


def as_network(plant: Plant) -> Network | None:
    """The plant as a network; None for other machines, which offer no `model`."""
    return cast(Network, plant) if getattr(plant, "model", None) is not None else None


@dataclass(frozen=True, eq=False)
class InSomeRuns:
    """A plant in which some effects act in some runs only.

    Attributes:
        plant: in which they act in all runs.
        effects: with the runs in which they do.
    """

    plant: Plant
    effects: tuple[Candidate, ...]

    @property
    def values(self) -> Mapping[str, float]:
        """Values of all parameters by full name, as they are in the runs in which effects act."""
        return self.plant.values

    @property
    def states(self) -> Mapping[str, float]:
        """The plant's."""
        return self.plant.states

    @property
    def concurrent(self) -> bool:
        """Whether runs may be predicted at the same time."""
        return self.plant.concurrent

    @property
    def static(self) -> bool:
        """Whether rows are equilibria."""
        return self.plant.static

    @property
    def quick(self) -> bool:
        """Whether a run takes little time."""
        return self.plant.quick

    def with_values(self, values: Mapping[str, float]) -> InSomeRuns:
        """The same with other values of some parameters."""
        return replace(self, plant=self.plant.with_values(values))

    def free(self, names: Sequence[str]) -> tuple[Free, ...]:
        """The plant's."""
        return self.plant.free(names)

    def predict(self, run: Run, by: Sequence[str] = (), step: float = np.inf) -> Prediction:
        """Prediction of a run; its derivatives by the parameters of effects that do not act in it are zero."""
        absent = {name: value for effect in self.effects if run.file not in effect.runs for name, value in effect.null.items()}
        if not absent:
            return self.plant.predict(run, by, step)
        at = [k for k, name in enumerate(by) if name not in absent]
        found = self.plant.with_values(absent).predict(run, [by[k] for k in at], step)
        whole = np.zeros((len(by), *found.by.shape[1:]))
        whole[at] = found.by
        return Prediction(found.points, whole)


def restrict_effects_to_runs(plant: Plant, effects: Iterable[Candidate]) -> Plant:
    """The plant with those effects that act in some runs only restricted to these runs."""
    partly = tuple(effect for effect in effects if effect.runs)
    return InSomeRuns(plant, partly) if partly else plant


@singledispatch
def without_run_restriction(plant: Plant) -> Plant:
    """The plant with all effects in all runs, the inverse of `restrict_effects_to_runs`."""
    return plant


@without_run_restriction.register
def _(plant: InSomeRuns) -> Plant:
    return plant.plant


def free_candidate_parameters(plant: Plant, candidate: Candidate) -> tuple[Free, ...]:
    """Free parameters of a candidate, each within the candidate's own range if it has one, else within the plant's."""
    found = []
    for free in plant.free(candidate.parameters):
        if free.name in candidate.ranges:
            low, high = candidate.ranges[free.name]
            free = replace(free, low=low, high=high, prior_std=np.inf, changed=True)
        found.append(free)
    return tuple(found)


def collect_free_parameters(known: Sequence[Free], plant: Plant, effects: Iterable[Candidate]) -> tuple[Free, ...]:
    """Free parameters of a fit with some effects: the known ones within their ranges, then the effects' in the effects' ranges."""
    added = {free.name: free for effect in effects for free in free_candidate_parameters(plant, effect)}
    return (*(free for free in known if free.name not in added), *added.values())
