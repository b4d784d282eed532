"""What is drawn of an arm."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.studio.arm import set_inputs
from tepm_opt.studio.shapes import BOUND, EMPTY, arm_shape, nodes_in_g, polyline, quaternion
from tests.tools import variant

ODD = variant(geometry={"actuator_angles_deg": (0.0, 90.0, 180.0, 270.0), "segments_per_module": 3})


@pytest.fixture(scope="module", params=["kang", "four"])
def model(request: pytest.FixtureRequest, kang: CompiledModel) -> CompiledModel:
    return kang if request.param == "kang" else compile_model(ODD, backend="python")


def test_lines_are_the_muscles(model: CompiledModel) -> None:
    """Their pieces are as long as the actuators, end at the tip plate and have its colours."""
    layout = model.layout
    inputs = np.zeros(layout.inputs)
    inputs[1] = 0.3 * model.input_max[1]
    held = set_inputs(model, inputs).held
    bound = np.zeros(layout.inputs // 2, dtype=bool)
    bound[-1] = True
    nodes = nodes_in_g(model.robot, held.x)
    shape = arm_shape(layout, nodes, inputs / model.input_max, bound)
    pieces = np.linalg.norm(shape.muscles[:, 1] - shape.muscles[:, 0], axis=1)
    lengths = pieces.reshape(layout.modules, layout.segments, layout.actuators).sum(axis=1)
    np.testing.assert_allclose(lengths, held.lengths, rtol=1e-9)
    np.testing.assert_allclose(nodes[-1].mean(axis=0), held.tip, atol=1e-12)
    assert len(shape.plates) == (layout.modules + 1) * layout.actuators
    assert len(shape.plates) + len(shape.rings) == (layout.levels + 1) * layout.actuators
    assert shape.labels.shape == (layout.inputs // 2, 3)
    colors = shape.muscle_colors.reshape(layout.modules, layout.segments, layout.actuators, 2, 3)
    assert (colors[-1, :, -1] == BOUND).all()
    assert (colors[0, :, 0] == EMPTY).all()
    assert (colors[0, :, 1] != EMPTY).any(axis=-1).all()
    assert (shape.tendon_colors.reshape(colors.shape)[0] == EMPTY).all()
    widest = np.linalg.norm(shape.tendons[:, 0] - shape.muscles[:, 0], axis=1)
    assert (widest > 0.05 * model.values["r"]).all()


@pytest.mark.parametrize(("points", "count"), [(5, None), (5, 3), (5, 9), (1, 4)])
def test_polylines(points: int, count: int | None) -> None:
    line = np.arange(3.0 * points).reshape(points, 3)
    pieces = polyline(line, count)
    assert len(pieces) == (points - 1 if count is None else count)
    np.testing.assert_array_equal(pieces[1:, 0], pieces[:-1, 1])
    if len(pieces):
        np.testing.assert_array_equal(pieces[[0, -1], [0, 1]], line[[0, -1]])


def test_quaternions() -> None:
    """A third of a turn about the diagonal takes x to y to z."""
    w, x, y, z = quaternion(np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]))
    np.testing.assert_allclose(np.array([w, x, y, z]) * np.sign(w), 0.5)
