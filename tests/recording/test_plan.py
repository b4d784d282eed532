"""Plans: what the patterns stand for, and one line for everything that can be wrong in a plan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.setpoints import SetPoints, write_setpoints
from tepm_opt.errors import InputError
from tepm_opt.models.robot import load_robot, robot_text
from tepm_opt.recording.plan import Plan, PlannedRun, read_plan
from tests.data.made import ACTUATORS
from tests.recording.fake_rig import RAMP, STEPS, SWEEP, plan_text, write_plan

EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "plan.toml"


def only(folder: Path, run: str) -> PlannedRun:
    return read_plan(write_plan(folder, run)).runs[0]


def at(setpoints: SetPoints, time: float) -> np.ndarray:
    return np.array([np.interp(time, setpoints.time, column) for column in setpoints.inputs.T])


def test_every_run_starts_steady_and_returns_to_rest(tmp_path: Path) -> None:
    for run in read_plan(write_plan(tmp_path)).runs:
        points = run.setpoints
        assert points.time[0] == 0
        assert np.all(np.diff(points.time) > 0)
        np.testing.assert_array_equal(at(points, 0.99), points.inputs[0])
        np.testing.assert_allclose(points.inputs[-1], points.inputs[0])


def test_steps(tmp_path: Path) -> None:
    points = only(tmp_path, STEPS).setpoints
    rest = np.repeat([1e5, 0.0], 6)
    first, second = rest.copy(), rest.copy()
    first[0], second[8] = 2e5, 3.0
    for time, value in ((1.0, rest), (1.02, first), (2.02, first), (2.04, second), (3.04, second), (3.06, rest), (4.06, rest)):
        np.testing.assert_allclose(at(points, time), value)
    assert points.time[-1] == pytest.approx(4.06)


def test_ramp_by_module(tmp_path: Path) -> None:
    points = only(tmp_path, RAMP).setpoints
    np.testing.assert_allclose(at(points, 2.0), [2e5] * 3 + [0] * 8 + [2])
    np.testing.assert_allclose(at(points, 1.5), [1e5] * 3 + [0] * 8 + [1])


def test_the_narrower_key_wins(tmp_path: Path) -> None:
    rest = "{pressure_12_Pa = 3, pressure_Pa = 1, pressure_1_Pa = 2, tension_2_N = 4}"
    run = f'file = "h.csv"\nrole = "fit"\npattern = "hold"\nduration_s = 2\nrest = {rest}'
    points = only(tmp_path, run).setpoints
    np.testing.assert_array_equal(points.inputs[-1], [2, 3, 2, 1, 1, 1, 0, 0, 0, 4, 4, 4])
    assert points.time[-1] == 3.0


def test_sweep_runs_through_its_frequencies(tmp_path: Path) -> None:
    run = SWEEP.replace("duration_s = 3", "duration_s = 40").replace("from_hz = 0.5", "from_hz = 0.25\nto_hz = 4")
    points = only(tmp_path, run).setpoints
    wave = (points.inputs[:, 1] - 1e5) / 5e4
    assert np.abs(wave).max() == pytest.approx(1.0, abs=0.01)
    assert np.ptp(points.inputs[:, 0]) == 0
    crossings = points.time[1:-1][np.diff(np.sign(wave[1:-1]), append=0) != 0] - 1.0
    for low, high, hertz in ((8, 12, 0.25 * 16**0.25), (28, 32, 0.25 * 16**0.75)):  # as many periods in every octave
        found = np.sum((crossings > low) & (crossings < high)) / (high - low) / 2
        assert found == pytest.approx(hertz, rel=0.2)


def test_circle_of_pressures(tmp_path: Path) -> None:
    run = (
        'file = "c.csv"\nrole = "fit"\npattern = "circle"\nrest = {pressure_Pa = 1.5e5}\namplitude_Pa = 1e5\n'
        "period_s = 4\nturns = 3\nmodules = [2]"
    )
    points = only(tmp_path, run).setpoints
    assert np.ptp(points.inputs[:, :3]) == 0
    angles = np.deg2rad([90, 210, 330])
    for time in (5.0, 6.3, 8.9):
        np.testing.assert_allclose(at(points, time)[3:6], 1.5e5 + 1e5 * np.cos(2 * np.pi * (time - 1) / 4 - angles), atol=300)
    np.testing.assert_allclose(points.inputs[:, 3:6].sum(axis=1), 4.5e5)


def test_known_force_and_file(tmp_path: Path) -> None:
    time = np.array([2.0, 3.0, 4.0])
    force = np.array([[0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]])
    write_setpoints(tmp_path / "in.csv", SetPoints(time, np.full((3, 12), 1.5), force), ACTUATORS)
    points = only(tmp_path, 'file = "f.csv"\nrole = "fit"\ninputs = "in.csv"\nlead_s = 0.5').setpoints
    np.testing.assert_array_equal(points.time, [0, 0.5, 1.5, 2.5])
    np.testing.assert_array_equal(points.tip_force, force[[0, 0, 1, 2]])
    loaded = only(tmp_path, f"{RAMP}\ntip_force_N = [0, 0, -0.5]").setpoints
    assert (loaded.tip_force == [0, 0, -0.5]).all()


def test_a_robot_beside_the_plan(tmp_path: Path) -> None:
    text = robot_text("kang2017").replace('name = "kang2017"', 'name = "small"').replace("modules = 2", "modules = 1")
    (tmp_path / "small.toml").write_text(text)
    path = tmp_path / "plan.toml"
    path.write_text('robot = "small.toml"\n' + plan_text(RAMP.replace("tension_23_N", "tension_13_N")))
    plan = read_plan(path)
    assert plan.robot.name == "small"
    assert plan.runs[0].setpoints.inputs.shape[1] == 6
    path.write_text('robot = "small.toml"\n' + plan_text(RAMP))
    with pytest.raises(InputError, match="unknown input 'tension_23_N'"):
        read_plan(path)


def test_fingerprints_change_with_what_would_be_recorded(tmp_path: Path) -> None:
    robot = load_robot("kang2017")
    runs = [only(tmp_path, text) for text in (STEPS, STEPS, STEPS.replace("hold_s = 1", "hold_s = 2"), STEPS.replace("fit", "validation"))]
    prints = [run.fingerprint(robot, 50.0) for run in runs]
    assert prints[0] == prints[1] == prints[3] != prints[2]
    assert runs[0].fingerprint(robot, 100.0) != prints[0]


def test_the_example_of_the_documentation() -> None:
    plan = read_plan(EXAMPLE)
    assert {run.role for run in plan.runs} == {"fit", "validation"}
    assert len(plan.runs) >= 5


WRONG = {
    "no runs": ('name = "x"\nruns = []', "runs = []: list should have at least 1 item"),
    "unknown key": (plan_text(RAMP).replace("sample_rate_hz", "rate"), "unknown key 'rate'"),
    "neither pattern nor file": (
        plan_text('file = "a.csv"\nrole = "fit"'),
        "runs entry 1: valid: either pattern = one of hold, steps, ramp, sweep, circle",
    ),
    "unknown pattern": (plan_text(RAMP.replace('"ramp"', '"rampe"')), "runs entry 1: unknown pattern 'rampe': did you mean 'ramp'?"),
    "unknown option": (plan_text(RAMP.replace("rise_s", "raise_s")), "runs entry 1: unknown key 'raise_s': did you mean 'rise_s'?"),
    "missing option": (plan_text(RAMP.replace("to = {pressure_1_Pa = 2e5, tension_23_N = 2}\n", "")), "runs entry 1: missing key 'to'"),
    "wrong role": (plan_text(RAMP.replace("validation", "test")), "runs entry 1: unknown role 'test'"),
    "unknown input": (
        plan_text(RAMP.replace("tension_23_N", "tension_33_N")),
        "(ramp.csv): to: unknown input 'tension_33_N': did you mean",
    ),
    "beyond the limits": (plan_text(RAMP.replace("2e5", "6e5")), "pressure_11_Pa = 600000 at 2 s; valid: 0 … 500000"),
    "below zero": (plan_text(SWEEP.replace("5e4", "2e5")), "pressure_12_Pa = -"),
    "too fast": (plan_text(SWEEP + "\nto_hz = 20"), "20 Hz; valid: up to 12.5 Hz"),
    "a path as a name": (plan_text(RAMP.replace("ramp.csv", "../ramp.csv")), "a plain file name ending in .csv"),
    "a name twice": (plan_text(RAMP, STEPS.replace("steps.csv", "RAMP.csv")), "the file 'ramp.csv' is named twice"),
    "missing file": (plan_text('file = "a.csv"\nrole = "fit"\ninputs = "none.csv"'), "none.csv: cannot be read"),
    "no TOML": ("runs", "not valid TOML"),
    "no such module": (
        plan_text('file = "c.csv"\nrole = "fit"\npattern = "circle"\namplitude_Pa = 1\nmodules = [3]'),
        "modules = [3]; valid: 1 … 2",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_one_clear_line(tmp_path: Path, name: str) -> None:
    text, message = WRONG[name]
    path = tmp_path / "plan.toml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_plan(path)
    assert message in str(error.value)
    assert str(tmp_path) in str(error.value) or name == "a name twice"
    assert "\n" not in str(error.value)


def test_plans_can_be_made_without_files() -> None:
    setpoints = SetPoints(np.array([0.0, 2.0]), np.zeros((2, 12)), np.zeros((2, 3)))
    plan = Plan("mine", load_robot("kang2017"), "kang2017", 50.0, None, (PlannedRun("a.csv", "fit", setpoints),))
    assert plan.runs[0].file == "a.csv"
