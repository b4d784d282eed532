"""The rod with tendons and weight against closed forms and against a boundary value problem solved by other means."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from tepm_opt.discrepancy.laws.rod import Bent, axes, equilibrium, multiply_quaternions, rotation_quaternion

LENGTH, PIECES = 0.4, 40
ALONG = (np.arange(PIECES) + 0.5) / PIECES


def bent(moment: np.ndarray, weight: float = 0.0, base: tuple[float, ...] = (0, 0, 0), taper: float = 0.0, friction: float = 0.0) -> Bent:
    """A rod of stiffness 1 at its base under moments about x and y, (sets, 2), which friction takes away as it turns."""
    sets = len(moment)
    moments = np.asarray(moment, dtype=float).T[..., None, None]
    stiffness = np.broadcast_to((1 - taper * ALONG) ** 4, (sets, 1, PIECES))
    weights, steps = np.full((1, 1, PIECES), weight / PIECES), np.full((1, 1, PIECES), LENGTH / PIECES)
    return equilibrium(
        lambda angle: moments * np.exp(-friction * angle), stiffness, weights, steps, np.array(base, dtype=float)[:, None, None]
    )


def tip(rod: Bent) -> np.ndarray:
    """(3, sets)."""
    return rod.point_at(np.ones((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)))[..., 0]


def test_without_weight_it_is_an_arc() -> None:
    rod = bent(np.array([[0.0, 3.0], [-3.0, 0.0]]))
    angle = 3.0 * LENGTH
    sideways, down = (1 - np.cos(angle)) / 3.0, np.sin(angle) / 3.0
    np.testing.assert_allclose(tip(rod)[:, 0], [sideways, 0, down], atol=1e-4)
    np.testing.assert_allclose(tip(rod)[:, 1], [0, sideways, down], atol=1e-4)


def test_friction_of_a_tendon_is_that_of_a_capstan() -> None:
    """Dφ/ds = M exp(-μ φ) has the solution φ = ln(1 + μ M s)/μ."""
    friction, moment = 0.4, 6.0
    rod = bent(np.array([[0.0, moment]]), friction=friction)
    angle = float((np.sqrt((rod.rates**2).sum(axis=0)) * rod.steps).sum())
    assert angle == pytest.approx(np.log(1 + friction * moment * LENGTH) / friction, rel=1e-3)


@pytest.mark.parametrize(("tilt", "weight", "moment", "taper"), [(0.3, 60.0, 0.0, 0.4), (0.0, 40.0, 8.0, 0.4), (2.6, 15.0, -4.0, 0.0)])
def test_a_heavy_rod_hangs_as_the_elastica(tilt: float, weight: float, moment: float, taper: float) -> None:
    """In a plane: EI θ' = M + m, m' = w (1 - s/L) sin θ, m(L) = 0, solved by collocation."""

    def rates(s: np.ndarray, y: np.ndarray) -> np.ndarray:
        theta, m = y
        stiffness = (1 - taper * s / LENGTH) ** 4
        return np.stack([(moment + m) / stiffness, weight * (1 - s / LENGTH) * np.sin(theta)])

    s = np.linspace(0, LENGTH, 200)
    rod = bent(np.array([[0.0, moment]]), weight, (0, tilt, 0), taper)
    ours = np.arctan2(*[axes(rod.turns)[2][k, 0, 0] for k in (0, 2)])
    first = np.stack([np.interp(s, np.arange(PIECES) * LENGTH / PIECES, np.unwrap(ours)), np.zeros(200)])
    found = solve_bvp(rates, lambda a, b: np.array([a[0] - tilt, b[1]]), s, first, tol=1e-8, max_nodes=20000)
    assert found.success
    fine = np.linspace(0, LENGTH, 4001)
    theta = found.sol(fine)[0]
    expected = [np.trapezoid(np.sin(theta), fine), 0.0, np.trapezoid(np.cos(theta), fine)]
    np.testing.assert_allclose(tip(rod)[:, 0], expected, atol=1e-3 * LENGTH)


def test_a_turn_of_the_base_about_the_vertical_turns_all() -> None:
    moment = np.array([[1.0, 4.0]])
    straight, other = bent(moment, 30.0), bent(moment, 30.0, (0, 0, 0.7))
    turn = np.array([[np.cos(0.7), -np.sin(0.7), 0], [np.sin(0.7), np.cos(0.7), 0], [0, 0, 1]])
    np.testing.assert_allclose(tip(other)[:, 0], turn @ tip(straight)[:, 0], atol=1e-9)


def test_sets_far_apart_are_as_if_alone() -> None:
    """Derivatives of the first set serve its neighbours only; the others find their own."""
    moments = np.array([[0.0, 0.5], [9.0, -2.0], [0.0, -12.0]])
    together = tip(bent(moments, 80.0, taper=0.5))
    alone = [tip(bent(moment[None], 80.0, taper=0.5))[:, 0] for moment in moments]
    np.testing.assert_allclose(together.T, alone, atol=1e-8)


def test_points_of_cross_sections_go_along() -> None:
    rod = bent(np.array([[0.0, 3.0]]))
    middle, outside = (rod.point_at(np.full((1, 1), 0.5), np.full((1, 1), x), np.full((1, 1), 0.02))[:, 0, 0] for x in (0.0, 0.1))
    angle = 3.0 * LENGTH / 2
    np.testing.assert_allclose(outside - middle, 0.1 * np.array([np.cos(angle), 0, -np.sin(angle)]), atol=1e-9)
    assert middle[1] == pytest.approx(0.02)


@pytest.mark.slow
def test_heavy_bodies_and_strong_pulls_find_their_shape() -> None:
    """Many of them do not by Newton's steps alone."""
    lost = []
    for case in product((20.0, 400.0), (0.0, 0.6), (-20.0, 1.0, 20.0), (0.0, 0.3, 1.5)):
        weight, taper, moment, tilt = case
        try:
            bent(np.array([[0.3 * moment, moment]]), weight, (0, tilt, 0), taper)
        except RuntimeError:
            lost.append(case)
    assert not lost


def test_a_body_without_equilibrium_says_so() -> None:
    with pytest.raises(RuntimeError, match="no equilibrium"):
        bent(np.array([[0.0, np.nan]]), 10.0)


def test_turns_follow_each_other() -> None:
    one, other = rotation_quaternion(np.array([0.3, -0.2, 0.5])), rotation_quaternion(np.array([1.1, 0.4]))
    frame, inner = np.stack(axes(one), axis=1), np.stack(axes(other), axis=1)
    np.testing.assert_allclose(np.stack(axes(multiply_quaternions(one, other)), axis=1), frame @ inner, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(multiply_quaternions(one, other)), 1.0)
