"""The network's geometry: SPEC section 2, counted by hand."""

from collections import Counter

import numpy as np
import pytest

from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import load_robot
from tests.tools import variant


def test_a_segment_of_the_papers_robot():
    layout = Layout.from_robot(load_robot("kang2017"))
    assert Counter(edge.kind for edge in layout.edges) == {"vertical": 3, "horizontal": 3, "diagonal": 6}
    diagonals = {(edge.a[1], edge.b[1]) for edge in layout.edges if edge.kind == "diagonal"}
    assert diagonals == {(i, j) for i in range(3) for j in range(3) if i != j}
    assert (layout.levels, layout.block, layout.inputs, layout.points) == (12, 9, 12, 4)
    assert layout.actuator_names == ("11", "12", "13", "21", "22", "23")
    assert layout.point_names == ("s1", "s2", "s3", "s4")


@pytest.mark.parametrize(
    ("angles", "bracing", "counts"),
    [
        ((90.0, 210.0, 330.0), "single", (3, 3, 3)),
        ((0.0, 90.0, 180.0, 270.0), "crossed", (4, 6, 8)),
        ((0.0, 240.0, 120.0, 60.0, 300.0, 180.0), "crossed", (6, 15, 12)),
    ],
)
def test_more_actuators_join_every_pair_of_a_ring_and_brace_neighbouring_faces(angles, bracing, counts):
    layout = Layout.from_robot(variant(geometry={"actuator_angles_deg": angles, "bracing": bracing}))
    found = Counter(edge.kind for edge in layout.edges)
    assert (found["vertical"], found["horizontal"], found["diagonal"]) == counts
    gaps = {(angles[edge.b[1]] - angles[edge.a[1]]) % 360 for edge in layout.edges if edge.kind == "diagonal"}
    step = 360 / len(angles)
    assert gaps == ({step} if bracing == "single" else {step, 360 - step})


@pytest.mark.parametrize(("segments", "modules"), [(6, 2), (5, 2), (1, 1), (7, 3)])
def test_reference_points_sit_at_half_and_full_height_of_every_module(segments, modules):
    layout = Layout.from_robot(variant(geometry={"segments_per_module": segments, "modules": modules}))
    weights = layout.point_weights
    assert weights.shape == (2 * modules, modules * segments + 1)
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    np.testing.assert_allclose(weights @ np.arange(modules * segments + 1), np.arange(1, 2 * modules + 1) * segments / 2)
    assert (np.count_nonzero(weights, axis=1) <= 2).all()


def test_two_digit_numbers_are_separated():
    names = Layout.from_robot(variant(geometry={"modules": 11})).actuator_names
    assert names[0] == "1_1"
    assert names[-1] == "11_3"
    assert len(set(names)) == 33
