"""The smoother on its own linear model: against the filter, against dense algebra, over a dropout, with friction at its bound."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.control.estimator import Estimator, Operating
from tepm_opt.control.friction import turned
from tepm_opt.control.smoother import RecordedMotion, smooth
from tepm_opt.errors import InputError
from tests.control.test_estimator import DIRECTION, KNOWN, MIDDLE, NOISE, RATES, TENSION, Arm, circle_points

__all__ = ["circle_points"]


def simulated(
    where: list[Operating], steps: int, seed: int, friction: float | None = None
) -> tuple[RecordedMotion, np.ndarray, np.ndarray]:
    """A run of the linear model with its noise: what is recorded, the states (samples, states) and the points in truth."""
    random = np.random.default_rng(seed)
    arm = Arm(where[0], KNOWN, random).drawn(Estimator(where[0], NOISE, MIDDLE, KNOWN))
    arm.friction = np.abs(arm.friction) if friction is None else np.full(6, friction)
    operating = [where[k // 10 % len(where)] for k in range(steps)]
    forces = where[0].forces + np.sin(0.3 * np.arange(steps))[:, None] * np.array([1.0, 0.5, -1.0, 0.3, -0.2, 0.8])
    points, states, truth = [arm.seen()], [arm.state], [arm.points]
    for k in range(1, steps):
        arm.advance(forces[k - 1 : k + 1], operating[k])
        points.append(arm.seen())
        states.append(arm.state)
        truth.append(arm.points)
    recorded = RecordedMotion(operating, np.array(points), forces, np.tile(TENSION, (steps, 1)), np.tile(RATES, (steps - 1, 1)))
    return recorded, np.array(states), np.array(truth)


def filtered(recorded: RecordedMotion) -> Estimator:
    """The Kalman filter after the run."""
    found = Estimator(recorded.operating[0], NOISE, MIDDLE, KNOWN)
    for k, points in enumerate(recorded.points):
        if k:
            found.predict(recorded.forces[k - 1 : k + 1], TENSION, RATES, recorded.operating[k])
        found.update(points)
    return found


def off(points: np.ndarray, truth: np.ndarray) -> float:
    """Root mean square of the tip's distance in m."""
    return float(np.sqrt(((points - truth)[:, -1] ** 2).sum(axis=-1).mean()))


@pytest.mark.parametrize("moving", [False, True])
def test_last_state_is_the_filters(circle_points, moving):
    """Without bounds there is nothing after the last sample that the filter would not know: the same mean, exactly."""
    recorded, _, _ = simulated(circle_points if moving else circle_points[:1], 60, 1)
    found, last = smooth(recorded, NOISE, MIDDLE, KNOWN, bounded=False), filtered(recorded)
    assert found.solved
    means = np.concatenate(
        [found.motion[-1], found.unknown[-1], found.strength[-1], found.friction[-1], found.hysteresis[-1], found.bias[-1].ravel()]
    )
    np.testing.assert_allclose(means, last.mean, atol=1e-6 * np.abs(last.mean).max())
    np.testing.assert_allclose(found.points[-1], found.filtered[-1], atol=1e-8)


def test_all_states_are_those_of_the_exact_smoother(circle_points):
    """Rauch, Tung and Striebel's recursion, on transitions that are found by moving unit vectors with the arm's own model."""
    recorded, _, _ = simulated(circle_points[:1], 40, 2)
    at, size = circle_points[0], 56
    estimator = Estimator(at, NOISE, MIDDLE, KNOWN)
    before, after = [], []
    for k, points in enumerate(recorded.points):
        if k:
            estimator.predict(recorded.forces[k - 1 : k + 1], TENSION, RATES, at)
        before.append((estimator.mean.copy(), estimator.covariance.copy()))
        estimator.update(points)
        after.append((estimator.mean.copy(), estimator.covariance.copy()))

    def moved(state: np.ndarray, k: int) -> np.ndarray:
        arm = Arm(at, KNOWN)
        arm.state, arm.direction, arm.turning = state, DIRECTION, turnings[k]
        arm.advance(recorded.forces[k : k + 2], at)
        return arm.state

    turnings = [np.zeros(6)]
    for rise in np.diff(recorded.forces, axis=0):
        turnings.append(turned(turnings[-1], rise, KNOWN.hysteresis_width))

    means = [after[-1][0]]
    for k in range(len(after) - 2, -1, -1):
        move = (np.array([moved(unit, k) for unit in np.eye(size)]) - moved(np.zeros(size), k)).T
        gain = after[k][1] @ move.T @ np.linalg.pinv(before[k + 1][1], rcond=1e-13, hermitian=True)
        means.insert(0, after[k][0] + gain @ (means[0] - before[k + 1][0]))
    found = smooth(recorded, NOISE, MIDDLE, KNOWN, bounded=False)
    exact = np.array(means)
    np.testing.assert_allclose(found.unknown, exact[:, 20:26], atol=1e-3)
    np.testing.assert_allclose(found.strength, exact[:, 26:32], atol=1e-4)
    np.testing.assert_allclose(found.friction, exact[:, 32:38], atol=1e-3)
    np.testing.assert_allclose(found.hysteresis, exact[:, 38:44], atol=1e-3)
    np.testing.assert_allclose(found.bias.reshape(-1, 12), exact[:, 44:], atol=1e-5)
    np.testing.assert_allclose(found.motion[:, :4], exact[:, :4], atol=1e-5)


def test_better_than_the_filter(circle_points):
    """Root mean square over some runs of the tip, of the forces that nobody commanded (with strength and friction, from which they
    can hardly be told) and of the rates of the slowest modes: by a third, a twentieth and a half at least."""
    loaded = DIRECTION * (1 - KNOWN.load_share + KNOWN.load_share * TENSION / MIDDLE)
    pulled = np.hstack([np.eye(6), np.diag(circle_points[0].forces + TENSION), -np.diag(loaded)])
    tips, forces, rates = np.zeros(2), np.zeros(2), np.zeros(2)
    for seed in range(3):
        recorded, states, truth = simulated(circle_points, 60, seed)
        found = smooth(recorded, NOISE, MIDDLE, KNOWN, bounded=False)
        estimator, means = Estimator(recorded.operating[0], NOISE, MIDDLE, KNOWN), []
        for k, points in enumerate(recorded.points):
            if k:
                estimator.predict(recorded.forces[k - 1 : k + 1], TENSION, RATES, recorded.operating[k])
            estimator.update(points)
            means.append(estimator.mean)
        means = np.array(means)
        tips += [off(found.points, truth) ** 2, off(found.filtered, truth) ** 2]
        smoothed = np.hstack([found.unknown, found.strength, found.friction]) - states[:, 20:38]
        forces += [((part @ pulled.T) ** 2).mean() for part in (smoothed, means[:, 20:38] - states[:, 20:38])]
        rates += [((found.motion - states[:, :20])[:, 10:12] ** 2).mean(), ((means - states)[:, 10:12] ** 2).mean()]
    parts = [float(np.sqrt(better / filters)) for better, filters in (tips, forces, rates)]
    assert (np.array(parts) < [0.7, 0.95, 0.5]).all(), parts


@pytest.mark.slow
def test_dropout_is_filled_from_both_sides(circle_points):
    """0.3 s without any point and an outlier: the tip within them is several times as near as the filter's, which only foresees."""
    recorded, _, truth = simulated(circle_points[:1], 100, 5)
    recorded.points[50:80] = np.nan
    recorded.points[30, 1] += 0.05
    found = smooth(recorded, NOISE, MIDDLE, KNOWN)
    lost = slice(52, 80)
    assert off(found.points[lost], truth[lost]) < off(found.filtered[lost], truth[lost]) / 2
    assert np.linalg.norm(found.points[30, 1] - truth[30, 1]) < 2e-3


def test_friction_is_not_negative(circle_points):
    """With hardly any friction the smoother without the bound has some that is negative; with it nowhere, and otherwise nearer."""
    recorded, states, _ = simulated(circle_points[:1], 50, 6, friction=0.1)
    free, bound = (smooth(recorded, NOISE, MIDDLE, KNOWN, bounded) for bounded in (False, True))
    assert bound.solved
    assert free.friction.min() < -0.1
    assert bound.friction.min() > -1e-6
    assert (bound.friction < 1e-6).any()
    true = np.abs(states[:, 32:38])
    assert np.abs(bound.friction - true).mean() < np.abs(free.friction - true).mean()
    recorded, _, _ = simulated(circle_points[:1], 40, 7, friction=12.0)
    free, bound = (smooth(recorded, NOISE, MIDDLE, KNOWN, bounded) for bounded in (False, True))
    assert free.friction.min() > 0
    np.testing.assert_allclose(bound.friction, free.friction)


def test_window_of_a_run(circle_points):
    """Far from its ends a window is as good as the whole run."""
    recorded, _, _ = simulated(circle_points[:1], 120, 8)
    whole = smooth(recorded, NOISE, MIDDLE, KNOWN, bounded=False)
    window = smooth(recorded.between(20, 120), NOISE, MIDDLE, KNOWN, bounded=False)
    np.testing.assert_allclose(window.points[40:60], whole.points[60:80], atol=3e-4)


def test_shapes_that_do_not_fit_are_refused(circle_points):
    """A sample short."""
    recorded, _, _ = simulated(circle_points[:1], 10, 9)
    with pytest.raises(InputError, match="shapes"):
        smooth(replace(recorded, forces=recorded.forces[1:]), NOISE, MIDDLE, KNOWN)
    with pytest.raises(InputError, match="at least 2"):
        smooth(recorded.between(3, 4), NOISE, MIDDLE, KNOWN)


@pytest.mark.slow
def test_run_on_the_virtual_prototype(kang, followed):
    """A second of a closed loop, as it was recorded: the tip is 0.4 mm off, as filtered 0.7 mm, as tracked 1.0 mm."""
    recorded = RecordedMotion.of(followed, kang.values["A"]).between(340, 440)
    found, truth = smooth(recorded, NOISE, MIDDLE), np.array(followed.truth)[340:440]
    assert found.solved
    assert found.friction.min() > -1e-6
    smoothed, seen, filters = (
        np.sqrt(np.nanmean(((points[20:80, -1] - truth[20:80]) ** 2).sum(axis=1)))
        for points in (found.points, recorded.points, found.filtered)
    )
    assert smoothed < 0.6 * seen
    assert smoothed < 0.8 * filters


def test_run_without_measured_inputs_is_refused(kang, followed):
    """Nor one with a gap, or of a single sample."""
    for change in ({"measured": [np.full(12, np.nan)] * len(followed.rows)}, {"rows": [0]}, {"rows": [*followed.rows[:-1], 999]}):
        broken = copy(followed)
        for name, value in change.items():
            setattr(broken, name, value)
        with pytest.raises(InputError, match="measured inputs"):
            RecordedMotion.of(broken, kang.values["A"])
