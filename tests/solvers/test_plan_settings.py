"""What each setting of a plan does, on a short way with coarse polynomials and few intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.devices import Devices
from tepm_opt.models.model import Model
from tepm_opt.outcome import Ending
from tepm_opt.solvers.planning.family import FamilyFit
from tepm_opt.solvers.planning.objective import Objective
from tepm_opt.solvers.planning.plan import PlanSettings, plan_move, plan_path
from tepm_opt.solvers.planning.program import Sphere
from tepm_opt.solvers.planning.result import MotionPlan
from tepm_opt.solvers.planning.trajectories import line
from tests.tools import variant

START, END = (0.13, 0.0, 0.35), (0.09, 0.0, 0.35)
COARSE = FamilyFit(degree=3, nodes=4, dynamics_degree=2, dynamics_nodes=3, validation_samples=1)
QUICK = PlanSettings(fit=COARSE, min_intervals=6, max_spacing=0.05, max_residual_sway=1.0, effort_weight=3e-5)


def planned(model: CompiledModel, **changed: object) -> MotionPlan:
    """A plan that is found, with some settings other than `QUICK`."""
    plan = plan_move(model, START, END, settings=replace(QUICK, **changed))
    assert plan.solved, plan.outcome
    return plan


def tensions(plan: MotionPlan) -> np.ndarray:
    return plan.setpoints.inputs[:, plan.model.layout.inputs // 2 :]


def largest_rate(plan: MotionPlan) -> float:
    return float(np.abs(np.diff(tensions(plan), axis=0)).max() / plan.time[1])


@pytest.fixture(scope="module")
def quick(kang: CompiledModel) -> MotionPlan:
    return planned(kang)


@pytest.mark.parametrize("setting", ["filling", "exhausting"])
def test_slow_regulators_take_longer(kang: CompiledModel, quick: MotionPlan, setting: str) -> None:
    known = Devices.from_model(kang)
    assert planned(kang, devices=replace(known, **{setting: 2.5 * getattr(known, setting)})).duration > 1.02 * quick.duration


@pytest.mark.slow
def test_devices_are_those_of_the_robot_file_or_of_the_model(quick: MotionPlan) -> None:
    """A lag that the model has goes before the file's, and is not waited for twice."""
    actuation = {"filling_time_s": 0.3, "exhausting_time_s": 0.6, "tension_rate_N_per_s": 5.0}
    slow = planned(compile_model(Model.from_robot(variant(actuation=actuation))))
    assert slow.duration > 1.2 * quick.duration
    assert largest_rate(slow) < 5.0
    known = Model.from_robot(variant(actuation={"tension_rate_N_per_s": 5.0})).with_effect(
        "regulator_lag", filling_time=0.3, exhausting_time=0.6
    )
    same = planned(compile_model(known))
    assert same.duration == pytest.approx(slow.duration)
    assert same.residual_sway == pytest.approx(slow.residual_sway)


@pytest.mark.parametrize("setting", [{"devices": Devices(0.12, 0.24, 6.0, 0.0)}, {"tension_rate_reserve": 0.5}], ids=str)
def test_slow_motors_take_longer(kang: CompiledModel, quick: MotionPlan, setting: dict[str, float]) -> None:
    slow = planned(kang, **setting)
    assert slow.duration > 1.02 * quick.duration
    assert largest_rate(slow) < 7 < largest_rate(quick)


def test_the_reserve_keeps_tensions_from_their_limits(kang: CompiledModel) -> None:
    """Here slack, from a low tension at rest."""
    near, far = (
        planned(kang, mid_tension=1.5, devices=Devices(0.12, 0.24, 20.0, 0.0), tension_reserve=reserve) for reserve in (0.15, 0.75)
    )
    assert tensions(near).min() < 0.6
    assert tensions(far).min() > 0.75 - 0.1, "up to the regulators' grid"


def test_less_sway_for_other_frequencies_takes_longer(kang: CompiledModel, quick: MotionPlan) -> None:
    loose, strict = (planned(kang, frequency_uncertainty=0.02, max_sway=sway) for sway in (1.0, 1e-3))
    assert loose.duration == pytest.approx(quick.duration, rel=1e-3)
    assert strict.duration > 1.2 * loose.duration


def test_set_points_are_no_further_apart(kang: CompiledModel, quick: MotionPlan) -> None:
    dense = planned(kang, max_spacing=0.01)
    assert np.diff(dense.time).max() <= 0.01 + 1e-9 < 0.03 < np.diff(quick.time).max() <= QUICK.max_spacing + 1e-9
    assert dense.duration == pytest.approx(quick.duration)


def test_more_intervals_find_a_faster_motion(kang: CompiledModel, quick: MotionPlan) -> None:
    """Splines on half the intervals hold those on the whole."""
    assert planned(kang, min_intervals=2 * QUICK.min_intervals).duration < quick.duration


def test_effort_counts_against_time(kang: CompiledModel, quick: MotionPlan) -> None:
    gentle = planned(kang, effort_weight=100 * QUICK.effort_weight)
    assert gentle.duration > 1.5 * quick.duration
    assert gentle.effort < 0.5 * quick.effort


def test_what_sways_too_much_is_made_anew(kang: CompiledModel, quick: MotionPlan) -> None:
    """With more weight on the effort, as often as it takes."""
    said: list[str] = []

    def note(stage: str, done: float, of: float) -> None:
        said.append(stage)

    settings = replace(QUICK, max_residual_sway=0.9 * quick.residual_sway)
    calm = plan_move(kang, START, END, settings=settings, progress=note)
    assert said.count("set points and simulation") > 1
    assert calm.residual_sway <= settings.max_residual_sway < quick.residual_sway
    assert calm.duration > quick.duration


def test_a_finer_fit_is_nearer_to_the_configurations(kang: CompiledModel, quick: MotionPlan) -> None:
    rough = planned(kang, fit=replace(COARSE, degree=2, nodes=3))
    assert all(fine < coarse / 2 for fine, coarse in zip(quick.surrogate_error, rough.surrogate_error, strict=True))


def test_a_path_takes_the_arguments_of_a_move(kang: CompiledModel) -> None:
    """Objective, duration and obstacles."""
    path = line(points=8, start=START, end=END)
    plan = plan_path(kang, path, Objective.EFFORT, 0.8, settings=QUICK)
    assert plan.solved, plan.outcome
    assert plan.duration == pytest.approx(0.8)
    blocked = plan_path(kang, path, obstacles=[Sphere((0.11, 0.0, 0.37), 0.019)], settings=QUICK)
    assert blocked.outcome.ending is Ending.BLOCKED
    assert blocked.outcome.message.startswith("path: s4 is ")
