"""The length estimator against equilibria whose lengths are known."""

from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.control.estimation.lengths import LengthEstimator, LengthEstimatorSettings
from tepm_opt.errors import InputError
from tepm_opt.solvers.mechanics.statics import solve_statics

BENT = np.array([0.2e6, 0.1e6, 0.15e6, 0.3e6, 0.1e6, 0.12e6, 0, 1.0, 0, 0, 0, 2.0])
EXACT = LengthEstimatorSettings(steps=60, tolerance=1e-9, noise=1e-6, force_step=1e3)


@pytest.fixture(scope="module")
def bent(kang):
    return solve_statics(kang, BENT)


def test_finds_the_lengths_of_a_model_in_equilibrium(kang, bent):
    estimator = LengthEstimator(kang, settings=EXACT)
    assert estimator.update(bent.points) == pytest.approx(bent.lengths.ravel(), abs=1e-7)
    area = kang.values["A"]
    assert estimator.forces == pytest.approx(area * BENT[:6] - BENT[6:], abs=1e-4)
    assert estimator.residual < 1e-7


def test_a_few_samples_are_enough_with_the_usual_settings(kang, bent):
    """From rest, warm-started: within 0.1 mm after 20 samples; a known tip force is not taken for an actuator's."""
    estimator = LengthEstimator(kang)
    for _ in range(20):
        found = estimator.update(bent.points)
    assert found == pytest.approx(bent.lengths.ravel(), abs=1e-4)
    pushed = solve_statics(kang, BENT, [0.3, 0, 0])
    aware = LengthEstimator(kang, np.array([0.3, 0, 0]), EXACT)
    assert aware.update(pushed.points) == pytest.approx(pushed.lengths.ravel(), abs=1e-7)


def test_largest_step_bounds_what_a_sample_can_change(kang, bent):
    """Ten steps of at most 0.1 N."""
    estimator = LengthEstimator(kang, settings=replace(EXACT, steps=10, largest_step=0.1))
    estimator.update(bent.points)
    assert np.abs(estimator.forces).max() == pytest.approx(1.0, rel=0.1)


def test_missing_points(kang, bent):
    """One missing point barely matters, all missing: the estimate stays, half of them: nothing breaks and it comes back."""
    estimator = LengthEstimator(kang)
    for _ in range(20):
        estimator.update(bent.points)
    for lost in ([0], [3], [0, 1], [1, 2, 3]):
        points = bent.points.copy()
        points[lost] = np.nan
        assert estimator.update(points) == pytest.approx(bent.lengths.ravel(), abs=1e-4)
    before = estimator.lengths
    assert estimator.update(np.full((4, 3), np.nan)) == pytest.approx(before, abs=0)


def test_noise_is_not_amplified_much(kang, bent):
    """1 mm RMS (3-D) of noise: the least squares' own propagation is 0.5 mm (module 1) and 0.95 mm (module 2) or less."""
    estimator, random = LengthEstimator(kang), np.random.default_rng(1)
    errors = []
    for k in range(300):
        found = estimator.update(bent.points + 5.8e-4 * random.normal(size=(4, 3)))
        errors.append(found - bent.lengths.ravel()) if k > 50 else None
    spread = np.std(errors, axis=0)
    assert (spread[:3] < 0.6e-3).all()
    assert (spread[3:] < 1.1e-3).all()


def test_wrong_shape_is_refused(kang):
    with pytest.raises(InputError, match="shape"):
        LengthEstimator(kang).update(np.zeros((3, 3)))
