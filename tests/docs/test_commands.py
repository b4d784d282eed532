"""README, tutorial and the page of commands as a reader follows them: in order, in one folder; prints how long each took (`-s`).

What needs the board speaks to the emulated one. What takes minutes is left to `-m study`, with what it needs from there on.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tepm_opt.cli import rigs, run
from tepm_opt.cli.hw import shared as hw_shared
from tepm_opt.hw.board.rig import SerialRig
from tepm_opt.hw.service.line import Line
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.models.robot import load_robot
from tests.docs.texts import ROOT, Step, answers, steps
from tests.hw.conftest import *  # noqa: F403  its fixtures
from tests.hw.emulator import Board
from tests.hw.emulator.world import World
from tests.hw.test_loop import hurry

COMMANDS = ROOT / "docs" / "reference" / "commands.md"
LONG = ("tepm identify", "tepm discrepancy", "tepm update-model", "tepm demo", "tepm study", "tepm data excite")
LACKING = ("tepm identify", "tepm discrepancy", "tepm update-model", "tepm hw check", "tepm data excite")
"""Those whose status 1 is an answer: the model lacks something, commissioning is not over, a value has no influence in any run."""
SERVING = ("tepm studio",)
BOARD = ("serial:", "tepm hw check")
FROM_VERDICT = ("found", "corrected")
"""Folders that there are only after a long command."""
OWN_TABLE = "log.csv"
"""The reader's own recording in the README."""
CHOOSE = ROOT / "docs" / "how-to" / "choose.md"
NO_DATA = ("tepm discrepancy after", "tepm discrepancy data", "tepm data next")
"""Questions about data sets or a verdict that the page's other commands do not leave behind."""
FEWEST = {"README.md": 4, "docs/tutorial.md": 6, "docs/reference/commands.md": 25}
"""Commands of each document that run at least."""


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """An environment whose `tepm` is this one."""
    programs = tmp_path / "bin"
    programs.mkdir()
    (programs / "tepm").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m tepm_opt "$@"\n')
    (programs / "tepm").chmod(0o755)
    return {**os.environ, "PATH": f"{programs}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}


def followed(step: Step, folder: Path, environment: dict[str, str]) -> tuple[int, str, float]:
    """Status, output and duration of a command; one that serves a page is ended by Ctrl-C once it has said where."""
    began = time.monotonic()
    process = subprocess.Popen(
        ["bash", "-c", f"exec {step.text}" if step.text.startswith(SERVING) else step.text], cwd=folder, env=environment, text=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    if step.text.startswith(SERVING) and process.stdout:
        first = process.stdout.readline()
        while first and "http://127.0.0.1" not in first:
            first = process.stdout.readline()
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=120)
        return (0 if process.returncode in (0, 130) and first else 1), first + rest, time.monotonic() - began
    out, _ = process.communicate()
    return process.returncode, out, time.monotonic() - began


def follow(document: Path, folder: Path, environment: dict[str, str], long: bool) -> int:
    """Run all commands of a document in order, but for those that set up and those that need the board; how many there were.

    Args:
        document: README, tutorial or page of commands.
        folder: where; empty.
        environment: of the commands.
        long: whether those that take minutes are run, and what needs their results.
    """
    done = 0
    for step in steps(document):
        text = step.text
        takes_minutes = text.startswith(LONG) or any(f"{folder}/" in text or folder in step.words for folder in FROM_VERDICT)
        if "pip install" in text or any(word in text for word in BOARD) or (takes_minutes and not long):
            continue
        status, out, seconds = followed(step, folder, environment)
        print(f"{seconds:7.1f} s  {text.partition(chr(10))[0]}")
        assert status in ((0, 1) if text.startswith(LACKING) else (0,)), f"{text}\n{out}"
        done += 1
    return done


@pytest.mark.parametrize("long", [pytest.param(False, marks=pytest.mark.slow), pytest.param(True, marks=pytest.mark.study)])
@pytest.mark.parametrize("name", FEWEST)
def test_commands_in_order(name: str, long: bool, environment: dict[str, str], tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    if name == "README.md":
        recorded = tmp_path / "recorded"
        status, out, _ = followed(Step(f"tepm record standard --rig sim --out {recorded}"), folder, environment)
        assert status == 0, out
        shutil.copy(recorded / "circle.csv", folder / OWN_TABLE)
    assert follow(ROOT / name, folder, environment, long) >= FEWEST[name]


@pytest.mark.slow
def test_commands_that_answer_questions(environment: dict[str, str], tmp_path: Path) -> None:
    """Those of `choose.md` in order, in one folder, but for those that take minutes, need a board or data of the reader's own."""
    page = [step for step in answers(CHOOSE) if not step.text.startswith((*LONG, *NO_DATA, "tepm hw")) and "serial:" not in step.text]
    assert len(page) > 15
    for step in page:
        status, out, _ = followed(step, tmp_path, environment)
        assert status == ("--radius" in step.text), f"{step.text}\n{out}"


@pytest.mark.slow
def test_commands_that_need_the_board(board: Board, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of the page of commands, on the emulated board with the virtual prototype behind it, in virtual time."""
    monkeypatch.chdir(tmp_path)
    hurry(monkeypatch)
    needing = [step.words[1:] for step in steps(COMMANDS) if any(word in step.text for word in BOARD)]
    assert [words[0] for words in needing] == ["hw", "play"]
    assert run(["ik", "circle", "--points", "4", "--out", "run"]) == 0
    world = World(board, SimulatedRig())
    robot = load_robot("kang2017")
    monkeypatch.setattr(rigs, "open_rig", lambda text, _: SerialRig(world.port, robot, world.tracker, clock=world.clock, threaded=False))
    monkeypatch.setattr(hw_shared, "open_line", lambda *_, **__: Line(world.port, world.clock, threaded=False))
    statuses = [run(words) for words in needing]
    assert statuses[0] in (0, 1)  # commissioning of an emulated board is not over
    assert statuses[1] == 0
