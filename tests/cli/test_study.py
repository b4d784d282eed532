"""`tepm study blind` and `machines`: answers that are kept, what all of them say, a controller on random machines."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import Command
from tests.cli.tables import names_in, summary
from tests.studies.blind.test_analysis import result


@pytest.mark.slow
def test_data_sets_are_written_with_their_labels(tepm: Command, here: Path) -> None:
    done = tepm("study", "blind", "--trials", "1", "--family", "null", "--data", "data")
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
    done = tepm("study", "blind", "--trials", "3", "--family", "null", "--out", "out")
    assert done.status == 0, done.err
    assert done.out.startswith("3 trials: 3 null.\n")
    assert (here / "out" / "rates.png").exists()
    told = tepm("study", "blind", "--trials", "3", "--family", "null", "--out", "out", "--json").json()
    assert told["asked"] == {"trials": 3, "seed": 0, "family": "null", "version": told["asked"]["version"]}
    assert told == json.loads((here / "out" / "summary.json").read_text())["blind"]


def test_an_interruption_keeps_what_is_there(tepm: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*arguments: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tepm_opt.studies.blind.run._in_processes", interrupted)
    done = tepm("study", "blind", "--trials", "2", "--out", "out")
    assert done.status == 130
    assert done.out.startswith("0 of 2 trials are done; the same command goes on from there\n")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("--family opne", ("family 'opne'", "valid: closed, engine, null, open, poor, rod, wrong")),
        ("--trials 0", ("--trials",)),
        ("--scheduler tcp://127.0.0.1:9 --trials 1", ("scheduler",)),
        ("--out file", ("file",)),
    ],
)
def test_wrong_options(tepm: Command, here: Path, options: str, says: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    (here / "file").write_text("")
    done = tepm("study", "blind", *shlex.split(options))
    assert (done.status, done.out) == (2, ""), done.err
    assert len(done.err.splitlines()) == 1
    assert all(text in done.err for text in says), done.err


SHORT = ("line", "--from", "0.0,0,0.35", "--to", "0.004,0,0.35", "--duration", 0.2)


@pytest.mark.slow
@pytest.mark.parametrize("command", [("study", "machines"), ("mpc",)], ids=" ".join)
def test_random_machines(tepm: Command, here: Path, command: tuple[str, ...]) -> None:
    """A row a run, a figure, and the numbers of all in a line; `tepm mpc --machines` does the same until it goes."""
    done = tepm(*command, *SHORT, "--machines", 2, "--noises", 1, "--seed", 3, "--bound", 50, "--out", "out")
    assert done.status == 0
    assert "100 % within 50 mm" in done.out
    assert names_in(here / "out") == {"machines.csv", "machines.png", "summary.json"}
    assert summary(here / "out", "machines")["runs"] == 2
    old = "`tepm mpc --machines` is now `tepm study machines`; the old name goes with version 0.4\n"
    assert done.err == (old if command == ("mpc",) else "")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("mpc", *SHORT, "--machines", 2, "--rig", "sim:perfect"), "leave --rig, --view, --ros, --foxglove, --learn and --learned out"),
        (("mpc", *SHORT, "--learn", 2, "--machines", 2), "leave --rig, --view, --ros, --foxglove, --learn and --learned out"),
        (("mpc", *SHORT, "--noises", 2), "--noises: an option of tepm study machines"),
        (("study", "machines", *SHORT, "--machines", 0), "--machines"),
        (("study", "machines", *SHORT, "--sway", 5), "--sway belongs to --free-progress"),
        (("study", "machines", *SHORT, "--rig", "sim"), "--rig"),
    ],
)
def test_options_of_machines(tepm: Command, here: Path, arguments: tuple[object, ...], says: str) -> None:
    """An option that would be ignored is refused, and nothing is left behind."""
    done = tepm(*arguments)
    assert (done.status, done.out) == (2, "")
    assert says in done.err
    assert list(here.iterdir()) == []
