"""Derivatives of a fit that are simulated apart from its values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.solvers.identification.identify import Problem, identify
from tepm_opt.solvers.mechanics.plant import Free, Prediction

NOISE, TIME = 1e-3, np.arange(0, 4, 0.02)
TRUTH = {"size": 1.3, "lag": 0.7}


@dataclass(frozen=True)
class Lag:
    """A step that is followed with a lag; `asked` counts the parameters of every simulation."""

    values: Mapping[str, float]
    asked: list[int] = field(default_factory=list)
    concurrent: bool = False
    static: bool = False
    quick: bool = False
    states: Mapping[str, float] = field(default_factory=dict)

    def with_values(self, values: Mapping[str, float]) -> Lag:
        return replace(self, values={**self.values, **values})

    def free(self, names: Sequence[str]) -> tuple[Free, ...]:
        return tuple(Free(name, "", self.values[name], 0.01, 10.0, 0.1) for name in names)

    def predict(self, run: Run, by: Sequence[str] = (), step: float = np.inf) -> Prediction:
        self.asked.append(len(by))
        size, lag = self.values["size"], self.values["lag"]
        left = np.exp(-run.time / lag)
        changes = {"size": 1 - left, "lag": -size * left * run.time / lag**2}
        points = np.zeros((*run.points.shape, len(by) + 1))
        for k, column in enumerate((size * (1 - left), *(changes[name] for name in by))):
            points[..., k] = column[:, None, None]
        return Prediction(points[..., 0], np.moveaxis(points[..., 1:], -1, 0))


def problem(apart: float, start: Mapping[str, float]) -> Problem:
    """A run with noise, to be fitted from a start."""
    empty = Run("step.csv", "fit", TIME, np.zeros((len(TIME), 2)), np.zeros((len(TIME), 3)), np.zeros((len(TIME), 1, 3)))
    truth = Lag(TRUTH).predict(empty).points
    run = replace(empty, points=truth + NOISE * np.random.default_rng(0).normal(size=truth.shape))
    plant = Lag(dict(start))
    return Problem(plant, (run,), plant.free(("size", "lag")), NOISE, derivatives_apart=apart)


@pytest.mark.parametrize("start", [{"size": 2.0, "lag": 0.4}, {"size": 0.8, "lag": 2.0}])
def test_derivatives_apart_lead_to_the_same_optimum(start: dict[str, float]) -> None:
    """They are simulated for values that a step has reached, never for others; the last ones are of the values found."""
    exact, apart = problem(0.0, start), problem(0.04, start)
    expected, found = identify(exact), identify(apart)
    assert found.solved
    assert (np.abs(found.values - expected.values) < 0.02 * expected.std).all()
    np.testing.assert_allclose(found.std, expected.std, rtol=0.02)
    np.testing.assert_allclose(found.residuals[0].by, apart.differentiate(found.values, found.residuals)[0].by, rtol=1e-12)
    asked = apart.plant.asked[:-1]
    assert 2 <= sum(count > 0 for count in asked) <= sum(count == 0 for count in asked)
