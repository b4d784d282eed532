"""`tepm record` killed at random moments: nothing that was finished is lost, and going on gives what an undisturbed recording gives.

Twenty kills, and twenty of the installed program on the default rig, by `pytest -m slow`.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from itertools import pairwise
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.cli import rigs, run
from tepm_opt.data.datasets import DESCRIPTION, read_dataset
from tepm_opt.data.journal import mend_journal
from tepm_opt.data.run import read_run
from tepm_opt.data.tables import read_table
from tepm_opt.models.channels import open_dataset
from tests.recording.fake_rig import RAMP, FakeRig, record_slowly, write_plan

RATE = 50
KILLS = 20
pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rigs, "open_rig", lambda text, robot: FakeRig())


def files(folder: Path) -> dict[str, bytes]:
    """What makes up a data set."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix in {".csv", ".toml"}}


def told(log: Path) -> tuple[int, float | None]:
    """From the process's own log: runs begun, and in the last one the time for which all rows must be there (None: not recording)."""
    text = log.read_text() if log.exists() else ""
    lines = [line.split(",") for line in text[: text.rfind("\n") + 1].splitlines()]
    stages = ["", *(stage for stage, _ in lines)]
    begun = sum(now == "approaching the start" != earlier for earlier, now in pairwise(stages))
    amid = stages[-2:] == ["recording", "recording"]
    return begun, float(lines[-2][1]) if amid else None


def check_left(folder: Path, truth: Path, log: Path, before: int) -> int:
    """What a killed process left, against the undisturbed recording; how many runs are finished."""
    if not (folder / DESCRIPTION).exists():
        assert told(log) == (0, None)
        return 0
    dataset = open_dataset(folder)
    for entry in dataset.runs:
        assert (folder / entry.file).read_bytes() == (truth / entry.file).read_bytes()
    begun, reached = told(log)
    assert len(dataset.runs) >= before + begun - 1
    if reached is not None and len(dataset.runs) == before + begun - 1:
        names = [entry.file for entry in read_dataset(truth).runs]
        name = names[len(dataset.runs)]
        journal = max((folder / "unfinished").glob(f"{Path(name).stem}-*.csv"), key=lambda path: int(path.stem.split("-")[1].split(".")[0]))
        rows = mend_journal(journal)
        assert rows >= int(reached * RATE - 1e-6) + 1
        kept, whole = read_table(journal, text=lambda column: column == "status"), read_table(truth / name)
        for column in whole.columns:
            np.testing.assert_array_equal(kept.columns[column], whole.columns[column][:rows])
    return len(dataset.runs)


@pytest.mark.slow
def test_killed_at_random_moments(tmp_path: Path, fake: None) -> None:
    plan, truth = write_plan(tmp_path), tmp_path / "truth"
    assert run(["record", str(plan), "--out", str(truth), "--rig", "fake", "--json"]) == 0
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tepm_opt.cli"])
    random = np.random.default_rng(KILLS)

    def start(folder: Path, log: Path) -> BaseProcess:
        process = context.Process(target=record_slowly, args=(str(plan), str(folder), str(log), 1e-4))
        process.start()
        return process

    start(tmp_path / "undisturbed", tmp_path / "whole-log").join()
    whole = (tmp_path / "whole-log").stat().st_size
    folder, finished, killed, amid = tmp_path / "set-0", 0, 0, 0
    for attempt in range(10 * KILLS):
        if killed == KILLS:
            break
        log = tmp_path / f"log-{attempt}"
        process = start(folder, log)
        _wait_for(log, random.uniform(0.0, whole * (1 - finished / 3)), process)
        assert process.pid is not None
        os.kill(process.pid, signal.SIGKILL)
        process.join()
        killed += process.exitcode == -signal.SIGKILL
        finished = check_left(folder, truth, log, finished)
        amid += any((folder / "unfinished").glob("*.csv"))
        if finished == 3 or attempt % 4 == 3:
            assert run(["record", str(plan), "--out", str(folder), "--rig", "fake", "--json"]) == 0
            assert files(folder) == files(truth)
            folder, finished = tmp_path / f"set-{attempt + 1}", 0
    assert killed == KILLS
    assert amid > KILLS / 3, "too few kills in the middle of a run to prove something"


def _wait_for(log: Path, length: float, process: BaseProcess, patience: float = 60.0) -> None:
    """Until the process has told so many bytes: moments of its progress, not of a clock, so that a slow machine kills at the same ones."""
    end = time.monotonic() + patience
    while process.is_alive() and (not log.exists() or log.stat().st_size < length):
        assert time.monotonic() < end, "the process does not go on"
        time.sleep(0.0005)


@pytest.mark.slow
def test_the_program_killed_on_the_default_rig(tmp_path: Path) -> None:
    """No help from within: what stood in the files just before each kill is there after it, and equal to an undisturbed recording."""
    ramp = RAMP.replace("hold_s = 0.5", "hold_s = 40")  # so long that most kills come while it records
    plan = write_plan(tmp_path, ramp, ramp.replace("ramp.csv", "again.csv"))
    truth, folder = tmp_path / "truth", tmp_path / "set-0"
    command = [str(Path(sys.executable).with_name("tepm")), "record", str(plan), "--rig", "sim", "--json", "--out"]
    begin = time.monotonic()
    subprocess.run([*command, str(truth)], check=True, capture_output=True)
    duration = time.monotonic() - begin
    random, killed, rounds, amid = np.random.default_rng(2017), 0, 0, 0
    while killed < KILLS:
        process = subprocess.Popen([*command, str(folder)], stdout=subprocess.DEVNULL)
        time.sleep(random.uniform(0.0, duration))
        before = sizes(folder)
        process.kill()
        process.wait()
        killed += process.returncode == -signal.SIGKILL
        finished = open_dataset(folder).runs if (folder / DESCRIPTION).exists() else ()
        listed = {entry.file for entry in finished}
        assert all(f"{name.split('-')[0]}.csv" in listed or (folder / "unfinished" / name).exists() for name in before)
        for entry in finished:
            assert (folder / entry.file).read_bytes() == (truth / entry.file).read_bytes()
        for path in (folder / "unfinished").glob("*.csv"):
            amid += 1
            assert path.stat().st_size >= before.get(path.name, 0)
            if mend_journal(path):
                kept, whole = read_run(path), read_run(truth / f"{path.name.split('-')[0]}.csv")
                np.testing.assert_array_equal(kept.points, whole.points[: kept.rows])
                np.testing.assert_array_equal(kept.time, whole.time[: kept.rows])
        if len(finished) == 2:
            rounds += 1
            assert files(folder) == files(truth)
            folder = tmp_path / f"set-{rounds}"
    assert amid > 5


def sizes(folder: Path) -> dict[str, int]:
    """Bytes of what is in `unfinished/`, by name."""
    found = {}
    for path in (folder / "unfinished").glob("*.csv"):
        with contextlib.suppress(FileNotFoundError):
            found[path.name] = path.stat().st_size
    return found
