"""Data sets: exact round trips, extra columns, equilibria, robots by path, whole or absent."""

from __future__ import annotations

import re
import string
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tepm_opt.data.channels import Channels
from tepm_opt.data.datasets import DataSet, read_dataset, read_description, write_dataset
from tepm_opt.data.run import Run, read_run, write_run
from tepm_opt.data.setpoints import FORCE_COLUMNS, SetPoints
from tepm_opt.errors import InputError
from tests.data.made import NAMES, make_dataset
from tests.paths import reference

REALS = st.floats(allow_nan=False, allow_infinity=False)
MEASURES = st.one_of(REALS, st.just(float("nan")))
WORDS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=8)
TOML_TEXT = st.text(st.characters(codec="utf-8"), min_size=1, max_size=12)


def assert_same_run(one: Run, other: Run) -> None:
    assert (one.file, one.role) == (other.file, other.role)
    for name in ("time", "inputs", "tip_force", "points"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert list(one.extra) == list(other.extra)
    for name, values in one.extra.items():
        np.testing.assert_array_equal(values, other.extra[name])


def assert_same(one: DataSet, other: DataSet) -> None:
    for name in ("name", "robot", "channels", "sample_rate", "position_noise", "static"):
        assert getattr(one, name) == getattr(other, name)
    for run, its in zip(one.runs, other.runs, strict=True):
        assert_same_run(run, its)


@st.composite
def runs(draw: st.DrawFn, file: str, channels: Channels, static: bool) -> Run:
    rows = draw(st.integers(1, 5))
    time = np.array(sorted(draw(st.lists(REALS, min_size=rows, max_size=rows, unique=True))))
    time = np.full(rows, np.nan) if static and draw(st.booleans()) else time
    values = [draw(arrays(float, (rows, *shape), elements=of)) for shape, of in (((len(channels.inputs),), REALS), ((3,), REALS))]
    points = draw(arrays(float, (rows, len(channels.points), 3), elements=MEASURES))
    extra = {"pressure_11_measured_Pa": draw(arrays(float, rows, elements=MEASURES))} if draw(st.booleans()) else {}
    if draw(st.booleans()):
        extra["remark"] = np.array(["first", *draw(st.lists(WORDS, min_size=rows - 1, max_size=rows - 1))])
    return Run(file, draw(st.sampled_from(["fit", "validation"])), time, *values, points, extra)


@st.composite
def datasets(draw: st.DrawFn) -> DataSet:
    modules = draw(st.integers(1, 2))
    channels = Channels(tuple(f"{h + 1}{j + 1}" for h in range(modules) for j in range(3)), tuple(f"s{k + 1}" for k in range(2 * modules)))
    static = draw(st.booleans())
    rate = None if static and draw(st.booleans()) else draw(st.floats(1e-3, 1e6))
    noise = draw(st.none() | st.floats(0, 0.1))
    files = draw(st.lists(st.text(string.ascii_lowercase, min_size=1, max_size=6), min_size=1, max_size=3, unique=True))
    made = tuple(draw(runs(f"{file}.csv", channels, static)) for file in files)
    return DataSet(draw(TOML_TEXT), "kang2017", channels, made, rate, noise, static)


@pytest.mark.slow
@given(datasets())
def test_round_trip_is_exact(tmp_path_factory: pytest.TempPathFactory, dataset: DataSet) -> None:
    folder = tmp_path_factory.mktemp("set")
    write_dataset(dataset, folder)
    assert_same(read_dataset(folder), dataset)


def test_columns_stand_in_the_order_of_the_specification(tmp_path: Path) -> None:
    dataset = make_dataset()
    run = replace(dataset.runs[0], extra={"temperature_K": np.full(300, 293.0), "tension_11_measured_N": np.zeros(300)})
    write_dataset(replace(dataset, runs=(run,)), tmp_path)
    header = (tmp_path / "steps.csv").read_text().splitlines()[0].split(",")
    names = [f"{h}{j}" for h in (1, 2) for j in (1, 2, 3)]
    inputs = [f"pressure_{name}_Pa" for name in names] + [f"tension_{name}_N" for name in names]
    points = [f"s{i}_{axis}_m" for i in range(1, 5) for axis in "xyz"]
    assert header == ["time_s", *inputs, *FORCE_COLUMNS, *points, "temperature_K", "tension_11_measured_N"]


def test_the_reference_data_are_read_and_written_alike(tmp_path: Path) -> None:
    source = reference("null")
    dataset = read_dataset(source)
    assert [run.rows for run in dataset.runs] == [1550, 1550, 1200, 1250, 1200, 1100, 1000]
    assert [run.file for run in dataset.validation] == ["circle.csv", "mixed.csv"]
    assert len(dataset.fit) == 5
    raw = np.loadtxt(source / "steps.csv", delimiter=",", skiprows=1)
    run = dataset.run("steps.csv")
    np.testing.assert_array_equal(np.column_stack([run.time, run.inputs, run.tip_force, run.points.reshape(-1, 12)]), raw)
    write_dataset(dataset, tmp_path)
    assert_same(read_dataset(tmp_path), dataset)


def test_columns_are_found_by_name_and_the_rest_is_kept(tmp_path: Path) -> None:
    dataset = make_dataset()
    write_dataset(dataset, tmp_path)
    lines = [line.split(",") for line in (tmp_path / "steps.csv").read_text().splitlines()]
    mixed = [
        [line[-1], *line[:-1], "1.5" if k else "supply_Pa", "fine" if k else "remark", "" if k else "void"] for k, line in enumerate(lines)
    ]
    (tmp_path / "steps.csv").write_text("\n".join(",".join(line) for line in mixed) + "\n")
    run = read_dataset(tmp_path).runs[0]
    np.testing.assert_array_equal(run.points, dataset.runs[0].points)
    assert list(run.extra) == ["supply_Pa", "remark", "void"]
    assert set(run.extra["supply_Pa"]) == {1.5}
    assert set(run.extra["remark"]) == {"fine"}
    assert np.isnan(run.extra["void"]).all()


def test_missing_samples_are_empty_or_nan(tmp_path: Path) -> None:
    run = make_dataset().runs[0]
    points = run.points.copy()
    points[3, 1] = np.nan
    write_run(tmp_path / "run.csv", replace(run, points=points), NAMES)
    assert ",,,," in (tmp_path / "run.csv").read_text().splitlines()[4]
    text = (tmp_path / "run.csv").read_text().replace(",,,,", ",NaN,nan,,")
    (tmp_path / "run.csv").write_text(text)
    np.testing.assert_array_equal(read_run(tmp_path / "run.csv").points, points)


def test_no_tip_force_columns_is_no_tip_force(tmp_path: Path) -> None:
    run = make_dataset().runs[0]
    write_run(tmp_path / "run.csv", run, NAMES)
    lines = [line.split(",") for line in (tmp_path / "run.csv").read_text().splitlines()]
    (tmp_path / "run.csv").write_text("\n".join(",".join(line[:13] + line[16:]) for line in lines))
    assert_same_run(read_run(tmp_path / "run.csv"), replace(run, file="run.csv"))


def began(folder: Path) -> list[float]:
    return [run.began for run in read_dataset(folder).runs]


class TestSession:
    """Runs of 5.98 s, one after the other."""

    def test_runs_follow_each_other_5_s_apart_unless_one_says_when_it_began(self, tmp_path: Path) -> None:
        write_dataset(make_dataset(), tmp_path)
        assert began(tmp_path) == [0.0, pytest.approx(10.98)]
        text = (tmp_path / "dataset.toml").read_text()
        (tmp_path / "dataset.toml").write_text(text.replace('role = "fit"', 'role = "fit"\nbegan_s = 20'))
        assert began(tmp_path) == [20.0, pytest.approx(30.98)]

    def test_what_is_said_is_written_and_what_is_usual_is_not(self, tmp_path: Path) -> None:
        first, second = make_dataset().runs
        write_dataset(replace(make_dataset(), runs=(first, replace(second, began=100.0))), tmp_path)
        assert began(tmp_path) == [0.0, 100.0]
        write_dataset(read_dataset(tmp_path), tmp_path / "again")
        assert (tmp_path / "again" / "dataset.toml").read_text() == (tmp_path / "dataset.toml").read_text()
        write_dataset(make_dataset(), tmp_path / "usual")
        write_dataset(read_dataset(tmp_path / "usual"), tmp_path / "usual again")
        assert "began_s" not in (tmp_path / "usual again" / "dataset.toml").read_text()

    @pytest.mark.parametrize(
        ("value", "message"),
        [("-1.0", "valid: 0 … 1e+07 s after the first run"), ('"noon"', "began_s"), ("0", "when the run before it began")],
    )
    def test_a_time_that_cannot_be_is_refused(self, tmp_path: Path, value: str, message: str) -> None:
        write_dataset(make_dataset(), tmp_path)
        text = (tmp_path / "dataset.toml").read_text()
        (tmp_path / "dataset.toml").write_text(text.replace('role = "validation"', f'role = "validation"\nbegan_s = {value}'))
        with pytest.raises(InputError, match=r"dataset.toml.*" + re.escape(message)):
            read_dataset(tmp_path)


class TestEquilibria:
    def test_a_table_without_time(self, tmp_path: Path) -> None:
        lines = reference("static.csv").read_text()
        (tmp_path / "static.csv").write_text(lines)
        (tmp_path / "dataset.toml").write_text(
            'name = "s"\nrobot = "kang2017"\nstatic = true\n[[runs]]\nfile = "static.csv"\nrole = "fit"\n'
        )
        dataset = read_dataset(tmp_path)
        run = dataset.runs[0]
        assert dataset.static
        assert dataset.sample_rate is None
        assert run.points.shape == (400, 4, 3)
        assert np.isnan(run.time).all()
        assert {"length_11_m", "smallest_stiffness_eigenvalue_N_per_m"} <= run.extra.keys()
        write_dataset(dataset, tmp_path / "copy")
        assert_same(read_dataset(tmp_path / "copy"), dataset)
        assert (tmp_path / "copy" / "static.csv").read_text().startswith("pressure_11_Pa,")

    def test_time_may_stand_there_and_need_not_increase(self, tmp_path: Path) -> None:
        dataset = make_dataset()
        run = replace(dataset.runs[0], time=dataset.runs[0].time[::-1].copy())
        write_dataset(replace(dataset, runs=(run,), static=True, sample_rate=None), tmp_path)
        np.testing.assert_array_equal(read_dataset(tmp_path).runs[0].time, run.time)


class TestRobot:
    def test_a_path_is_relative_to_the_data_set(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        (tmp_path / "robots").mkdir()
        (tmp_path / "robots" / "mine.toml").write_text("name = 'mine'")
        dataset = replace(make_dataset(), robot="robots/mine.toml")
        write_dataset(dataset, "sets/one")
        assert read_description("sets/one").robot == "../../robots/mine.toml"
        read = read_dataset("sets/one")
        assert Path(read.robot).samefile("robots/mine.toml")
        write_dataset(read, "two")
        assert read_description("two").robot == "../robots/mine.toml"

    def test_the_robots_columns_are_asked_for(self, tmp_path: Path) -> None:
        write_dataset(make_dataset(), tmp_path)
        with pytest.raises(InputError, match="column 'pressure_31_Pa' is missing"):
            read_dataset(tmp_path, Channels((*NAMES.actuators, "31"), NAMES.points))
        with pytest.raises(InputError, match="'pressure_23_Pa' is of no actuator or point of the robot"):
            read_dataset(tmp_path, Channels(NAMES.actuators[:-1], NAMES.points))

    def test_two_digits(self) -> None:
        names = ["pressure_10_1_Pa", "pressure_2_11_Pa", "tension_2_2_N", "s11_x_m", "pressure_1_measured_Pa", "s1_x_mm"]
        found = Channels.from_header(names)
        assert found.actuators == ("2_2", "2_11", "10_1")
        assert found.points == tuple(f"s{k}" for k in range(1, 12))


class TestWriting:
    def test_an_existing_data_set_is_not_overwritten(self, tmp_path: Path) -> None:
        write_dataset(make_dataset(), tmp_path)
        with pytest.raises(InputError, match="holds a data set"):
            write_dataset(make_dataset(), tmp_path)
        write_dataset(replace(make_dataset(), name="new"), tmp_path, overwrite=True)
        assert read_dataset(tmp_path).name == "new"

    def test_text_that_reads_as_numbers_is_refused(self, tmp_path: Path) -> None:
        run = replace(make_dataset().runs[0], extra={"remark": np.array(["12", *["x"] * 299])})
        with pytest.raises(InputError, match="column 'remark' holds text that reads as numbers"):
            write_run(tmp_path / "run.csv", run, NAMES)
        assert not list(tmp_path.iterdir())

    def test_no_runs(self, tmp_path: Path) -> None:
        empty = DataSet("empty", "kang2017", NAMES, (), 50.0)
        write_dataset(empty, tmp_path)
        assert_same(read_dataset(tmp_path, NAMES), empty)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time": np.zeros(299)}, r"time has the shape \(299,\); valid: \(300,\)"),
        ({"tip_force": np.zeros((300, 2))}, "tip_force has the shape"),
        ({"points": np.zeros((300, 12))}, "points has the shape"),
        ({"role": "test"}, "unknown role 'test'"),
        ({"extra": {"x": np.zeros(3)}}, "column 'x' has the shape"),
        ({"extra": {"x": np.zeros(300, dtype=int)}}, "column 'x' has the type int64"),
    ],
)
def test_arrays_that_do_not_fit(change: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(make_dataset().runs[0], **change)


def test_runs_of_another_robot_do_not_fit() -> None:
    with pytest.raises(InputError, match="12 inputs and 4 points; valid: 6 and 2"):
        replace(make_dataset(), channels=Channels(("11", "12", "13"), ("s1", "s2")))
    with pytest.raises(InputError, match=r"unknown run 'step.csv': did you mean 'steps.csv'"):
        make_dataset().run("step.csv")


def test_they_say_in_one_line_what_they_are() -> None:
    dataset = make_dataset()
    assert repr(dataset) == f"DataSet({dataset.name}: 1 runs to fit to, 1 to judge by, 50 Hz, robot kang2017)"
    assert repr(dataset.runs[0]) == "Run(steps.csv: fit, 300 rows over 5.98 s, 12 inputs, 4 points)"
    assert dataset._repr_html_().count("<tr>") == 1 + len(dataset.runs)
    assert (
        repr(SetPoints(np.array([1.0, 3.0]), np.zeros((2, 12)), np.ones((2, 3))))
        == "SetPoints(2 rows over 2 s, 12 inputs, with a tip force)"
    )
