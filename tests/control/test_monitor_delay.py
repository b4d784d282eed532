"""Pressure monitors that read late are told from slow regulators, and from monitors that are wrong in other ways."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tepm_opt.control.diagnostics.monitor_delay import MonitorDelay

PERIOD, ROWS = 0.01, 400
LAGS = 0.12, 0.24  # s, filling and exhausting
NOISE = 500.0  # Pa


def commands(seed: int) -> np.ndarray:
    """Steps of six regulators by 10 kPa and more at random times, (rows, 6) in Pa."""
    random = np.random.default_rng(seed)
    steps = 1e4 * np.round(random.normal(size=(ROWS, 6))) * (random.random((ROWS, 6)) < 0.05)
    return 1e5 + np.cumsum(steps, axis=0)


def measured(sent: np.ndarray, factor: float = 1.0, late: int = 0) -> np.ndarray:
    """Pressures of regulators with a factor on the usual lags, as they were some rows ago, with noise, (rows, 6) in Pa."""
    path = [sent[0]]
    for command in sent[:-1]:
        missing = command - path[-1]
        path.append(path[-1] + (1 - np.exp(-PERIOD / factor / np.where(missing > 0, *LAGS))) * missing)
    shown = np.array([path[max(k - late, 0)] for k in range(len(path))])
    return shown + NOISE * np.random.default_rng(0).normal(size=shown.shape)


def found(sent: np.ndarray, read: np.ndarray, time: np.ndarray | None = None) -> MonitorDelay:
    """What a look at all samples finds."""
    delay = MonitorDelay(PERIOD)
    for at, readings, command in zip(PERIOD * np.arange(ROWS) if time is None else time, read, sent, strict=True):
        delay.look(float(at), readings, command)
    return delay


@pytest.mark.parametrize("factor", [0.05, 0.3, 1.0, 3.0])
@pytest.mark.parametrize(("late", "low", "high"), [(0, 0.0, 0.0), (2, 0.0, 0.0), (6, 0.05, 0.09), (12, 0.09, 0.13)])
def test_a_delay_is_told_from_a_lag(factor: float, late: int, low: float, high: float) -> None:
    sent = commands(1)
    delay = found(sent, measured(sent, factor, late))
    assert low <= delay.late <= high
    assert bool(delay.describe()) is bool(delay.late)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda read: 0.7 * read,
        lambda read: read + 1e4 * PERIOD * np.arange(ROWS)[:, None],
        lambda read: np.broadcast_to(read[0], read.shape),
        lambda read: 0 * read,
        lambda read: np.where(np.random.default_rng(2).random(read.shape) < 0.5, np.nan, read),
    ],
    ids=["scale", "drift", "stuck", "zero", "lost"],
)
def test_other_errors_are_no_delay(spoil: Callable[[np.ndarray], np.ndarray]) -> None:
    sent = commands(3)
    assert found(sent, spoil(measured(sent))).late == 0


def test_nothing_is_told_of_a_gap_or_without_monitors() -> None:
    """Readings before a gap are not compared with commands after it."""
    sent, time = commands(4), PERIOD * np.arange(ROWS)
    time[200:] += 1.0
    assert found(sent, measured(sent), time).late == 0
    delay = MonitorDelay(PERIOD)
    delay.look(0.0, None, sent[0])
    assert not delay.describe()
