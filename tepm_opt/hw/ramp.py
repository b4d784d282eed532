"""Slow ways from one command to another: how every rig is brought to a start and back to zero."""

from __future__ import annotations

from collections.abc import Callable, Iterator


def smooth_step(part: float) -> float:
    """Share 0 … 1 of a way after a part 0 … 1 of its time, with speed zero at both ends (3 s² − 2 s³); its speed is at most 1.5."""
    s = min(max(part, 0.0), 1.0)
    return s**2 * (3 - 2 * s)


def smooth_ramp(clock: Callable[[], float], duration: float) -> Iterator[tuple[float, float]]:
    """Shares of a way that rise smoothly as time passes, from 0 to 1, which is the last one.

    Args:
        clock: tells the time in s; it has to go on between two shares, as a rig's does when it is read.
        duration: of the way in s.

    Yields:
        Time passed in s, at most `duration`, and the share of the way.
    """
    begin, passed = clock(), 0.0
    while passed < duration:
        passed = min(clock() - begin, duration)
        yield passed, smooth_step(passed / duration)
