"""`tepm record` killed at random moments: nothing that was finished is lost, and going on gives what an undisturbed recording gives."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from itertools import pairwise
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import pytest

from tepm_opt.cli import rigs, run
from tepm_opt.data.datasets import DESCRIPTION, read_dataset
from tepm_opt.data.journal import mend_journal
from tepm_opt.data.tables import read_table
from tests.recording.fake_rig import SeededLater, record_slowly, write_plan

KILLS, RATE = 20, 50
pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rigs, "open_rig", lambda text, robot: SeededLater())


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
    dataset = read_dataset(folder)
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


def test_killed_at_random_moments(tmp_path: Path, fake: None) -> None:
    plan, truth = write_plan(tmp_path), tmp_path / "truth"
    assert run(["record", str(plan), "--out", str(truth), "--rig", "fake", "--json"]) == 0
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tepm_opt.cli"])
    random = np.random.default_rng(2017)
    folder, finished, killed, amid = tmp_path / "set-0", 0, 0, 0
    for attempt in range(10 * KILLS):
        if killed == KILLS:
            break
        log = tmp_path / f"log-{attempt}"
        process = context.Process(target=record_slowly, args=(str(plan), str(folder), str(log), 1e-4))
        process.start()
        _wait_for(log, process)
        time.sleep(random.uniform(0.0, 0.6))
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


def _wait_for(log: Path, process: BaseProcess, patience: float = 60.0) -> None:
    end = time.monotonic() + patience
    while not log.exists() and process.is_alive():
        assert time.monotonic() < end, "the process does not start"
        time.sleep(0.002)
