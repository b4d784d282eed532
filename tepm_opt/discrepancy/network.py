"""The network with what could be missing in it: every known effect with every detail, all in one model at their null values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from tepm_opt.data.channels import Channels
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.plant import Candidate
from tepm_opt.models.compile import compile_model
from tepm_opt.models.effect import ActiveEffect
from tepm_opt.models.effects import effects, find_effect
from tepm_opt.models.layout import Layout
from tepm_opt.models.model import Model
from tepm_opt.solvers.network_plant import NetworkPlant


def candidate(name: str, detail: str | None = None) -> Candidate:
    """An effect of the network, on its detail where it has one, as a candidate."""
    effect, label = find_effect(name), ActiveEffect(name, detail).label
    shape = any(parameter.null == parameter.probe for parameter in effect.parameters)  # parameters without which the others say nothing
    inputs = any(effect.has(hook) for hook in ("inputs", "pressure_memory", "tension_memory", "delay"))
    return Candidate(
        name,
        detail,
        {f"{label}.{parameter.name}": parameter.null for parameter in effect.parameters},
        ({f"{label}.{parameter.name}": parameter.probe for parameter in effect.parameters},),
        "input" if inputs else "body",
        effect.smooth and not shape,
        explains=effect.explains,
        part=effect.detail or "",
        reference=effect.reference,
    )


def candidates(model: Model) -> tuple[Candidate, ...]:
    """All effects that the model does not have yet, one for every detail of those that have one."""
    layout = Layout.of(model.robot)
    every = [candidate(effect.name, detail) for effect in effects() for detail in layout.details(effect.detail) or (None,)]
    present = {effect.label for effect in model.effects}
    return tuple(candidate for candidate in every if candidate.label not in present)


def wide(model: Model, missing: Iterable[Candidate]) -> Model:
    """The model with all candidates at their null values: the same motion, and one compilation for every fit that follows."""
    added = [ActiveEffect(c.name, c.detail, {p.name: p.null for p in find_effect(c.name).parameters}) for c in missing]
    return replace(model, effects=(*model.effects, *added))


def narrow(model: Model, values: Mapping[str, float], kept: Iterable[Candidate]) -> Model:
    """The model with those candidates only, and all parameters at `values` (full names)."""
    parameters = {name: values[name] for name, nominal in model.robot.parameters.model_dump().items() if values[name] != nominal}
    present = [(effect.name, effect.detail) for effect in model.effects] + [(c.name, c.detail) for c in kept]
    active = []
    for name, detail in present:
        prefix = ActiveEffect(name, detail).label
        active.append(ActiveEffect(name, detail, {p.name: values[f"{prefix}.{p.name}"] for p in find_effect(name).parameters}))
    return replace(model, parameters=parameters, effects=tuple(active))


@dataclass(frozen=True, eq=False)
class SearchableNetwork(NetworkPlant):
    """A network in which effects may be missing, see `plant.SearchablePlant`.

    Attributes:
        known_model: what is known of the machine; the effects it has are fitted anew with the known parameters.
        candidates: effects that it does not have, at their null values in the compiled model.
        signals: of its robot's data.
    """

    known_model: Model = field(kw_only=True)
    candidates: tuple[Candidate, ...] = field(kw_only=True)
    signals: Signals = field(kw_only=True)

    @staticmethod
    def of(known: Model, channels: Channels, static: bool = False) -> SearchableNetwork:
        """A network with all effects that it does not have yet; compiles it."""
        missing = candidates(known)
        return SearchableNetwork(
            compile_model(wide(known, missing)), static, known_model=known, candidates=missing, signals=channels.signals
        )

    @property
    def name(self) -> str:
        """The robot's."""
        return self.known_model.robot.name

    @property
    def derivatives_apart(self) -> float:
        """Derivatives of its motion are smooth."""
        return 0.04

    @property
    def known(self) -> tuple[str, ...]:
        """The robot's parameters with priors and those of the effects that it has."""
        missing = {name for candidate in self.candidates for name in candidate.parameters}
        return (*self.known_model.robot.priors, *(name for name in self.values if "." in name and name not in missing))

    def corrected(self, kept: Sequence[Candidate]) -> Model:
        """The model with these effects only and the values it has."""
        return narrow(self.known_model, self.model.values, kept)
