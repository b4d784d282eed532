"""Durations of the fast tests, stored by `pytest -n 2 --store-durations` on a warm compile cache."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

FILE = Path(__file__).with_name("durations.csv")
SHORT = 0.5
"""Tests below this many seconds share one row."""
REST, SET_UP = "all shorter tests", "set-up of"


def store(measured: Iterable[tuple[str, str, float]]) -> None:
    """Write the seconds of each test, longest first; set-ups, which several tests share, are summed by file.

    Args:
        measured: test, phase ("setup", "call" or "teardown") and seconds.
    """
    total: Counter[str] = Counter()
    for test, phase, seconds in measured:
        total[test if phase == "call" else f"{SET_UP} {test.partition('::')[0]}"] += seconds
    rows = [(test, round(seconds, 1)) for test, seconds in total.most_common() if seconds >= SHORT]
    rest = round(sum(seconds for seconds in total.values() if seconds < SHORT), 1)
    with FILE.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([("test", "seconds"), *rows, (REST, rest)])


def read() -> dict[str, float]:
    """Seconds by test, as stored."""
    with FILE.open(encoding="utf-8", newline="") as file:
        return {row["test"]: float(row["seconds"]) for row in csv.DictReader(file)}
