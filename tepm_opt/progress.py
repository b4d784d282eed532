"""Progress of long work: one form for all of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

Item = TypeVar("Item")


class Progress(Protocol):
    """Called now and then by long work with what it is at and how far it is."""

    def __call__(self, stage: str, done: float, of: float) -> None:
        """Take note.

        Args:
            stage: what is going on, in words.
            done: how much of it is done, in points, rounds or s.
            of: how much there is in the same unit; 0 where nobody knows.
        """
        ...


def silent(stage: str, done: float, of: float) -> None:
    """Take no note: the default of all long work."""


def track(items: Iterable[Item], progress: Progress, stage: str, of: int) -> Iterator[Item]:
    """Iterate over items and report progress after each one has been processed.

    Args:
        items: any iterable.
        progress: told how many are done.
        stage: what is going on.
        of: how many there will be.
    """
    progress(stage, 0, of)
    for done, item in enumerate(items, start=1):
        yield item
        progress(stage, done, of)


def with_prefix(progress: Progress, name: str) -> Progress:
    """Put a name before every stage that is reported to a progress, such as the file of a run.

    Args:
        progress: told.
        name: before each stage.
    """

    def tell(stage: str, done: float, of: float) -> None:
        progress(f"{name}: {stage}", done, of)

    return tell
