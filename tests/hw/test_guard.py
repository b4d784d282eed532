"""What stops a rig that is driven, whoever drives it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tepm_opt.hw.guard import Stopped, Watch
from tepm_opt.hw.rig import Sample
from tepm_opt.outcome import Ending

NAMES, LIMITS = ("11", "12", "13"), np.repeat([5e5, 7.0], 3)
POINTS = np.zeros((2, 3))
LOST = np.full((2, 3), np.nan)


def sample(time: float, pressures: object = (1e5, 1e5, 1e5), tensions: object = (1.0, 1.0, 1.0), points: np.ndarray = POINTS) -> Sample:
    values = [None if part is None else np.array(part, dtype=float) for part in (pressures, tensions)]
    return Sample(time, points, values[0], values[1])


def stops_at(watch: Watch, *, bad: dict[str, Any], good: int = 10, until: float = 5.0) -> tuple[float, Stopped]:
    """Seconds of bad samples, 100 a second, until the rig is stopped, and why."""
    for k in range(good):
        watch.check(sample(0.01 * k))
    begin = 0.01 * good
    for k in range(round(until / 0.01)):
        try:
            watch.check(sample(begin + 0.01 * k, **bad))
        except Stopped as stop:
            return 0.01 * k, stop
    raise AssertionError("never stopped")


@pytest.mark.parametrize(
    ("bad", "after", "ending", "says"),
    [
        ({"pressures": (1e5, 5.3e5, 1e5)}, 0.0, Ending.LIMIT, "measured pressure_12 is 106 % of its limit"),
        ({"tensions": (1.0, 1.0, 7.4)}, 0.0, Ending.LIMIT, "measured tension_13 is 106 % of its limit"),
        ({"pressures": (5.3e5, 5.3e5, 5.3e5)}, 0.0, Ending.LIMIT, "measured pressure_11 is 106 % of its limit"),
        ({"tensions": (np.inf, 1.0, 1.0)}, 0.0, Ending.LIMIT, "tension_11"),
        ({"pressures": (np.nan, 5.3e5, np.nan)}, 0.0, Ending.LIMIT, "pressure_12"),
        ({"pressures": (1e5, 5.3e5, 1e5), "tensions": (9.0, 1.0, 1.0)}, 0.0, Ending.LIMIT, "pressure_12"),
        ({"pressures": None, "tensions": (8.0, 1.0, 1.0)}, 0.0, Ending.LIMIT, "tension_11"),
        ({"pressures": (1e5, 1e5, np.nan)}, 0.2, Ending.UNMEASURED, "pressure_13 was not measured for 0.2 s"),
        ({"tensions": (1.0, -np.inf, 1.0)}, 0.2, Ending.UNMEASURED, "tension_12"),
        ({"pressures": None}, 0.2, Ending.UNMEASURED, "pressure_11"),
        ({"tensions": None}, 0.2, Ending.UNMEASURED, "tension_11"),
        ({"points": LOST}, 1.0, Ending.BLIND, "no tracked point for 1 s"),
    ],
)
def test_stops(bad: dict[str, Any], after: float, ending: Ending, says: str) -> None:
    time, stop = stops_at(Watch(NAMES, LIMITS), bad=bad)
    assert time == pytest.approx(after, abs=0.015)
    assert stop.outcome.ending is ending
    assert says in str(stop)


def test_what_was_never_measured_is_not_missed() -> None:
    """A rig without monitors, or without a tracker, is not stopped for that; one that needs a tracker is; so is one that measures NaN."""
    never: list[tuple[Watch, dict[str, Any]]] = [
        (Watch(NAMES, LIMITS), {"pressures": None, "points": LOST}),
        (Watch(NAMES, LIMITS, tracked=True), {"tensions": None}),
    ]
    for watch, values in never:
        for k in range(500):
            watch.check(sample(0.01 * k, **values))
    assert stops_at(Watch(NAMES, LIMITS, tracked=True), bad={"points": LOST}, good=0)[1].outcome.ending is Ending.BLIND
    assert stops_at(Watch(NAMES, LIMITS), bad={"tensions": (1.0, 1.0, np.nan)}, good=0)[0] == pytest.approx(0.2, abs=0.015)


def test_gaps_that_are_short() -> None:
    """A pressure that is missing for 0.15 s again and again, points for 0.9 s: nothing is stopped; nor are 105 %."""
    watch = Watch(NAMES, LIMITS)
    for k in range(1000):
        pressures = (np.nan if k % 20 < 15 else 5.25e5, 1e5, 1e5)
        watch.check(sample(0.01 * k, pressures, (7.35, 0.0, -0.1), POINTS if k % 100 > 90 else LOST))


def test_a_limit_of_time_itself_is_still_allowed() -> None:
    """A second without points is borne, a millisecond more is not."""
    watch = Watch(NAMES, LIMITS)
    watch.check(sample(0.0))
    watch.check(sample(1.0, points=LOST))
    with pytest.raises(Stopped, match="no tracked point for 1 s"):
        watch.check(sample(1.0 + 2**-10, points=LOST))
