"""Data sets that say which inputs gauges show, and which effects that leaves possible."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.data.trials import read_trials
from tepm_opt.discrepancy.preparation.measured_inputs import downstream_candidates, measured_inputs
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.errors import InputError

SIGNALS = Signals.from_names(("pressure", "valve"), ("y",), "m")
LAG, OFFSET = Candidate("lag", "pressure", stage="input"), Candidate("offset", "pressure", stage="input", gauge=True)
OTHER, BODY = Candidate("lag", "valve", stage="input"), Candidate("friction", "pressure")


def folder(path: Path, gauges: str) -> Path:
    (path / "a.csv").write_text("time_s,pressure,valve,y\n0,1,0,0\n1,2,0,1\n")
    (path / "dataset.toml").write_text(f'name = "a"\n{gauges}runs = [{{ file = "a.csv", role = "fit" }}]\n[noise]\ny = 0.1\n')
    return path


def test_a_data_set_says_which_inputs_are_shown_by_gauges(tmp_path: Path) -> None:
    assert read_trials(folder(tmp_path, ""), SIGNALS).gauges == ()
    assert read_trials(folder(tmp_path, 'gauges = ["pressure"]\n'), SIGNALS).gauges == ("pressure",)
    with pytest.raises(InputError, match="unknown input 'preasure'"):
        read_trials(folder(tmp_path, 'gauges = ["preasure"]\n'), SIGNALS)


def test_nothing_stands_between_a_command_and_what_a_gauge_shows_but_the_gauge() -> None:
    every = (LAG, OFFSET, OTHER, BODY)
    assert downstream_candidates(every, ()) == every
    assert downstream_candidates(every, ("pressure",)) == (OFFSET, OTHER, BODY)


def test_an_input_is_measured_where_all_runs_have_its_column() -> None:
    both = [
        Run(name, "fit", np.arange(3.0), np.zeros((3, 2)), np.zeros((3, 3)), np.zeros((3, 1, 1)), {"pressure_measured": measured})
        for name, measured in (("a", np.ones(3)), ("b", np.array([1.0, 2.0, np.nan])))
    ]
    assert measured_inputs(both, Signals.from_names(("pressure",), ("y",))) == ("pressure",)
    bare = Run("c", "fit", np.arange(3.0), np.zeros((3, 1)), np.zeros((3, 3)), np.zeros((3, 1, 1)))
    assert measured_inputs([*both, bare], Signals.from_names(("pressure",), ("y",))) == ()
