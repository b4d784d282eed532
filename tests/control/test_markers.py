"""A tracked point that jumps alone is taken for a marker that slipped; an arm that is shaken is not."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.control.diagnostics.marker_slip import FARTHEST, HALF, Markers
from tepm_opt.hw.rig import Sample

NAMES, NOISE = ("s1", "s2", "s3", "s4"), 6e-4
TIME = 0.01 * np.arange(300)
SHARE = np.array([0.2, 0.4, 0.7, 1.0])[:, None]  # of the tip's motion that each point makes


def arm(seed: int, velocity: float = 0.0) -> np.ndarray:
    """Points that sway by 20 mm at 1.5 Hz and, from the 150th frame on, fly off at a velocity in m/s, (300, 4, 3) in m."""
    sway = 0.02 * np.sin(2 * np.pi * 1.5 * TIME) + velocity * np.maximum(TIME - TIME[150], 0.0)
    noise = NOISE * np.random.default_rng(seed).standard_normal((len(TIME), len(NAMES), 3))
    return sway[:, None, None] * SHARE * np.array([1.0, 0.5, 0.0]) + noise


def take(markers: Markers, points: np.ndarray, after: float = 0.01) -> np.ndarray:
    """Points of a sample some time in s after the last one as they are placed, which are looked at then."""
    before = markers._time if np.isfinite(markers._time) else 0.0
    sample = markers.undo_slips(Sample(before + after, points))
    markers.look(sample, NOISE)
    return sample.points


@pytest.mark.parametrize(("which", "by"), [(3, (5e-3, 0.0, 0.0)), (1, (0.0, -4e-3, 8e-3)), (0, (3e-3, 3e-3, -3e-3))])
def test_a_slip_is_found_and_taken_off(which: int, by: tuple[float, float, float]) -> None:
    """Within the time of the frames that judge it, to what the noise leaves; nothing is told before."""
    points, markers = arm(1), Markers(NAMES, 0.01)
    points[150:, which] += by
    told = []
    for frame in points:
        take(markers, frame)
        told.append(list(markers.describe_slips()))
    assert not any(told[:150])
    assert told[150 + HALF + 1] == [f"marker {NAMES[which]}"]
    assert np.linalg.norm(markers.slipped[which] - by) < 2.5e-3
    assert not np.delete(markers.slipped, which, axis=0).any()


def test_what_was_taken_off_is_no_jump_again() -> None:
    """Of frames before and after the slip, once it is known; a second slip adds up."""
    points, markers = arm(2), Markers(NAMES, 0.01)
    points[100:, 3] += (6e-3, 0.0, 0.0)
    points[200:, 3] += (6e-3, 0.0, 0.0)
    for frame in points:
        placed = take(markers, frame)
    assert markers.slipped[3, 0] == pytest.approx(12e-3, abs=3e-3)
    np.testing.assert_allclose(placed, points[-1] - markers.slipped)


@pytest.mark.parametrize("velocity", [0.3, 1.0])
def test_an_arm_that_is_hit_has_not_slipped(velocity: float) -> None:
    markers = Markers(NAMES, 0.01)
    for frame in arm(3, velocity):
        take(markers, frame)
    assert not markers.slipped.any()


def test_chance_and_lost_points_are_no_slip() -> None:
    """Two minutes of noise, of which a tenth of the points is lost; and a jump that no marker makes."""
    markers, random = Markers(NAMES, 0.01), np.random.default_rng(4)
    for _ in range(40):
        points = arm(int(random.integers(2**31)))
        points[random.random(points.shape[:2]) < 0.1] = np.nan
        for frame in points[: 250 + 1]:
            take(markers, frame)
        markers = Markers(NAMES, 0.01) if not markers.slipped.any() else markers
    assert not markers.slipped.any()
    points = arm(5)
    points[150:, 3] += 2 * FARTHEST
    for frame in points:
        take(markers, frame)
    assert not markers.slipped.any()


def test_frames_that_are_lost_are_no_slip() -> None:
    """A seventh of all frames, while the tip alone moves fast; a jump in frames that are there is found all the same."""
    points, markers, random = arm(6), Markers(NAMES, 0.01), np.random.default_rng(7)
    points[:, 3] += 0.05 * np.sin(2 * np.pi * 1.5 * TIME)[:, None]
    gap = 0.01
    for frame in points[:280]:
        gap += 0.01
        if random.random() > 0.15:
            take(markers, frame, gap - 0.01)
            gap = 0.01
    assert not markers.slipped.any()
    still = arm(8)
    still[150:, 3, 0] += 6e-3
    for frame in still:
        take(markers, frame)
    assert markers.slipped[3, 0] == pytest.approx(6e-3, abs=2.5e-3)
