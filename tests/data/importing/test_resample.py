"""Samples on a grid, against closed forms: what is above half the new rate goes, what is below passes, nothing is made up in gaps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tepm_opt.data.importing.resample import ATTENUATION, PASS, Clock, grid_of, resample_commanded, resample_measured, taps
from tests.data.importing.layouts import even, jittering

RATE = 50.0
LEAK = 10 ** (-ATTENUATION / 20)
MIDDLE = slice(50, 250)  # of six seconds: the filter is as long as 36 rows


def on_grid(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    grid = grid_of(0.0, 6.0, RATE)
    return grid, resample_measured(Clock(time), values, grid, RATE)


@pytest.mark.parametrize("source", [100.0, 240.0, 1000.0])
@pytest.mark.parametrize("frequency", [25.5, 31.0, 44.0])
def test_above_half_the_new_rate_a_thousandth_is_left(source: float, frequency: float) -> None:
    """A sine that would come back as one of rate - frequency."""
    time = even(source)
    grid, found = on_grid(time, np.sin(2 * np.pi * frequency * time))
    aliased = np.abs(np.sin(2 * np.pi * frequency * grid))[MIDDLE].max()
    assert aliased > 0.9, "without a filter"
    assert np.abs(found[MIDDLE]).max() < 1.3 * LEAK


@pytest.mark.parametrize("source", [240.0, 1000.0])
@pytest.mark.parametrize("frequency", [0.5, 5.0, 12.0, 0.5 * PASS * RATE])
def test_below_0_8_of_it_passes_without_delay(source: float, frequency: float) -> None:
    time = even(source)
    grid, found = on_grid(time, np.sin(2 * np.pi * frequency * time + 0.3))
    spline = 5 / 384 * (2 * np.pi * frequency / source) ** 4
    assert found[MIDDLE] == pytest.approx(np.sin(2 * np.pi * frequency * grid + 0.3)[MIDDLE], abs=1.3 * LEAK + spline)


def test_jitter_is_no_noise() -> None:
    """Times off by a third of a step: within the spline's error of the longest one."""
    time = jittering(240, seed=1, by=0.33)
    grid, found = on_grid(time, np.sin(2 * np.pi * 3 * time))
    step = float(np.diff(time).max())
    assert found[MIDDLE] == pytest.approx(np.sin(2 * np.pi * 3 * grid)[MIDDLE], abs=1.3 * LEAK + 5 / 384 * (2 * np.pi * 3 * step) ** 4)
    assert Clock(time).jitter == pytest.approx(0.33 / np.sqrt(6), rel=0.1), "of two uniform distributions half as wide"


def test_white_noise_shrinks_by_the_filter_s_energy() -> None:
    values = np.random.default_rng(2).normal(size=len(even(1000)))
    _, found = on_grid(even(1000), values)
    expected = np.sqrt(np.sum(taps(20) ** 2))
    assert expected == pytest.approx(np.sqrt(0.9 * RATE / 1000), rel=0.05), "the part of the spectrum that passes"
    assert found[MIDDLE].std() == pytest.approx(expected, rel=0.15)


def test_a_constant_stays_to_the_ends() -> None:
    _, found = on_grid(even(240), np.full(len(even(240)), 0.35))
    assert found == pytest.approx(0.35, abs=1e-9)


def test_samples_on_the_grid_stay_as_they_are() -> None:
    values = np.random.default_rng(3).normal(size=301)
    values[[10, 11, 40]] = np.nan
    _, found = on_grid(even(50), values)
    assert np.array_equal(np.isnan(found), np.isnan(values))
    assert np.nanmax(np.abs(found - values)) < 1e-12


def test_gaps_stay_empty() -> None:
    """Half a second without samples, of 240 a second: the rows in it are empty, those around are not touched by it."""
    time = even(240)
    time = time[(time <= 2) | (time >= 2.5)]
    grid, found = on_grid(time, np.sin(2 * np.pi * time))
    inside = (grid > 2) & (grid < 2.5)
    assert np.isnan(found[inside]).all()
    assert np.isfinite(found[~inside]).all()
    assert np.nanmax(np.abs(found - np.sin(2 * np.pi * grid))) < 0.02, "an end of a stretch is less certain than its middle"


def test_what_is_put_in_is_never_filtered() -> None:
    """A step stays within the two rows around it: nothing rings, nothing moves before."""
    time = even(240)
    grid = grid_of(0.0, 6.0, RATE)
    step = np.where(time < 3.003, 0.0, 1e5)
    for hold in (False, True):
        found = resample_commanded(Clock(time), step, grid, hold)
        assert np.unique(found).tolist() == [0.0, 1e5]
        assert found[grid < 3].max() == 0
        assert found[grid > 3.0043].min() == 1e5


def test_a_held_command_has_no_value_before_its_first() -> None:
    found = resample_commanded(Clock(np.array([1.0, 2.0, 3.0])), np.array([np.nan, 5.0, np.nan]), np.array([1.5, 2.0, 2.5, 9.0]), hold=True)
    assert found.tolist()[1:] == [5.0, 5.0, 5.0]
    assert np.isnan(found[0])


@given(st.floats(20, 900), st.integers(1, 40), st.integers(0, 10**6))
def test_a_straight_line_stays(source: float, size: int, seed: int) -> None:
    """At any rate and size, up to the ends."""
    time = jittering(source, seed, by=0.5)
    grid = grid_of(time[0], time[-1], 20.0)
    found = resample_measured(Clock(time), size * (time - 2), grid, 20.0)
    assert found == pytest.approx(size * (grid - 2), abs=1e-4 * size)
