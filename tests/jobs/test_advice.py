"""What to do after a verdict: a command for every status that the program takes, with the files of the run."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer

from tepm_opt.cli.program import app
from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.reporting.sentences import ONE_CLOCK, next_step
from tepm_opt.discrepancy.state import Discovery
from tepm_opt.jobs.advice import Asked, add_advice
from tests.discrepancy.test_report import LOCALISATION, VERDICT


def told(status: VerdictStatus, asked: Asked, shift: str = "", static: bool = False, law: Any = None) -> tuple[str, list[list[str]]]:
    """What is advised, and the commands, all of which the program takes."""
    runs = [SimpleNamespace(file="a.csv", role="fit"), SimpleNamespace(file="b c.csv", role="validation")]
    dataset: Any = SimpleNamespace(runs=runs, static=static)
    verdict = replace(VERDICT, status=status, next=next_step(status, shift))
    found = add_advice(Discovery(verdict, dataset, 1e-3, LOCALISATION, {}, None, law), asked).verdict  # type: ignore[arg-type]
    commands = [shlex.split(command) for command in found.command.split(" && ")] if found.command else []
    for program, verb, *arguments in commands:
        assert program == "tepm"
        typer.main.get_command(app).commands[verb].make_context(verb, list(arguments))  # type: ignore[attr-defined]  # refuses wrong options
    return found.next, commands


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A data set's folder with its runs, in the working folder."""
    monkeypatch.chdir(tmp_path)
    Path("bench").mkdir()
    for name in ("a.csv", "b c.csv"):
        (Path("bench") / name).touch()
    return Path("bench")


@pytest.mark.parametrize("status", list(VerdictStatus))
def test_every_status_has_a_command(bench: Path, status: VerdictStatus) -> None:
    step, commands = told(status, Asked(bench, Path("found")))
    assert step
    assert commands


def test_a_model_is_shown_beside_a_run_that_was_not_fitted_to(bench: Path) -> None:
    _, (command,) = told(VerdictStatus.NAMED, Asked(bench, Path("found")))
    assert command == ["tepm", "simulate", "bench/b c.csv", "--model", "found/model.toml", "--out", "found/beside"]
    _, (command,) = told(VerdictStatus.NO_DISCREPANCY, Asked(bench, Path("found")), static=True)
    assert command[1] == "statics"


def test_what_cannot_be_told_apart_is_recorded_on_the_same_rig(bench: Path) -> None:
    asked = Asked(bench, Path("found"), model=Path("lab.toml"), add=(Path("more"),))
    _, (proposed, recorded, again) = told(VerdictStatus.INDISTINGUISHABLE, asked)
    assert proposed == ["tepm", "data", "next", "found", "--out", "found/run2.toml"]
    assert recorded[-4:] == ["--rig", "RIG", "--out", "found/extra2"]
    assert again == shlex.split("tepm discrepancy bench --model lab.toml --add more --add found/extra2 --out found")
    (bench / "recording.json").write_text(json.dumps({"rig": "sim:machine.toml"}))
    assert "sim:machine.toml" in told(VerdictStatus.INDISTINGUISHABLE, asked)[1][1]


def test_a_law_is_sought_once(bench: Path) -> None:
    _, (command,) = told(VerdictStatus.PARTIAL, Asked(bench, Path("found")))
    assert command == ["tepm", "discrepancy", "bench", "--invent", "--out", "found"]
    asked = Asked(bench, Path("found"), invent=True, despite_errors=True, effects=(Path("mine.py"),))
    step, (command,) = told(VerdictStatus.UNEXPLAINED, asked)
    assert command == shlex.split("tepm discrepancy bench --despite-errors --effects mine.py --out found")
    assert step.endswith("ask again")
    law = SimpleNamespace(file=Path("found/effects/law.py"))
    assert "--effects found/effects/law.py" in " ".join(
        told(VerdictStatus.PARTIAL, Asked(bench, Path("found"), invent=True), law=law)[1][0]
    )


def test_a_clock_comes_first(bench: Path) -> None:
    step, (command,) = told(VerdictStatus.UNEXPLAINED, Asked(bench, Path("found")), "all runs: shifted clock")
    assert step == f"{ONE_CLOCK}, then ask again"
    assert "--invent" not in command


def test_another_machine(bench: Path) -> None:
    asked = Asked(bench, Path("found"), plant=Path("slide.py"))
    for status in VerdictStatus:
        assert told(status, asked)[1] == [shlex.split("tepm discrepancy bench --plant slide.py --out found")]
    assert told(VerdictStatus.NAMED, asked)[0] == "take the values of found/values.json over into slide.py, then ask again"


def test_a_run_that_is_not_there_is_not_named(tmp_path: Path) -> None:
    assert told(VerdictStatus.NAMED, Asked(tmp_path, Path("found")))[1] == []
