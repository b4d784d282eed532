"""Built-in rigs keep the contract of rigs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tepm_opt.hw import registry
from tepm_opt.hw.registry import RigKind, open_rig
from tepm_opt.hw.rig import Command, Rig
from tepm_opt.models.robot import load_robot
from tepm_opt.testing import RigContract
from tests.hw.test_emulation import bench
from tests.hw.test_simulated import recording

__all__ = ["bench"]  # a fixture


class TestSimulated(RigContract):
    """The virtual prototype, compiled or in MuJoCo, and the bench of one actuator."""

    @pytest.fixture(autouse=True, params=["sim", "sim:perfect", pytest.param("sim@mujoco", marks=pytest.mark.slow), "bench"])
    def _which(self, request: pytest.FixtureRequest) -> None:
        self.text = request.param

    def open_rig(self) -> Rig:
        """The rig of this text."""
        return open_rig(self.text)


class TestReplay(RigContract):
    """A run that is played again."""

    @pytest.fixture(autouse=True)
    def _recorded(self, tmp_path: Path) -> None:
        path = Path(recording(tmp_path))
        *head, row, _ = path.read_text().splitlines()
        rows = [f"{0.01 * k:g},{row.partition(',')[2]}" for k in range(20)]
        path.write_text("\n".join([*head, *rows]) + "\n")
        self.text = f"replay:{path}"

    def open_rig(self) -> Rig:
        """The rig of this run."""
        return open_rig(self.text)


@pytest.mark.slow
class TestSerial(RigContract):
    """The robot behind its board, which is emulated, with a tracker."""

    @pytest.fixture(autouse=True)
    def _emulated(self, bench: str) -> None:
        self.text = bench

    def open_rig(self) -> Rig:
        """The rig behind the emulated port."""
        return open_rig(self.text, load_robot(Path(self.text.removeprefix("serial:")).parent / "robot.toml"))


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


def test_commands_are_made_by_the_old_name() -> None:
    """Packages of rigs and controllers may still call it."""
    with pytest.warns(DeprecationWarning, match=r"Command\.of is now Command\.from_inputs; the old name goes with version 0\.4"):
        command = Command.of(np.array([1e5, 2e5, 3.0, 4.0]))
    assert command.pressures.tolist() == [1e5, 2e5]
    assert command.tensions.tolist() == [3.0, 4.0]
    assert command.enabled.all()
