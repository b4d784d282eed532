"""Shifts between positions and inputs, against differences taken one lag after the other."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.clock import shifts

RATE = 50
NOISE = 3e-4  # m


def swing(seed: int, rows: int = 600) -> np.ndarray:
    """Points that sway irregularly by some cm, (rows, 4, 3) in m."""
    time, frequencies = np.arange(rows) / RATE, (0.2, 0.37, 0.5, 0.9, 1.3)
    parts = np.random.default_rng(seed).normal(0, 0.01, (5, 4, 3))
    waves = [part * np.sin(2 * np.pi * f * time + f)[:, None, None] for part, f in zip(parts, frequencies, strict=True)]
    return 0.3 + np.sum(waves, axis=0)


def run(points: np.ndarray) -> Run:
    rows = len(points)
    return Run("a.csv", "fit", np.arange(rows) / RATE, np.zeros((rows, 12)), np.zeros((rows, 3)), points)


def searched(measured: np.ndarray, modelled: np.ndarray, most: int) -> int:
    """The lag in rows with the least squared difference from a constant."""
    costs = []
    for lag in range(-most, most + 1):
        error = measured - modelled[np.clip(np.arange(len(measured)) - lag, 0, len(measured) - 1)]
        costs.append(np.nansum((error - np.nanmean(error, axis=0)) ** 2))
    return int(np.argmin(costs)) - most


@pytest.mark.parametrize("lag", [-140, -7, 61])
def test_finds_the_lag_with_the_least_difference(lag: int) -> None:
    modelled, random = swing(1), np.random.default_rng(2)
    measured = np.roll(modelled, lag, axis=0) + 0.02 + NOISE * random.normal(size=modelled.shape)
    measured[random.random(measured.shape) < 0.2] = np.nan
    measured[:, 1] = np.nan  # a point nobody sees
    found = shifts([run(measured)], [modelled])["a.csv"]
    seen = [0, 2, 3]
    assert round(found * RATE) == searched(measured[:, seen].reshape(600, -1), modelled[:, seen].reshape(600, -1), 250)
    assert abs(round(found * RATE) - lag) <= 1, "what a roll puts at the ends differs"


def test_noise_and_lags_of_a_machine_are_no_shift() -> None:
    modelled, random = swing(3), np.random.default_rng(4)
    for lag in (0, 10):
        assert not shifts([run(np.roll(modelled, lag, axis=0) + NOISE * random.normal(size=modelled.shape))], [modelled])
