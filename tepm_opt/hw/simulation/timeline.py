"""Values over simulated time that are linear between knots, on the simulation's whole steps."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np

from tepm_opt.errors import InputError


class Timeline:
    """Piecewise linear course of a value, perhaps with jumps at its knots; times are whole steps of `step` s.

    Args:
        value: before the first knot.
        step: of the simulation in s.
    """

    def __init__(self, value: np.ndarray, step: float) -> None:
        self.step = step
        self.at = [0]
        self.values = [np.array(value, dtype=float)]
        self.slopes: list[np.ndarray | None] = [None]

    def set(self, at: int, value: np.ndarray, slope: np.ndarray | None = None) -> None:
        """Set `value` from step `at` on, changing by `slope` a second (default 0). What was set for later is dropped."""
        keep = bisect_right(self.at, at - 1)
        del self.at[keep:], self.values[keep:], self.slopes[keep:]
        self.at.append(at)
        self.values.append(np.array(value, dtype=float))
        self.slopes.append(np.array(slope, dtype=float) if slope is not None and np.any(slope) else None)

    def follow(self, at: np.ndarray, values: np.ndarray, linear: bool) -> None:
        """Knots (knots,) in steps with values (knots, …), linear between them or each held until the next; the last one stays."""
        for k, (start, value) in enumerate(zip(at, values, strict=True)):
            last = k + 1 == len(at)
            slope = None if last or not linear else (values[k + 1] - value) / ((at[k + 1] - start) * self.step)
            self.set(int(start), value, slope)

    def between(self, start: int, end: int) -> np.ndarray:
        """Values at two steps with no knot between them, (2, …): from the right at the first, from the left at the second."""
        k = bisect_right(self.at, start) - 1
        at, value, slope = self.at[k], self.values[k], self.slopes[k]
        if slope is None:
            return np.array([value, value])
        return np.array([value + (start - at) * self.step * slope, value + (end - at) * self.step * slope])

    def next_knot(self, after: int, otherwise: int) -> int:
        """The first knot after a step, or `otherwise`."""
        k = bisect_right(self.at, after)
        return self.at[k] if k < len(self.at) else otherwise

    def constant(self, at: int) -> bool:
        """Whether the value does not change between this step and the next knot."""
        return self.slopes[bisect_right(self.at, at) - 1] is None

    def forget(self, before: int) -> None:
        """Drop knots that a time from `before` on does not need."""
        done = bisect_right(self.at, before) - 1
        del self.at[:done], self.values[:done], self.slopes[:done]


def knots(time: np.ndarray, step: float) -> np.ndarray:
    """Numbers of whole steps from the first time to each of times (rows,) in s, (rows,).

    Raises:
        InputError: they do not increase by at least a step.
    """
    steps = np.round((time - time[0]) / step).astype(int)
    if (np.diff(steps) <= 0).any():
        raise InputError(f"set points: times must increase by at least the simulation's step of {step:g} s")
    return steps
