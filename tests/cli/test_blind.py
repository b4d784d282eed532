"""`tepm blind`: data sets with labels, answers that are kept, and what all of them say."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.blind.test_analysis import result
from tests.cli.conftest import Command


@pytest.mark.slow
def test_data_sets_are_written_with_their_labels(tepm: Command, here: Path) -> None:
    done = tepm("blind", "--trials", "1", "--family", "null", "--data", "data")
    assert (done.status, done.out) == (0, "1 data sets in data\n"), done.err
    assert {path.name for path in (here / "data").iterdir()} == {"null_000", "labels"}
    label = json.loads((here / "data" / "labels" / "null_000.json").read_text())
    assert (label["names"], label["kind"]) == ([], "null")
    checked = tepm("data", "check", "data/null_000")
    assert checked.status == 0, checked.out + checked.err


def test_answers_that_are_there_are_told(tepm: Command, here: Path) -> None:
    """Without a new trial: all that were asked for are done."""
    (here / "out").mkdir()
    lines = [result("null", [], "no_discrepancy", [], number) for number in range(3)]
    (here / "out" / "trials.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    done = tepm("blind", "--trials", "3", "--family", "null", "--out", "out")
    assert done.status == 0, done.err
    assert done.out.startswith("3 trials: 3 null.\n")
    assert (here / "out" / "rates.png").exists()
    told = tepm("blind", "--trials", "3", "--family", "null", "--out", "out", "--json").json()
    assert told["asked"] == {"trials": 3, "seed": 0, "family": "null", "version": told["asked"]["version"]}
    assert told == json.loads((here / "out" / "summary.json").read_text())["blind"]


def test_an_interruption_keeps_what_is_there(tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*arguments: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tepm_opt.jobs.blind._in_processes", interrupted)
    done = tepm("blind", "--trials", "2", "--out", "out")
    assert done.status == 130
    assert done.out.startswith("0 of 2 trials are done; the same command goes on from there\n")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("--family opne", ("family 'opne'", "valid: closed, null, open, poor, wrong")),
        ("--trials 0", ("--trials",)),
        ("--scheduler tcp://127.0.0.1:9 --trials 1", ("scheduler",)),
        ("--out file", ("file",)),
    ],
)
def test_wrong_options(tepm: Command, here: Path, options: str, says: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    (here / "file").write_text("")
    done = tepm("blind", *shlex.split(options))
    assert (done.status, done.out) == (2, ""), done.err
    assert len(done.err.splitlines()) == 1
    assert all(text in done.err for text in says), done.err
