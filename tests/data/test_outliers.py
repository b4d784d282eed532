"""Samples that no machine makes: found where they are, and none where there are none."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.data.outliers import strays, stuck, without_strays
from tepm_opt.data.run import Run, RunSet

RATE, NOISE = 50, 3e-4  # Hz, m
TIME = np.arange(1500) / RATE


def swing(rows: int = 1500, jump: float = 0.0) -> np.ndarray:
    """Points that sway by some cm, from a jump of their acceleration on, (rows, 4, 3) in m."""
    time, random = np.arange(rows) / RATE, np.random.default_rng(1)
    parts = random.normal(0, 0.02, (4, 4, 3))
    waves = np.sum(
        [part * np.sin(2 * np.pi * f * time)[:, None, None] for part, f in zip(parts, (0.3, 0.7, 1.3, 1.9), strict=True)], axis=0
    )
    after = np.maximum(time - 10, 0)
    return waves + jump * (1 - np.cos(2 * np.pi * 3 * after) * np.exp(-after))[:, None, None]


def noisy(points: np.ndarray, seed: int = 2) -> np.ndarray:
    return points + NOISE * np.random.default_rng(seed).normal(size=points.shape)


def hit(points: np.ndarray, share: float, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Points with outliers at some samples, and which these are."""
    random = np.random.default_rng(3)
    where = random.random(points.shape[:2]) < share
    return points + np.where(where, size, 0.0)[:, :, None] * random.normal(size=points.shape), where


def run(points: np.ndarray, file: str = "a.csv") -> Run:
    rows = len(points)
    return Run(file, "fit", np.arange(rows) / RATE, np.zeros((rows, 2)), np.zeros((rows, 3)), points)


@pytest.mark.parametrize(("share", "found"), [(0.01, 0.97), (0.04, 0.93)])
def test_outliers_are_found_and_nothing_else(share: float, found: float) -> None:
    clean = swing()
    points, where = hit(noisy(clean), share, 6e-3)
    lost = strays(TIME, points, clean * 1.05, NOISE)
    large = np.linalg.norm(points - clean, axis=2) > 10 * NOISE
    assert lost[large].mean() >= found
    assert not lost[~where].sum() > 2


def test_no_motion_is_an_outlier() -> None:
    """Neither with a model that is far off nor with none; not where acceleration jumps, either."""
    measured = noisy(swing(jump=0.01))
    for modelled in (None, np.zeros_like(measured), swing() * 0.7):
        assert not strays(TIME, measured, modelled, NOISE).any()


def test_a_motion_that_is_slowly_sampled_is_none() -> None:
    """Five samples a second: nothing is smooth, neither model nor what it misses; but for where it begins to sway at 3 Hz."""
    slow = noisy(swing(3000, jump=0.05))[::10]
    assert set(np.flatnonzero(strays(np.arange(300) / 5, slow, swing(3000)[::10], NOISE).any(axis=1))) <= {50, 51}


def test_gaps_hide_nothing_and_make_nothing() -> None:
    """Half a second missing every two seconds, and a quarter of the samples at random; the model is off by half."""
    points = noisy(swing())
    points[np.arange(1500) % 100 < 25] = np.nan
    points[np.random.default_rng(5).random(points.shape[:2]) < 0.25] = np.nan
    points[777, 2] += 0.03
    assert np.argwhere(strays(TIME, points, 0.5 * swing(), NOISE)).tolist() == [[777, 2]]


@pytest.mark.parametrize("row", [0, 1, 1498, 1499])
def test_outliers_at_the_ends(row: int) -> None:
    points = noisy(swing())
    points[row, 2] += 0.02
    assert np.argwhere(strays(TIME, points, swing(), NOISE)).tolist() == [[row, 2]]


def test_two_near_each_other_are_outliers_and_four_in_a_row_are_a_motion() -> None:
    points = noisy(swing())
    points[[700, 702], 1] += 0.03
    points[900:904, 1] += 0.03
    assert np.flatnonzero(strays(TIME, points, swing(), NOISE)[:, 1]).tolist() == [700, 702]


def test_what_stands_still_in_noise_is_stuck() -> None:
    points = noisy(swing())
    points[300:350, 2] = points[300, 2]
    found = np.zeros(points.shape[:2], dtype=bool)
    found[301:350, 2] = True
    assert np.array_equal(stuck(points), found)
    assert not stuck(np.round(swing() / 1e-2) * 1e-2).any(), "a coarse tracker repeats itself"
    assert not stuck(points[:, :, :1]).any(), "a single quantity may rest"


def test_they_are_left_out_and_told() -> None:
    clean = swing()
    points, where = hit(noisy(clean), 0.01, 6e-3)
    points[300:350, 2] = points[300, 2]
    dataset, said = without_strays(RunSet.from_runs("a", [run(noisy(clean), "a.csv"), run(points, "b.csv")]), [clean, clean], NOISE)
    assert [text.split(":")[0] for text in said] == ["Outliers", "Frozen"]
    assert "49 of 12000 samples (0.41 %) are exactly those before them, most in b.csv; they are left out." in said[1]
    assert np.isfinite(dataset.runs[0].points).all()
    gone = np.asarray(np.isnan(dataset.runs[1].points).all(axis=2))
    assert gone[301:350, 2].all()
    assert gone.sum() <= where.sum() + 49
    same, said = without_strays(dataset, [clean, clean], NOISE)
    assert (same, said) == (dataset, [])


def test_many_are_left_out_and_told_as_many() -> None:
    clean = swing()
    _, said = without_strays(RunSet.from_runs("a", [run(hit(noisy(clean), 0.08, 6e-3)[0])]), [clean], NOISE)
    assert said[0].endswith("That is more than 5 %: look at what measures.")
