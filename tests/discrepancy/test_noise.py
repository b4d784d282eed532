"""The noise as residuals show it: its scale where they are white, what was assumed where they are not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.preparation.noise import describe_noise, estimate_noise
from tepm_opt.solvers.identification.residuals import Residual

RATE, NOISE, ROWS = 50, 3e-4, 700
SIGNALS = Signals(("u",), (1.0,), ("s1", "s2", "s3", "s4"), ("x", "y", "z"), "m")
Make = Callable[[np.random.Generator, tuple[int, ...]], np.ndarray]


def white(random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return random.normal(size=shape)


def smoothed(random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Noise behind a tracker's filter, of unit variance."""
    return np.asarray(lfilter([np.sqrt(1 - 0.7**2)], [1, -0.7], random.normal(size=shape), axis=0))


def tails(random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return random.standard_t(5, size=shape) / np.sqrt(5 / 3)


def found(
    make: Make, scale: float, misfit: float = 0.0, noise: float | np.ndarray = NOISE, points: int = 4
) -> tuple[float | np.ndarray, list[str]]:
    """The noise fitted, and what is said, to five runs whose samples scatter by `scale` times 0.3 mm about a misfit of so many m."""
    random, time = np.random.default_rng(2), np.arange(ROWS) / RATE
    runs, residuals = [], []
    for k in range(5):
        wave = (
            np.sum([np.sin(2 * np.pi * f * time + k) for f in (0.2, 0.7, 1.6)], axis=0)[:, None, None]
            * np.linspace(0.2, 1, points)[:, None]
        )
        shape = (ROWS, points, 3)
        left = misfit * wave * np.ones(3) + scale * NOISE * make(random, shape)
        moved = 0.05 * wave * np.ones(3)
        run = Run("a.csv", "fit", time, np.zeros((ROWS, 1)), np.zeros((ROWS, 3)), moved + left)
        runs.append(run)
        residuals.append(Residual.from_prediction(run, moved, np.empty((0, *shape)), noise))
    value, scatters = estimate_noise(noise, runs, residuals)
    return value, describe_noise(scatters, noise, SIGNALS)


@pytest.mark.parametrize("misfit", [0.0, 0.003])
def test_noise_as_declared_stays_as_it_is(misfit: float) -> None:
    assert found(white, 1.0, misfit) == (NOISE, [])


@pytest.mark.parametrize("misfit", [0.0, 0.003])
@pytest.mark.parametrize(
    ("scale", "said"), [(1.03, "% above the 0.3 mm assumed; fits"), (0.9, "% below"), (2.5, "2.5 times the 0.3"), (0.5, "% below")]
)
def test_its_scale_is_found_below_a_misfit(scale: float, said: str, misfit: float) -> None:
    noise, sentences = found(white, scale, misfit)
    assert noise == pytest.approx(scale * NOISE, rel=0.015)
    assert len(sentences) == 1
    assert said in sentences[0]
    assert ("What is declared is wrong" in sentences[0]) == (abs(scale - 1) > 0.25)


def test_far_more_than_scatters_is_meant() -> None:
    """An encoder of a micrometre, and a tenth of a millimetre declared since nobody cares for less."""
    noise, sentences = found(white, 0.01)
    assert noise == NOISE
    assert "99 % below the 0.3 mm assumed; more than noise must be meant: what was assumed is kept." in sentences[0]


def test_smooth_noise_is_not_taken_for_less() -> None:
    noise, sentences = found(smoothed, 1.0)
    assert noise == NOISE
    assert "over several samples than from one to the next, so that it is no white noise: what was assumed is kept" in sentences[0]


def test_vibration_is_no_noise() -> None:
    time = np.arange(ROWS) / RATE
    noise, sentences = found(lambda random, shape: random.normal(size=shape) + 3 * np.sin(2 * np.pi * 17 * time)[:, None, None], 1.0)
    assert noise == NOISE
    assert "no white noise" in sentences[0]


def test_noise_that_grows_with_motion_is_another_matter() -> None:
    """Time that jitters."""
    loud = np.where(np.arange(ROWS) < ROWS / 2, 1.0, 4.0)[:, None, None]
    assert found(lambda random, shape: loud * random.normal(size=shape), 1.0)[0] == NOISE


def test_heavy_tails_are_not_taken_for_less() -> None:
    assert found(tails, 1.0)[0] == pytest.approx(NOISE, rel=0.02)


def test_a_loud_axis_is_named_and_counts() -> None:
    noise, sentences = found(lambda random, shape: random.normal(size=shape) * [1, 1, 3], 1.0)
    assert noise == pytest.approx(NOISE * np.sqrt(11 / 3), rel=0.02)
    assert "Noise: s1 z, s2 z, s3 z, s4 z scatter by up to 2.9 times" in sentences[1]


def test_each_quantity_has_its_own() -> None:
    assumed = np.array([[NOISE], [NOISE], [2 * NOISE], [NOISE]])
    noise, sentences = found(white, 1.0, noise=assumed)
    assert np.allclose(np.ravel(noise), NOISE, rtol=0.02)
    assert len(sentences) == 1
    assert sentences[0].startswith("Noise of s3")


def test_too_short_to_tell() -> None:
    random = np.random.default_rng(1)
    run = Run("a.csv", "fit", np.arange(60) / RATE, np.zeros((60, 1)), np.zeros((60, 3)), random.normal(size=(60, 4, 3)))
    noise, scatters = estimate_noise(1e-3, [run], [Residual.from_prediction(run, 0 * run.points, np.empty((0, 60, 4, 3)), 1e-3)])
    assert (noise, describe_noise(scatters, 1e-3, SIGNALS)) == (1e-3, [])
