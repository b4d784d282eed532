"""Counters that begin again, and times in several columns: hours, minutes, seconds, milliseconds."""

from __future__ import annotations

import re

import numpy as np

from tepm_opt.data.importing.sources import Sheet

SECOND, MINUTE, HOUR, DAY = 1.0, 60.0, 3600.0, 86400.0
WIDTHS = (1e3, 1e6, 1e9, 2.0**16, 2.0**32)  # of counters: thousands of a second, and what 16 and 32 bits hold
BESIDE = 5.0  # median steps from the end and the start within which a counter rolls over
_PARTS = {
    "h": (re.compile(r"(?:hours?|hh?|hr|stunden?)", re.I), 24),
    "min": (re.compile(r"(?:minutes?|mins?|minuten)", re.I), 60),
    "s": (re.compile(r"(?:seconds?|secs?|ss?|sekunden?)", re.I), 60),
    "ms": (re.compile(r"(?:milli[ _]?seconds?|milli[ _]?sec|millis|msecs?|ms)", re.I), 1000),
    "us": (re.compile(r"(?:micro[ _]?seconds?|micros|usecs?|us|µs)", re.I), 1000),
}
"""By unit: names of a part of a time, and the value at which it begins again."""


def time_parts(sheet: Sheet) -> dict[str, str]:
    """Columns that are parts of a time with their units, the largest first; empty where there are fewer than two."""
    found: dict[str, str] = {}
    for unit, (pattern, limit) in _PARTS.items():
        for name in sheet.order:
            values = sheet.columns[name]
            if pattern.fullmatch(name.strip(" :[]()")) is None or values.dtype.kind not in "iuf" or name in sheet.twice:
                continue
            seen = values[np.isfinite(values)]
            if seen.size and seen.min() >= 0 and seen.max() < limit:
                found[name] = unit
                break
    last = sheet.columns[next(reversed(found))] if found else np.empty(0)
    whole = all(np.all(np.nan_to_num(sheet.columns[name]) % 1 == 0) for name in list(found)[:-1])
    return found if len(found) > 1 and whole and len(last) else {}


def unroll(values: np.ndarray, period: float) -> tuple[np.ndarray, int]:
    """A counter that goes on where it begins again, and how many times it did.

    Args:
        values: (rows,) without NaN.
        period: the value at which it begins again.
    """
    back = np.diff(values) < -period / 2
    return values + period * np.concatenate([[0], np.cumsum(back)]), int(back.sum())


def period_of(values: np.ndarray, back: np.ndarray, one: float) -> float | None:
    """The value at which a counter rolls over; None where it seems to begin anew for another reason.

    Args:
        values: (rows,) without NaN.
        back: rows whose values are less than those before.
        one: what one of the counter is in s.
    """
    steps = np.diff(values)
    step = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    if step <= 0 or np.all(values[back] == values[0]):  # a run that begins where the first did
        return None
    widths = {*(each / one for each in (SECOND, MINUTE, HOUR, DAY)), *(WIDTHS if np.all(values == np.round(values)) else ())}
    for period in sorted(widths):
        over = values[back] + period - values[back - 1]
        beside = (values[back] <= BESIDE * step) & (values[back - 1] >= period - BESIDE * step) & (over > 0) & (over <= BESIDE * step)
        if values.max() <= period and np.all(beside):
            return period
    return None
