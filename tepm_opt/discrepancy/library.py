"""What could be missing: every known effect with every detail, and one model that holds them all at their null values."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from tepm_opt.models.effect import ActiveEffect, Effect
from tepm_opt.models.effects import effects, find_effect
from tepm_opt.models.layout import Layout
from tepm_opt.models.model import Model


@dataclass(frozen=True)
class Candidate:
    """An effect that may be missing.

    Attributes:
        name: of the effect.
        detail: the actuator or reference point it acts on, where it has a detail.
    """

    name: str
    detail: str | None = None

    @property
    def effect(self) -> Effect:
        """The effect."""
        return find_effect(self.name)

    @property
    def label(self) -> str:
        """Name of the candidate with its detail: "actuator_gain[13]"."""
        return ActiveEffect(self.name, self.detail).label

    @property
    def parameters(self) -> tuple[str, ...]:
        """Full names of its parameters."""
        return tuple(f"{self.label}.{parameter.name}" for parameter in sorted(self.effect.parameters, key=lambda p: p.name))

    @property
    def null(self) -> dict[str, float]:
        """Values by full name at which it vanishes."""
        return {f"{self.label}.{parameter.name}": parameter.null for parameter in self.effect.parameters}

    @property
    def probe(self) -> dict[str, float]:
        """Small but visible values by full name."""
        return {f"{self.label}.{parameter.name}": parameter.probe for parameter in self.effect.parameters}

    @property
    def acts_on_inputs(self) -> bool:
        """Whether it stands between the commands and what presses and pulls, so that measured pressures and tensions may show it."""
        return any(self.effect.has(hook) for hook in ("inputs", "pressure_memory", "tension_memory", "delay"))

    @property
    def bends(self) -> bool:
        """Whether its outputs are far from linear in its parameters: not smooth at the null, or with parameters of shape."""
        return not self.effect.smooth or any(parameter.null == parameter.probe for parameter in self.effect.parameters)


def candidates(model: Model) -> tuple[Candidate, ...]:
    """All effects that the model does not have yet, one for every detail of those that have one."""
    layout = Layout.of(model.robot)
    every = [Candidate(effect.name, detail) for effect in effects() for detail in layout.details(effect.detail) or (None,)]
    present = {effect.label for effect in model.effects}
    return tuple(candidate for candidate in every if candidate.label not in present)


def wide(model: Model, missing: Iterable[Candidate]) -> Model:
    """The model with all candidates at their null values: the same motion, and one compilation for every fit that follows."""
    added = [ActiveEffect(c.name, c.detail, {p.name: p.null for p in c.effect.parameters}) for c in missing]
    return replace(model, effects=(*model.effects, *added))


def narrow(model: Model, values: dict[str, float], kept: Iterable[Candidate]) -> Model:
    """The model with those candidates only, and all parameters at `values` (full names)."""
    parameters = {name: values[name] for name, nominal in model.robot.parameters.model_dump().items() if values[name] != nominal}
    present = [(effect.name, effect.detail) for effect in model.effects] + [(c.name, c.detail) for c in kept]
    active = []
    for name, detail in present:
        prefix = ActiveEffect(name, detail).label
        active.append(ActiveEffect(name, detail, {p.name: values[f"{prefix}.{p.name}"] for p in find_effect(name).parameters}))
    return replace(model, parameters=parameters, effects=tuple(active))
