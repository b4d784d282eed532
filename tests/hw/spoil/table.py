"""docs/results/spoiling.md: what was tried out, and which test caught it. The runner begins with that test the next time."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from tests.hw.spoil.spoiling import ROOT, Spoiling, source

PAGE = ROOT / "docs" / "results" / "spoiling.md"


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


def cells(spoiling: Spoiling, drawn: bool) -> str:
    """A spoiling's row of the table up to the test that caught it."""
    name = f"| {Path(spoiling.file).name} | {spoiling.name} | "
    return name + "".join(f"`` {line} `` | ".replace("|", r"\|")[:-3] + "| " for line in spoiling.lines(source(spoiling.file))) * drawn


def caught_last_time(spoiling: Spoiling) -> list[str]:
    """The test that caught it when the table was written."""
    known = dict(line.removesuffix(" |").rpartition("| ")[::2] for line in _page() if line.startswith("| "))
    before = (known.get(cells(spoiling, drawn).removesuffix("| ")) for drawn in (False, True))
    return [test.strip("`") for test in before if test and "::" in test]


def _page() -> list[str]:
    return PAGE.read_text(encoding="utf-8").splitlines() if PAGE.exists() else []


def table(rows: list[Row], seed: int) -> str:
    """The rows as a page of the documentation."""
    drawn = [row for row in rows if row.drawn]
    survived = sum(row.outcome.caught is None for row in rows)
    left_out = [(slip, reason) for row in drawn for slip, reason in row.left_out]
    lines = [
        "# Spoiling",
        "",
        "Written by `python -m tests.hw.spoil --table`; "
        '`pytest -m "slow or study" tests/hw/test_spoiling.py` tries the same, `-m slow` a third of it.',
        "",
        "The safety side is made wrong on purpose, in one place at a time, in a copy, and the tests run until one fails. "
        f"{len(rows)} spoilings, {len(drawn)} of them drawn with the seed {seed}: {len(rows) - survived} caught, {survived} survived.",
        "",
        "## By hand",
        "",
        "| in | what is wrong | caught by |",
        "|---|---|---|",
        *(f"{cells(row.spoiling, False)}{_by(row.outcome)} |" for row in rows if not row.drawn),
        "",
        "## Drawn",
        "",
        "| in | slip | line | becomes | caught by |",
        "|---|---|---|---|---|",
        *(f"{cells(row.spoiling, True)}{_by(row.outcome)} |" for row in drawn),
        "",
        f"Drawn and left out, because they do not test the tests: {len(left_out)}.",
        "",
    ]
    for slip, reason in left_out:
        before, after = slip.lines(source(slip.file))
        lines.append(f"- {Path(slip.file).name}, {slip.name}: `` {before} `` to `` {after} `` {reason}")
    return "\n".join([*lines, ""])


def _by(outcome: Outcome) -> str:
    return f"`{outcome.caught}`" if outcome.caught else "**survived**"
