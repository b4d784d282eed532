"""The residual learnt without physics."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.assessment.black_box import predict_residuals

NOISE = 1e-4  # m


def moving(seed: int, rows: int = 300) -> Run:
    """A run under one pressure and one tension that wander."""
    random = np.random.default_rng(seed)
    steps = np.cumsum(random.normal(size=(rows, 2)), axis=0)
    inputs = (steps - steps.min(axis=0)) / np.ptp(steps, axis=0)
    return Run(f"{seed}.csv", "fit", np.arange(rows) / 50, inputs, np.zeros((rows, 3)), np.zeros((rows, 2, 3)))


def hidden(run: Run) -> np.ndarray:
    """A residual that is no straight line in the inputs, (rows, points, 3) in m."""
    pressure, tension = run.inputs.T
    shape = np.stack([np.sin(3 * pressure), pressure * tension, tension**2], axis=1)
    return 1e-3 * shape[:, None, :] * np.array([0.5, 1.0])[:, None]


@pytest.mark.parametrize("static", [False, True])
def test_finds_what_depends_on_the_inputs(static: bool) -> None:
    random, runs, other = np.random.default_rng(0), [moving(seed) for seed in range(3)], moving(9)
    left = [hidden(run) + NOISE * random.normal(size=run.points.shape) for run in runs]
    left[0][20:40, 1] = np.nan
    left[1][:5] = np.nan
    (guess,) = predict_residuals(runs, left, np.ones(2), [other], static)
    assert np.sqrt(np.mean((guess - hidden(other)) ** 2)) < 0.4 * NOISE
    assert np.std(hidden(other)) > 2 * NOISE


def test_finds_nothing_in_noise() -> None:
    random, runs, other = np.random.default_rng(1), [moving(seed) for seed in range(3)], moving(9)
    (guess,) = predict_residuals(runs, [NOISE * random.normal(size=run.points.shape) for run in runs], np.ones(2), [other], False)
    assert np.sqrt(np.mean(guess**2)) < 0.15 * NOISE


@pytest.mark.slow
def test_remembers_the_past() -> None:
    """A residual that follows the inputs late is beyond what the inputs of the moment tell."""
    runs, other = [moving(seed) for seed in range(3)], moving(9)

    def late(run: Run) -> np.ndarray:
        held = np.concatenate([np.full(200, run.inputs[0, 0]), run.inputs[:, 0]])
        kernel = np.exp(-np.arange(200) / 15)
        past = np.convolve(held, kernel / kernel.sum())[200 : 200 + run.rows]
        return 1e-3 * np.broadcast_to(past[:, None, None], run.points.shape)

    learnt = [predict_residuals(runs, [late(run) for run in runs], np.ones(2), [other], static)[0] for static in (False, True)]
    with_past, without = (np.sqrt(np.mean((guess - late(other)) ** 2)) for guess in learnt)
    assert with_past < 0.2 * without
