"""The LQG controller on machines that are not its model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.control.baselines.lqg import Lqg, LqgSettings
from tepm_opt.control.baselines.modes import MODE1
from tepm_opt.control.controllers import find_controller
from tepm_opt.control.loop import close_loop
from tepm_opt.control.references.reference import Reference
from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.family import random_machine
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.models.compile import CompiledModel


def test_follows_within_limits(kang: CompiledModel, short: Reference) -> None:
    """On a machine that is not the model: some millimetres, no tension beyond its range, none that the motors could not follow."""
    rig = SimulatedRig(random_machine("kang2017", 2, 0))
    done = close_loop(rig, Lqg(kang, short), kang.robot)
    assert done.outcome.solved
    assert 1e3 * done.error() < 6.0
    tensions = np.array([command.tensions for command in done.commands])
    assert tensions.min() >= 0
    assert tensions.max() <= 7.0
    rates = np.abs(np.diff(tensions, axis=0)) / short.period
    assert np.percentile(rates, 99) < 1.2 * 10.0, "commands are relative to what is believed of the tension, which noise moves a little"


@pytest.mark.slow
def test_is_offered_like_the_others(kang: CompiledModel, short: Reference) -> None:
    kind = find_controller("lqg")
    assert isinstance(kind.make(kang, short, kind.settings({})), Lqg)
    with pytest.raises(InputError, match="LqgSettings"):
        kind.make(kang, short, MODE1.settings({}))


@pytest.mark.slow
def test_a_lost_point_corrects_nothing(kang: CompiledModel, short: Reference) -> None:
    rig, controller = SimulatedRig(), Lqg(kang, short, LqgSettings())
    rig.apply(controller.start())
    sample = rig.read()
    blind = controller.command(replace(sample, points=np.full_like(sample.points, np.nan)))
    assert np.isfinite(blind.tensions).all()
    assert np.isfinite(blind.pressures).all()
