"""Options that commands share: a new shape reaches every command by its registration alone, a setting by its group."""

from __future__ import annotations

import inspect
from collections.abc import Iterator

import numpy as np
import pytest

from tepm_opt.cli.groups import IkOptions, PathOptions, TrajectoryOptions, spread
from tepm_opt.cli.ik import ik
from tepm_opt.cli.mpc import mpc
from tepm_opt.cli.plan import plan
from tepm_opt.errors import InputError
from tepm_opt.solvers.kinematics.ik import IkSettings
from tepm_opt.solvers.planning import trajectories
from tepm_opt.solvers.planning.trajectories import HEIGHT, ShapeParameter, Trajectory, shape
from tests.cli.conftest import Command

TURNS = ShapeParameter("turns", "turns", "number of turns", "turns", 0.0, 20.0, above=True)


@pytest.fixture
def spiral() -> Iterator[None]:
    """A shape that a person adds."""
    before = dict(trajectories.SHAPES)

    @shape(HEIGHT, TURNS)
    def spiral(points: int = 8, duration: float = 5.0, height: float = 0.35, turns: float = 2.0) -> Trajectory:
        part = np.arange(points) / points
        angle = 2 * np.pi * turns * part
        return Trajectory(duration * part, np.stack([0.1 * part * np.cos(angle), 0.1 * part * np.sin(angle), np.full(points, height)], 1))

    yield
    trajectories.SHAPES.clear()
    trajectories.SHAPES.update(before)


@pytest.mark.usefixtures("spiral")
@pytest.mark.parametrize("command", [ik, mpc, plan])
def test_a_new_shape_is_an_option_of_every_command(command: object) -> None:
    found = inspect.signature(spread(command)).parameters  # type: ignore[arg-type]
    (info,) = found["turns"].annotation.__metadata__
    assert info.help == "Number of turns of spiral, turns."
    assert found["turns"].default is None
    (info,) = found["height"].annotation.__metadata__
    assert info.help == "Height, z in G, of circle and lissajous and spiral, m."


@pytest.mark.usefixtures("spiral")
def test_a_new_shape_is_made_checked_and_refused_as_the_others() -> None:
    made = TrajectoryOptions.from_options({"points": 4, "duration": None, "turns": 1.0}).trajectory("spiral")
    np.testing.assert_allclose(made.positions[1], [0, 0.025, 0.35], atol=1e-12)
    for given, name, says in (
        ({"turns": 0.0}, "spiral", "--turns 0.0; valid: more than 0 … 20 turns"),
        ({"turns": 1.0}, "circle", "option --turns does not fit trajectory 'circle'"),
        ({"radius": 0.1}, "spiral", "option --radius does not fit trajectory 'spiral'"),
        ({}, "spirals", "unknown trajectory 'spirals': valid: circle, lissajous, line, spiral or a .csv file"),
    ):
        with pytest.raises(InputError, match=says.replace("(", r"\(")):
            PathOptions.from_options(given).trajectory(name)


def test_a_setting_of_the_inverse_kinematics_reaches_both_commands(tepm: Command) -> None:
    assert IkOptions(tolerance=1e-6).settings().tolerance == 1e-6
    assert IkOptions().settings().tolerance == 1e-9
    for command in (ik, mpc):
        assert "tolerance" in inspect.signature(spread(command)).parameters
        done = tepm(command.__name__, "circle", "--tolerance", 1)
        assert (done.status, "--tolerance" in done.err) == (2, True)


@pytest.mark.parametrize(("command", "solver"), [("ik", "tepm_opt.jobs.ik"), ("mpc", "tepm_opt.control.references.reference")])
def test_a_setting_reaches_the_solver(tepm: Command, monkeypatch: pytest.MonkeyPatch, command: str, solver: str) -> None:
    seen = []

    def each(*arguments: object, **options: object) -> None:
        seen.extend(value for value in (*arguments, *options.values()) if isinstance(value, IkSettings))
        raise KeyboardInterrupt

    monkeypatch.setattr(f"{solver}.each_configuration", each)
    assert tepm(command, "circle", "--tolerance", 1e-7).status == 130
    assert seen == [IkSettings(tolerance=1e-7)]
