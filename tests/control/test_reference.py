"""References: the path's own timing where it counts, smooth to it and from it, and forces that hold every tip."""

import numpy as np
import pytest

from tepm_opt.control.references.reference import PERIOD, Reference, approach, minimum_jerk, point_by_point, reference_of, sample_tips
from tepm_opt.errors import InputError
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.planning.trajectories import Trajectory, circle, lissajous

HALF = Trajectory(np.linspace(0.0, 4.0, 41), np.stack([np.linspace(0, 0.1, 41), np.zeros(41), np.full(41, 0.35)], axis=1))


def speeds(tips: np.ndarray) -> np.ndarray:
    """Between periods, (periods - 1,) in m/s."""
    return np.linalg.norm(np.diff(tips, axis=0), axis=1) / PERIOD


def test_rising_is_smooth_and_stays_within():
    """From 0 to 1, without speed and acceleration at the ends, and held beyond them."""
    part = np.linspace(-0.5, 1.5, 2001)
    values = minimum_jerk(part)
    assert values[0] == 0
    assert values[-1] == 1
    assert (np.diff(values) >= 0).all()
    slope = np.gradient(values, part)
    assert slope.max() == pytest.approx(1.875, rel=1e-3)
    assert np.abs(np.gradient(slope, part)).max() < 5.9  # 10 / √3; a jump would be many times that


@pytest.mark.parametrize("laps", [1.0, 2.0])
def test_closed_path_counts_with_its_own_timing(laps):
    """The circle of 8 s: what counts begins and ends at the same place, with the path's speed, and takes whole laps."""
    tips, counted = sample_tips(circle(400), laps=laps)
    assert counted.sum() * PERIOD == pytest.approx(8.0 * laps)
    assert np.linalg.norm(tips[:, :2], axis=1) == pytest.approx(0.15, abs=1e-6)
    inside = speeds(tips[counted])
    assert inside == pytest.approx(2 * np.pi * 0.15 / 8, rel=1e-3)
    first, last = np.flatnonzero(counted)[[0, -1]]
    assert tips[last + 1] == pytest.approx(tips[first], abs=1e-6)
    assert tips[0] == pytest.approx([0.15, 0, 0.35])


@pytest.mark.parametrize("path", [circle(400), lissajous(400), HALF])
def test_paths_start_and_end_at_rest_and_are_smooth(path):
    """No speed at the ends, and nowhere a jump of the speed."""
    tips, _ = sample_tips(path)
    assert max(speeds(tips)[[0, -1]]) < 1e-3
    change = np.linalg.norm(np.diff(tips, n=2, axis=0), axis=1) / PERIOD**2
    assert change.max() < 1.0  # m/s²; the circle without start-up would be at 12


def test_open_path_runs_from_end_to_end_and_counts_as_a_whole():
    """In its own time and one start-up."""
    tips, counted = sample_tips(HALF, start_up=1.0)
    assert counted.all()
    assert tips[0] == pytest.approx(HALF.positions[0])
    assert tips[-1] == pytest.approx(HALF.positions[-1])
    assert len(tips) == 501
    assert speeds(tips)[200:300] == pytest.approx(0.1 / 4, rel=1e-6)


def test_path_of_one_point_is_refused():
    """An open one."""
    with pytest.raises(InputError, match="no path"):
        sample_tips(Trajectory(np.zeros(1), np.zeros((1, 3))))


def test_point_by_point_moves_stays_and_counts_at_the_end():
    """Three targets, each for 3 s: 1 s of motion, 2 s of rest of which the last counts."""
    targets = np.array([[0.0, 0, 0.35], [0.1, 0, 0.35], [0.1, 0.1, 0.35]])
    tips, counted, number = point_by_point(targets, move=1.0, stay=3.0, taken=1.0)
    assert tips.shape == (900, 3)
    assert np.bincount(number).tolist() == [300, 300, 300]
    assert np.bincount(number[counted]).tolist() == [100, 100, 100]
    np.testing.assert_allclose(tips[counted], targets[number[counted]])
    np.testing.assert_allclose(tips[300:900:300], targets[:2])  # each move begins where the one before ended
    assert speeds(tips).max() == pytest.approx(0.1 * 1.875, rel=1e-3)
    assert speeds(tips)[[299, 300, 400, 599]].max() < 1e-3


def test_approach_goes_from_rest_to_the_target(kang):
    """Smoothly, from where the robot stands without forces."""
    tips = approach(kang, np.array([0.15, 0.0, 0.35]), 3.0)
    assert tips[0] == pytest.approx(solve_statics(kang, np.zeros(12)).tip)
    assert len(tips) == 300
    assert np.linalg.norm(tips[-1] - [0.15, 0, 0.35]) < 1e-6
    assert speeds(tips)[[0, -1]].max() < 1e-4


def test_forces_hold_the_tips(kang, short: Reference):
    """At some periods, by statics of its own; levels, lengths and the row of any period with them."""
    for row in (0, 149, 300, 449):
        half = np.clip(short.forces[row] / kang.values["A"], 0, None)
        held = solve_statics(kang, np.concatenate([half, kang.values["A"] * half - short.forces[row]]))
        assert held.tip == pytest.approx(short.tips[row], abs=1e-5)
        assert short.lengths[row] == pytest.approx(held.lengths.ravel(), abs=1e-5)
        assert short.levels[row] == pytest.approx(held.x[1:].ravel(), abs=1e-5)
    assert short.rows_at(np.array([-3, 0, 449, 450, 9999])).tolist() == [0, 0, 449, 449, 449]
    assert short.duration == pytest.approx(4.49)


def test_tip_out_of_reach_names_its_time(kang):
    """The third of some tips."""
    tips = np.array([[0.1, 0, 0.35], [0.1, 0, 0.351], [0.1, 0, 0.9]])
    with pytest.raises(InputError, match=r"at 0\.02 s"):
        reference_of(kang, tips)
