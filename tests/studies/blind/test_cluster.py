"""Blind trials on a Dask cluster: the same numbers as in processes, whatever happens to its workers. Needs the extra `cluster`."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tepm_opt.errors import InputError
from tepm_opt.jobs.executors import cluster
from tepm_opt.studies.blind.run import run_blind
from tepm_opt.studies.blind.trial import Trial, TrialSeries, make

distributed = pytest.importorskip("distributed", reason="Dask is not installed (extra cluster)")


def drawn(trial: Trial) -> dict[str, Any]:
    """A result that depends on all of a trial's data, and a process that is slow enough to be killed in between."""
    made = make(Trial(trial.seed, trial.number, "null"))
    time.sleep(1.0)
    total = sum(float(run.points.sum()) for run in made.dataset.runs)
    return {
        "family": trial.family, "seed": trial.seed, "number": trial.number, "label": made.label, "verdict": None, "error": str(total),
        "seconds": {},
    }  # fmt: skip


@pytest.fixture
def address() -> Iterator[str]:
    """A scheduler with two workers of one thread, in processes of their own."""
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as found:
        yield found.scheduler_address


@pytest.mark.slow
def test_a_lost_worker_does_not_change_the_numbers(tmp_path: Path, address: str) -> None:
    here = run_blind(tmp_path / "here", TrialSeries(4, 5), jobs=2, examine=drawn)
    killed: list[int] = []

    def kill(stage: str, done: float, of: float) -> None:
        if done == 1 and not killed:
            with distributed.Client(address) as client:
                killed.append(min(client.run(os.getpid).values()))
            os.kill(killed[0], 9)

    with cluster(address) as executor:
        there = run_blind(tmp_path / "there", TrialSeries(4, 5), executor=executor, progress=kill, examine=drawn)
    assert killed
    assert there.ok
    assert there.results == here.results


@pytest.mark.slow
def test_the_command_asks_a_scheduler(tmp_path: Path, address: str) -> None:
    command = ["study", "blind", "--trials", "1", "--family", "null", "--scheduler", address, "--out", str(tmp_path / "out")]
    done = subprocess.run([sys.executable, "-m", "tepm_opt", *command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 trials: 1 null" in done.stdout
    assert (tmp_path / "out" / "summary.json").exists()


def test_no_scheduler_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tepm_opt.jobs.executors.PATIENCE", 0.5)
    with pytest.raises(InputError, match="does not answer"), cluster("tcp://127.0.0.1:9"):
        pass
