"""Tables of sixteen laboratories become data sets that hold the motion they were made of, within what theory says of resampling."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.run import run_columns
from tepm_opt.jobs.check import run_check
from tepm_opt.jobs.import_data import ImportRun, run_import
from tepm_opt.models.channels import open_dataset
from tests.data.importing.layouts import LAYOUTS, Foreign
from tests.data.importing.truth import COMMANDS, PLACES, hold_error, line_error, signals, spline_error

MOST_LINES = 15
RIPPLE = 1e-3  # of the filter, 60 dB, on what moves


def brought(foreign: Foreign, folder: Path) -> ImportRun:
    (folder / "map.toml").write_text(foreign.map, encoding="utf-8")
    run = run_import(foreign.files, folder / "map.toml")
    run.save(folder / "out")
    return run


def allowed(foreign: Foreign, run: int, name: str) -> float:
    """By how much a value on the grid may be off."""
    measured, commanded = foreign.step
    if name in PLACES:
        moving = float(np.ptp(signals(np.linspace(1, 5, 401), run)[name]))
        return spline_error(measured, run)[name] + (RIPPLE * moving if foreign.filtered else 0.0) + foreign.rounding
    kind = hold_error if foreign.hold else line_error
    return kind(commanded, run)[name] + 1e-6 * (1.5e5 if name.endswith("Pa") else 2.0)


@pytest.mark.sample(3)
@pytest.mark.parametrize("name", LAYOUTS)
def test_the_motion_is_the_one_in_the_tables(name: str, tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    foreign = LAYOUTS[name](tmp_path)
    assert len(foreign.map.strip().splitlines()) <= MOST_LINES
    run = brought(foreign, tmp_path)
    dataset = open_dataset(tmp_path / "out")
    assert [each.file for each in dataset.runs] == [f"{one}.csv" for one in foreign.runs]
    for each, (which, made) in zip(dataset.runs, foreign.runs.items(), strict=True):
        columns, truth = run_columns(each, dataset.channels), signals(each.time, made)
        assert each.duration > 5.9, which
        assert np.allclose(np.diff(each.time), 1 / (dataset.sample_rate or 0), rtol=1e-6)
        for column in (*COMMANDS, *PLACES):
            if column in foreign.filled:
                seen = np.isfinite(columns[column])
                assert seen.sum() >= each.rows - 8, "no more is lost than was"
                worst = np.abs(columns[column] - truth[column])[seen].max()
                assert worst <= allowed(foreign, made, column), (column, worst)
            else:
                assert not np.nan_to_num(columns[column]).any(), column
    assert not [finding for finding in run.findings if finding.severity == "error"]
    assert not run_check(tmp_path / "out").errors


def test_words_say_what_was_left_open(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    run = brought(LAYOUTS["pneumatic_only_with_quaternions"](tmp_path), tmp_path)
    notes = "\n".join(run.notes)
    assert "no tension in the map: 0 N throughout (no tendons, or tendons that follow)" in notes
    assert "no place for orientations: s1/qw, s1/qx" in notes
    (tmp_path / "tip").mkdir()
    tip = brought(LAYOUTS["tip_alone_without_header"](tmp_path / "tip"), tmp_path / "tip")
    assert "s1, s2, s3: not measured, left empty" in "\n".join(tip.notes)


def test_two_clocks_begin_where_both_have_begun(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    run = brought(LAYOUTS["two_files_a_run"](tmp_path), tmp_path)
    assert run.dataset is not None
    assert [each.began for each in run.dataset.runs] == pytest.approx([0.0, 100.0])
    assert {row["entry"]: row["filtered"] for row in run.rows()} == {"pressure": False, "tension": False, "position": True}


def test_lost_samples_stay_lost(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    run = brought(LAYOUTS["stacked_runs"](tmp_path), tmp_path)
    assert run.dataset is not None
    lost = ~np.isfinite(run.dataset.runs[0].points[:, 1]).all(axis=1)
    assert np.flatnonzero(lost).tolist() == [100, 101]


def test_extra_columns_and_gauges_are_kept(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    run = brought(LAYOUTS["dates_in_latin_1"](tmp_path), tmp_path)
    assert run.dataset is not None
    kept = run.dataset.runs[0]
    assert kept.extra["temperature_C"] == pytest.approx(20 + kept.time, abs=1e-6)
    (tmp_path / "gauges").mkdir()
    gauges = brought(LAYOUTS["rows_without_time"](tmp_path / "gauges"), tmp_path / "gauges").dataset
    assert gauges is not None
    assert gauges.runs[0].extra["pressure_11_measured_Pa"] == pytest.approx(1.01 * gauges.runs[0].inputs[:, 0], rel=1e-6)
