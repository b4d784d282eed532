"""Pictures of a rig by either means, and the live view's file."""

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command
from tepm_opt.hw.simulation.view import RerunStream, RigView
from tests.hw.rigs import inputs, rig_of


@pytest.mark.parametrize("plain", [True, False])
def test_picture_shows_the_bend(plain):
    """Seen along y, pulled to +x: ink moves to one side; MuJoCo's renderer is skipped where it does not work."""
    pictures = []
    for force in (0.0, 2.5):
        rig = rig_of()
        rig.push(np.array([force, 0, 0]))
        view = RigView(rig, 320, 240, plain=plain)
        if not plain and view.method != "mujoco":
            pytest.skip("MuJoCo cannot render off-screen here")
        pictures.append(view.image(azimuth=-90.0))
    straight, bent = (picture.mean(axis=2) < 200 for picture in pictures)
    assert straight.shape == (240, 320)
    middle = [(ink[:160] * np.arange(320)).sum() / ink[:160].sum() for ink in (straight, bent)]
    assert middle[1] > middle[0] + 3


def test_rerun_is_optional(tmp_path, monkeypatch):
    rig = rig_of()
    rig.apply(Command.of(inputs(rig, 1e5)))
    sample = rig.read()
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    stream = RerunStream(path=tmp_path / "run.rrd")
    stream.show(sample, Command.of(inputs(rig, 1e5)), rig.true_nodes)
    stream.close()
    assert (tmp_path / "run.rrd").stat().st_size > 1000


def test_missing_rerun_is_explained(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rerun", None)
    with pytest.raises(InputError, match="pip install rerun-sdk"):
        RerunStream()
