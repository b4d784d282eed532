"""Blind trials run in processes: every trial has one result, whatever happens to it."""

from __future__ import annotations

import json
import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from tepm_opt.errors import InputError
from tepm_opt.studies.blind.run import DIED, RESULTS, read_results, run_blind
from tepm_opt.studies.blind.trial import CYCLE, Trial, TrialSeries, make

DEADLY, WRONG, INTERRUPTED = 2, 3, 4


def answered(trial: Trial) -> dict[str, Any]:
    return {"family": trial.family, "seed": trial.seed, "number": trial.number, "label": {}, "verdict": {}, "error": None, "seconds": {}}


def dangerous(trial: Trial) -> dict[str, Any]:
    if trial.number == DEADLY:
        time.sleep(0.3)
        os._exit(1)
    if trial.number == WRONG:
        raise RuntimeError("no luck")
    time.sleep(0.6)  # so that another is under way when the process dies
    return answered(trial)


def interrupted(trial: Trial) -> dict[str, Any]:
    if trial.number >= INTERRUPTED:
        raise KeyboardInterrupt
    return answered(trial)


def test_families_take_turns() -> None:
    assert [Trial.from_number(0, number).family for number in range(len(CYCLE))] == list(CYCLE)
    assert Trial.from_number(0, 3, "null").family == "null"
    with pytest.raises(InputError, match="closed"):
        Trial.from_number(0, 0, "opne")


@pytest.mark.slow
def test_a_trial_that_kills_its_process_or_fails_is_a_result(tmp_path: Path) -> None:
    run = run_blind(tmp_path, TrialSeries(6, 7), jobs=2, examine=dangerous)
    assert run.ok
    errors = {result["number"]: result["error"] for result in run.results}
    assert errors == dict.fromkeys((0, 1, 4, 5)) | {DEADLY: DIED, WRONG: "RuntimeError: no luck"}
    assert [result["seed"] for result in run.results] == [7] * 6


@pytest.mark.slow
def test_what_is_there_is_not_repeated(tmp_path: Path) -> None:
    path = tmp_path / RESULTS
    with ThreadPoolExecutor(1) as executor:
        first = run_blind(tmp_path, TrialSeries(8), executor=executor, examine=interrupted)
        assert not first.ok
        assert first.interrupted
        assert [result["number"] for result in first.results] == list(range(INTERRUPTED))
        kept = path.read_text(encoding="utf-8")
        path.write_text(kept + '{"family": "null", "se', encoding="utf-8")  # killed while it wrote
        told: list[float] = []
        second = run_blind(
            tmp_path, TrialSeries(8), executor=executor, examine=answered, progress=lambda stage, done, of: told.append(done)
        )
    assert second.ok
    assert path.read_text(encoding="utf-8").startswith(kept)
    assert len(read_results(path)) == 8
    assert told == [4, 5, 6, 7, 8]
    other = run_blind(tmp_path, TrialSeries(2, 1), jobs=1, examine=answered)
    assert [result["seed"] for result in other.results] == [1, 1]
    assert len(read_results(path)) == 10


def test_a_file_that_is_none_of_ours_is_refused(tmp_path: Path) -> None:
    (tmp_path / RESULTS).write_text('{"some": "thing"}\n', encoding="utf-8")
    with pytest.raises(InputError, match="line 1"):
        run_blind(tmp_path, TrialSeries(1), examine=answered)


@pytest.mark.slow
def test_a_trial_depends_on_seed_number_and_family_alone() -> None:
    one, same, other = (make(Trial(seed, 1, "null")) for seed in (3, 3, 4))
    assert json.dumps(one.label) == json.dumps(same.label)
    assert all((a.points == b.points).all() for a, b in zip(one.dataset.runs, same.dataset.runs, strict=True))
    assert json.dumps(one.label) != json.dumps(other.label)


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is_hidden(tmp_path: Path) -> None:
    """The whole way, in two processes."""
    run = run_blind(tmp_path, TrialSeries(2, 11, "null"), jobs=2)
    assert run.ok
    for result in run.results:
        assert result["error"] is None
        assert result["label"]["names"] == []
        assert result["verdict"]["status"] == "no_discrepancy"
        assert 0 < result["seconds"]["making"] < result["seconds"]["cpu"]
