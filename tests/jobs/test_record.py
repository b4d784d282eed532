"""Recording: what is stored, what is kept, what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.cli.rigs import opener
from tepm_opt.data.datasets import read_dataset, read_description, write_dataset
from tepm_opt.data.run import read_run
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Rig
from tepm_opt.jobs.record import RecordResult, RigSource, record, seed_of
from tepm_opt.models.channels import check, open_dataset
from tepm_opt.models.robot import robot_text
from tepm_opt.recording.plan import read_plan
from tests.data.made import make_dataset
from tests.paths import reference
from tests.recording.fake_rig import RAMP, ROBOT, STEPS, SWEEP, FakeRig, plan_text, write_plan


class Bench:
    """Opens fake rigs, keeps them, and prepares the n-th one."""

    def __init__(self) -> None:
        self.rigs: list[FakeRig] = []
        self.prepare = lambda number, rig: None

    def __call__(self, seed: int) -> Rig:
        rig = FakeRig(seed)
        self.prepare(len(self.rigs), rig)
        self.rigs.append(rig)
        return rig


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set of the plan, recorded in one go. Read only."""
    folder = tmp_path_factory.mktemp("undisturbed")
    go(folder, Bench())
    return folder / "set"


def go(folder: Path, bench: Bench, *runs: str, seed: int = 0, rig: str = "fake") -> RecordResult:
    return record(read_plan(write_plan(folder, *runs)), folder / "set", RigSource(rig, bench), seed)


@pytest.mark.slow
def test_what_is_recorded(tmp_path: Path, bench: Bench) -> None:
    done = go(tmp_path, bench)
    assert (done.done, done.kept, dict(done.notes)) == (("steps.csv", "ramp.csv", "sweep.csv"), (), {})
    dataset = open_dataset(tmp_path / "set")
    assert [(run.file, run.role, run.rows) for run in dataset.runs] == [
        ("steps.csv", "fit", 204), ("ramp.csv", "validation", 201), ("sweep.csv", "fit", 301),
    ]  # fmt: skip
    run = dataset.runs[0]
    np.testing.assert_allclose(run.time, np.arange(204) / 50, atol=1e-9)
    assert run.inputs[50, 0] == pytest.approx(1e5)
    assert run.inputs[51, 0] == pytest.approx(2e5)
    assert list(run.extra) == [*(f"pressure_{name}_measured_Pa" for name in dataset.channels.actuators), "supply_Pa"]
    assert abs(run.extra["pressure_11_measured_Pa"][95] - 2e5) < 1e3
    assert check(tmp_path / "set") == []
    assert sorted(path.name for path in (tmp_path / "set").iterdir()) == [
        "dataset.toml", "ramp.csv", "recording.json", "steps.csv", "sweep.csv",
    ]  # fmt: skip
    assert all(rig.stops >= 1 for rig in bench.rigs)
    assert not any(rig.commanded.any() for rig in bench.rigs)


@pytest.mark.slow
def test_progress_says_which_run_of_how_many(tmp_path: Path, bench: Bench) -> None:
    told: dict[str, None] = {}
    plan = read_plan(write_plan(tmp_path, STEPS, RAMP))
    record(plan, tmp_path / "set", RigSource("fake", bench), progress=lambda stage, done, of: told.setdefault(stage))
    assert "steps.csv (1 of 2): recording" in told
    assert "ramp.csv (2 of 2): recording" in told


@pytest.mark.slow
def test_the_seed_makes_the_noise(tmp_path: Path, bench: Bench) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        (tmp_path / name).mkdir()
        go(tmp_path / name, bench, RAMP, seed=seed)
    files = [(tmp_path / name / "set" / "ramp.csv").read_bytes() for name in "abc"]
    assert files[0] == files[1] != files[2]
    assert len({seed_of(seed, file) for seed in range(3) for file in ("a.csv", "b.csv")}) == 6


def test_what_the_rig_says_is_kept(tmp_path: Path, bench: Bench) -> None:
    bench.prepare = lambda number, rig: rig.lose.update(dict.fromkeys(range(700, 710), 2))
    done = go(tmp_path, bench, STEPS)
    run = read_dataset(tmp_path / "set").runs[0]
    lost = np.isnan(run.points[:, 2]).all(axis=1)
    assert 4 <= lost.sum() <= 6
    assert set(run.extra["status"][lost]) == {"lost s3, see log"}
    assert set(run.extra["status"][~lost]) == {"ok"}
    assert "with a status, the first: lost s3" in done.notes["steps.csv"][0]


class TestInterrupted:
    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("tick", "error"),
        [(3, KeyboardInterrupt()), (250, RuntimeError("line dead")), (600, KeyboardInterrupt()), (850, RuntimeError("again"))],
    )
    def test_going_on_gives_the_same(self, tmp_path: Path, bench: Bench, tick: int, error: BaseException, undisturbed: Path) -> None:
        def prepare(number: int, rig: FakeRig) -> None:
            if number == 1:
                rig.fail_at[tick] = error

        bench.prepare = prepare
        with pytest.raises(type(error)):
            go(tmp_path, bench)
        assert [rig.stops > 0 for rig in bench.rigs] == [True, True]
        assert not bench.rigs[1].commanded.any()
        assert [run.file for run in read_dataset(tmp_path / "set").runs] == ["steps.csv"]
        left = list((tmp_path / "set" / "unfinished").glob("*"))
        whole = read_run(undisturbed / "ramp.csv")
        if tick >= 600:
            run = read_run(left[0])
            assert left[0].name == "ramp-1.unfinished.csv"
            assert run.rows > 20
            np.testing.assert_array_equal(run.points, whole.points[: run.rows])
        done = go(tmp_path, bench)
        assert (done.done, done.kept) == (("ramp.csv", "sweep.csv"), ("steps.csv",))
        for file in ("dataset.toml", "steps.csv", "ramp.csv", "sweep.csv"):
            assert (tmp_path / "set" / file).read_bytes() == (undisturbed / file).read_bytes()
        assert [path.name for path in (tmp_path / "set").glob("unfinished/*")] == [path.name for path in left if tick >= 600]

    @pytest.mark.slow
    def test_attempts_are_all_kept(self, tmp_path: Path, bench: Bench) -> None:
        def prepare(number: int, rig: FakeRig) -> None:
            if number < 3:
                rig.fail_at[600 + 50 * number] = KeyboardInterrupt()

        bench.prepare = prepare
        for _ in range(3):
            with pytest.raises(KeyboardInterrupt):
                go(tmp_path, bench)
        names = [f"steps-{k}.unfinished.csv" for k in (1, 2, 3)]
        assert sorted(path.name for path in (tmp_path / "set" / "unfinished").iterdir()) == names
        go(tmp_path, bench)
        assert sorted(path.name for path in (tmp_path / "set" / "unfinished").iterdir()) == names
        assert check(tmp_path / "set") == []

    @pytest.mark.slow
    def test_nothing_is_done_twice(self, tmp_path: Path, bench: Bench) -> None:
        go(tmp_path, bench)
        before = {path: path.stat().st_mtime_ns for path in (tmp_path / "set").iterdir()}
        done = go(tmp_path, bench)
        assert (done.done, len(done.kept), len(bench.rigs)) == ((), 3, 3)
        assert {path: path.stat().st_mtime_ns for path in (tmp_path / "set").iterdir()} == before


class TestChangedPlans:
    @pytest.mark.slow
    def test_more_runs_and_other_roles(self, tmp_path: Path, bench: Bench) -> None:
        go(tmp_path, bench, STEPS, RAMP)
        done = go(tmp_path, bench, SWEEP, STEPS.replace("fit", "validation"), RAMP)
        assert (done.done, done.kept) == (("sweep.csv",), ("steps.csv", "ramp.csv"))
        entries = [(entry.file, entry.role) for entry in read_description(tmp_path / "set").runs]
        assert entries == [("sweep.csv", "fit"), ("steps.csv", "validation"), ("ramp.csv", "validation")]

    @pytest.mark.parametrize(
        ("runs", "options", "message"),
        [
            ((STEPS.replace("hold_s = 1", "hold_s = 2"), RAMP), {}, "steps.csv was recorded under other inputs than the plan's"),
            ((STEPS,), {}, "ramp.csv is not in the plan"),
            ((STEPS, RAMP), {"seed": 1}, "was recorded with seed 0, not 1"),
            ((STEPS, RAMP), {"rig": "other"}, "was recorded with rig 'fake', not 'other'"),
        ],
    )
    def test_what_does_not_belong_together(self, tmp_path: Path, bench: Bench, runs: tuple, options: dict, message: str) -> None:
        go(tmp_path, bench, STEPS, RAMP)
        before = {path: path.read_bytes() for path in (tmp_path / "set").iterdir()}
        with pytest.raises(InputError, match=message):
            go(tmp_path, bench, *runs, **options)
        assert {path: path.read_bytes() for path in (tmp_path / "set").iterdir()} == before

    def test_other_names_rates_robots(self, tmp_path: Path, bench: Bench) -> None:
        go(tmp_path, bench, STEPS)
        path = tmp_path / "plan.toml"
        (tmp_path / "mine.toml").write_text(robot_text("kang2017"))
        for change in (("fake", "other"), ("= 50", "= 100"), ("sample_rate", 'robot = "mine.toml"\nsample_rate')):
            path.write_text(plan_text(STEPS).replace(*change, 1))
            with pytest.raises(InputError, match="name, robot, rate or noise differ"):
                record(read_plan(path), tmp_path / "set", RigSource("fake", bench))

    def test_a_data_set_from_elsewhere(self, tmp_path: Path, bench: Bench) -> None:
        write_dataset(make_dataset(), tmp_path / "set")
        with pytest.raises(InputError, match=r"was not recorded here \(recording\.json is missing\)"):
            go(tmp_path, bench)

    def test_without_runs_it_begins_anew(self, tmp_path: Path, bench: Bench) -> None:
        bench.prepare = lambda number, rig: rig.fail_at.update({1: RuntimeError()} if number == 0 else {})
        with pytest.raises(RuntimeError):
            go(tmp_path, bench, STEPS, rig="fale")
        assert go(tmp_path, bench, RAMP, seed=2).done == ("ramp.csv",)

    @pytest.mark.parametrize("damage", ["", "{}", "[]", "nonsense"])
    def test_a_damaged_log(self, tmp_path: Path, bench: Bench, damage: str) -> None:
        go(tmp_path, bench, STEPS)
        (tmp_path / "set" / "recording.json").write_text(damage)
        with pytest.raises(InputError, match=r"recording\.json: is damaged"):
            go(tmp_path, bench, STEPS)


class TestRobots:
    def test_a_robot_file_goes_with_the_data(self, tmp_path: Path, bench: Bench) -> None:
        (tmp_path / "mine.toml").write_text(robot_text("kang2017").replace('"kang2017"', '"mine"'))
        path = tmp_path / "plan.toml"
        path.write_text('robot = "mine.toml"\n' + plan_text(STEPS))
        record(read_plan(path), tmp_path / "set", RigSource("fake", bench))
        (tmp_path / "mine.toml").unlink()
        assert read_description(tmp_path / "set").robot == "robot.toml"
        assert open_dataset(tmp_path / "set").channels.pressure_max == 5e5

    def test_the_rigs_robot_is_the_plans(self, tmp_path: Path, bench: Bench) -> None:
        small = ROBOT.model_copy(update={"name": "small", "geometry": ROBOT.geometry.model_copy(update={"modules": 1})})
        bench.prepare = lambda number, rig: setattr(rig, "robot", small)
        with pytest.raises(InputError, match="the rig's robot is 'small', the set points are for 'kang2017'"):
            go(tmp_path, bench)

    @pytest.mark.slow
    def test_a_person_hangs_the_weights(self, tmp_path: Path, bench: Bench) -> None:
        """Asked whenever the tip force differs from that of the run before; when recording goes on, nothing hangs there yet."""
        hung = RAMP.replace("ramp.csv", "hung.csv") + "\nrest = {tip_force_z_N = -0.5}"
        plan = read_plan(write_plan(tmp_path, STEPS, RAMP + "\nrest = {tip_force_z_N = -0.5}", hung, SWEEP))
        bench.prepare = lambda number, rig: rig.fail_at.update({300: KeyboardInterrupt()} if number == 2 else {})
        asked: list[str] = []
        with pytest.raises(KeyboardInterrupt):
            record(plan, tmp_path / "set", RigSource("fake", bench), ask=asked.append)
        record(plan, tmp_path / "set", RigSource("fake", bench), ask=asked.append)
        force = "make the force on the tip x, y, z ="
        assert asked == [f"ramp.csv: {force} 0, 0, -0.5 N", f"hung.csv: {force} 0, 0, -0.5 N", f"sweep.csv: {force} 0, 0, 0 N"]

    def test_a_changing_force_needs_a_rig_that_pushes(self, tmp_path: Path, bench: Bench) -> None:
        go(tmp_path, bench, f"{RAMP}\nrest = {{tip_force_z_N = -0.5}}")
        assert (read_dataset(tmp_path / "set").runs[0].tip_force == [0, 0, -0.5]).all()
        plan = read_plan(write_plan(tmp_path, RAMP.replace("ramp.csv", "more.csv")))
        plan.runs[0].setpoints.tip_force[2] = 1.0
        with pytest.raises(InputError, match="the tip force changes, but this rig cannot push"):
            record(plan, tmp_path / "other", RigSource("fake", bench))


class TestSimulated:
    """The rig of another engine, imperfections off: what is recorded is what the reference says, at the right time."""

    def test_against_the_reference(self, tmp_path: Path) -> None:
        pytest.importorskip("mujoco")
        from tepm_opt.hw.registry import open_rig

        truth = read_run(reference("null/tip_load.csv"))
        rows = slice(0, 120)
        header = reference("null/tip_load.csv").read_text().splitlines()
        (tmp_path / "in.csv").write_text("\n".join(header[:121]) + "\n")
        path = write_plan(tmp_path, 'file = "load.csv"\nrole = "fit"\ninputs = "in.csv"\nlead_s = 0.5')
        record(read_plan(path), tmp_path / "set", RigSource("sim:perfect", lambda seed: open_rig("sim:perfect")))
        run = read_dataset(tmp_path / "set").runs[0]
        np.testing.assert_allclose(run.time[25:] - 0.5, truth.time[rows], atol=1e-9)
        np.testing.assert_allclose(run.tip_force[25:], truth.tip_force[rows], atol=1e-9)
        assert np.abs(truth.tip_force[rows]).max() > 0.1
        assert 1e3 * np.sqrt(np.mean((run.points[25:] - truth.points[rows]) ** 2)) < 0.001

    def test_every_run_has_noise_of_its_own(self, tmp_path: Path) -> None:
        pytest.importorskip("mujoco")
        holds = [
            f'file = "{name}.csv"\nrole = "fit"\npattern = "steps"\nlevels = [{{}}]\nhold_s = 0.2\nlead_s = 0.5\nrest_s = 0'
            for name in "ab"
        ]
        both, first = (read_plan(write_plan(tmp_path, *runs)) for runs in (holds, holds[:1]))
        for folder, plan, seed in (("one", both, 0), ("same", first, 0), ("other", first, 1)):
            record(plan, tmp_path / folder, RigSource("sim", opener("sim", plan.robot, seed)), seed)
        files = {name: (tmp_path / name).read_bytes() for name in ("one/a.csv", "same/a.csv", "one/b.csv", "other/a.csv")}
        assert files["one/a.csv"] == files["same/a.csv"]
        assert len(set(files.values())) == 3


def test_the_log_says_when_and_with_what(tmp_path: Path, bench: Bench) -> None:
    go(tmp_path, bench, STEPS, seed=4)
    log = json.loads((tmp_path / "set" / "recording.json").read_text())
    assert (log["rig"], log["seed"], list(log["runs"])) == ("fake", 4, ["steps.csv"])
    assert {"fingerprint", "recorded_at", "notes"} <= log["runs"]["steps.csv"].keys()
