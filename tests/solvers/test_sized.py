"""Named paths in the size of a robot: the paper's on its robot, about the arm elsewhere, and in reach."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.models.compile import compile_model
from tepm_opt.solvers.planning.scaled_paths import path_for
from tepm_opt.solvers.planning.trajectories import SHAPES


def test_on_the_papers_robot_they_are_the_papers() -> None:
    """To the last bit, whatever is chosen of them."""
    model = compile_model("kang2017")
    given = (
        {},
        {"points": 5},
        {"radius": 0.1},
        {"height": 0.3},
        {"start": (0.0, 0.1, 0.3)},
        {"start": (0.0, 0.1, 0.3), "end": (0, 0, 0.35)},
    )
    for name, shape in SHAPES.items():
        for chosen in given:
            if chosen.keys() <= {"points", *(parameter.name for parameter in shape.parameters)}:
                path = path_for(model, name, **chosen)
                assert path.says == ""
                assert path.positions.tobytes() == shape.make(**chosen).positions.tobytes()


def test_about_an_arm_that_sticks_out() -> None:
    """Across its axis, which is x: 3/8 of 120 mm. No height cuts it."""
    model = compile_model("one_module", "python")
    path = path_for(model, "circle", points=4)
    assert path.positions[:, 0] == pytest.approx(np.full(4, 0.120))
    assert np.linalg.norm(path.positions - [0.120, 0.0, 0.300], axis=1) == pytest.approx(np.full(4, 0.045))
    assert "within 0.045 m of (0.12, 0, 0.3) m" in path.says
    with pytest.raises(InputError, match="sticks out sideways, which no height cuts"):
        path_for(model, "circle", height=0.3)


@pytest.mark.slow
def test_shrunk_until_it_is_in_reach_and_turned_with_the_base() -> None:
    """The slim arm hangs from 0.8 m: three quarters of what its length would have; a height of its own is where its axis has it."""
    model = compile_model("slim", "python")
    path = path_for(model, "circle", points=4)
    assert path.positions[:, 2] == pytest.approx(np.full(4, 0.2))
    assert np.linalg.norm(path.positions[:, :2], axis=1) == pytest.approx(np.full(4, 0.75 * 0.225))
    assert path_for(model, "circle", points=4, height=0.22, radius=0.1).positions[1] == pytest.approx([0.0, -0.1, 0.22])


def test_unknown_names() -> None:
    with pytest.raises(InputError, match="unknown path 'circl': did you mean 'circle'"):
        path_for(compile_model("kang2017", "python"), "circl")
