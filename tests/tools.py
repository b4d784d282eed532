"""What several tests need: differences of a precise order, variants of the robot, operating points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.effect import Effect
from tepm_opt.models.effects import effects
from tepm_opt.models.layout import Layout
from tepm_opt.models.model import Model
from tepm_opt.models.robot import Robot, load_robot
from tepm_opt.progress import Progress
from tepm_opt.solvers.mechanics.statics import Equilibrium, StaticsSettings

PRECISE = StaticsSettings(tolerance=1e-10)
"""For differences of equilibria: ten times the rounding noise of the forces."""


def slope(function: Callable[[float], np.ndarray], step: float) -> np.ndarray:
    """Derivative at 0 by central differences, Richardson-extrapolated: error of order step^4."""
    coarse, fine = ((function(h) - function(-h)) / (2 * h) for h in (step, step / 2))
    return (4 * fine - coarse) / 3


def one_sided_slope(function: Callable[[float], np.ndarray], step: float) -> np.ndarray:
    """Derivative at 0 from one side, Richardson-extrapolated: error of order step^3."""
    at = {k: function(k * step) for k in (0, 0.5, 1, 2)}
    coarse, fine = (-3 * at[0] + 4 * at[1] - at[2]) / (2 * step), (-3 * at[0] + 4 * at[0.5] - at[1]) / step
    return (4 * fine - coarse) / 3


def relative(value: np.ndarray, truth: np.ndarray) -> float:
    """Norm of the difference over the norm of the truth."""
    return float(np.linalg.norm(value - truth) / np.linalg.norm(truth))


def observed(equilibrium: Equilibrium) -> np.ndarray:
    """Points in G, then lengths, in one row: the observations a backend returns."""
    return np.concatenate([equilibrium.points.ravel(), equilibrium.lengths.ravel()])


def random_inputs(model: CompiledModel, count: int, seed: int, low: float = 0.0, high: float = 1.0) -> np.ndarray:
    """Inputs spread over part of their ranges, (count, inputs)."""
    return np.random.default_rng(seed).uniform(low, high, (count, model.layout.inputs)) * model.input_max


def random_directions(count: int, seed: int) -> np.ndarray:
    """Unit vectors, (count, 3)."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def variant(**sections: dict) -> Robot:
    """kang2017 with some keys of its sections changed, as `variant(geometry={"modules": 1})`."""
    content = load_robot("kang2017").model_dump()
    for name, changes in sections.items():
        content[name] |= changes
    return Robot.model_validate(content)


def with_effect(model: Model, effect: Effect, **parameters: float) -> Model:
    """The model with an effect at its probe values; where it has a detail, on the third actuator or point."""
    layout = Layout.from_robot(model.robot)
    names = layout.details(effect.detail)
    return model.with_effect(effect.name, names[min(2, len(names) - 1)] if names else None, **parameters)


def stages_into(found: list[str]) -> Progress:
    """A progress that notes what it is told is going on."""

    def told(stage: str, done: float, of: float) -> None:
        found.append(stage)

    return told


def with_all_effects(model: Model) -> Model:
    """The model with every effect at once: one library serves whatever is asked of any of them."""
    for effect in effects():
        model = with_effect(model, effect)
    return model


def in_company(**present: dict[str, float]) -> Model:
    """kang2017 with these effects; all others are there at their null values, so that it shares the library of `with_all_effects`."""
    model = Model.from_robot("kang2017")
    layout = Layout.from_robot(model.robot)
    for effect in effects():
        model = with_effect(model, effect, **present.get(effect.name, {p.name: p.null for p in effect.parameters_of(layout)}))
    return model
