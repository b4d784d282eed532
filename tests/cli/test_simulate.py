"""`tepm simulate`: the trajectory as a run of a data set, methods, sensitivities, comparison, what ends it early, wrong input."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt.jobs import simulate as simulate_job
from tepm_opt.models.compile import compile_model
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.plots import film
from tepm_opt.solvers.mechanics.simulate import simulate
from tests.cli.conftest import PNG, Command, hear_ctrl_c
from tests.cli.tables import input_columns, length_columns, names_in, shape_columns, summary, table, values, write_rows

FORCES = [f"tip_force_{axis}_N" for axis in "xyz"]
COLUMNS = [*input_columns(), *FORCES, *shape_columns()[1:]]
FILES = {"trajectory.csv", "lengths.csv", "summary.json", "tip.png", "actuator_lengths.png"}
DATA_SET = 'name = "made"\nrobot = "kang2017"\nsample_rate_hz = 50\n\n[[runs]]\nfile = "trajectory.csv"\nrole = "fit"\n'


def inputs(path: Path, times: Any = (0.0, 0.5, 2.0)) -> Path:
    """Set points: all pressures 1 bar, then A_11 rises to 1.5 bar and A_22 gets a tension of 1 N."""
    rows = np.zeros((len(times), 13))
    rows[:, 0] = times
    rows[:, 1:7] = 1e5
    rows[1:, 1], rows[1:, 11] = 1.5e5, 1.0
    return write_rows(path, input_columns(), rows)


@pytest.fixture
def in_csv(here: Path) -> Path:
    """A set-point file in the working folder."""
    return inputs(here / "in.csv")


def plain(tepm: Command, *arguments: object) -> Any:
    """`tepm simulate in.csv --out out` without a film."""
    return tepm("simulate", "in.csv", "--out", "out", "--animation", "none", *arguments)


@pytest.mark.slow
@pytest.mark.usefixtures("in_csv")
def test_files_and_columns(tepm: Command, here: Path) -> None:
    done = plain(tepm)
    assert (done.status, done.err) == (0, "")
    assert names_in(here / "out") == FILES
    header, rows = table(here / "out" / "trajectory.csv")
    assert header == COLUMNS
    np.testing.assert_array_equal(rows[:, :13], values(here / "in.csv"))
    header, lengths = table(here / "out" / "lengths.csv")
    assert header == length_columns()
    np.testing.assert_array_equal(lengths[:, 0], [0.0, 0.5, 2.0])
    told = summary(here / "out", "simulate")
    assert (told["rows"], told["simulated"], told["duration_s"], told["method"]) == (3, 3, 2.0, "implicit")
    assert 0 < told["estimated_error_m"] <= 1.5e-4
    assert (told["interrupted"], told["failure"]) == (False, None)
    assert told["steps"] >= 2.0 / told["step_s"]
    assert told["iterations"] > 0
    np.testing.assert_array_equal(told["last_tip_m"], rows[-1, -3:])


@pytest.mark.slow
@pytest.mark.usefixtures("in_csv")
def test_the_start_is_the_equilibrium_of_statics(tepm: Command, here: Path) -> None:
    assert plain(tepm).status == 0
    assert tepm("statics", "in.csv", "--out", "still").status == 0
    np.testing.assert_allclose(values(here / "out" / "trajectory.csv")[0, -12:], values(here / "still" / "shape.csv")[0, 1:], atol=1e-9)
    assert set(summary(here / "still", "statics")) & set(summary(here / "out", "simulate"))


@pytest.mark.slow
def test_the_trajectory_is_a_run_of_a_data_set(tepm: Command, here: Path) -> None:
    inputs(here / "in.csv", np.arange(100) * 0.02)
    rows = values(here / "in.csv")
    rows[:, 1:7] = 1e5 + 5e4 * np.clip((rows[:, :1] - 0.5) / 0.5, 0, 1) * [1, 0.9, 0.8, 0.7, 0.6, 0.5]
    rows[:, 7:] = 0.0
    write_rows(here / "in.csv", input_columns(), rows)
    assert plain(tepm).status == 0
    folder = here / "set"
    folder.mkdir()
    shutil.copy(here / "out" / "trajectory.csv", folder)
    (folder / "dataset.toml").write_text(DATA_SET)
    done = tepm("data", "check", "set", "--json")
    assert (done.status, done.json()["errors"]) == (0, 0), done.out


@pytest.mark.slow
def test_sparse_and_dense_files_of_one_motion_agree(tepm: Command, here: Path) -> None:
    """Between rows the inputs are linear, however many rows say so."""
    inputs(here / "in.csv", (0.0, 0.5, 2.0))
    assert plain(tepm).status == 0
    sparse = values(here / "out" / "trajectory.csv")
    times = np.arange(201) * 0.01
    rows = np.stack([np.interp(times, sparse[:, 0], column) for column in sparse[:, :13].T], axis=1)
    write_rows(here / "in.csv", input_columns(), rows)
    assert plain(tepm).status == 0
    np.testing.assert_allclose(values(here / "out" / "trajectory.csv")[[50, 200], -12:], sparse[1:, -12:], atol=2e-5)


@pytest.mark.slow
@pytest.mark.usefixtures("in_csv")
def test_rk4_and_implicit_agree(tepm: Command, here: Path) -> None:
    assert plain(tepm).status == 0
    implicit = values(here / "out" / "trajectory.csv")
    assert plain(tepm, "--method", "rk4", "--step", "0.3").status == 0
    told = summary(here / "out", "simulate")
    assert (told["method"], told["iterations"]) == ("rk4", 0)
    assert told["step_s"] == pytest.approx(3e-4)
    np.testing.assert_allclose(values(here / "out" / "trajectory.csv"), implicit, atol=2e-5)


@pytest.mark.slow
@pytest.mark.usefixtures("in_csv")
def test_hold(tepm: Command, here: Path) -> None:
    """Held rows: nothing moves until the second one, and what follows is another motion; the file's reader is warned."""
    done = plain(tepm, "--hold")
    assert "hold until the next row" in done.out
    rows = values(here / "out" / "trajectory.csv")
    np.testing.assert_allclose(rows[1, -12:], rows[0, -12:], atol=1e-9)
    assert np.linalg.norm(rows[2, -3:] - rows[0, -3:]) > 1e-3
    assert summary(here / "out", "simulate")["inputs_between_rows"] == "held"


@pytest.mark.slow
@pytest.mark.usefixtures("in_csv")
def test_sensitivities_against_differences(tepm: Command, here: Path) -> None:
    assert plain(tepm, "--sensitivities", "K_a,pressure_11").status == 0
    header, found = table(here / "out" / "sensitivities.csv")
    assert header == ["time_s", *(f"{column}_per_{name}" for name in ("K_a", "pressure_11") for column in shape_columns()[1:])]
    moved = []
    for change in (0.01, -0.01):
        (here / "m.toml").write_text(f'robot = "kang2017"\n\n[parameters]\nK_a = {358.86 + change!r}\n')
        assert tepm("simulate", "in.csv", "--out", "moved", "--animation", "none", "--model", "m.toml").status == 0
        moved.append(values(here / "moved" / "trajectory.csv")[:, -12:])
    np.testing.assert_allclose(found[:, 1:13], (moved[0] - moved[1]) / 0.02, atol=1e-3 * np.abs(found[:, 1:13]).max())
    told = summary(here / "out", "simulate")["largest_tip_change_by_1_percent_m"]
    assert told["K_a"] >= 0.01 * 358.86 * np.linalg.norm(found[:, 10:13], axis=1).max() * 0.999
    assert plain(tepm).status == 0
    assert names_in(here / "out") == FILES, "sensitivities of an earlier run must not stay"


@pytest.mark.slow
@pytest.mark.usefixtures("drawn")
def test_a_recorded_run_is_compared_and_two_runs_give_the_same_bytes(tepm: Command, here: Path) -> None:
    """Points shifted by 3 mm, one of them missing: Eq. (5) is 3 mm. With all figures, sensitivities and a film."""
    inputs(here / "in.csv", (0.0, 0.1, 0.2))
    task = simulate_job.read_task(here / "in.csv", model := compile_model("kang2017"))
    run = simulate_job.run_simulation(model, task)
    points = run.points + np.array([3e-3, 0, 0])
    points[1, -1] = np.nan
    rows = np.hstack([values(here / "in.csv"), np.zeros((3, 3)), points.reshape(3, -1)])
    write_rows(here / "measured.csv", COLUMNS, rows)
    for out in ("one", "two"):
        done = tepm("simulate", "measured.csv", "--out", out, "--animation", "gif", "--sensitivities", "c_a")
        assert (done.status, done.err) == (0, "")
        assert "3 mm" in done.out
    told = summary(here / "one", "simulate")["measured"]
    assert told["error_rms_m"] == pytest.approx(3e-3, rel=1e-6)
    assert told["largest_error_m"] == pytest.approx(3e-3, rel=1e-6)
    assert list(told["point_error_rms_m"]) == ["s1", "s2", "s3", "s4"]
    assert names_in(here / "one") == names_in(here / "two") == FILES | {"animation.gif", "sensitivities.csv"}
    for name in names_in(here / "one"):
        assert (here / "one" / name).read_bytes() == (here / "two" / name).read_bytes(), name
    assert (here / "one" / "tip.png").read_bytes().startswith(PNG)


@pytest.mark.slow
@pytest.mark.usefixtures("in_csv")
def test_json_alone(tepm: Command, here: Path) -> None:
    done = plain(tepm, "--json")
    assert done.err == ""
    assert done.json() == summary(here / "out", "simulate")


def partial(*arguments: Any, **options: Any) -> Any:
    """The first second of a simulation."""
    model, setpoints, *rest = arguments
    rows = setpoints.time <= 1.0
    cut = type(setpoints)(setpoints.time[rows], setpoints.inputs[rows], setpoints.tip_force[rows])
    return simulate(model, cut, *rest, **options)


@pytest.mark.slow
@pytest.mark.usefixtures("in_csv")
def test_a_motion_that_leaves_all_bounds_is_kept_until_then(tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*arguments: Any, **options: Any) -> Any:
        failed = Outcome(Ending.FAILED, "the motion left all bounds after 1.01 s")
        return replace(partial(*arguments, **options), outcome=failed)

    monkeypatch.setattr(simulate_job, "simulate", failing)
    done = plain(tepm)
    assert done.status == 1
    assert done.err.count("\n") == 1
    assert "left all bounds after 1.01 s" in done.err
    np.testing.assert_array_equal(values(here / "out" / "trajectory.csv")[:, 0], [0.0, 0.5])
    told = summary(here / "out", "simulate")
    assert told["simulated"] == 2
    assert 0.96 <= told["reached_s"] <= 1.0
    assert "bounds" in told["failure"]


@pytest.mark.usefixtures("in_csv")
@pytest.mark.parametrize("first", [True, False], ids=["at once", "later"])
def test_interruption(tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch, first: bool) -> None:
    def interrupted(*arguments: Any, **options: Any) -> Any:
        if first:
            raise KeyboardInterrupt
        return replace(partial(*arguments, **options), outcome=Outcome(Ending.INTERRUPTED))

    monkeypatch.setattr(simulate_job, "simulate", interrupted)
    done = plain(tepm)
    assert done.status == 130
    assert "interrupted" in done.out + done.err
    if first:
        assert names_in(here) == {"in.csv"}
        assert "nothing was finished" in done.err
    else:
        assert names_in(here / "out") == FILES
        assert summary(here / "out", "simulate")["interrupted"] is True


@pytest.mark.slow
@pytest.mark.usefixtures("in_csv")
def test_interrupted_film_keeps_its_pictures(tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    draw, calls = film.Scene.image, iter(range(100))

    def image(scene: film.Scene, instant: int) -> np.ndarray:
        if next(calls) == 3:
            raise KeyboardInterrupt
        return draw(scene, instant)

    monkeypatch.setattr(film.Scene, "image", image)
    done = tepm("simulate", "in.csv", "--out", "out", "--animation", "gif")
    assert done.status == 130
    assert "film" in done.err
    assert names_in(here / "out") == FILES | {"animation.gif"}
    assert summary(here / "out", "simulate")["interrupted"] is False


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_on_the_program(here: Path) -> None:
    """A real SIGINT while the film of a minute is drawn: status 130, tables whole, no temporary files."""
    inputs(here / "in.csv", (0.0, 1.0, 60.0))
    command = [sys.executable, "-c", "from tepm_opt.cli import main; main()", "simulate", "in.csv", "--out", "out", "--animation", "gif"]
    program = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=hear_ctrl_c)
    waited = time.monotonic() + 60
    while not list((here / "out").glob(".animation*")) and time.monotonic() < waited and program.poll() is None:
        time.sleep(0.02)
    time.sleep(0.5)
    program.send_signal(signal.SIGINT)
    _, err = program.communicate(timeout=60)
    assert program.returncode == 130, err
    assert "Traceback" not in err
    assert names_in(here / "out") - {"animation.gif"} == FILES


NAN = ("in.csv", "line 3", "pressure_11_Pa")
WRONG = {
    "rk4 step too long": ("", ("--method", "rk4", "--step", "1"), ("1 ms", "rk4", "implicit")),
    "step in s": ("", ("--step", "0.0003"), ("--step", "0.0003", "ms")),
    "error and step": ("", ("--step", "10", "--error", "1"), ("--error", "--step")),
    "error in m": ("", ("--error", "1e-5"), ("--error", "mm")),
    "no step": ("", ("--step", "nan"), ("--step",)),
    "method": ("", ("--method", "euler"), ("'euler'", "implicit, rk4")),
    "animation": ("", ("--animation", "avi"), ("'avi'", "gif")),
    "parameter": ("", ("--sensitivities", "K_a,K_b"), ("'K_b'", "K_a")),
    "input": ("", ("--sensitivities", "pressure_31"), ("'pressure_31'", "pressure_11")),
    "no names": ("", ("--sensitivities", ""), ("''",)),
    "sensitivities of rk4": ("", ("--sensitivities", "K_a", "--method", "rk4"), ("--sensitivities", "implicit")),
    "one row": ("one", (), ("in.csv", "1 row", "at least 2")),
    "NaN": ("nan", (), NAN),
    "empty": ("", (), NAN),
    "time": ("time", (), ("in.csv", "line 3", "time_s")),
    "out of range": ("6e5", (), (*NAN, "600000", "500000")),
    "robot and model": ("", ("--robot", "kang2017", "--model", "m.toml"), ("--robot", "--model")),
}


@pytest.mark.sample(3)
@pytest.mark.parametrize("name", WRONG)
def test_wrong_input_leaves_nothing_behind(tepm: Command, here: Path, name: str) -> None:
    content, options, says = WRONG[name]
    inputs(here / "in.csv")
    header, first, second, *rest = (here / "in.csv").read_text().splitlines()
    edited = {"one": [], "time": [second.replace("0.5,", "0.0,", 1), *rest]}
    lines = edited.get(content, [second.replace("150000.0", content, 1) if content or name == "empty" else second, *rest])
    (here / "in.csv").write_text("\n".join([header, first, *lines]) + "\n")
    done = tepm("simulate", "in.csv", "--out", "new/out", *(("--animation", "none") if "--animation" not in options else ()), *options)
    assert (done.status, done.out, done.err.count("\n")) == (2, "", 1)
    assert all(part in done.err for part in says), done.err
    assert names_in(here) == {"in.csv"}


@pytest.mark.slow
@pytest.mark.usefixtures("in_csv")
def test_hold_does_not_fit_a_recorded_run_nor_overwrites_it(tepm: Command, here: Path) -> None:
    assert plain(tepm).status == 0
    before = (here / "out" / "trajectory.csv").read_bytes()
    done = tepm("simulate", "out/trajectory.csv", "--hold", "--out", "held")
    assert (done.status, names_in(here)) == (2, {"in.csv", "out"})
    assert "--hold" in done.err
    done = tepm("simulate", "out/trajectory.csv", "--out", "out", "--animation", "none")
    assert done.status == 2
    assert "overwritten" in done.err
    assert (here / "out" / "trajectory.csv").read_bytes() == before


@pytest.mark.slow
@pytest.mark.usefixtures("in_csv")
def test_a_gif_says_how_to_have_it_smaller(tepm: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(film, "find_ffmpeg", lambda: None)
    done = tepm("simulate", "in.csv", "--out", "out", "--animation", "gif")
    assert re.search(
        r"film: out/animation\.gif, \d+\.\d MB; with ffmpeg it is a far smaller MP4: .*pip install 'tepm-opt\[film\]'", done.out
    )


@pytest.mark.usefixtures("in_csv")
def test_film_without_ffmpeg(tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(film, "find_ffmpeg", lambda: None)
    done = tepm("simulate", "in.csv", "--out", "out", "--animation", "mp4")
    assert (done.status, names_in(here)) == (2, {"in.csv"})
    assert "ffmpeg" in done.err
