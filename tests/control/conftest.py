"""The emulated board for closed loops (see `tests.hw.conftest`), a short reference and a run on it."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.control.loop import LoopRecord, close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.references.reference import Reference, approach, reference_of, sample_tips
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.planning.trajectories import circle
from tests.hw.conftest import board, board_factory, firmware, library

__all__ = ["board", "board_factory", "firmware", "library"]


@pytest.fixture(scope="session")
def short(kang: CompiledModel) -> Reference:
    """To the circle in 3 s and 1.5 s along it, of which the last second counts."""
    tips = sample_tips(circle(400))[0][:150]
    lead = approach(kang, tips[0], 3.0)
    return reference_of(kang, np.vstack([lead, tips]), np.arange(450) >= 350)


@pytest.fixture(scope="session")
def followed(kang: CompiledModel, short: Reference) -> LoopRecord:
    """The predictive controller on it, on the virtual prototype, which differs from the model."""
    rig = SimulatedRig()
    rig.reseed(1)
    return close_loop(rig, Mpc(kang, short), kang.robot)
