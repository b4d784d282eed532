"""Listings of docs/how-to/any_machine.md, run in an empty folder: what is hidden is named, and nothing where nothing is."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import script
from tests.discrepancy.machines import arm, drive

ROOT = Path(__file__).resolve().parents[2]
LISTINGS = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "how-to" / "any_machine.md").read_text(encoding="utf-8"), re.DOTALL)
NAMES = ("linear_drive", "two_link_arm", "motor")


@pytest.mark.parametrize(("name", "listing"), list(zip(NAMES, LISTINGS, strict=True)), ids=NAMES)
def test_the_page_shows_the_examples(name: str, listing: str) -> None:
    assert listing == (ROOT / "examples" / f"{name}.py").read_text(encoding="utf-8")
    assert listing.count("\n") < 60


def answer(folder: Path, listing: str, data: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[int, dict[str, Any]]:
    """Exit status and verdict of the program in an empty folder with nothing but the listing."""
    here = folder / "empty"
    here.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    Path("machine.py").write_text(listing, encoding="utf-8")
    done = script("discrepancy", data, "--plant", "machine.py", "--out", "found", "--json")
    assert done.status in (0, 1), done.err
    assert json.loads(done.out) == json.loads(Path("found/verdict.json").read_text())
    assert {path.name for path in here.iterdir()} <= {"machine.py", "found", "__pycache__"}
    assert {"report.html", "values.json", "verdict.json"} <= {path.name for path in Path("found").iterdir()}
    return done.status, json.loads(done.out)


def named(verdict: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Values of the parameters of the effects that are named."""
    return {
        f"{effect['name']}[{effect['detail']}]": {name: value["value"] for name, value in effect["parameters"].items()}
        for effect in verdict["effects"]
    }


@pytest.mark.slow
def test_friction_of_the_drive_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    status, verdict = answer(tmp_path, LISTINGS[0], drive(tmp_path / "data", friction=8.0), monkeypatch)
    assert (status, verdict["status"]) == (0, "named"), verdict["paragraph"]
    assert named(verdict) == {"dry_friction[rail]": {"force": pytest.approx(8.0, rel=0.02)}}
    assert verdict["effects"][0]["probability"] > 0.9
    assert verdict["effects"][0]["parameters"]["force"]["unit"] == "N"
    assert verdict["recalibrated"]["mass"]["value"] == pytest.approx(10.4, rel=0.01)
    assert verdict["rmse_m"]["corrected"] < 1.2e-4 < 5e-3 < verdict["rmse_m"]["recalibrated"]


@pytest.mark.slow
def test_nothing_is_named_on_a_drive_in_which_nothing_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    status, verdict = answer(tmp_path, LISTINGS[0], drive(tmp_path / "data"), monkeypatch)
    assert (status, verdict["status"], verdict["effects"]) == (0, "no_discrepancy", []), verdict["paragraph"]
    assert verdict["recalibrated"]["mass"]["value"] == pytest.approx(10.4, rel=0.01)


@pytest.mark.slow
def test_a_constant_force_is_told_besides_but_not_from_the_amplifiers_zero(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In these equations the two are the same: a constant in one sum. Both stand there, neither is sure."""
    status, verdict = answer(tmp_path, LISTINGS[0], drive(tmp_path / "data", friction=8.0, offset=5.0), monkeypatch)
    assert (status, verdict["status"]) == (1, "indistinguishable"), verdict["paragraph"]
    found = named(verdict)
    assert set(found) == {"dry_friction[rail]", "constant_force[rail]", "input_offset[force]"}
    assert found["dry_friction[rail]"]["force"] == pytest.approx(8.0, rel=0.02)
    assert found["constant_force[rail]"]["force"] == pytest.approx(5.0, rel=0.02)
    assert found["input_offset[force]"]["offset"] == pytest.approx(5.0, rel=0.02)


@pytest.mark.slow
def test_friction_of_the_elbow_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    status, verdict = answer(tmp_path, LISTINGS[1], arm(tmp_path / "data", friction=0.15), monkeypatch)
    assert (status, verdict["status"]) == (0, "named"), verdict["paragraph"]
    assert named(verdict) == {"dry_friction[elbow]": {"force": pytest.approx(0.15, rel=0.05)}}
    assert verdict["effects"][0]["parameters"]["force"]["unit"] == "N m"
    assert verdict["recalibrated"]["upper_mass"]["value"] == pytest.approx(1.55, rel=0.02)


@pytest.mark.slow
def test_nothing_is_named_on_an_arm_in_which_nothing_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    status, verdict = answer(tmp_path, LISTINGS[1], arm(tmp_path / "data"), monkeypatch)
    assert (status, verdict["status"], verdict["effects"]) == (0, "no_discrepancy", []), verdict["paragraph"]
    assert verdict["recalibrated"]["fore_mass"]["value"] == pytest.approx(0.96, rel=0.02)
    assert verdict["rmse"]["corrected"] == pytest.approx(1e-3, rel=0.05)
