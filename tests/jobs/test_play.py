"""Playing set points: slowly there, on time, slowly back, stopped whatever happens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.run import read_run
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.jobs.play import play
from tests.data.made import shape
from tests.recording.fake_rig import ROBOT, FakeRig


def made() -> SetPoints:
    """There and back, 11's pressure by 100 kPa, in two seconds."""
    inputs = np.tile(np.repeat([1e5, 1.0], 6), (3, 1))
    inputs[1, 0] = 2e5
    return SetPoints(np.array([5.0, 6.0, 7.0]), inputs, np.zeros((3, 3)))


def test_slowly_there_on_time_and_back(tmp_path: Path) -> None:
    rig = FakeRig()
    measured = play(rig, made(), ROBOT, tmp_path / "out" / "m.csv")
    run = measured.run
    assert measured.notes == ()
    commands = np.array([inputs for _, inputs in rig.applied])
    steps = np.abs(np.diff(commands, axis=0)) / ROBOT.input_max
    assert steps.max() < 0.005
    assert commands[0, 6:].max() < 1e-3
    assert not commands[-1].any()
    assert rig.stops >= 1
    assert run.rows == 101
    np.testing.assert_allclose(run.inputs[:, 0], 1e5 + 1e5 * (1 - np.abs(run.time - 1)))
    back = read_run(tmp_path / "out" / "m.csv", "validation")
    np.testing.assert_array_equal(back.points, run.points)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["m.csv"]


def test_it_begins_at_rest(tmp_path: Path) -> None:
    """What was measured is a run as any other: it starts in equilibrium under its first row."""
    run = play(FakeRig(noise=0.0), made(), ROBOT, tmp_path / "m.csv").run
    assert np.ptp(run.points[:3], axis=0).max() < 1e-3
    np.testing.assert_allclose(run.points[0], shape(run.inputs[0]), atol=5e-4)


def test_interrupted(tmp_path: Path) -> None:
    rig = FakeRig()
    rig.fail_at[400] = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        play(rig, made(), ROBOT, tmp_path / "m.csv")
    assert rig.stops == 1
    assert not rig.commanded.any()
    assert [path.name for path in tmp_path.iterdir()] == ["m-1.unfinished.csv"]
    assert read_run(tmp_path / "m-1.unfinished.csv").rows > 20
    play(FakeRig(), made(), ROBOT, tmp_path / "m.csv")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["m-1.unfinished.csv", "m.csv"]


def test_what_cannot_be_played(tmp_path: Path) -> None:
    points, rig = made(), FakeRig()
    (tmp_path / "old.csv").write_text("old")
    with pytest.raises(InputError, match=r"old\.csv exists; name another file"):
        play(rig, points, ROBOT, tmp_path / "old.csv")
    one = SetPoints(points.time[:1], points.inputs[:1], points.tip_force[:1])
    with pytest.raises(InputError, match="one row has no duration"):
        play(rig, one, ROBOT, tmp_path / "m.csv")
    points.inputs[1] = np.nan
    with pytest.raises(InputError, match="row 2 has no inputs"):
        play(rig, points, ROBOT, tmp_path / "m.csv")
    pushed = SetPoints(points.time, made().inputs, np.arange(9.0).reshape(3, 3))
    with pytest.raises(InputError, match="the tip force changes, but this rig cannot push"):
        play(rig, pushed, ROBOT, tmp_path / "m.csv")
    assert not rig.applied
