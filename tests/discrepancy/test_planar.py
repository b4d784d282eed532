"""Points of which only x and y are measured, as one camera does: every number that is told is one."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.cli import run as tepm
from tepm_opt.models.compile import CompiledModel
from tests.discrepancy.small import NOISE, changed, cut, dataset_of, measured, planned, true_values, write

PERCENT = 1.12  # of the stiffness, beyond its prior


@pytest.fixture(scope="module")
def folder(kang: CompiledModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a machine of another stiffness does in the plane of x and y."""
    values = true_values(kang)
    runs = measured(changed(kang, **values | {"K_a": PERCENT * values["K_a"]}), planned())
    flat = [cut(replace(run, points=np.where([True, True, False], run.points, np.nan)), 4.0) for run in runs]
    return write(dataset_of(kang, flat), tmp_path_factory.mktemp("planar"))


@pytest.mark.slow
def test_errors_of_two_axes_are_numbers(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert tepm(["discrepancy", str(folder), "--out", str(out), "--json"]) in (0, 1)
    verdict = json.loads(capsys.readouterr().out)
    errors = verdict["rmse_m"]
    assert all(isinstance(value, float) for value in errors.values()), errors
    assert errors["noise_floor"] == pytest.approx(np.sqrt(2) * NOISE, rel=1e-4)
    assert errors["noise_floor"] < errors["recalibrated"] < errors["nominal"]
    assert {place["name"] for place in verdict["where"] if place["by"] == "axis"} <= {"x", "y"}
    words = [verdict["paragraph"], *verdict["notes"], (out / "report.html").read_text(encoding="utf-8").split("data:image")[0]]
    assert not re.search(r"\bnan\b", json.dumps(verdict) + " ".join(words), re.IGNORECASE)


@pytest.mark.slow
def test_identification_tells_errors_of_two_axes(folder: Path, tmp_path: Path) -> None:
    assert tepm(["identify", str(folder), "--out", str(tmp_path)]) in (0, 1)
    found = json.loads((tmp_path / "identified.json").read_text(encoding="utf-8"))
    assert "NaN" not in json.dumps(found)
