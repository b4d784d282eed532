"""The standard plan: for every robot, within its limits, with what the example in docs says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.jobs.excite import Standard, standard
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.model import Model
from tepm_opt.models.robot import load_robot
from tepm_opt.recording.patterns import PatternContext
from tepm_opt.recording.plan import read_plan
from tepm_opt.recording.probing import draw_pattern, random_run, vary_pattern
from tepm_opt.recording.reach import BEND, Reach, reach_of, unbearable
from tepm_opt.recording.standard import plan_text, sample_rate, standard_runs, wiring_runs
from tepm_opt.solvers.mechanics.statics import solve_statics

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def reach(kang: CompiledModel) -> Reach:
    return reach_of(kang)


@pytest.fixture(scope="module")
def found() -> Standard:
    return standard(Model.from_robot("kang2017"))


def test_the_example_in_docs_is_what_is_written(found: Standard) -> None:
    assert found.text(DOCS) == (DOCS / "plan.toml").read_text(encoding="utf-8")
    assert found.share == 1.0


def test_the_text_reads_back_as_the_plan(found: Standard, tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(found.text(tmp_path), encoding="utf-8")
    again = read_plan(path)
    assert [run.fingerprint(again.robot, 50.0) for run in again.runs] == [run.fingerprint(again.robot, 50.0) for run in found.plan.runs]


def test_levels_move_the_tip_as_far_as_wanted(kang: CompiledModel, reach: Reach) -> None:
    inputs = np.zeros(12)
    rest = solve_statics(kang, inputs).tip
    inputs[0] = reach.alone[0]
    assert np.linalg.norm(solve_statics(kang, inputs).tip - rest) == pytest.approx(BEND * 0.4, rel=0.02)
    assert reach.alone[1] == pytest.approx(0.36 * 5e5)  # would have to be more than the limit allows
    assert reach.sway == pytest.approx(0.8, abs=0.05)


def test_levels_shrink_with_the_share(reach: Reach) -> None:
    robot = load_robot("kang2017")
    whole, half = (standard_runs(robot, reach, share) for share in (1.0, 0.5))
    setup = PatternContext(robot, 50.0, Path(), "here")
    tops = [[run.pattern.setpoints(setup).inputs.max() for run in runs] for runs in (whole, half)]
    assert np.all(np.array(tops[1]) < 0.7 * np.array(tops[0]))


def test_the_wiring_plan_moves_every_input_alone(reach: Reach) -> None:
    """Above rest, which is none or equal pressures, one input at a time, each of them, in half a minute a run."""
    robot = load_robot("kang2017")
    setup = PatternContext(robot, 50.0, Path(), "here")
    courses = [run.pattern.setpoints(setup) for run in wiring_runs(robot, reach)]
    moved = [course.inputs > course.inputs.min(axis=0) + 1e-9 for course in courses]
    assert all(np.all(each.sum(axis=1) <= 1) for each in (moved[0], moved[1][:, 6:]))
    assert np.all(np.any(np.concatenate(moved), axis=0))
    assert all(course.time[-1] <= 32 for course in courses)


@pytest.mark.slow
def test_a_robot_on_a_guide_has_a_plan_without_a_pulley(tmp_path: Path) -> None:
    model = Model.from_robot(DOCS / "one_axis.toml")
    plan = standard(model).plan
    assert {"weight.csv", "single_pressure.csv"} <= {run.file for run in plan.runs}
    assert "side_load.csv" not in {run.file for run in plan.runs}
    assert all(run.setpoints.inputs.max(axis=0)[:3].max() <= 5e5 for run in plan.runs)


def test_a_robot_that_does_not_stand_is_refused() -> None:
    robot = load_robot("kang2017")
    heavy = robot.model_copy(update={"parameters": robot.parameters.model_copy(update={"m_d": 1.0})})
    with pytest.raises(InputError, match=r"robot kang2017: it has no stable equilibrium without inputs"):
        standard(Model(heavy, source="kang2017"))


def test_rates_are_parts_of_the_trackers() -> None:
    robot = load_robot("kang2017")
    for rate, expected in ((100.0, 50.0), (50.0, 50.0), (40.0, 40.0), (120.0, 40.0), (240.0, 48.0)):
        other = robot.model_copy(update={"tracker": robot.tracker.model_copy(update={"rate_Hz": rate})})
        assert sample_rate(other) == pytest.approx(expected)


def test_what_a_model_does_not_bear_is_told(kang: CompiledModel) -> None:
    rest = np.zeros((2, 12))
    assert unbearable(kang, SetPoints(np.array([0.0, 1.0]), rest, np.zeros((2, 3)))) == ""
    assert "limits" in unbearable(kang, SetPoints(np.array([0.0, 1.0]), rest + 1e6, np.zeros((2, 3))))
    pressed = np.tile([0.0, 0.0, -60.0], (2, 1))
    assert unbearable(kang, SetPoints(np.array([0.0, 1.0]), rest, pressed)) != ""


def test_drawn_runs_have_the_length_and_are_the_same_again(reach: Reach, tmp_path: Path) -> None:
    robot = load_robot("kang2017")
    setup, kinds, within = PatternContext(robot, 50.0, Path(), "here"), set[str](), 0
    for seed in range(30):
        one, again = (draw_pattern(np.random.default_rng(seed), robot, reach, 30.0) for _ in range(2))
        assert one == again
        kinds.add(type(one).__name__)
        try:
            lasts = one.setpoints(setup).time[-1]
        except InputError:  # beyond the limits: another one is drawn
            continue
        within += 1
        assert lasts == pytest.approx(30.0, rel=0.05)
    assert kinds == {"Steps", "Sweep", "Random", "Circle"}
    assert within >= 20


def test_varied_runs_stay_near_and_as_long(reach: Reach) -> None:
    robot = load_robot("kang2017")
    setup = PatternContext(robot, 50.0, Path(), "here")
    random = np.random.default_rng(1)
    base = random_run(random, reach, 30.0)
    other = vary_pattern(random, base)
    assert other is not None
    assert other != base
    assert other.setpoints(setup).time[-1] == pytest.approx(base.setpoints(setup).time[-1], rel=0.05)
    assert draw_pattern(random, robot, reach, 30.0, loads=False).rest.keys() <= {"pressure_Pa"}


def test_plan_texts_hold_noise_and_large_and_small_numbers(reach: Reach, tmp_path: Path) -> None:
    run = standard_runs(load_robot("kang2017"), reach)[0]
    (tmp_path / "p.toml").write_text(plan_text("x", "kang2017", 100 / 3, [run], ["first"], 3e-4), encoding="utf-8")
    plan = read_plan(tmp_path / "p.toml")
    assert (plan.position_noise, plan.name) == (3e-4, "x")
    assert plan.sample_rate == pytest.approx(100 / 3, rel=1e-5)
