"""`tepm mpc`: log, figures, summary, point by point, the other controllers, what ends it early, wrong input."""

from __future__ import annotations

import json
import re
import shutil
import sys
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tepm_opt.cli import rigs
from tepm_opt.data.run import read_run
from tepm_opt.hw.board.errors import LinkError
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import load_rig_file
from tepm_opt.jobs import mpc as running
from tepm_opt.jobs.closed_loop import LoopSetup
from tepm_opt.jobs.compare import LoopTask, compare
from tepm_opt.jobs.course import Course
from tepm_opt.models.model import Model
from tepm_opt.solvers.planning.trajectories import circle
from tepm_opt.studio import live
from tests.cli.conftest import PNG, Command
from tests.cli.tables import input_columns, names_in, shape_columns, summary, write_rows

pytest.importorskip("mujoco")

FILES = {"log.csv", "summary.json", "path.png", "errors.png", "inputs.png", "times.png"}
SHORT = ("line", "--from", "0.0,0,0.35", "--to", "0.004,0,0.35", "--duration", 0.2)


@pytest.fixture(autouse=True)
def short_approach(monkeypatch: pytest.MonkeyPatch) -> None:
    """The approach is not what is looked at."""
    monkeypatch.setattr("tepm_opt.jobs.course.FULL", Course(approach=0.2, pause=0.02))


@pytest.fixture
def in_rig(monkeypatch: pytest.MonkeyPatch) -> Callable[[int, Callable[[SimulatedRig], None]], list[SimulatedRig]]:
    """Does something in the simulated rig when its sample of a number is read; all rigs that were opened."""

    def arrange(number: int, happens: Callable[[SimulatedRig], None]) -> list[SimulatedRig]:
        opened: list[SimulatedRig] = []

        class Rig(SimulatedRig):
            stops = 0

            def read(self) -> Any:
                self.count = getattr(self, "count", 0) + 1
                if self.count == number:
                    happens(self)
                return super().read()

            def stop(self) -> None:
                self.stops += 1
                super().stop()

        def open_it(text: str, robot: object) -> SimulatedRig:
            opened.append(Rig(load_rig_file()))
            return opened[-1]

        monkeypatch.setattr(rigs, "open_rig", open_it)
        return opened

    return arrange


def raises(error: BaseException) -> Callable[[SimulatedRig], None]:
    def happens(rig: SimulatedRig) -> None:
        raise error

    return happens


@pytest.mark.usefixtures("drawn")
def test_files_log_and_summary(tepm: Command, here: Path) -> None:
    done = tepm("mpc", *SHORT, "--out", "out", "--seed", 1)
    assert (done.status, done.err) == (0, "")
    assert names_in(here / "out") == FILES
    for name in FILES:
        assert not name.endswith(".png") or (here / "out" / name).read_bytes().startswith(PNG)
    run = read_run(here / "out" / "log.csv")
    wanted = {
        "target_x_m",
        "true_tip_z_m",
        "enabled_11",
        "unknown_force_11_N",
        "friction_23_N",
        "nis",
        "program",
        "iterations",
        "pressure_moves",
    }
    assert wanted | {"pressure_11_measured_Pa", "tension_23_measured_N", "estimated_tip_x_m", "step_seconds", "program_seconds"} <= set(
        run.extra
    )
    header = (here / "out" / "log.csv").read_text().splitlines()[0].split(",")
    assert header[:13] == input_columns()
    assert header[16:28] == shape_columns()[1:]
    told = summary(here / "out", "mpc")
    assert (told["controller"], told["rig"], told["robot"], told["seed"], told["end"]) == ("mpc", "sim", "kang2017", 1, "done")
    assert told["samples"] == run.rows == round(told["duration_s"] / 0.01) + 1
    np.testing.assert_allclose(np.diff(run.time), 0.01, atol=1e-9)
    counted = run.extra["counted"] == 1
    assert counted.sum() == told["counted_samples"]
    target = np.column_stack([run.extra[f"target_{axis}_m"] for axis in "xyz"])
    np.testing.assert_allclose(target[-1], [0.004, 0, 0.35], atol=1e-9)
    true = np.column_stack([run.extra[f"true_tip_{axis}_m"] for axis in "xyz"])
    for kind, tip in (("true", true), ("tracked", run.points[:, -1])):
        distance = np.linalg.norm((tip - target)[counted], axis=1)
        assert told["errors"][kind]["rms_m"] == pytest.approx(np.sqrt(np.mean(distance**2)), rel=1e-9)
        assert told["errors"][kind]["largest_m"] == pytest.approx(distance.max(), rel=1e-9)
    assert told["errors"]["true"]["rms_m"] < 0.01
    assert told["rig_complaints"] == 0
    assert [band["to_Hz"] for band in told["actuation"]] == [0.5, 2.0, 10.0, 50.0]
    assert set(told["mean_tension_N"]) == {"11", "12", "13", "21", "22", "23"}
    assert {"step_seconds", "program_seconds", "fallbacks", "estimator", "versions", "pressure_moves_per_s"} <= told.keys()
    assert f"{1e3 * told['errors']['true']['rms_m']:.3g} mm rms" in done.out


@pytest.mark.slow
def test_the_log_is_a_recording_to_play_back(tepm: Command, here: Path) -> None:
    assert tepm("mpc", *SHORT, "--out", "out").status == 0
    done = tepm("mpc", *SHORT, "--rig", "replay:out/log.csv", "--out", "again")
    assert done.status == 1
    assert "ended early: the rig has no more samples: log.csv: the recording ended after" in done.out
    assert not (here / "again").exists()


@pytest.mark.slow
def test_json_and_nothing_else(tepm: Command, here: Path) -> None:
    done = tepm("mpc", *SHORT, "--controller", "mode2", "--out", "out", "--json")
    assert (done.status, done.err) == (0, "")
    assert done.json() == summary(here / "out", "mpc")
    assert done.json()["controller"] == "mode2"
    assert "program" not in (here / "out" / "log.csv").read_text().splitlines()[0]


@pytest.mark.slow
def test_a_gauge_that_lies_is_told(tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the terminal, in the summary and by the exit status; the path is followed all the same."""
    monkeypatch.setattr("tepm_opt.jobs.course.FULL", Course(approach=2.0, pause=0.02))
    weighed = SimulatedRig._measure_tensions
    monkeypatch.setattr(SimulatedRig, "_measure_tensions", lambda rig, tensions: weighed(rig, tensions) - np.array([0, 0.5, 0, 0, 0, 0]))
    done = tepm("mpc", *SHORT)
    assert done.status == 1
    assert re.search(r"dynamometer 12 reads 0\.[45]\d* N low", " ".join(done.out.split())), "as far as it is known after two seconds"
    told = summary(here / "mpc", "mpc")
    assert told["end"] == "done"
    assert list(told["doubts"]) == ["dynamometer 12"]
    assert told["doubts"]["dynamometer 12"]["from_s"] < 2.0


@pytest.mark.slow
def test_point_by_point(tepm: Command, here: Path) -> None:
    done = tepm("mpc", "circle", "--points", 2, "--radius", 0.02, "--stay", 0.3, "--controller", "mode1", "--out", "out")
    assert (done.status, done.err) == (0, "")
    assert summary(here / "out", "mpc")["counted_samples"] == 2 * 10


@pytest.mark.slow
@pytest.mark.parametrize(("option", "enabled"), [("pressure", 0.0), ("tension", 1.0)])
def test_options_of_the_predictive_controller(tepm: Command, here: Path, option: str, enabled: float) -> None:
    path = ("line", "--from", "0.0,0,0.35", "--to", "0.001,0,0.35", "--duration", 0.05)
    assert tepm("mpc", *path, "--use", option, "--out", "out").status == 0
    told = summary(here / "out", "mpc")
    assert told["settings"] == {"use": option}
    assert told["motors_enabled"] == enabled


@pytest.mark.slow
def test_a_plan_keeps_its_own_timing(tepm: Command, here: Path) -> None:
    part = np.linspace(0, 1, 41)
    smooth = part**3 * (10 - 15 * part + 6 * part**2)
    write_rows(
        here / "reference.csv", ["time_s", "x_m", "y_m", "z_m"], np.column_stack([0.4 * part, 0.02 * smooth, 0 * part, 0 * part + 0.35])
    )
    assert tepm("mpc", "reference.csv", "--controller", "mode1", "--out", "out").status == 0
    assert summary(here / "out", "mpc")["counted_samples"] == 41


class TestEarlyEnds:
    @pytest.mark.slow
    def test_an_interruption_keeps_what_was_done(self, tepm: Command, here: Path, in_rig: Any) -> None:
        opened = in_rig(40, raises(KeyboardInterrupt()))
        done = tepm("mpc", *SHORT, "--out", "out")
        assert done.status == 130
        assert "interrupted: what was done is kept" in done.out
        assert "Traceback" not in done.err
        assert names_in(here / "out") == FILES
        told = summary(here / "out", "mpc")
        assert (told["interrupted"], told["samples"]) == (True, 39)
        assert read_run(here / "out" / "log.csv").rows == 39
        assert opened[0].stops >= 1

    @pytest.mark.slow
    def test_an_interruption_before_anything_counts(self, tepm: Command, here: Path, in_rig: Any) -> None:
        in_rig(4, raises(KeyboardInterrupt()))
        done = tepm("mpc", *SHORT, "--out", "out", "--json")
        assert done.status == 130
        assert done.json()["errors"] == {"true": None, "tracked": None}
        assert names_in(here / "out") == FILES

    def test_an_interruption_before_the_first_sample(self, tepm: Command, here: Path, in_rig: Any) -> None:
        in_rig(1, raises(KeyboardInterrupt()))
        done = tepm("mpc", *SHORT, "--out", "out")
        assert done.status == 130
        assert not (here / "out").exists()

    @pytest.mark.slow
    def test_a_rig_that_fails_keeps_the_log(self, tepm: Command, here: Path, in_rig: Any) -> None:
        opened = in_rig(30, raises(LinkError("the board does not answer")))
        done = tepm("mpc", *SHORT, "--out", "out")
        assert done.status == 1
        assert "ended early: the rig failed: the board does not answer" in done.out
        assert summary(here / "out", "mpc")["message"] == "the board does not answer"
        assert read_run(here / "out" / "log.csv").rows == 29
        assert opened[0].stops >= 1

    def test_a_rig_that_fails_at_once(self, tepm: Command, here: Path, in_rig: Any) -> None:
        in_rig(1, raises(LinkError("the board does not answer")))
        done = tepm("mpc", *SHORT, "--out", "out")
        assert (done.status, done.err.count("\n")) == (1, 1)
        assert "the rig failed: the board does not answer" in done.err
        assert not (here / "out").exists()

    def test_a_program_that_dies_leaves_the_journal(self, tepm: Command, here: Path, in_rig: Any) -> None:
        in_rig(30, raises(ZeroDivisionError("a bug")))
        with pytest.raises(ZeroDivisionError):
            tepm("mpc", *SHORT, "--out", "out")
        assert names_in(here / "out") == {"log-1.unfinished.csv"}
        assert read_run(here / "out" / "log-1.unfinished.csv").rows == 29

    @pytest.mark.slow
    def test_a_disk_that_is_full_does_not_stop_the_robot(self, tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(running, "journal_path", lambda folder, name: here / "absent" / "log.csv")
        assert tepm("mpc", *SHORT, "--controller", "mode1", "--out", "out").status == 0
        assert names_in(here / "out") == FILES


class Real:
    """A rig that has no virtual time: the simulated one without what a real one does not have."""

    simulated = None

    def __init__(self) -> None:
        self._rig = SimulatedRig(load_rig_file())
        self.robot, self.read, self.apply, self.stop = self._rig.robot, self._rig.read, self._rig.apply, self._rig.stop

    @property
    def time(self) -> float:
        return self._rig.time

    def __enter__(self) -> Real:
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()


@pytest.mark.slow
class TestARealRig:
    def test_it_is_brought_to_the_start_and_followed(self, tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(rigs, "open_rig", lambda text, robot: Real())
        assert tepm("mpc", *SHORT, "--rig", "serial:x", "--out", "out").status == 0
        told = summary(here / "out", "mpc")
        assert told["errors"]["true"] is None
        assert told["errors"]["tracked"]["rms_m"] < 0.02
        assert "true_tip_x_m" not in (here / "out" / "log.csv").read_text().splitlines()[0]
        assert names_in(here / "out") == FILES

    def test_it_is_refused_where_it_is_elsewhere(self, tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(rigs, "open_rig", lambda text, robot: Elsewhere())
        done = tepm("mpc", *SHORT, "--rig", "serial:x", "--out", "out")
        assert (done.status, done.err.count("\n")) == (2, 1)
        assert "the tracked points miss the model's by" in done.err
        assert names_in(here) == set()

    def test_it_stops_where_the_tracker_sees_nothing(self, tepm: Command, here: Path, in_rig: Any) -> None:
        in_rig(5, lambda rig: setattr(rig, "_lens", Blind()))
        path = ("line", "--from", "0.0,0,0.35", "--to", "0.004,0,0.35", "--duration", 2)
        done = tepm("mpc", *path, "--controller", "mode1", "--out", "out")
        assert done.status == 1
        assert "ended early: the tracker saw nothing: no tracked point for 0.2 s" in done.out
        assert "tracker lost s1, s2, s3, s4" in (here / "out" / "log.csv").read_text()
        assert summary(here / "out", "mpc")["rig_complaints"] > 15
        assert names_in(here / "out") == FILES


class Elsewhere(Real):
    """Its tracker is not registered."""

    def __init__(self) -> None:
        super().__init__()
        read = self.read

        def shifted() -> Any:
            sample = read()
            sample.points[:, 0] += 0.2
            return sample

        self.read = shifted


class Blind:
    """A lens that sees nothing."""

    def look(self, points: np.ndarray) -> np.ndarray:
        return np.full_like(points, np.nan)


@pytest.mark.slow
def test_results_do_not_depend_on_the_number_of_processes() -> None:
    course, file = Course(approach=0.3, pause=0.02, laps=0.02, start_up=0.05), load_rig_file()
    tasks = [LoopTask(Model.from_robot("kang2017"), circle(), course, file, LoopSetup(name, seed=1)) for name in ("mpc", "mode2")]
    told: list[tuple[str, float, float]] = []
    for one, two in zip(compare(tasks, 1), compare(tasks, 2, lambda *shown: told.append(shown)), strict=True):
        assert one.summary(timing=False) == two.summary(timing=False)
        np.testing.assert_array_equal(one.points, two.points)
    assert {name for name, _, _ in told} == {"mpc", "mode2"}


WRONG = [
    (("mpc",), "Missing argument 'TRAJ'"),
    (("mpc", "square"), "unknown trajectory 'square'"),
    (("mpc", "none.csv"), "none.csv: cannot be read"),
    (("mpc", *SHORT, "--controller", "mode3"), "unknown controller 'mode3': did you mean"),
    (("mpc", *SHORT, "--use", "tensions"), "unknown use 'tensions': did you mean 'tension'?"),
    (("mpc", *SHORT, "--controller", "mode1", "--use", "tension"), "--use belongs to the predictive controller"),
    (("mpc", *SHORT, "--rule"), "No such option: --rule"),
    (("mpc", *SHORT, "--nonlinear"), "No such option: --nonlinear"),
    (("mpc", *SHORT, "--rig", "sin"), "unknown rig 'sin': did you mean 'sim'?"),
    (("mpc", *SHORT, "--rig", "bench"), "the rig's robot is"),
    (("mpc", *SHORT, "--rig", "serial"), "rig 'serial' needs a port"),
    (("mpc", *SHORT, "--laps", 2), "only a closed path has laps"),
    (("mpc", "circle", "--laps", 0), "laps = 0"),
    (("mpc", "circle", "--stay", 0.01), "stay = 0.01 s; valid: 0.3 … 1000 s"),
    (("mpc", "line", "--points", 1), "1 point is no path"),
    (("mpc", "circle", "--radius", 0.6), "reference: at"),
    (("mpc", *SHORT, "--model", "none.toml"), "none.toml"),
]


@pytest.mark.sample(3)
@pytest.mark.parametrize(("arguments", "message"), WRONG, ids=lambda value: value if isinstance(value, str) else "")
def test_wrong_input(tepm: Command, here: Path, arguments: tuple[object, ...], message: str) -> None:
    done = tepm(*arguments)
    assert (done.status, done.out, done.err.count("\n")) == (2, "", 1), done
    assert message in done.err
    assert names_in(here) == set()


@pytest.mark.slow
def test_the_live_view(tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("viser", reason="viser is not installed (extra view)")
    shown: list[Any] = []

    def none() -> Any:
        raise webbrowser.Error

    class View(live.LiveView):
        def __init__(self, robot: Any, paced: bool) -> None:
            assert paced
            super().__init__(robot, paced=False)

        def show(self, sample: Any, command: Any, target: Any, nodes: Any = None) -> None:
            super().show(sample, command, target, nodes)
            shown.append((sample.points.shape, command.pressures.shape, target.shape, nodes.shape))

        def close(self) -> None:
            assert self.settle()
            shown.append(self._words.content)
            super().close()

    monkeypatch.setattr(live, "LiveView", View)
    monkeypatch.setattr(webbrowser, "get", none)
    done = tepm("mpc", *SHORT, "--controller", "mode1", "--view", "--out", "out", "--json")
    assert done.status == 0
    assert "?token=" in done.err
    assert done.json()["samples"] == len(shown) - 1
    assert "off its target" in shown[-1]
    assert set(shown[:-1]) == {((4, 3), (6,), (3,), (13, 3, 3))}


def test_the_live_view_needs_viser(tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    done = tepm("mpc", *SHORT, "--view")
    assert (done.status, done.err.count("\n")) == (2, 1)
    assert "pip install 'tepm-opt[view]'" in done.err
    assert names_in(here) == set()


@pytest.mark.slow
def test_a_second_run_into_the_same_folder(tepm: Command, here: Path) -> None:
    assert tepm("mpc", *SHORT, "--controller", "mode1", "--out", "out").status == 0
    shutil.copytree(here / "out", here / "before")
    assert tepm("mpc", *SHORT, "--controller", "mode1", "--out", "out").status == 0
    first, again = (read_run(here / name / "log.csv") for name in ("before", "out"))
    np.testing.assert_array_equal(first.points, again.points)
    assert json.loads((here / "out" / "summary.json").read_text()).keys() == {"mpc"}


@pytest.mark.slow
def test_rounds_of_learning_and_what_was_learned(tepm: Command, here: Path) -> None:
    done = tepm("mpc", *SHORT, "--learn", 2, "--out", "out", "--seed", 3)
    assert (done.status, done.err) == (0, "")
    assert names_in(here / "out") == {"learned.csv", "round_1", "round_2", "rounds.png", "summary.json"}
    told = summary(here / "out", "rounds")
    assert (told["asked"], told["seed"], told["end"]) == (2, 3, "done")
    true = [summary(here / "out" / f"round_{number}", "mpc")["errors"]["true"]["rms_m"] for number in (1, 2)]
    assert [found["true_rms_m"] for found in told["rounds"]] == true
    assert f"{1e3 * true[0]:.3g} → {1e3 * true[1]:.3g}" in done.out
    first, second = (read_run(here / "out" / f"round_{number}" / "log.csv") for number in (1, 2))
    for axis in "xyz":  # judged by the path, not by its corrected targets
        np.testing.assert_array_equal(first.extra[f"target_{axis}_m"], second.extra[f"target_{axis}_m"])
    again = tepm("mpc", *SHORT, "--learned", "out/learned.csv", "--out", "again", "--seed", 3)
    assert again.status == 0
    assert names_in(here / "again") == {"learned.csv", "round_1", "rounds.png", "summary.json"}
    commanded = read_run(here / "again" / "round_1" / "log.csv").inputs
    assert (commanded != first.inputs).any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--learn", 2, "--stay", 1), "--learn and --learned correct a path; leave --stay out"),
        (("--learned", "none.csv"), "none.csv"),
        (("--learned", "other.csv"), "correction: 2 targets; valid: "),
        (("--learned", "broken.csv"), "broken.csv: line 3: y_m is empty; valid: a finite number"),
    ],
)
def test_learning_that_makes_no_sense(tepm: Command, here: Path, options: tuple, message: str) -> None:
    (here / "other.csv").write_text("time_s,x_m,y_m,z_m\n0,0,0,0\n0.01,0,0,0\n")
    (here / "broken.csv").write_text("time_s,x_m,y_m,z_m\n0,0,0,0\n0.01,0,,0\n")
    done = tepm("mpc", *SHORT, *options)
    assert done.status == 2
    assert message in done.err


@pytest.mark.slow
def test_a_round_that_ends_early_teaches_nothing_and_loses_nothing(tepm: Command, here: Path) -> None:
    """A recording that is too short for the path."""
    assert tepm("mpc", *SHORT, "--out", "out").status == 0
    (here / "again").mkdir()
    (here / "again" / "learned.csv").write_text("mine")
    done = tepm("mpc", *SHORT[:-1], 2, "--rig", "replay:out/log.csv", "--learn", 2, "--out", "again")
    assert done.status == 1
    assert "1 of 2 rounds" in done.out
    assert "nothing that counts" in done.out
    assert "ended early: " in done.out
    assert (here / "again" / "learned.csv").read_text() == "mine"


OBSTACLES = """
[[spheres]]
name = "lamp"
centre_m = [0.03, 0.0, 0.35]
radius_m = 0.02
margin_m = 0.001
"""


@pytest.mark.slow
def test_keeping_out_with_free_progress(tepm: Command, here: Path) -> None:
    """Log, summary and words: how near the arm came, how far from the path it was."""
    (here / "o.toml").write_text(OBSTACLES, encoding="utf-8")
    done = tepm("mpc", *SHORT[:-2], "--keep-out", "o.toml", "--free-progress", "--out", "out", "--seed", 3)
    told = summary(here / "out", "mpc")
    assert told["keep_out"]["estimated"]["obstacle"] == "lamp"
    assert told["contour"]["true"]["rms_m"] < 5e-3
    assert "smallest distance to obstacles: in truth" in done.out
    assert done.status == int(bool(told["doubts"]))
    header = (here / "out" / "log.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert {"distance_m", "true_distance_m", "contour_error_m"} < set(header)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--keep-out", "none.toml"), "none.toml: cannot be read"),
        (("--keep-out", "o.toml"), "spheres entry 1: unknown key 'radius'"),
        (("--keep-out", "o.toml", "--learn", 2), "--keep-out does not go with --learn"),
        (("--sway", 3), "--sway belongs to --free-progress"),
        (("--free-progress", "--controller", "lqg"), "--free-progress is for a path and --controller mpc"),
    ],
)
def test_obstacles_and_progress_that_make_no_sense(tepm: Command, here: Path, options: tuple, message: str) -> None:
    (here / "o.toml").write_text(OBSTACLES.replace("radius_m", "radius"), encoding="utf-8")
    done = tepm("mpc", *SHORT, *options, "--out", "out")
    assert done.status == 2
    assert message in done.err
