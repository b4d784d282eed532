"""All kinds of trackers. A module of `kinds`, an entry point `tepm_opt.trackers` or `register` adds one; no list names them."""

from __future__ import annotations

import importlib
import pkgutil
import time
from collections.abc import Callable
from functools import cache
from importlib.metadata import entry_points

from tepm_opt.errors import InputError, unknown_name
from tepm_opt.hw.trackers import kinds
from tepm_opt.hw.trackers.frames import STALE_PERIODS
from tepm_opt.hw.trackers.tracker import LiveTracker, Tracker, TrackerKind
from tepm_opt.models.hardware import TrackerLink

__all__ = ["LiveTracker", "Tracker", "TrackerKind", "find_tracker", "open_link", "register", "tracker_kinds"]


@cache
def _registry() -> dict[str, TrackerKind]:
    modules = [importlib.import_module(f"{kinds.__name__}.{info.name}") for info in pkgutil.iter_modules(kinds.__path__)]
    found = [kind for module in modules for kind in vars(module).values() if isinstance(kind, TrackerKind)]
    found += [point.load() for point in entry_points(group="tepm_opt.trackers")]
    return {kind.name: kind for kind in sorted(found, key=lambda kind: kind.name)}


def tracker_kinds() -> tuple[TrackerKind, ...]:
    """All kinds of trackers, by name."""
    return tuple(_registry().values())


def find_tracker(name: str) -> TrackerKind:
    """The kind of this name.

    Raises:
        InputError: no such tracker.
    """
    if name not in _registry():
        raise unknown_name("hardware.tracker.kind", name, _registry())
    return _registry()[name]


def register(kind: TrackerKind) -> None:
    """Add a kind at run time (the same as an entry point `tepm_opt.trackers` of an installed package).

    Raises:
        InputError: the name is taken.
    """
    if kind.name in _registry():
        raise InputError(f"tracker {kind.name!r} exists already")
    _registry()[kind.name] = kind


def open_link(link: TrackerLink, clock: Callable[[], float] = time.monotonic, stale_periods: float = STALE_PERIODS) -> LiveTracker:
    """The tracker that a robot file's link names; it begins to receive.

    Args:
        link, clock, stale_periods: as for `LiveTracker`.

    Raises:
        InputError: no such kind, a wrong option, or its package is not installed.
    """
    return LiveTracker(link, find_tracker(link.kind), clock, stale_periods)
