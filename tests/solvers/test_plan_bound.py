"""Plans beside what no plan can do better, and what they say of doubts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.errors import InputError
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.devices import Devices
from tepm_opt.solvers.kinematics.ik import solve_ik
from tepm_opt.solvers.linear.modal_model import modal_model
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.planning.linearised import Program
from tepm_opt.solvers.planning.plan import FOR_LOOPS, PlanSettings, plan_move
from tepm_opt.solvers.planning.result import MotionPlan
from tepm_opt.solvers.planning.setpoints import Friction, residual_sway
from tests.solvers.lowest_time import between, lowest_time

START, END = (0.15, 0.0, 0.35), (0.05, 0.0, 0.35)  # 100 mm apart


@pytest.fixture(scope="module")
def fastest(kang: CompiledModel) -> MotionPlan:
    return plan_move(kang, START, END)


@pytest.mark.slow
def test_is_within_a_third_of_the_linear_arm_s_shortest_time(kang: CompiledModel, fastest: MotionPlan) -> None:
    ends = tuple(solve_ik(kang, np.array(tip)) for tip in (START, END))
    local, devices = modal_model(solve_statics(kang, between(kang, ends))), Devices.from_model(kang)
    shortest = {lag: lowest_time(local, ends, devices, lag, (0.0, 7.0)) for lag in (devices.filling, devices.exhausting)}
    assert shortest[0.12] == pytest.approx(0.27, abs=0.015)
    assert shortest[0.24] == pytest.approx(0.35, abs=0.015)
    assert shortest[0.24] < fastest.duration < 1.3 * shortest[0.24]


@pytest.mark.slow
def test_tells_the_sway_of_arms_with_other_frequencies(kang: CompiledModel, fastest: MotionPlan) -> None:
    """In proportion to the doubt, and as it is for an arm that is heavier and whose muscles are stiffer the less."""
    known, doubting = (plan_move(kang, START, END, settings=PlanSettings(frequency_uncertainty=part)) for part in (0.0, 0.1))
    assert known.doubted_sway == known.residual_sway < 5e-4
    assert fastest.residual_sway == known.residual_sway
    assert 10 * known.residual_sway < fastest.doubted_sway
    assert doubting.doubted_sway == pytest.approx(2 * fastest.doubted_sway, rel=0.25)


def test_the_doubted_sway_is_that_of_a_heavier_arm(kang: CompiledModel, fastest: MotionPlan) -> None:
    """A mass 4 % larger makes it sway 2 % more slowly, and gravity on it some more."""
    names, half = kang.network.parameter_names, kang.layout.inputs // 2
    area = kang.values["A"]
    muscle, tension = (fastest.forces + np.clip(fastest.setpoints.inputs[:, half:], 0, 7)) / area, fastest.setpoints.inputs[:, half:]
    arms = [kang, kang.with_theta(np.where([name == "m_d" for name in names], 1.04, 1.0) * kang.theta)]
    own, heavy = (
        residual_sway(arm, fastest.time, muscle, tension, solve_statics(arm, np.hstack([muscle, tension])[-1]).tip) for arm in arms
    )
    slower = residual_sway(kang, 0.98 * fastest.time, muscle, tension, fastest.tips[-1])
    assert own < 0.3 * slower
    assert slower < heavy < 8 * slower


@pytest.mark.slow
def test_bounded_sway_is_less_of_it(kang: CompiledModel, fastest: MotionPlan) -> None:
    """By far: but it takes more than a period of the sway."""
    calm = plan_move(kang, START, END, settings=PlanSettings(max_sway=1e-3))
    assert calm.doubted_sway < 0.35 * fastest.doubted_sway
    assert calm.duration > 1 / fastest.sway_frequencies[1] > fastest.duration


def test_friction_is_reckoned_with(kang: CompiledModel, fastest: MotionPlan) -> None:
    """A doubt as large as the tension itself leaves half of their range and rate; what it may hold grows with it."""
    half = kang.layout.inputs // 2
    doubting = plan_move(kang, START, END, settings=PlanSettings(friction_doubt=0.9))
    rates = [np.abs(np.diff(plan.setpoints.inputs[:, half:], axis=0)).max() / plan.time[1] for plan in (fastest, doubting)]
    assert rates[1] < 10 / 1.9 + 1.5 < rates[0] + 0.5
    assert doubting.friction_offset == pytest.approx(0.9 / 0.25 * fastest.friction_offset)
    assert doubting.setpoints.inputs[:, half:].max() < (7.0 - 0.1) / 1.9 + 0.2


def test_the_offset_is_that_of_the_worst_signs(kang: CompiledModel) -> None:
    end = solve_ik(kang, np.array(END))
    at, inputs, half = end.equilibrium, end.allocation.inputs, kang.layout.inputs // 2
    gain = modal_model(at, modes=1).gain[-3:]
    most = Friction(0.0, 0.01).offset(at, inputs[half:])
    found = []
    for sign in (np.sign(gain[0]), np.sign(gain[1]), np.ones(half)):
        moved = solve_statics(kang, np.concatenate([inputs[:half], inputs[half:] * (1 + 0.01 * sign)]))
        found.append(np.linalg.norm(moved.tip - at.tip))
    assert max(found) == pytest.approx(most, rel=0.1)
    assert min(found) < 0.3 * most


@pytest.mark.slow
def test_room_for_a_controller_takes_half_as_long_again(kang: CompiledModel, fastest: MotionPlan) -> None:
    roomy = plan_move(kang, START, END, settings=PlanSettings(effort_weight=FOR_LOOPS))
    assert fastest.duration < roomy.duration < 1.6 * fastest.duration
    assert roomy.effort < 0.4 * fastest.effort


def test_derivatives_of_the_program(kang: CompiledModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of all rows and residuals, by differences: with an obstacle, a margin and a bounded sway."""
    from tepm_opt.solvers.planning import convex
    from tepm_opt.solvers.planning.program import Sphere

    made: list[Program] = []
    original = convex.Program

    def kept(*arguments: object) -> Program:
        made.append(original(*arguments))  # type: ignore[arg-type]
        return made[-1]

    monkeypatch.setattr(convex, "Program", kept)
    settings = PlanSettings(min_stiffness=0.1, max_sway=1e-2, max_iterations=1, min_intervals=6)
    plan_move(kang, START, END, obstacles=[Sphere((0.1, 0.03, 0.35), 0.02)], settings=settings)
    program, rng = made[-1], np.random.default_rng(0)
    x = program.guess(0.6) + 0.01 * rng.normal(size=program.unknowns)
    about = program.linearise(x)
    for _ in range(5):
        way = rng.normal(size=program.unknowns)
        ahead, behind = (program.linearise(x + sign * 1e-6 * way) for sign in (1, -1))
        for name, slopes in (("values", about.slopes), ("residuals", about.residual_slopes)):
            np.testing.assert_allclose((getattr(ahead, name) - getattr(behind, name)) / 2e-6, slopes @ way, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"friction_doubt": -0.1}, r"friction_doubt: -0\.1; valid: 0 … 0\.9 of the tension"),
        ({"max_sway": 0.0}, "max_sway: 0 m; valid: more than 0"),
    ],
)
def test_wrong_doubts(kang: CompiledModel, settings: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plan_move(kang, START, END, settings=replace(PlanSettings(), **settings))
