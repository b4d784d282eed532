"""Slips that change nothing that anybody could notice, each with the reason. A draw leaves them out."""

from __future__ import annotations

from tests.hw.spoil.operators import changes
from tests.hw.spoil.spoiling import StaleError, source

EQUIVALENT: dict[tuple[str, str, str], str] = {}
"""By file, line before and line after."""


def check_equivalent() -> None:
    """Look whether each can still be drawn.

    Raises:
        StaleError: the source has changed; names the entry.
    """
    for file in sorted({file for file, _, _ in EQUIVALENT}):
        text = source(file)
        known = {spoiling.lines(text) for spoiling in changes(file, text)}
        for entry in EQUIVALENT:
            if entry[0] == file and entry[1:] not in known:
                raise StaleError(f"equivalent.py: {file} has no such change any more: {entry[1]!r} to {entry[2]!r}")
