"""Tables after public reports: what is said of them, and that following the proposals ends in a data set."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.importing.advice import merge_maps
from tepm_opt.errors import InputError
from tepm_opt.jobs.import_data import ImportRun, run_import, suggest_map
from tests.data.importing.test_refusals import entries, write_map
from tests.paths import SHARED

pytest.importorskip("pandas")


def case(name: str) -> Path:
    path = SHARED / "cases" / name
    if not path.exists():
        pytest.skip(f"{path} is not on this machine")
    return path


def followed(file: Path, text: str, folder: Path) -> tuple[list[str], ImportRun]:
    """All refusals of a map, and the data set after their proposals."""
    content, said = tomllib.loads(text), []
    while len(said) < 6:
        try:
            return said, run_import([file], write_map(folder / "map.toml", content))
        except InputError as error:
            said.append(str(error))
            if not entries(str(error)):
                raise
            for entry in entries(str(error)):
                content = merge_maps(content, tomllib.loads(entry))
    raise AssertionError(said)


def test_coils_with_a_time_in_four_columns(tmp_path: Path) -> None:
    file = case("01-ndi-aurora/coils.csv")
    guess = suggest_map([file])
    assert 'column = ["Hour", "Minutes", "Seconds", "ms"], unit = ["h", "min", "s", "ms"]' in guess
    assert '"Xa", "Ya", "Za", "Xb", "Yb", "Zb", "Xc", "Yc", "Zc", "Xd", "Yd", "Zd"], unit = "mm", missing = [0]' in guess
    assert 'short_rows = "ends"' in guess
    _, run = followed(file, guess, tmp_path)
    assert run.dataset is not None
    assert run.dataset.runs[0].duration == pytest.approx(7.38, abs=0.05)
    assert "has 5 of 33 fields: left out" in "\n".join(run.notes)


def test_seven_header_rows(tmp_path: Path) -> None:
    folder = case("03-motive-seven-rows")
    guess = suggest_map([folder / "motive.csv"])
    assert "csv = { header = 7, groups = 4 }" in guess
    assert 'time = { column = "Time (Seconds)", unit = "s" }  # the file states 120 Hz' in guess
    assert "Marker 001 X" in guess
    for name in ("naive", "n2", "n3"):
        _, run = followed(folder / "motive.csv", (folder / f"{name}.toml").read_text(), tmp_path)
        assert run.rate == pytest.approx(120, rel=1e-3)


def test_a_log_that_begins_and_ends_within_a_line(tmp_path: Path) -> None:
    folder = case("06-cut-rows")
    for name in ("m_crash", "m_crash2"):
        said, run = followed(folder / "crash.csv", (folder / f"{name}.toml").read_text(), tmp_path)
        assert "line 2 has 8 of 25 fields, line 427 has 14 of 25 fields: cut off?" in said[0]
        assert run.runs[0].rows > 400


@pytest.mark.parametrize("name", ["ndi_bad", "m9999"])
def test_codes_for_lost_markers(name: str, tmp_path: Path) -> None:
    folder = case("07-sentinel")
    for one in ("map", "m_nb2"):
        said, run = followed(folder / f"{name}.csv", (folder / f"{one}.toml").read_text(), tmp_path)
        assert "the same three numbers" in said[0]
        assert "a code for lost samples?; put into the map: position.missing = [" in said[0]
        assert run.dataset is not None
        assert np.nanmax(np.abs(run.dataset.runs[0].points)) < 1


@pytest.mark.parametrize("name", ["two_rows.csv", "unicode.txt"])
def test_names_over_two_rows_and_wide_text(name: str, tmp_path: Path) -> None:
    file = case("09-two-header-rows") / name
    _, run = followed(file, suggest_map([file]), tmp_path)
    assert run.dataset is not None
    assert np.isfinite(run.dataset.runs[0].points).all()
