"""Plans: what the patterns stand for, and one line for everything that can be wrong in a plan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.setpoints import SetPoints, write_setpoints
from tepm_opt.errors import InputError
from tepm_opt.models.robot import load_robot, robot_text
from tepm_opt.recording.plan import PlannedRun, RecordingPlan, read_plan
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
    run = f'file = "h.csv"\nrole = "fit"\npattern = "steps"\nlevels = [{{}}]\nhold_s = 2\nrest = {rest}\nrest_s = 0'
    points = only(tmp_path, run).setpoints
    np.testing.assert_array_equal(points.inputs[-1], [2, 3, 2, 1, 1, 1, 0, 0, 0, 4, 4, 4])
    assert points.time[-1] == pytest.approx(3.06)


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


def test_triangles_repeated(tmp_path: Path) -> None:
    run = RAMP.replace("hold_s = 0.5", "hold_s = 0") + "\nrepeats = 3"
    points = only(tmp_path, run).setpoints
    for k in range(3):
        begin = 1 + 2.5 * k
        found = [at(points, begin + time)[0] for time in (0, 0.5, 1, 1.5, 2, 2.4)]
        np.testing.assert_allclose(found, [0, 1e5, 2e5, 1e5, 0, 0], atol=1)
    assert points.time[-1] == pytest.approx(8.5)


def test_knots_stand_on_the_grid_of_the_samples(tmp_path: Path) -> None:
    """So that rows, linear between samples, say exactly what was commanded."""
    run = STEPS.replace("hold_s = 1", "hold_s = 0.333\nrise_s = 0.117") + "\nlead_s = 0.77"
    time = only(tmp_path, run).setpoints.time * 50
    np.testing.assert_allclose(time, np.round(time), atol=1e-9)
    np.testing.assert_array_equal(np.round(np.diff(time)), [38, 6, 17, 6, 17, 6, 50])


def test_sweeps_one_after_another(tmp_path: Path) -> None:
    run = SWEEP.replace("}]", "}, {pressure_21_Pa = 4e4, pressure_22_Pa = -4e4}]").replace("from_hz = 0.5", "from_hz = 1\nto_hz = 1")
    points = only(tmp_path, run).setpoints
    first, second = (np.array([at(points, begin + time) for time in np.arange(0, 3, 0.02)]) - points.inputs[0] for begin in (1, 4))
    assert np.flatnonzero(np.ptp(first, axis=0)).tolist() == [1]
    assert np.flatnonzero(np.ptp(second, axis=0)).tolist() == [3, 4]
    np.testing.assert_allclose(second[:, 3], -second[:, 4])
    np.testing.assert_allclose(first[30:120, 1], 5e4 * np.sin(2 * np.pi * np.arange(0.6, 2.4, 0.02)), atol=1)  # a plain sine


RANDOM = (
    'file = "r.csv"\nrole = "fit"\npattern = "random"\nrest = {pressure_Pa = 1e5}\n'
    "low = {pressure_Pa = 0.5e5}\nhigh = {pressure_Pa = 2e5, tension_2_N = 3, tip_force_x_N = 0.5}\ncount = 40\nhold_s = 0.5\nrise_s = 0.1"
)


def test_random_levels(tmp_path: Path) -> None:
    points = only(tmp_path, RANDOM).setpoints
    levels = points.inputs[2:-2:2]
    np.testing.assert_array_equal(levels, points.inputs[3:-2:2])
    assert levels.shape == (40, 12)
    assert np.all((levels[:, :6] >= 0.5e5) & (levels[:, :6] <= 2e5))
    assert np.all((levels[:, 9:] >= 0) & (levels[:, 9:] <= 3))
    assert not levels[:, 6:9].any()
    assert np.all(np.ptp(levels, axis=0)[[0, 1, 2, 3, 4, 5]] > 1.2e5)
    moved = levels[:, [0, 1, 2, 3, 4, 5, 9, 10, 11]]
    assert np.linalg.cond(np.corrcoef(moved.T)) < 10, "no input like another"
    assert np.ptp(points.tip_force[:, 0]) > 0.3
    assert not points.tip_force[[0, -1]].any()


def test_what_random_levels_depend_on(tmp_path: Path) -> None:
    texts = (RANDOM, RANDOM.replace('"fit"', '"validation"'), f"{RANDOM}\nseed = 1", RANDOM.replace("r.csv", "s.csv"))
    found = [only(tmp_path, text).setpoints.inputs for text in texts]
    np.testing.assert_array_equal(found[0], found[1])
    for other in found[2:]:
        assert not np.any(found[0][2:-2] == other[2:-2], axis=0)[:6].any()


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
    write_setpoints(tmp_path / "in.csv", SetPoints(time, np.repeat([1.5e4, 1.5], 6) * np.ones((3, 1)), force), ACTUATORS)
    points = only(tmp_path, 'file = "f.csv"\nrole = "fit"\ninputs = "in.csv"\nlead_s = 0.5').setpoints
    np.testing.assert_array_equal(points.time, [0, 0.5, 1.5, 2.5])
    np.testing.assert_array_equal(points.tip_force, force[[0, 0, 1, 2]])
    loaded = only(tmp_path, f"{RAMP}\nrest = {{tip_force_z_N = -0.5}}").setpoints
    assert (loaded.tip_force == [0, 0, -0.5]).all()
    pushed = only(tmp_path, RAMP.replace("tension_23_N", "tip_force_x_N")).setpoints
    np.testing.assert_allclose([np.interp(time, pushed.time, pushed.tip_force[:, 0]) for time in (1.0, 1.5, 2.3, 3.0)], [0, 1, 2, 1])


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


class TestExample:
    """`docs/plan.toml` has what identification needs."""

    plan = read_plan(EXAMPLE)

    def of(self, role: str) -> list[SetPoints]:
        return [run.setpoints for run in self.plan.runs if run.role == role]

    @pytest.mark.parametrize("role", ["fit", "validation"])
    def test_every_input_moves(self, role: str) -> None:
        moved = np.max([np.ptp(points.inputs, axis=0) for points in self.of(role)], axis=0)
        assert np.all(moved[:6] >= 0.15 * 5e5)
        assert np.all(moved[6:] >= 0.15 * 7)

    def test_inputs_can_be_told_apart(self) -> None:
        """Each input varies within the runs by at least 3 % of its range (RMS) in a way that no combination of the others follows."""
        dense = [np.array([at(points, time) for time in np.arange(0, points.time[-1], 0.1)]) for points in self.of("fit")]
        varied = np.vstack([inputs - inputs.mean(axis=0) for inputs in dense]) / np.repeat([5e5, 7.0], 6)
        assert np.all(1 / np.sqrt(np.diag(np.linalg.inv(np.cov(varied.T)))) > 0.03)

    def test_every_input_turns_back(self) -> None:
        """Directions against which friction and hysteresis show: each input moves alone, up and down again."""
        for k in range(12):
            alone = [points.inputs for points in self.of("fit") if np.ptp(points.inputs[:, k]) > 0]
            steps = np.vstack([np.diff(inputs, axis=0) for inputs in alone])
            single = steps[(steps[:, k] != 0) & (np.count_nonzero(steps, axis=1) == 1), k]
            assert (single > 0).any(), k
            assert (single < 0).any(), k

    def test_loads_and_a_range_of_stretch(self) -> None:
        forces = np.array([points.tip_force[0] for points in self.of("fit")])
        assert len(np.unique(forces, axis=0)) >= 3
        assert max(points.inputs[:, :6].min(axis=1).max() for points in self.of("fit")) >= 0.6 * 5e5

    def test_a_real_rig_can_record_it(self) -> None:
        """Nothing pushes a robot's tip while a run goes on; between runs a person hangs a weight."""
        assert all(np.ptp(run.setpoints.tip_force, axis=0).max() == 0 for run in self.plan.runs)
        assert sum(run.setpoints.time[-1] for run in self.plan.runs) < 330


WRONG = {
    "no runs": ('name = "x"\nruns = []', "runs = []: list should have at least 1 item"),
    "unknown key": (plan_text(RAMP).replace("sample_rate_hz", "rate"), "unknown key 'rate'"),
    "neither pattern nor file": (
        plan_text('file = "a.csv"\nrole = "fit"'),
        "runs entry 1: valid: either pattern = one of steps, random, sweep, circle",
    ),
    "unknown pattern": (plan_text(RAMP.replace('"steps"', '"stepps"')), "runs entry 1: unknown pattern 'stepps': did you mean 'steps'?"),
    "unknown option": (plan_text(RAMP.replace("rise_s", "raise_s")), "runs entry 1: unknown key 'raise_s': did you mean 'rise_s'?"),
    "missing option": (plan_text(SWEEP.replace("amplitudes = [{pressure_12_Pa = 5e4}]\n", "")), "runs entry 1: missing key 'amplitudes'"),
    "wrong role": (plan_text(RAMP.replace("validation", "test")), "runs entry 1: unknown role 'test'"),
    "unknown input": (
        plan_text(RAMP.replace("tension_23_N", "tension_33_N")),
        "(ramp.csv): levels entry 1: unknown input 'tension_33_N': did you mean",
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
    plan = RecordingPlan("mine", load_robot("kang2017"), "kang2017", 50.0, None, (PlannedRun("a.csv", "fit", setpoints),))
    assert plan.runs[0].file == "a.csv"
