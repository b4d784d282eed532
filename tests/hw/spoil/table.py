"""Tables of a study of spoilings: what was tried out, and which test caught it.

`caught.csv` beside this file is the `spoilings.csv` of the last whole study. The runner begins with the test that caught a spoiling then.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from tests.hw.spoil.spoiling import Spoiling, source

CAUGHT = Path(__file__).with_name("caught.csv")
SPOILINGS, LEFT_OUT = "spoilings.csv", "left_out.csv"
SURVIVED = "survived"
Key = tuple[str, str, str, str]


@dataclass(frozen=True)
class Outcome:
    """What became of a spoiling.

    Attributes:
        caught: the test that failed; "time-out" where the tests hung, "crash" where Python did not survive them, "compiler" where there is
            nothing to test, "conftest.py" where none could begin; None: it has survived.
        seconds: how long that took.
    """

    caught: str | None
    seconds: float

    def __repr__(self) -> str:
        return f"Outcome({self.caught or 'SURVIVED'}, {self.seconds:.0f} s)"


@dataclass(frozen=True)
class Row:
    """What became of a spoiling, and what was drawn before it and left out."""

    spoiling: Spoiling
    drawn: bool
    outcome: Outcome
    left_out: list[tuple[Spoiling, str]] = field(default_factory=list)


def key(spoiling: Spoiling, drawn: bool) -> Key:
    """File, name, and for a drawn spoiling its line before and after."""
    before, after = spoiling.lines(source(spoiling.file)) if drawn else ("", "")
    return Path(spoiling.file).name, spoiling.name, before, after


def caught_last_time(spoiling: Spoiling) -> list[str]:
    """The test that caught it in the last whole study; none where it is new, or was noticed otherwise."""
    found = (_known().get(key(spoiling, drawn), "") for drawn in (False, True))
    return [test for test in found if "::" in test]


def write_tables(rows: Sequence[Row], folder: Path) -> None:
    """Write `spoilings.csv`, a row each with what caught it, and `left_out.csv`, what was drawn and does not test the tests."""
    folder.mkdir(parents=True, exist_ok=True)
    heading = ("file", "spoiling", "line", "becomes")
    tried = ((*key(row.spoiling, row.drawn), row.outcome.caught or SURVIVED) for row in rows)
    _write(folder / SPOILINGS, (*heading, "caught_by"), tried)
    left_out = ((*key(slip, True), reason) for row in rows for slip, reason in row.left_out)
    _write(folder / LEFT_OUT, (*heading, "because"), left_out)


def survivors(rows: Iterable[Row]) -> list[str]:
    """Names of the spoilings that no test noticed, each after its file."""
    return [f"{Path(row.spoiling.file).name}: {row.spoiling.name}" for row in rows if row.outcome.caught in (None, "compiler")]


@cache
def _known() -> dict[Key, str]:
    """The test that caught each spoiling in the last whole study."""
    with CAUGHT.open(newline="", encoding="utf-8") as file:
        return {(row["file"], row["spoiling"], row["line"], row["becomes"]): row["caught_by"] for row in csv.DictReader(file)}


def _write(path: Path, heading: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(heading)
        writer.writerows(rows)
