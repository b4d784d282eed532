"""One core for what is compared, all of them for what uses several."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

ALL = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None


def pin() -> str:
    """Keep this process and its children on one core where the system allows it; what it did, in words."""
    if ALL is None:
        return "not pinned to a core"
    core = max(ALL)
    os.sched_setaffinity(0, {core})
    return f"pinned to core {core}"


@contextmanager
def every_core() -> Iterator[None]:
    """Give this process all its cores back for a while."""
    if ALL is None:
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, ALL)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)
