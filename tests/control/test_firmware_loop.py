"""The predictive controller through line, firmware and drivers, against the same controller on the simulated rig, in virtual time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tepm_opt.control.loop import LoopRecord, close_loop
from tepm_opt.control.mpc.controller import Mpc
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


NOISES, BESIDE = range(1, 9), range(1, 13)  # of the runs through the firmware, and beside it; the ratio of their means is known to 4 %


def through(board: Board, noise: int) -> LoopRecord:
    """The circle through the firmware."""
    world = Witnessed(board, study.prototype(noise))
    rig, truth = Emulated(world, "tension"), list[np.ndarray]()
    controller, observer = Mpc(study.model(), study.reference("circle")), lambda sample, target: truth.append(rig.truth)
    done = close_loop(rig, controller, study.model().robot, observer=observer)
    done.truth[:] = truth
    return done


@pytest.mark.slow
def test_circle_through_the_firmware_as_on_the_simulated_rig(board_factory: Callable[..., Board]) -> None:
    """Root mean square error of the true tip on the 8 s circle: within 10 % of the same controller's without board and line.

    The tracker's noise is another one through the firmware, and alone makes 13 % (one sigma) of a run's error: means are compared.
    """
    boards = [board_factory() for _ in NOISES]
    runs = [through(board, noise) for board, noise in zip(boards, NOISES, strict=True)]
    direct = float(np.mean([study.follow("circle", "mpc", noise).error() for noise in BESIDE]))
    for run, board in zip(runs, boards, strict=True):
        assert run.outcome.ending is Ending.DONE
        assert not run.fallbacks
        assert len(run.rows) == len(run.reference)
        assert board.safe
    found = float(np.mean([run.error() for run in runs]))
    print(f"through the firmware {1e3 * found:.2f} mm, direct {1e3 * direct:.2f} mm")
    assert found < 1.1 * direct
