"""`tepm data new|map|import|check`: from another program's table to a data set, by commands alone."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from tepm_opt import plots
from tepm_opt.data.datasets import read_description
from tepm_opt.data.tables import read_table
from tepm_opt.jobs.import_data import run_import
from tepm_opt.models.channels import open_dataset
from tepm_opt.models.robot import robot_text
from tepm_opt.plots.importing import preview_figure
from tests.cli.conftest import PNG, Command
from tests.data.importing.layouts import LAYOUTS, even, text
from tests.data.importing.truth import COMMANDS, PLACES, signals
from tests.data.made import ACTUATORS, NAMES


def spreadsheet(folder: Path, run: int, name: str) -> Path:
    """What a German laboratory saves: numbers with commas, mm, bar, names of its own."""
    time = even(50)
    found = signals(time, run)
    columns = {"t [ms]": 1e3 * time} | {f"Druck{a} [bar]": found[f"pressure_{a}_Pa"] / 1e5 for a in ACTUATORS}
    columns |= {f"M{n[1]}_{n[3]} [mm]": 1e3 * found[n] for n in PLACES} | {f"quat_{axis}": 0.5 * np.ones(301) for axis in "wxyz"}
    return text(folder / name, columns, ";", ",")


def test_a_table_becomes_a_data_set_with_a_guessed_map(tepm: Command, here: Path) -> None:
    pytest.importorskip("pandas")
    spreadsheet(here, 0, "one.csv")
    spreadsheet(here, 1, "two.csv")
    guessed = tepm("data", "map", "one.csv", "two.csv", "--out", "map.toml")
    assert (guessed.status, guessed.err) == (0, "")
    assert len((here / "map.toml").read_text().splitlines()) <= 15
    looked = tepm("data", "import", "one.csv", "two.csv", "--map", "map.toml", "--preview", "look.png")
    assert (looked.status, looked.err) == (0, "")
    assert "nothing written: --out FOLDER writes the data set" in looked.out
    assert sorted(path.name for path in here.iterdir()) == ["look.png", "map.toml", "one.csv", "two.csv"]
    done = tepm("data", "import", "one.csv", "two.csv", "--map", "map.toml", "--out", "set")
    assert (done.status, done.err) == (0, "")
    assert "two.csv is for validation, being the last" in done.out
    assert "left out, a data set has no place for orientations: quat_w, quat_x, quat_y, quat_z" in done.out
    assert {path.name for path in (here / "set").iterdir()} == {"dataset.toml", "import.json", "import.png", "one.csv", "two.csv"}
    dataset = open_dataset(here / "set")
    for run, each in enumerate(dataset.runs):
        truth = signals(each.time, run)
        assert each.inputs[:, :6] == pytest.approx(np.array([truth[n] for n in COMMANDS[:6]]).T, rel=1e-9)
        assert each.points.reshape(-1, 12) == pytest.approx(np.array([truth[n] for n in PLACES]).T, abs=1e-9)
    assert tepm("data", "check", "set").status == 0


def test_plain_data(tepm: Command, here: Path) -> None:
    pytest.importorskip("pandas")
    spreadsheet(here, 0, "one.csv")
    (here / "map.toml").write_text(tepm("data", "map", "one.csv").out)
    summary = tepm("data", "import", "one.csv", "--map", "map.toml", "--out", "set", "--json").json()
    assert summary == json.loads((here / "set" / "import.json").read_text())
    assert summary["rate_hz"] == 50
    assert [(run["file"], run["role"], run["rows"]) for run in summary["runs"]] == [("one.csv", "fit", 301)]
    assert {row["entry"]: row["filtered"] for row in summary["entries"]} == {"pressure": False, "position": False}


def test_what_is_wrong_is_one_line_and_nothing_is_written(tepm: Command, here: Path) -> None:
    pytest.importorskip("pandas")
    spreadsheet(here, 0, "one.csv")
    (here / "map.toml").write_text(tepm("data", "map", "one.csv").out.replace('"bar"', '"psi"').replace('"mm"', '"m"'))
    done = tepm("data", "import", "one.csv", "--map", "map.toml", "--out", "set", "--preview", "look.png")
    assert (done.status, done.out) == (2, "")
    assert len(done.err.splitlines()) == 1
    assert 'put into the map: position.unit = "mm"' in done.err
    assert sorted(path.name for path in here.iterdir()) == ["map.toml", "one.csv"]


def test_a_data_set_is_never_overwritten(tepm: Command, here: Path) -> None:
    pytest.importorskip("pandas")
    spreadsheet(here, 0, "one.csv")
    (here / "map.toml").write_text(tepm("data", "map", "one.csv").out)
    assert tepm("data", "new", "set").status == 0
    before = {path: path.read_bytes() for path in (here / "set").iterdir()}
    for command in (("import", "one.csv", "--map", "map.toml", "--out", "set"), ("new", "set")):
        done = tepm("data", *command)
        assert done.status == 2
        assert "set holds a data set; name another folder" in done.err
    assert {path: path.read_bytes() for path in (here / "set").iterdir()} == before
    assert "map.toml exists; name another file" in tepm("data", "map", "one.csv", "--out", "map.toml").err


def test_a_new_data_set_says_what_belongs_into_it(tepm: Command, here: Path) -> None:
    assert tepm("data", "new", "set").out == "wrote set/dataset.toml: fill it, then run tepm data check set\n"
    assert read_description(here / "set").robot == "kang2017"
    assert (here / "set" / "run1.csv").read_text() == ",".join(NAMES.columns) + "\n"
    assert "has no rows" in tepm("data", "check", "set").out
    table = signals(even(50))
    rows = np.column_stack([even(50), *(table[n] for n in COMMANDS), np.zeros((301, 3)), *(table[n] for n in PLACES)])
    with (here / "set" / "run1.csv").open("a") as file:
        np.savetxt(file, rows, delimiter=",")
    assert "0 errors" in tepm("data", "check", "set").out


def test_of_another_robot(tepm: Command, here: Path) -> None:
    (here / "robots").mkdir()
    (here / "robots" / "arm.toml").write_text(robot_text("kang2017").replace("modules = 2", "modules = 1"))
    assert tepm("data", "new", "set", "--robot", "robots/arm.toml").status == 0
    assert tomllib.loads((here / "set" / "dataset.toml").read_text())["robot"] == "../robots/arm.toml"
    assert read_table_names(here / "set" / "run1.csv")[1:7] == ["pressure_11_Pa", "pressure_12_Pa", "pressure_13_Pa", *COMMANDS[6:9]]


def read_table_names(path: Path) -> list[str]:
    return path.read_text().strip().split(",")


@pytest.mark.slow
def test_the_preview_shows_samples_and_rows(tmp_path: Path) -> None:
    """A panel for what is put in, one for what is measured, one for the steps; samples lie where the rows' line goes."""
    pytest.importorskip("pandas")
    foreign = LAYOUTS["two_files_a_run"](tmp_path)
    (tmp_path / "map.toml").write_text(foreign.map)
    run = run_import(foreign.files, tmp_path / "map.toml")
    figure = preview_figure(run)
    assert len(figure.axes) == 2 * 4, "pressure, tension, position and steps of two runs"
    position = figure.axes[4]
    samples, line = position.lines[0], position.lines[1]
    assert len(samples.get_xdata()) == 1441  # type: ignore[arg-type]
    assert np.interp(samples.get_xdata(), line.get_xdata(), line.get_ydata()) == pytest.approx(samples.get_ydata(), abs=1.0)  # type: ignore[arg-type]
    drawn = plots.draw(run, tmp_path)
    assert drawn["import"].read_bytes().startswith(PNG)


def test_a_table_of_this_project_needs_no_import(tmp_path: Path) -> None:
    """The guess knows the names of a data set's own columns."""
    pytest.importorskip("pandas")
    time = even(50)
    path = text(tmp_path / "own.csv", {"time_s": time} | {n: signals(time)[n] for n in (*COMMANDS, *PLACES)})
    from tepm_opt.jobs.import_data import suggest_map

    (tmp_path / "map.toml").write_text(suggest_map([path]))
    run = run_import([path], tmp_path / "map.toml")
    assert run.dataset is not None
    assert run.dataset.runs[0].inputs[:, 6:] == pytest.approx(np.array([signals(time)[n] for n in COMMANDS[6:]]).T)
    assert set(read_table(path).columns) == {"time_s", *COMMANDS, *PLACES}
