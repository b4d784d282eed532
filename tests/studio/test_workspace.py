"""The boundary of what the tip reaches."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.kinematics.ik import solve_ik
from tepm_opt.studio.workspace import WIDEST, Boundary, boundary


@pytest.fixture(scope="module")
def found(kang: CompiledModel) -> Boundary:
    return boundary(kang, around=3, polar=3)


def test_the_tip_gets_there_and_no_farther(kang: CompiledModel, found: Boundary) -> None:
    """A centimetre on, towards where it was sought from, nothing is reached: the arm's length and a half from the first module's end."""
    for row, angle in enumerate(np.radians([0, WIDEST / 2, WIDEST])):
        for column in range(3 if row else 1):
            turn = 2 * np.pi * column / 3
            far = np.array([0, 0, 0.15]) + 0.6 * np.array([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
            place = found.points[row, column]
            assert solve_ik(kang, place).miss < 1e-5
            assert not solve_ik(kang, place + 0.01 * (far - place) / np.linalg.norm(far - place)).solved


def test_three_muscles_make_it_repeat_three_times(found: Boundary) -> None:
    turn = np.array([[-0.5, -np.sqrt(0.75), 0], [np.sqrt(0.75), -0.5, 0], [0, 0, 1]])
    np.testing.assert_allclose(found.points[1:, 1], found.points[1:, 0] @ turn.T, atol=1e-4)


def test_lines() -> None:
    """A direction where nothing was found leaves its pieces out: four of five along three meridians, five round."""
    points = np.zeros((3, 3, 3))
    assert Boundary(points).pieces.shape == (12, 2, 3)
    points[2, 1] = np.nan
    assert Boundary(points).pieces.shape == (9, 2, 3)
