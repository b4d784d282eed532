"""Statistics of the checks, and which lines they name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.data.checks.findings import Subject, intervals, lines_text, noise_level
from tepm_opt.data.datasets import write_dataset
from tepm_opt.models.channels import check
from tests.data.made import NAMES, make_dataset


def test_noise_level() -> None:
    random = np.random.default_rng(0)
    time = np.arange(2000) / 50
    smooth = 0.05 * np.sin(2 * np.pi * 0.9 * time)
    values = np.stack([smooth + s * random.normal(size=2000) for s in (5e-4, 1e-3)], axis=1)
    values[100:120] += 0.3
    np.testing.assert_allclose(noise_level(values), [5e-4, 1e-3], rtol=0.15)
    assert np.isnan(noise_level(np.full((50, 1), np.nan))).all()


def test_intervals() -> None:
    assert intervals(np.array([True, True, False, True, False])) == [(0, 1), (3, 3)]
    assert intervals(np.zeros(3, dtype=bool)) == []


@pytest.mark.parametrize(
    ("lines", "text"),
    [([7], "line 7"), ([7, 8], "lines 7, 8"), ([7, 8, 9], "lines 7 to 9"), ([1, 3, 5, 7, 9, 11], "lines 1, 3, 5, 7 and 2 more")],
)
def test_lines(lines: list[int], text: str) -> None:
    assert lines_text(lines) == text


def test_lines_are_those_of_the_file(tmp_path: Path) -> None:
    write_dataset(make_dataset(), tmp_path)
    kept = (tmp_path / "steps.csv").read_text().splitlines()
    (tmp_path / "steps.csv").write_text("\n".join([*kept[:20], "", "", *kept[20:100], kept[99], *kept[100:]]) + "\n")
    assert [(f.row, f.last_row) for f in check(tmp_path)] == [(103, 103)]


def test_a_subject_without_time() -> None:
    run = replace(make_dataset().runs[0], time=np.full(300, np.nan))
    assert Subject(run, NAMES, None).step == 0.0
    assert Subject(run, NAMES, 50.0).step == 0.02
