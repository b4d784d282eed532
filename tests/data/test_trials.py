"""Data sets of any machine: what is read, how runs are cut, and one clear line for what is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.data.trials import pieces, read_trials
from tepm_opt.errors import InputError

SIGNALS = Signals.from_names(("force",), ("position", "angle"))
TOML = """name = "a drive"
runs = [
  { file = "one.csv", role = "fit" },
  { file = "two.csv", role = "validation", start = "measured", group = "warm" },
]
[noise]
position = 1e-3
angle = 0.2
"""
CSV = """time_s,force,position,angle,remark
0,1,0.1,2,early
0.5,2,,3,
1.25,-3,0.3,nan,late
"""


def written(folder: Path, toml: str = TOML, csv: str = CSV) -> Path:
    (folder / "dataset.toml").write_text(toml)
    for name in ("one.csv", "two.csv"):
        (folder / name).write_text(csv)
    return folder


def test_what_is_written_is_read(tmp_path: Path) -> None:
    trials = read_trials(written(tmp_path), SIGNALS)
    assert repr(trials) == "Trials(a drive: 1 runs to fit to, 1 to judge by)"
    one, two = trials.runs
    np.testing.assert_array_equal(one.time, [0, 0.5, 1.25])
    np.testing.assert_array_equal(one.inputs, [[1], [2], [-3]])
    np.testing.assert_array_equal(one.points, np.array([[0.1, 2], [np.nan, 3], [0.3, np.nan]])[..., None])
    np.testing.assert_array_equal(one.extra["remark"], ["early", "", "late"])
    assert (one.start, one.group, one.role, two.start, two.group, two.role) == ("equilibrium", "", "fit", "measured", "warm", "validation")
    assert [one.line(k) for k in range(3)] == [2, 3, 4]
    np.testing.assert_array_equal(trials.noise, [[1e-3], [0.2]])


def test_inputs_need_not_be(tmp_path: Path) -> None:
    trials = read_trials(written(tmp_path), Signals.from_names((), ("position", "angle")))
    assert trials.runs[0].inputs.shape == (3, 0)
    assert set(trials.runs[0].extra) == {"force", "remark"}


WRONG = {
    "no noise": (TOML.replace("angle = 0.2", ""), CSV, "noise of 'angle' is missing or not positive"),
    "no size of noise": (TOML.replace("0.2", "0.0"), CSV, "noise of 'angle' is missing or not positive"),
    "noise without end": (TOML.replace("0.2", "inf"), CSV, "noise: angle = inf: input should be a finite number"),
    "noise of nothing": (TOML + "angel = 1.0\n", CSV, "unknown output 'angel'"),
    "file twice": (TOML.replace("two.csv", "one.csv"), CSV, "'one.csv' is listed twice"),
    "pieces of a run at rest": ('piece_s = 1.0\nstart = "measured"\n' + TOML, CSV, 'valid: with start = "free"'),
    "pieces without rows": ('piece_s = 0.1\nstart = "free"\n' + TOML, CSV, "piece_s = 0.1 is shorter than the steps of one.csv"),
    "unknown start": (TOML.replace("measured", "moving"), CSV, "start"),
    "unknown key": (TOML.replace("group", "groop"), CSV, "groop"),
    "no input": (TOML, CSV.replace("force", "farce"), "column 'force' is missing; found: time_s, farce"),
    "no input and no output": (TOML, CSV.replace("force", "farce").replace("angle", "angel"), "'force' is missing (and angle)"),
    "empty input": (TOML, CSV.replace("0.5,2", "0.5,"), "line 3: force is empty; valid: a finite number"),
    "time that goes back": (TOML, CSV.replace("0.5,", "0,"), "line 3: time_s = 0; valid: larger than in the row before"),
    "endless output": (TOML, CSV.replace("0.3", "inf"), "line 4: position = inf; valid: a finite number"),
    "text": (TOML, CSV.replace("0.3", "a lot"), "line 4"),
}


@pytest.mark.parametrize(("toml", "csv", "says"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_is_told_in_a_line(tmp_path: Path, toml: str, csv: str, says: str) -> None:
    with pytest.raises(InputError) as error:
        read_trials(written(tmp_path, toml, csv), SIGNALS)
    assert says in str(error.value)
    assert str(tmp_path) in str(error.value)
    assert "\n" not in str(error.value)


def test_folder_without_description(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no dataset\.toml"):
        read_trials(tmp_path, SIGNALS)


def test_runs_to_fit_to_are_cut_where_asked_for(tmp_path: Path) -> None:
    trials = read_trials(written(tmp_path, 'piece_s = 0.6\nstart = "free"\n' + TOML), SIGNALS)
    assert [(run.file, run.rows) for run in trials.runs] == [("one.csv from 0 s", 2), ("two.csv", 3)]  # the last sample alone is none


@given(
    st.lists(st.floats(1e-3, 3.0), min_size=0, max_size=40),
    st.floats(0.2, 5.0),
    st.floats(-100.0, 100.0),
)
def test_pieces_hold_all_rows_in_order_and_are_no_longer_than_two(steps: list[float], seconds: float, begin: float) -> None:
    time = begin + np.concatenate([[0.0], np.cumsum(steps)])
    rows = len(time)
    number = np.arange(float(rows))
    run = Run("a.csv", "fit", time, number[:, None], np.zeros((rows, 3)), number[:, None, None], {"n": number}, tuple(range(rows)), "free")
    cut = pieces(run, seconds)
    kept = np.concatenate([np.zeros(0), *(piece.inputs[:, 0] for piece in cut)])
    assert (np.diff(kept) > 0).all()
    for piece in cut:
        first = round(piece.inputs[0, 0])
        assert piece.file == f"a.csv from {time[first]:g} s"
        assert (piece.role, piece.start) == ("fit", "free")
        assert piece.duration <= 2 * seconds + 1e-6
        at = piece.inputs[:, 0]
        for same in (piece.points[:, 0, 0], piece.extra["n"], np.array(piece.lines)):
            np.testing.assert_array_equal(same, at)
        np.testing.assert_array_equal(piece.time, time[at.astype(int)])
    left_out = np.setdiff1d(number, kept).astype(int)
    begins = np.floor((time - time[0]) / seconds + 1e-9)
    for row in left_out:  # alone in its piece
        assert (np.delete(begins, row) != begins[row]).all()
