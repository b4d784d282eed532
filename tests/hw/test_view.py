"""Pictures of a rig by either means."""

import numpy as np
import pytest

from tepm_opt.hw.simulation.view import RigView
from tests.hw.rigs import rig_of


@pytest.mark.slow
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
