"""The network with its missing effects: every known effect with every detail, all in one model at their null values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from tepm_opt.data.channels import Channels
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.models.compile import compile_model
from tepm_opt.models.effect import ActiveEffect, Effect
from tepm_opt.models.effects import effects, find_effect
from tepm_opt.models.layout import Layout
from tepm_opt.models.model import Model
from tepm_opt.models.robot import UNITS
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant

PARAMETER = "parameter"  # the cause that a value of the robot file is wrong


def candidate(name: str, detail: str | None = None, layout: Layout | None = None) -> Candidate:
    """An effect of the network, on its detail where it has one, as a candidate; of one whose parameters depend on it with the layout."""
    hooks = {
        "axial": ("inputs", "pressure_memory", "tension_memory", "delay", "edge_energy", "tendon_energy", "edge_memory", "properties"),
        "force": ("loads", "properties"),
        "measurement": ("outputs",),
    }  # of effects that act through axial forces, a force, the measurement
    effect, label = find_effect(name), ActiveEffect(name, detail).label
    own = effect.parameters if layout is None else effect.parameters_of(layout)
    shape = any(p.is_shape and not p.refines for p in own)  # without these parameters the others mean nothing
    acts_first = any(effect.has(hook) for hook in ("inputs", "pressure_memory", "tension_memory", "tendon_energy", "delay"))
    inputs = acts_first or effect.detail == "actuator"  # the gauges of an actuator may show its effects
    return Candidate(
        name,
        detail,
        {f"{label}.{parameter.name}": parameter.null for parameter in own},
        tuple({f"{label}.{p.name}": probe.get(p.name, p.probe) for p in own} for probe in ({}, *effect.further_probes)),
        "input" if inputs else "body",
        effect.smooth and (not shape or effect.has("suggest_values")),
        tuple(f"{label}.{p.name}" for p in own if p.is_shape),
        explains=effect.explains,
        part=effect.detail or "",
        reference=effect.reference,
        acts=tuple(kind for kind, own in hooks.items() if any(effect.has(hook) for hook in own)),
        exact=effect.exact,
        happens=f"{label}.{effect.happens}" if effect.happens else "",
        timed=effect.timed,
        scatters=any(p.spread for p in own),
        suggested=partial(_suggest_values, effect, label) if effect.has("suggest_values") else None,
        further_shapes=tuple({f"{label}.{name}": value for name, value in shape.items()} for shape in effect.further_shapes),
    )


def _suggest_values(effect: Effect, label: str, clock: np.ndarray, began: np.ndarray, left: np.ndarray) -> dict[str, float]:
    """Values of `Effect.suggest_values` by full name."""
    return {f"{label}.{name}": value for name, value in effect.suggest_values(clock, began, left).items()}


def candidates(model: Model) -> tuple[Candidate, ...]:
    """All effects that the model does not have yet, one for every detail of those that have one."""
    layout = Layout.from_robot(model.robot)
    every = [candidate(effect.name, detail, layout) for effect in effects() for detail in layout.details(effect.detail) or (None,)]
    present = {effect.label for effect in model.effects}
    return tuple(candidate for candidate in every if candidate.label not in present)


def wrong_values(model: Model) -> tuple[Candidate, ...]:
    """Causes that a value of the robot file is wrong, beyond its prior or although it is taken to be right; one for every value.

    A value may be a tenth or ten times that of the file. A probe of 5 % is visible and still nearly linear.
    """
    nominal = model.robot.parameters.model_dump()
    return tuple(
        Candidate(
            PARAMETER,
            name,
            {name: value},
            ({name: 1.05 * value},),
            explains="a value of the robot file is wrong",
            part="parameter",
            acts=("axial", "force", "measurement"),
            exact="s/m" not in UNITS[name],  # damping is somebody's formula
            ranges={name: (value / 10, 10 * value)},
        )
        for name, value in nominal.items()
        if value > 0 and name in UNITS
    )


def with_all_candidates(model: Model, missing: Iterable[Candidate]) -> Model:
    """The model with all candidates at their null values: the same motion, and one compilation for every fit that follows."""
    added = [ActiveEffect(c.name, c.detail, {name.removeprefix(f"{c.label}."): null for name, null in c.null.items()}) for c in missing]
    return replace(model, effects=(*model.effects, *added))


def with_selected_candidates(model: Model, values: Mapping[str, float], kept: Iterable[Candidate]) -> Model:
    """The model with those candidates only, and all parameters at `values` (full names)."""
    kept = [candidate for candidate in kept if candidate.name != PARAMETER]
    parameters = {name: values[name] for name, nominal in model.robot.parameters.model_dump().items() if values[name] != nominal}
    present = [(effect.name, effect.detail) for effect in model.effects] + [(c.name, c.detail) for c in kept]
    layout = Layout.from_robot(model.robot)
    return replace(model, parameters=parameters, effects=tuple(acting_effect(*each, values, layout) for each in present))


def acting_effect(name: str, detail: str | None, values: Mapping[str, float], layout: Layout) -> ActiveEffect:
    """An effect with its parameters out of a whole model's; those that rounding put beside a bound are at it.

    Args:
        name: of the effect.
        detail: where it acts.
        values: of all parameters by full name.
        layout: of the robot.
    """
    prefix, own = ActiveEffect(name, detail).label, find_effect(name).parameters_of(layout)
    return ActiveEffect(name, detail, {p.name: min(max(values[f"{prefix}.{p.name}"], p.low), p.high) for p in own})


@dataclass(frozen=True, eq=False)
class SearchableNetwork(NetworkPlant):
    """A network in which effects may be missing, see `plant.SearchablePlant`.

    Attributes:
        known_model: of the machine; the effects it has are fitted anew with the known parameters.
        candidates: effects that it does not have, at their null values in the compiled model.
        signals: of its robot's data.
    """

    known_model: Model = field(kw_only=True)
    candidates: tuple[Candidate, ...] = field(kw_only=True)
    signals: Signals = field(kw_only=True)

    @staticmethod
    def from_model(known: Model, channels: Channels, static: bool = False) -> SearchableNetwork:
        """Compile a network with all effects that it does not have yet."""
        missing = candidates(known)
        wrong = wrong_values(known)
        model = compile_model(with_all_candidates(known, missing))
        return SearchableNetwork(model, static, known_model=known, candidates=(*missing, *wrong), signals=channels.signals)

    @staticmethod
    def of_known(known: Model, channels: Channels, static: bool = False) -> SearchableNetwork:
        """A network to which nothing is missing: enough to check the set-up, and compiled in a fraction of the time."""
        return SearchableNetwork(compile_model(known), static, known_model=known, candidates=(), signals=channels.signals)

    @property
    def without_candidates(self) -> NetworkPlant:
        """The network of the known model."""
        return self._known_network

    @cached_property
    def _known_network(self) -> NetworkPlant:
        return NetworkPlant(compile_model(self.known_model), self.static)

    @property
    def equilibria(self) -> NetworkPlant | None:
        """The network of the known model at rest, where the runs are motions."""
        return None if self.static else replace(self.without_candidates, static=True)

    @property
    def name(self) -> str:
        """The robot's."""
        return self.known_model.robot.name

    @property
    def modules(self) -> int:
        """The robot's."""
        return self.model.layout.modules

    @property
    def derivatives_apart(self) -> float:
        """Derivatives of its motion are smooth."""
        return 0.04

    @property
    def known(self) -> tuple[str, ...]:
        """The robot's parameters with priors and those of the effects that it has."""
        missing = {name for candidate in self.candidates for name in candidate.parameters}
        return (*self.known_model.robot.priors, *(name for name in self.values if "." in name and name not in missing))

    def corrected_model(self, kept: Sequence[Candidate]) -> Model:
        """The model with these effects only and the values it has."""
        return with_selected_candidates(self.known_model, self.model.values, kept)
