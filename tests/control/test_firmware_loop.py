"""The predictive controller through line, firmware and drivers, against the same controller on the simulated rig, in virtual time."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.control.controllers.mpc import Mpc
from tepm_opt.control.loop import close_loop
from tepm_opt.hw.board.rig import SerialRig, Tendons
from tepm_opt.hw.rig import Sample
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.outcome import Ending
from tests.control import study
from tests.hw.emulator import Board
from tests.hw.emulator.world import World


class Witnessed(World):
    """Also notes where the points were in truth.

    Attributes:
        truth: (points, 3) in m in G by the time in s of the frame.
    """

    def __init__(self, board: Board, rig: SimulatedRig) -> None:
        self.truth: dict[float, np.ndarray] = {}
        super().__init__(board, rig)

    def _couple(self) -> None:
        due = self._due
        super()._couple()
        if self._due > due and self.rig is not None:
            self.truth[self.time] = self.rig.true_points


class Emulated(SerialRig):
    """The virtual prototype behind the emulated board.

    Attributes:
        truth: of the tip at the last sample's time, (3,) in m; the controller knows nothing of it.
    """

    def __init__(self, world: Witnessed, tendons: Tendons) -> None:
        super().__init__(world.port, study.model().robot, world.tracker, clock=world.clock, threaded=False, tendons=tendons)
        self.world, self.truth = world, np.full(3, np.nan)

    def read(self) -> Sample:
        sample = super().read()
        at = min(self.world.truth, key=lambda time: abs(time - self._origin - sample.time))
        self.truth = self.world.truth[at][-1]
        return sample


@pytest.mark.slow
def test_circle_through_the_firmware_as_on_the_simulated_rig(board: Board) -> None:
    """Root mean square error of the true tip on the 8 s circle: within 10 % of the same controller's without board and line."""
    world = Witnessed(board, study.prototype(1))
    rig, truth = Emulated(world, "tension"), list[np.ndarray]()
    controller, observer = Mpc(study.model(), study.reference("circle")), lambda sample, target: truth.append(rig.truth)
    through = close_loop(rig, controller, study.model().robot, observer=observer)
    through.truth[:] = truth
    direct = study.follow("circle", "mpc", 1)
    print(f"through the firmware {1e3 * through.error():.2f} mm, direct {1e3 * direct.error():.2f} mm")
    assert through.outcome.ending is direct.outcome.ending is Ending.DONE
    assert not through.fallbacks
    assert len(through.rows) == len(through.reference)
    assert board.safe
    assert through.error() < 1.1 * direct.error()
