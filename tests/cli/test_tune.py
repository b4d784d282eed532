"""`tepm tune`: from a closed loop to a model file that the next loop takes."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from tepm_opt.jobs.course import Course
from tepm_opt.models.model import FILTER_UNITS
from tests.cli.conftest import Command

pytest.importorskip("mujoco")


@pytest.mark.slow
def test_tune_from_loop_to_loop(tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tepm_opt.jobs.course.FULL", Course(approach=1.0, pause=0.02, start_up=0.5))
    assert tepm("mpc", "circle", "--duration", 3, "--out", "run").status == 0
    told = tepm("tune", "run", "--out", "tuned.toml")
    assert told.status == 0, told.err
    assert "chosen" in told.out
    assert "hand-set" in told.out
    assert told.out.splitlines()[-1].endswith("tepm mpc circle --model tuned.toml")
    levels = tomllib.loads((here / "tuned.toml").read_text(encoding="utf-8"))["filter"]
    assert set(levels) == set(FILTER_UNITS)
    as_json = tepm("tune", "run/log.csv", "--model", "tuned.toml", "--json").json()
    assert as_json["filter"] == levels  # tuned once more from the hand-set values, not from the tuned ones
    assert json.dumps(as_json["candidates"][0]["friction_scale"]) == "1.0"
    assert tepm("mpc", "circle", "--duration", 3, "--model", "tuned.toml", "--out", "again").status == 0


def test_a_log_that_is_not_there(tepm: Command, here: Path) -> None:
    told = tepm("tune", "nothing.csv")
    assert told.status == 2
    assert "nothing.csv" in told.err
    assert not list(here.iterdir())
