"""Eq. (5) and the PCHIP backbone."""

import numpy as np
import pytest
from scipy.interpolate import pchip_interpolate

from tepm_opt.data.metrics import axes_measured, error_over_time, point_errors, shape_error
from tepm_opt.solvers.kinematics.backbone import backbone, backbone_error

MODEL = np.arange(12.0).reshape(4, 3)


def test_equation_5_by_hand():
    moved = MODEL + np.array([[3, 4, 0], [0, 0, 0], [0, 0, 5], [0, 5, 0]])
    assert point_errors(moved, MODEL) == pytest.approx([5, 0, 5, 5])
    assert shape_error(moved, MODEL) == pytest.approx(np.sqrt(75 / 4))
    run = np.stack([moved, MODEL])
    assert shape_error(run, np.stack([MODEL, MODEL])) == pytest.approx([np.sqrt(75 / 4), 0])
    assert error_over_time(run, MODEL) == pytest.approx(np.sqrt(75 / 8))


def test_missing_points_do_not_count():
    moved = MODEL + 1.0
    moved[2] = np.nan
    assert shape_error(moved, MODEL) == pytest.approx(np.sqrt(3))
    assert error_over_time(moved[None], MODEL) == pytest.approx(np.sqrt(3))
    assert np.isnan(shape_error(np.full((4, 3), np.nan), MODEL))
    assert np.isnan(error_over_time(np.full((2, 4, 3), np.nan), MODEL))


def test_missing_axes_leave_the_distance_along_the_others():
    moved = MODEL + np.array([3.0, 4.0, 12.0])
    moved[:, 2] = np.nan
    assert point_errors(moved, MODEL) == pytest.approx([5, 5, 5, 5])
    moved[1] = np.nan
    assert np.array_equal(np.isnan(point_errors(moved, MODEL)), [False, True, False, False])
    assert shape_error(moved, MODEL) == pytest.approx(5)
    assert error_over_time(moved[None], MODEL) == pytest.approx(5)
    assert axes_measured(moved) == 2
    assert axes_measured(MODEL) == axes_measured(np.full((4, 3), np.nan)) == 3


def test_isotropic_noise_is_root_three_of_it():
    """SPEC section 2."""
    noise = 1e-3 * np.random.default_rng(3).normal(size=(5000, 4, 3))
    assert error_over_time(MODEL + noise, MODEL) == pytest.approx(np.sqrt(3) * 1e-3, rel=0.02)


def test_backbone_goes_through_base_and_points_as_scipys_pchip():
    points = np.array([[0, 0, 0.1], [0.02, 0, 0.2], [0.05, 0.01, 0.28], [0.1, 0.02, 0.35]])
    curve = backbone(np.zeros(3), points, 41)
    assert curve[::10] == pytest.approx(np.vstack([np.zeros(3), points]))
    expected = pchip_interpolate(np.arange(5), np.vstack([np.zeros(3), points]), np.linspace(0, 4, 41))
    assert curve == pytest.approx(expected)
    assert backbone(np.zeros(3), np.stack([points, points + 0.01])).shape == (2, 41, 3)
    assert backbone_error(np.zeros(3), points, points + np.array([0, 0, 0.01]))[::10] == pytest.approx([0, *[0.01] * 4])
