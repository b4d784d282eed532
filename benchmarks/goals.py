"""Targets of the figures, and whether they are met."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.limit import Limit
from benchmarks.timing import Task


@dataclass(frozen=True)
class Goal:
    """A target: a figure of a task, NaN where not measured, and its bound.

    Attributes:
        task: key of the task.
        name: what the figure is called over the versions (history.csv).
        text: the target in words.
        figure: of the task and the practical limit.
        bound: largest figure that meets it, or smallest.
        at_least: whether it is the smallest.
    """

    task: str
    name: str
    text: str
    figure: Callable[[Task, Limit], float]
    bound: float
    at_least: bool = False

    def measured(self, tasks: Sequence[Task], limit: Limit) -> float:
        """The figure."""
        return self.figure(next(task for task in tasks if task.key == self.task), limit)

    def met(self, figure: float) -> bool | None:
        """Whether it is met; None where it was not measured."""
        if np.isnan(figure):
            return None
        return figure >= self.bound if self.at_least else figure <= self.bound

    def margin(self, figure: float) -> float:
        """The figure over its bound, or the other way round, so that 1 and more is met; at most 10, also where the figure is 0."""
        return min(figure / self.bound if self.at_least else self.bound / max(figure, self.bound / 10), 10.0)


def faster(task: str, name: str, factor: float, peer: str) -> Goal:
    """The first contender at least `factor` times faster than a peer."""

    def figure(found: Task, _: Limit) -> float:
        return found.named(peer).over(found.contenders[0])

    return Goal(task, f"{name}, over {peer}", f"at least {factor:g} times faster than {peer}", figure, factor, True)


def near_limit(task: str, name: str, factor: float) -> Goal:
    """The first contender within `factor` times the practical limit."""

    def figure(found: Task, limit: Limit) -> float:
        ours = found.contenders[0]
        return ours.median / limit.median(task) if ours.right else np.nan

    return Goal(task, f"{name}, over the limit", f"at most {factor:g} times the limit", figure, factor)


def within(task: str, name: str, seconds: float, text: str) -> Goal:
    """The first contender's median below a time."""

    def figure(found: Task, _: Limit) -> float:
        return found.contenders[0].median if found.contenders[0].right else np.nan

    return Goal(task, name, text, figure, seconds)


def times_real(task: str, name: str, factor: float, text: str) -> Goal:
    """The first contender at least `factor` times as fast as what it simulates."""

    def figure(found: Task, _: Limit) -> float:
        return found.simulated / found.contenders[0].median if found.contenders[0].right else np.nan

    return Goal(task, name, text, figure, factor, True)
