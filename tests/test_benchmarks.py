"""The frame of the benchmarks: what is refused before anything is compiled, targets, and the page of their figures."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from benchmarks.__main__ import main
from benchmarks.casadi_step import Case, filter_functions, horizon_functions, prepare_call
from benchmarks.goals import Goal, faster, times_real, within
from benchmarks.history import PAGE, page_text, read_history
from benchmarks.inputs import data_sets
from benchmarks.limit import Limit
from benchmarks.parts import goals
from benchmarks.timing import Contender, Task, measure
from tepm_opt.data.datasets import DataSet, write_dataset
from tepm_opt.data.run import Run
from tepm_opt.models.channels import channels_of
from tepm_opt.models.robot import load_robot


def described(folder: Path, static: bool = False) -> Path:
    """A data set of three rows."""
    robot = load_robot("kang2017")
    rows = np.zeros((3, 12)), np.zeros((3, 3)), np.zeros((3, 4, 3))
    time = np.full(3, np.nan) if static else np.arange(3) / 50
    write_dataset(
        DataSet("x", "kang2017", channels_of(robot), (Run("x.csv", "fit", time, *rows),), None if static else 50.0, None, static), folder
    )
    return folder


@pytest.fixture
def never_compiled(monkeypatch):
    """Whoever gets as far as compiling fails."""

    def refused(*_):
        pytest.fail("it went on to compile")

    monkeypatch.setattr("benchmarks.parts.tasks", refused)
    monkeypatch.setattr("benchmarks.__main__.tasks", refused)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--only", "stil"], "'stil' is not one of"),
        (["--limit", "nowhere"], "--limit nowhere: no time_limit.py there"),
        (["--json", "nowhere/figures.json"], "--json nowhere/figures.json: not a file in a folder that can be written to"),
        (["--json", "."], "--json .: not a file"),
        (["--page", "nowhere/page.html"], "--page nowhere/page.html: not a file in a folder that can be written to"),
        (["--reference", "nowhere"], "--reference nowhere: no dataset.toml there; valid: the folder of a data set"),
        (["--reference", "static"], "--reference static: equilibria; valid: a data set of motions of kang2017"),
        (["--data", "nowhere"], "--data nowhere: no dataset.toml there"),
    ],
)
def test_wrong_arguments_are_refused_before_compiling(never_compiled, tmp_path, monkeypatch, options, said):
    monkeypatch.chdir(tmp_path)
    described(tmp_path / "static", static=True)
    app = typer.Typer()
    app.command()(main)
    done = CliRunner().invoke(app, options)
    assert done.exit_code == 2
    assert said in " ".join(re.sub(r"\x1b\[[0-9;]*m|│", " ", done.output).split())


def test_a_folder_of_data_sets_is_all_of_them(tmp_path):
    for name in ("b", "a"):
        described(tmp_path / name)
    assert data_sets(tmp_path) == (tmp_path / "a", tmp_path / "b")
    assert data_sets(tmp_path / "a") == (tmp_path / "a",)
    assert data_sets(None) == ()


def contender(name: str, answer: float = 0.0) -> Contender:
    return Contender(name, lambda: None, lambda _: np.array([answer]))


class TestMeasure:
    @pytest.fixture
    def limit(self, tmp_path) -> Limit:
        return Limit(None, tmp_path)

    def test_wrong_answers_have_no_ratio(self, limit):
        task = Task("x", "X", np.zeros(1), [contender("ours"), contender("peer"), contender("wrong", 1.0)])
        measure(task, 6, quick=False)
        assert [c.verdict for c in task.contenders] == ["right", "right", "wrong"]
        for one, seconds in zip(task.contenders, (0.5, 2.0, 8.0), strict=True):
            one.rounds = {turn: [seconds * (turn + 1)] for turn in range(6)}  # what slows the machine slows both
        assert faster("x", "n", 1.5, "peer").measured([task], limit) == 4
        assert np.isnan(faster("x", "n", 1.5, "wrong").measured([task], limit))

    def test_a_long_task_runs_once(self, limit):
        calls = []
        once = Contender("long", lambda: calls.append(0), lambda _: np.zeros(1))
        task = Task("x", "X", np.zeros(1), [once], once=True)
        measure(task, 10, quick=False)
        assert len(calls) == len(once.times) == 1

    @pytest.mark.parametrize(
        ("figure", "met"), [(1.9, (False, True)), (2.1, (True, False)), (2.0, (True, True)), (0.0, (False, True)), (np.nan, (None, None))]
    )
    def test_both_kinds_of_bound(self, figure, met):
        both = [Goal("x", "n", "t", lambda *_: figure, 2.0, at_least) for at_least in (True, False)]
        assert tuple(goal.met(figure) for goal in both) == met
        if met[0] is not None:
            assert tuple(goal.margin(figure) >= 1 for goal in both) == met

    def test_times(self, limit):
        task = Task("x", "X", np.zeros(1), [contender("ours")], simulated=10.0)
        task.contenders[0].verdict, task.contenders[0].rounds = "right", {0: [0.5]}
        assert times_real("x", "n", 1, "t").measured([task], limit) == 20
        assert within("x", "n", 1, "t").measured([task], limit) == 0.5


def test_figures_have_names_of_their_own():
    names = [goal.name for goal in goals()]
    assert len(set(names)) == len(names) > 25
    assert {name for named in read_history().values() for name in named} <= set(names)


def test_the_page_shows_the_history():
    assert page_text(read_history()) == PAGE.read_text(encoding="utf-8")


def test_the_controller_s_arithmetic_in_casadi_is_the_controller_s() -> None:
    """Else its times would say nothing of the controller."""
    case = Case()
    for function in [*filter_functions(), *horizon_functions()]:
        call, found = prepare_call(function, case.arguments[function.name()])
        call()
        for values, right in zip(found, case.answers[function.name()], strict=True):
            assert values == pytest.approx(np.ravel(right, order="F"), rel=1e-9, abs=1e-12 * np.abs(right).max())
