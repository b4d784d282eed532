"""The network of masses and springs as a plant whose parameters are identified and whose missing effects are searched."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.errors import InputError, unknown_name
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.effects import find_effect
from tepm_opt.models.robot import UNITS, Parameters
from tepm_opt.solvers.mechanics.plant import Free, Prediction
from tepm_opt.solvers.mechanics.predict import LONGEST_STEP, predict


@dataclass(frozen=True, eq=False)
class NetworkPlant:
    """A compiled model of a network, see `plant.Plant`.

    Attributes:
        model: with its effects.
        static: whether rows of the runs are equilibria.
    """

    model: CompiledModel
    static: bool = False

    quick = False

    def __repr__(self) -> str:
        """The model, in a line."""
        return f"NetworkPlant({self.model})"

    @property
    def values(self) -> Mapping[str, float]:
        """Values of all parameters by full name."""
        return self.model.values

    @property
    def states(self) -> Mapping[str, float]:
        """None: its runs begin at rest."""
        return {}

    @property
    def concurrent(self) -> bool:
        """Whether it is C, which lets other threads run."""
        return self.model.is_c

    def with_values(self, values: Mapping[str, float]) -> Self:
        """The same network with other values of some parameters."""
        if not self.static:
            _ = self.model.stepper  # read or compiled now: the models of all values share it
        theta = self.model.theta.copy()
        for name, value in values.items():
            theta[self.model.network.parameter_names.index(name)] = value
        return replace(self, model=self.model.with_theta(theta))

    def free(self, names: Sequence[str]) -> tuple[Free, ...]:
        """Parameters by full name with their ranges, see `free_parameters`."""
        return free_parameters(self.model, names)

    def predict(self, run: Run, by: Sequence[str] = (), step: float = np.inf) -> Prediction:
        """Reference points of a run, see `predict.predict`."""
        return predict(self.model, run, by, self.static, step if np.isfinite(step) else LONGEST_STEP)


def free_parameters(model: CompiledModel, names: Sequence[str] | None = None) -> tuple[Free, ...]:
    """Parameters by full name with their ranges; without names those that the robot file has priors for.

    A robot parameter with a prior keeps to it, around the robot file's value; one without is believed to be right to 100 %. A
    parameter of an effect keeps to the effect's range; one of a group that scatters is believed to do so by its `scale` at first.

    Raises:
        InputError: no such parameter; a value outside its prior.
    """
    robot, known = model.robot, model.values
    active = [(effect.label, find_effect(effect.name).parameters_of(model.layout)) for effect in model.model.effects]
    effects = {f"{label}.{parameter.name}": parameter for label, own in active for parameter in own}
    found = []
    for name in robot.priors if names is None else names:
        if name not in known:
            raise unknown_name("parameter", name, known)
        value = known[name]
        if name in effects:
            kind = effects[name]
            doubt = kind.scale if kind.spread else np.inf
            found.append(Free(name, kind.unit, value, kind.low, kind.high, kind.scale, kind.null, doubt, kind.spread, kind.refines))
            continue
        nominal = float(getattr(robot.parameters, name))
        low, high = _physical_range(name)
        half = robot.priors.get(name)
        scale = abs(nominal) * (half or 0.05) or 1e-3 * (high - low)  # a part of 0 is 0
        if half is not None:
            low, high = max(low, nominal - abs(nominal) * half), min(high, nominal + abs(nominal) * half)
        if not low - 1e-9 * scale <= value <= high + 1e-9 * scale:
            raise InputError(f"parameter {name} = {value:g} {UNITS[name]} is outside its prior; valid: {low:g} … {high:g}")
        doubt = np.inf if half is not None or not nominal else abs(nominal)
        found.append(Free(name, UNITS[name], min(max(value, low), high), low, high, scale, nominal, doubt))
    return tuple(found)


def _physical_range(name: str) -> tuple[float, float]:
    limits = {type(rule).__name__: rule for rule in Parameters.model_fields[name].metadata}
    return float(limits["Ge"].ge), float(limits["Le"].le)
