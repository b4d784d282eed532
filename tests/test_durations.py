"""The fast tests stay fast: by the durations of `tests/durations.csv`, none is long and all fit the budget of a person who waits."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import durations

LONGEST, BUDGET = 3.0, 360.0
"""Seconds of a fast test and of all, summed over both workers: five minutes with set-up and compiling on two cores."""


def test_no_fast_test_is_long() -> None:
    long = {test: seconds for test, seconds in durations.read().items() if seconds > LONGEST and "::" in test}
    assert long == {}, "mark them slow where a quicker test covers the same code, or make them quicker"


def test_their_sum_is_within_the_budget() -> None:
    assert 30 < sum(durations.read().values()) < BUDGET


def test_durations_are_of_fast_tests(request: pytest.FixtureRequest) -> None:
    """Each stored test of a collected file is among the fast ones: neither gone nor slow by now."""
    asked = request.config
    if asked.getoption("-m") or asked.getoption("-k") or any("::" in each for each in asked.args):
        pytest.skip("only some of the tests were asked for")
    collected = {item.nodeid for item in request.session.items}
    files = {test.partition("::")[0] for test in collected}
    assert {test for test in durations.read() if "::" in test and test.partition("::")[0] in files} - collected == set()


def test_stored_durations_are_read_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(durations, "FILE", tmp_path / "durations.csv")
    durations.store(
        [("a.py::long", "setup", 1.0), ("a.py::long", "call", 1.5), ("a.py::b[x,y]", "call", 0.2), ("a.py::c", "teardown", 0.1)]
    )
    assert durations.read() == {"a.py::long": 1.5, f"{durations.SET_UP} a.py": 1.1, durations.REST: 0.2}
