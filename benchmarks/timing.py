"""Contenders of one task, checked first and then timed in turns, so that their ratios come from the same minutes."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

SHARE = 0.003  # s a contender and round
MOST = 50  # calls a contender and round
SLOW = 0.02  # s a call, above which a contender sits out rounds
INTERRUPTED = 1e-3  # s a call, above which the processor's time counts, without that of others who took it meanwhile


@dataclass
class Contender:
    """One way to solve a task.

    Attributes:
        name: for the table.
        solve: the call that is timed.
        answer: what it found, from the call's result, comparable within the task; not timed, may raise.
        ours: whether it is the package's.
        slow: whether --quick leaves it out.
        ready: what is done before each call, and not timed.
        rounds: times of its calls in s, by round.
        verdict: "right", or how it went wrong.
        error: largest deviation from the task's answer.
    """

    name: str
    solve: Callable[[], Any]
    answer: Callable[[Any], np.ndarray]
    ours: bool = False
    slow: bool = False
    ready: Callable[[], Any] = lambda: None
    rounds: dict[int, list[float]] = field(default_factory=dict)
    verdict: str = "left out"
    error: float = np.nan

    @property
    def right(self) -> bool:
        """Whether it found the task's answer."""
        return self.verdict == "right"

    @property
    def times(self) -> list[float]:
        """Times of all calls in s."""
        return [time for times in self.rounds.values() for time in times]

    @property
    def median(self) -> float:
        """Median time of a call in s."""
        return float(np.median(self.times)) if self.times else np.nan

    @property
    def spread(self) -> tuple[float, float]:
        """First and ninth decile of the times in s."""
        low, high = np.quantile(self.times, [0.1, 0.9]) if self.times else (np.nan, np.nan)
        return float(low), float(high)

    def over(self, other: Contender) -> float:
        """Time over another's, the median of the rounds that both took part in: what slows the machine slows both."""
        common = [turn for turn in self.rounds if turn in other.rounds]
        if not (common and self.right and other.right):
            return np.nan
        return float(np.median([np.median(self.rounds[turn]) / np.median(other.rounds[turn]) for turn in common]))


@dataclass
class Task:
    """What all contenders solve; the first contender is ours, to which ratios refer.

    Attributes:
        simulated: time in s that a call simulates; NaN where nothing moves.
        figures: more figures by name, from the call that is checked.
        once: whether that call is all there is time for.
    """

    key: str
    title: str
    expected: np.ndarray
    contenders: list[Contender]
    tolerance: float = 1e-6
    simulated: float = np.nan
    figures: dict[str, float] = field(default_factory=dict)
    once: bool = False

    def named(self, name: str) -> Contender:
        """A contender by name."""
        return next(contender for contender in self.contenders if contender.name == name)


def _check(task: Task, contender: Contender) -> float:
    """Set the verdict of a contender from its first call; time of that call or of the fastest of three more."""
    start, took = time.perf_counter(), np.nan
    try:
        contender.ready()
        start = time.perf_counter()
        result = contender.solve()
        took = time.perf_counter() - start
        answer = contender.answer(result)
        contender.error = float(np.abs(answer - task.expected).max())
        contender.verdict = "right" if contender.error <= task.tolerance else "wrong"
    except Exception as error:  # whatever a peer raises is its result
        contender.verdict = f"fails: {' '.join(str(error).split())[:60]}"
    took = time.perf_counter() - start if np.isnan(took) else took
    return min(_calls(contender, 3, took)) if contender.right and not task.once else took


def _calls(contender: Contender, count: int, expected: float) -> list[float]:
    """Times of calls; where there are many, after one untimed, which finds the caches as the contender before left them."""
    times, clock = [], time.process_time if expected > INTERRUPTED else time.perf_counter
    if count > 1:
        contender.ready()
        contender.solve()
    for _ in range(count):
        contender.ready()
        start = clock()
        contender.solve()
        times.append(clock() - start)
    return times


def measure(task: Task, rounds: int, quick: bool) -> None:
    """Check every contender, then time those that are right in rounds; the wrong ones get the time of one call."""
    entrants = [contender for contender in task.contenders if not (quick and contender.slow)]
    once = {contender.name: _check(task, contender) for contender in entrants}
    for contender in entrants:
        if task.once or not contender.right:
            contender.rounds[0] = [once[contender.name]]
    if task.once:
        return
    gc.collect()
    gc.disable()
    try:
        for turn in range(rounds):
            for contender in entrants:
                expected = once[contender.name]
                every = int(np.clip(expected / SLOW, 1, rounds // 3))
                if contender.right and turn % every == 0:
                    contender.rounds[turn] = _calls(contender, int(np.clip(SHARE / expected, 1, MOST)), expected)
    finally:
        gc.enable()
