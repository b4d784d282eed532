"""References that stop at several targets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.control.estimation.kalman_filter import FilterSettings
from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.compiled.setup import StepSetup
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.mpc.settings import MpcSettings
from tepm_opt.control.references.reference import approach, point_by_point, reference_of
from tepm_opt.hw.simulation.rigfile import load_rig_file
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tepm_opt.solvers.planning.trajectories import circle
from tests.control.study import APPROACH, model, prototype, reference


def test_unknown_forces_last_longer_at_targets_and_the_model_file_s_filter_stays() -> None:
    tuned = compile_model(replace(Model.from_robot("kang2017"), filter={"strength_std": 0.015}))
    stops, path = (StepSetup.from_model(tuned, reference(task, 3), MpcSettings(), 0.0) for task in ("points", "circle"))
    assert path.controller == stops.controller == MpcSettings()
    assert path.filter == replace(FilterSettings(), strength_std=0.015)
    assert stops.filter == replace(path.filter, force_correlation_time=4 * path.filter.force_correlation_time)


@pytest.mark.slow
def test_quick_moves_between_targets_do_not_throw_an_arm_without_valve_lags() -> None:
    """Neither friction nor monitors: pressures led by lags that are not there threw it by 275 mm in the first move."""
    targets = circle(12).positions
    tips, counted, number = point_by_point(targets, 0.5, stay=1.5, taken=0.5)
    lead = approach(model(), targets[0], APPROACH)
    before = np.zeros(len(lead), dtype=int)
    quick = reference_of(model(), np.vstack([lead, tips]), np.append(before > 0, counted), np.append(before, number))
    done = close_loop(prototype(1, load_rig_file("perfect")), Mpc(model(), quick), model().robot)
    assert done.outcome.solved
    off = np.linalg.norm(np.array(done.truth) - done.targets, axis=1)
    assert off.max() < 0.03
    assert done.error() < 1.5e-3
