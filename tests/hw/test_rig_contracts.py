"""Built-in rigs keep the contract of rigs."""

from __future__ import annotations

import pytest

from tepm_opt.hw import registry
from tepm_opt.hw.registry import RigKind, open_rig
from tepm_opt.hw.rig import Rig
from tepm_opt.testing import RigContract


class TestPrototype(RigContract):
    """The virtual prototype, compiled or in MuJoCo."""

    @pytest.fixture(autouse=True, params=["sim", "sim:perfect", pytest.param("sim@mujoco", marks=pytest.mark.slow), "bench"])
    def _which(self, request: pytest.FixtureRequest) -> None:
        self.text = request.param

    def open_rig(self) -> Rig:
        """The rig of this text."""
        return open_rig(self.text)


def test_a_rig_can_be_plugged_in() -> None:
    """It is opened by its name, with what stands after the colon, and is among the valid ones."""
    opened = []
    kind = RigKind("mine", "mine:PLACE", lambda target, robot: opened.append((target, robot)) or open_rig("sim"))
    registry._registry.cache_clear()
    registry.register(kind)
    try:
        with open_rig("mine:left") as rig:
            assert rig.robot.name == "kang2017"
        assert opened == [("left", None)]
        assert kind in registry.rig_kinds()
    finally:
        registry._registry.cache_clear()
