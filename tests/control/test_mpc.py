"""The predictive controller: its cost against sums written out, its value against scipy, and what it does when something fails."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from tepm_opt.control.actuation.pressure_planner import PressurePlannerSettings
from tepm_opt.control.estimation.kalman_filter import DiscreteModalModel, FilterSettings
from tepm_opt.control.mpc.controller import Mpc, MpcSettings, Use
from tepm_opt.control.mpc.prediction import PredictionModel, Weights
from tepm_opt.control.mpc.qp import QpResult
from tepm_opt.control.references.reference import Reference
from tepm_opt.errors import InputError
from tepm_opt.hw.commands import check_command
from tepm_opt.hw.rig import Command, Sample
from tepm_opt.jobs.closed_loop import ClosedLoop, LoopSetup
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.model import Model
from tepm_opt.models.robot import load_robot
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.solvers.linear.modal_model import modal_model
from tests.control.study_models import alone, error

ROBOT = load_robot("kang2017")
STAGES, ROW = 4, 330
PYTHON = MpcSettings(backend="python")  # for what reaches into a step
WEIGHTS = Weights()


@pytest.fixture(scope="module")
def operating(short: Reference) -> DiscreteModalModel:
    """On the circle, in motion."""
    return DiscreteModalModel.from_modal_model(modal_model(short.equilibria[ROW]), short.forces[ROW], short.period)


def forecast_of(
    operating: DiscreteModalModel, reference: Reference, stages: int = STAGES, still: bool = False, seed: int = 5
) -> tuple[PredictionModel, np.ndarray]:
    """About a point of a reference, from a random motion and with a random bias of the tip; with the program's H."""
    random = np.random.default_rng(seed)
    rows = np.full(stages + 9, ROW) if still else ROW + 2 * np.arange(-1, stages + 8)
    forecast = PredictionModel(WEIGHTS, stages)
    motion = np.append(4e-3 * random.normal(size=10), 1e-2 * random.normal(size=10))
    hessian = forecast.prepare(operating, reference, rows)
    forecast.horizon.set_initial_state(motion, 2e-3 * random.normal(size=3))
    return forecast, hessian


def written_out(
    forecast: PredictionModel, operating: DiscreteModalModel, begin: np.ndarray, plan: np.ndarray, value: np.ndarray, path: np.ndarray
) -> float:
    """Cost of deviations (stages, actuators): the arm stage by stage, and a sum of squares.

    Args:
        path: modal coordinates of the reference at stages −1, 0, 1, …
    """
    model, two = operating.model, operating.double_period()
    deviations = np.vstack([begin, plan])
    state, cost = forecast.horizon.free[0], 0.0
    aim = model.static(forecast.horizon.rest_force)
    lever = np.vstack([model.observe[-3:] / WEIGHTS.tip, model.observe[:-3] / WEIGHTS.shape])
    step = two.period
    for k in range(len(plan)):
        pushed = []
        for stage in (k, k + 1):
            rate = (path[stage + 2] - path[stage]) / (2 * step)
            bend = (path[stage + 2] - 2 * path[stage + 1] + path[stage]) / step**2
            pushed.append(model.drive @ deviations[stage] - bend - model.damping @ rate)
        state = two.A @ state + two.start @ pushed[0] + two.end @ pushed[1]
        cost += ((deviations[k + 1] - deviations[k]) ** 2).sum() / WEIGHTS.change**2
        if k + 1 < len(plan):
            cost += ((lever @ (state[:10] - aim)) ** 2).sum()
            cost += ((deviations[k + 1] - forecast.horizon.rest_force) ** 2).sum() / WEIGHTS.force**2
    left = np.concatenate([state[:10] - aim, state[10:], deviations[-1] - forecast.horizon.rest_force])
    return float(cost + left @ value @ left) / 2


@pytest.mark.parametrize("still", [True, False])
def test_cost_is_the_sum_over_the_stages(short, operating, still):
    """½ vᵀ H v + fᵀ v differs between plans as sums do that are written out naively."""
    (forecast, H), random = forecast_of(operating, short, still=still), np.random.default_rng(6)
    rows = np.full(STAGES + 3, ROW) if still else ROW + 2 * np.arange(-1, STAGES + 2)
    path = (short.levels[rows] - operating.model.levels) @ operating.model.weights.T
    begin = random.normal(size=6)
    f = forecast.gradient(begin)
    np.testing.assert_allclose(H, H.T, rtol=1e-9, atol=1e-9)
    plans = random.normal(size=(5, STAGES, 6))
    condensed = [plan.ravel() @ (H @ plan.ravel() / 2 + f) for plan in plans]
    summed = [written_out(forecast, operating, begin, plan, forecast.horizon.value, path) for plan in plans]
    np.testing.assert_allclose(np.diff(condensed), np.diff(summed), rtol=1e-7)


def riccati(operating: DiscreteModalModel) -> np.ndarray:
    """Value of the problem without limits about a point, by scipy."""
    model, two = operating.model, operating.double_period()
    A, B = np.eye(26), np.vstack([two.end @ model.drive, np.eye(6)])
    A[:20, :20], A[:20, 20:] = two.A, (two.start + two.end) @ model.drive
    cost = np.zeros((26, 26))
    tip, others = model.observe[-3:], model.observe[:-3]
    cost[:10, :10] = tip.T @ tip / WEIGHTS.tip**2 + others.T @ others / WEIGHTS.shape**2
    cost[20:, 20:] = np.eye(6) / WEIGHTS.force**2
    return solve_discrete_are(A, B, cost, np.eye(6) / WEIGHTS.change**2)


def test_value_beyond_the_horizon_converges(short, operating):
    """From the value about a point further on, by a step a period, to that of scipy about the one at which the robot stays."""
    rows = np.full(STAGES + 9, ROW)
    far = DiscreteModalModel.from_modal_model(modal_model(short.equilibria[200], operating.model), short.forces[200], short.period)
    forecast = PredictionModel(WEIGHTS, STAGES)
    forecast.prepare(far, short, rows)
    wanted, off = riccati(operating), []
    for _ in range(200):
        forecast.prepare(operating, short, rows)
        off.append(np.abs(forecast.horizon.value - wanted).max() / np.abs(wanted).max())
    assert off[0] > 1e-3
    assert off[-1] < 1e-6


def test_horizon_does_not_matter_without_limits(short, operating):
    """At a point where the robot stays, the first forces of a plan over 3 stages are those of one over 20."""
    begin, plans = np.linspace(-1, 1, 6), []
    for stages in (3, 20):
        forecast, H = forecast_of(operating, short, stages, still=True)
        plans.append(np.linalg.solve(H, -forecast.gradient(begin))[:18])
    np.testing.assert_allclose(plans[0], plans[1], atol=1e-5)
    assert np.abs(plans[0]).max() > 0.1


def test_forces_at_rest_undo_the_bias(short, operating):
    """The static answer of the tip to `rest_force`, exactly, is minus its bias."""
    forecast = PredictionModel(WEIGHTS, STAGES)
    bias = np.array([2e-3, -1e-3, 3e-3])
    forecast.prepare(operating, short, np.full(STAGES + 9, ROW))
    forecast.horizon.set_initial_state(np.zeros(20), bias)
    assert operating.model.gain[-3:] @ forecast.horizon.rest_force == pytest.approx(-bias)


def sample_at(reference: Reference, row: int, random: np.random.Generator, noise: float = 5e-4) -> Sample:
    """As if the arm were where it shall be."""
    points = reference.equilibria[min(row, len(reference) - 1)].points
    return Sample(reference.period * row, points + noise * random.normal(size=points.shape))


def in_order(command: Command) -> None:
    """Checks that all is finite and within the limits."""
    check_command(command, ROBOT)
    assert np.isfinite(command.tensions).all()


def failing(controller: Mpc, monkeypatch: pytest.MonkeyPatch, ending: Ending, when) -> SimpleNamespace:
    """The quadratic program fails when asked to; counts how often."""
    solve, count = controller._step._program._solver.solve, SimpleNamespace(failed=0)

    def unreliable(*args) -> QpResult:
        if not when():
            return solve(*args)
        count.failed += 1
        return QpResult(outcome=Outcome(ending))

    monkeypatch.setattr(controller._step._program._solver, "solve", unreliable)
    return count


@pytest.mark.parametrize("ending", [Ending.INFEASIBLE, Ending.NOT_FINITE, Ending.ITERATION_LIMIT])
def test_failed_program_goes_on_with_the_last_plan(kang, short, monkeypatch, ending):
    """Shifted by a period, half a stage; counted by its reason; when the program works again, its plan counts again."""
    controller, random = Mpc(kang, short, PYTHON), np.random.default_rng(1)
    for row in range(20):
        controller.command(sample_at(short, row, random))
    assert not controller.fallbacks
    plan = controller.last.plan
    with monkeypatch.context() as broken:
        failing(controller, broken, ending, lambda: True)
        for row in range(20, 25):
            in_order(controller.command(sample_at(short, row, random)))
            plan = (plan + np.vstack([plan[1:], plan[-1:]])) / 2
            np.testing.assert_allclose(controller.last.plan, plan, atol=1e-12)
            assert controller.last.outcome.ending is ending
    assert controller.fallbacks == {ending.value: 5}
    controller.command(sample_at(short, 25, random))
    assert controller.last.outcome.ending is Ending.SOLVED
    assert controller.fallbacks == {ending.value: 5}


def test_first_program_fails(kang, short, monkeypatch):
    """Without any plan yet the tensions stay where they are."""
    controller = Mpc(kang, short, PYTHON)
    failing(controller, monkeypatch, Ending.FAILED, lambda: True)
    first = controller.start().tensions
    for row in range(5):
        command = controller.command(sample_at(short, row, np.random.default_rng(2)))
        np.testing.assert_allclose(command.tensions, first, atol=1e-9)


@pytest.mark.slow
def test_program_that_fails_now_and_then(kang, short, monkeypatch):
    """One of twenty, at random, with half of the points lost or wrong: commands are finite and within the limits, all failures counted."""
    controller, random = Mpc(kang, short, PYTHON), np.random.default_rng(3)
    count = failing(controller, monkeypatch, Ending.INFEASIBLE, lambda: random.random() < 0.05)
    for row in range(120):
        sample = sample_at(short, row, random)
        sample.points[random.random(4) < 0.3] = np.nan
        sample.points[random.random(4) < 0.2] += 0.1
        in_order(controller.command(sample))
    assert count.failed >= 3
    assert sum(controller.fallbacks.values()) == count.failed


def test_late_step_goes_on_with_the_last_plan(kang, short):
    """A program that is not solved in time is not used."""
    controller, random = Mpc(kang, short, MpcSettings(deadline=0.0)), np.random.default_rng(1)
    for row in range(3):
        in_order(controller.command(sample_at(short, row, random)))
    assert controller.fallbacks == {"late": 3}


@pytest.mark.parametrize("part", [0.5, 0.3])
def test_tensions_start_at_their_middle(kang, short, part):
    """Within half a step of the regulators."""
    start = Mpc(kang, short, MpcSettings(mid_range=part)).start()
    assert start.tensions == pytest.approx(np.full(6, 7.0 * part), abs=kang.values["A"] * 4500 / 2 * 1.01)


@pytest.mark.slow
def test_horizon_and_preview_are_settings(kang, short):
    """Plans are as long as the horizon; a preview that is no longer than it is enough."""
    controller = Mpc(kang, short, MpcSettings(stages=8, pressure_planner=PressurePlannerSettings(preview=11)))
    in_order(controller.command(sample_at(short, 0, np.random.default_rng(1))))
    assert controller.last.plan.shape == (8, 6)


def held_off(kang: CompiledModel, short: Reference, settings: MpcSettings, first: int, count: int) -> np.ndarray:
    """Pressures (steps, actuators) in Pa while the arm is pushed 10 mm aside, from a row of the reference on."""
    path = dataclasses.replace(
        short, tips=short.tips[first:], forces=short.forces[first:], equilibria=short.equilibria[first:],
        counted=short.counted[first:], point=short.point[first:],
    )  # fmt: skip
    controller, found = Mpc(kang, path, settings), []
    for row in range(count):
        points = path.equilibria[row].points + np.array([10e-3, 0, 0]) * np.arange(1, 5)[:, None] / 4
        found.append(controller.command(Sample(path.period * row, points)).pressures)
    return np.array(found)


@pytest.mark.parametrize(
    ("row", "quick", "slow"),
    [
        (0, {"disturbance_time": 0.05, "full_feedback_speed": 1e3}, {"disturbance_time": 5.0, "full_feedback_speed": 1e3}),
        (400, {"full_feedback_speed": 0.05}, {"full_feedback_speed": 1e3}),
        (400, {"feedback_time": 0.01}, {"feedback_time": 5.0}),
    ],
)
def test_pressures_take_over_what_goes_on(kang, short, row, quick, slow):
    """A push that stays: pressures move further from those without it the sooner they take over, the more they take part in feedback."""
    moved = {}
    for name, change in (("quick", quick), ("slow", slow)):
        planner = PressurePlannerSettings(quantised=False, **change)
        pressures = [held_off(kang, short, MpcSettings(mid_ranging=on, pressure_planner=planner), row, 25) for on in (True, False)]
        moved[name] = float(np.abs(pressures[0] - pressures[1]).sum())
    assert moved["quick"] > 1.1 * moved["slow"]


@pytest.mark.sample(3)
@pytest.mark.parametrize("use", list(Use))
@pytest.mark.parametrize("seed", range(2))
def test_any_points_make_commands_within_the_limits(kang, short, use, seed):
    """From random states, points of any size, some or all of them lost, measured inputs too, frames left out: for 80 steps."""
    controller, random = Mpc(kang, short, MpcSettings(use=use)), np.random.default_rng(seed)
    check_command(controller.start(), ROBOT)
    row = 0
    for k in range(80):
        row += int(random.integers(1, 4)) if k % 10 == 9 else 1
        sample = sample_at(short, row, random, noise=10 ** random.uniform(-4, 0))
        points = sample.points
        points[random.random(4) < 0.3] = np.nan
        points[:] = np.nan if 40 <= k < 55 else points
        measured = [limit * random.uniform(-0.1, 1.2, 6) for limit in (0.5e6, 7.0)]
        measured[0][random.random(6) < 0.2] = np.nan
        if random.random() < 0.5:
            sample = dataclasses.replace(sample, pressures=measured[0], tensions=measured[1])
        command = controller.command(sample)
        in_order(command)
        assert np.isfinite(controller.last.plan).all()
        if use is Use.PRESSURE:
            assert not command.enabled.any()
            assert not command.tensions.any()
        if use is Use.TENSION:
            assert (command.pressures == controller.start().pressures).all()


def test_blind_from_the_start(kang, short):
    """Without a single point the reference's forces go on, with pressures on the regulators' grid."""
    controller = Mpc(kang, short)
    for row in range(0, 300, 2):
        command = controller.command(Sample(short.period * row, np.full((4, 3), np.nan)))
        in_order(command)
        assert command.pressures / 4500 == pytest.approx(np.round(command.pressures / 4500), abs=1e-6)
    made = kang.values["A"] * command.pressures - command.tensions
    assert made == pytest.approx(short.forces[300], abs=0.7)
    assert np.ptp(short.forces[300]) > 3


def test_loop_on_the_virtual_prototype(short, followed):
    """To the circle and along it for 1.5 s: 1.5 mm over the last second when this was written."""
    assert followed.outcome.ending is Ending.DONE
    assert not followed.fallbacks
    assert len(followed.telemetry) == len(short)
    assert {row.columns["program"] for row in followed.telemetry} == {"solved"}
    assert followed.error() < 2e-3
    commanded = np.array([command.pressures for command in followed.commands])
    assert (np.diff(commanded, axis=0) != 0).sum() < 0.2 * commanded.size


def test_results_say_in_one_line_what_they_are(kang, short, followed):
    """How it ended first, no arrays; a closed loop is a table in notebooks."""
    controller = Mpc(kang, short)
    controller.command(sample_at(short, 0, np.random.default_rng(1)))
    assert repr(short) == "Reference(4.49 s, 450 periods, counted=100, targets=1)"
    assert repr(followed) == "LoopRecord(done, samples=450, until=4.49 s)"
    assert repr(controller).startswith(f"Mpc(kang2017 in {'C' if controller.is_c else 'Python'}, Reference(")
    assert repr(controller.last).startswith("Step(solved, period=0, moves=")
    assert repr(controller.last.estimate).startswith("StateEstimate(tip=(")
    loop = ClosedLoop.from_record(followed, kang, LoopSetup(rig="sim <one>"))
    assert repr(loop).startswith("ClosedLoop(done, MPC on sim <one>, 4.49 of 4.49 s, true ")
    assert len(repr(loop)) < 120
    table = loop._repr_html_()
    assert "<th>controller</th><td>MPC</td>" in table
    assert "sim &lt;one&gt;" in table
    assert f"{1e3 * followed.error():.3g} mm rms" in table


@pytest.mark.parametrize(("probability", "refused"), [(1e-6, [2]), (0.0, [])])
def test_the_filter_takes_its_settings(kang, short, probability, refused):
    """A point far off is an outlier unless nothing is too improbable."""
    sample = sample_at(short, 0, np.random.default_rng(1))
    sample.points[2] += 0.3
    controller = Mpc(kang, short, MpcSettings(filter=FilterSettings(gate_probability=probability)))
    controller.command(sample)
    assert np.flatnonzero(controller.last.estimate.refused).tolist() == refused


@pytest.mark.slow
def test_friction_of_the_model_is_where_the_filter_starts_and_nothing_else(kang, short):
    """0.03 N and a quarter of the tension are 0.9 N at the middle; nothing is foreseen of it by reversals of commands."""
    known = compile_model(kang.model.with_effect("tendon_friction", constant=0.03, share=0.25))
    controller = Mpc(known, short, PYTHON)
    sample = sample_at(short, 0, np.random.default_rng(1))
    sample.points[:] = np.nan  # nothing is learned
    controller.command(sample)
    assert controller.last.estimate.friction == pytest.approx(np.full(6, 0.03 + 0.25 * 3.5))
    for row in range(1, 40):
        sample = sample_at(short, row, np.random.default_rng(1))
        controller.command(sample)
    assert not controller._step._state.effects.forces.any()
    nothing = compile_model(kang.model.with_effect("tendon_friction", constant=0.0, share=0.0))
    assert Mpc(nothing, short).setup.filter == FilterSettings()


@pytest.mark.slow
def test_hysteresis_of_the_model_is_where_the_filter_starts_and_nothing_else(kang, short):
    """Half of it, 10 kPa on the way up and 5 kPa on the way down, by the area; no force of it is held over the horizon."""
    known = compile_model(kang.model.with_effect("pressure_hysteresis", width=1e4, distance=5e3, falling_ratio=0.5))
    controller = Mpc(known, short)
    half = 7.5e3 * known.values["A"]
    assert controller.setup.filter == dataclasses.replace(FilterSettings(), hysteresis=half, hysteresis_std=half / 2)
    assert not controller.setup.effects.forces.any()
    sample = sample_at(short, 0, np.random.default_rng(1))
    sample.points[:] = np.nan  # nothing is learned
    controller.command(sample)
    assert controller.last.estimate.hysteresis == pytest.approx(np.full(6, half))
    driven = Mpc(known, short, PYTHON)
    for row in range(40):
        driven.command(sample_at(short, row, np.random.default_rng(1)))
    assert not driven._step._state.effects.forces.any()


@pytest.mark.slow
def test_a_model_that_knows_the_friction_steers_no_worse():
    """As the library's effect was fitted to a prototype with nothing but that, two noises: 0.82 mm without it and 0.79 when written."""
    file = alone(("tendon_friction",))
    known = Model.from_robot(ROBOT).with_effect("tendon_friction", constant=0.0218, share=0.267, released=1.0, distance=4.06)
    without, knowing = (error(file, compile_model(model), (31, 32)) for model in (Model.from_robot(ROBOT), known))
    assert knowing <= 1.05 * without
    assert without < 1.2


def test_pressures_are_planned_over_the_whole_horizon() -> None:
    with pytest.raises(InputError, match=r"pressure_planner.preview: 13 stages; valid: at least the 15 of the horizon"):
        MpcSettings(pressure_planner=PressurePlannerSettings(preview=13))
