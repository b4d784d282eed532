"""Values over simulated time that are linear between knots, on the simulation's whole steps."""

from __future__ import annotations

from bisect import bisect_left, bisect_right

import numpy as np

from tepm_opt.errors import InputError


class Timeline:
    """Piecewise linear course of a value, perhaps with jumps at its knots; times are whole steps of `step` s.

    Args:
        value: before the first knot.
        step: of the simulation in s.

    Attributes:
        at: of the knots in steps, (room,), int64; as the next three with room for more of them.
        values: from a knot on, (room, …).
        slopes: their changes a second, (room, …).
        moves: whether a slope is not 0, (room,), uint8.
        addresses: of these four, for C.
        first, end: the knots that there are.
    """

    def __init__(self, value: np.ndarray, step: float) -> None:
        self.step = step
        self.first, self.end = 0, 0
        self._take(4, np.shape(value))
        self.set(0, value)

    def _take(self, room: int, shape: tuple[int, ...]) -> None:
        """Take place for a number of knots."""
        self.at, self.moves = np.zeros(room, dtype=np.int64), np.zeros(room, dtype=np.uint8)
        self.values, self.slopes = np.zeros((room, *shape)), np.zeros((room, *shape))
        self.addresses = tuple(each.ctypes.data for each in (self.at, self.values, self.slopes, self.moves))
        self._steps = self.at.data

    def set(self, at: int, value: np.ndarray) -> None:
        """Set `value` from step `at` on. What was set for later is dropped."""
        self._add(1, at)
        k = self.end - 1
        self.at[k], self.values[k], self.slopes[k], self.moves[k] = at, value, 0.0, 0

    def follow(self, at: np.ndarray, values: np.ndarray, linear: bool) -> None:
        """Knots (knots,) in steps with values (knots, …), linear between them or each held until the next; the last one stays."""
        self._add(len(at), int(at[0]))
        new = slice(self.end - len(at), self.end)
        slopes = np.zeros_like(values)
        if linear:
            slopes[:-1] = np.diff(values, axis=0) / (np.diff(at) * self.step).reshape(-1, *[1] * (values.ndim - 1))
        self.at[new], self.values[new], self.slopes[new] = at, values, slopes
        self.moves[new] = slopes.reshape(len(at), -1).any(axis=1)

    def _add(self, count: int, at: int) -> None:
        """Make room for knots from a step on, in place of those that are there."""
        self.end = bisect_left(self._steps, at, self.first, self.end)
        kept, had = slice(self.first, self.end), (self.at, self.values, self.slopes, self.moves)
        if self.end + count > len(self.at):
            self._take(2 * (self.end - self.first + count), self.values.shape[1:])
            self.first, self.end = 0, kept.stop - kept.start
            for new, old in zip((self.at, self.values, self.slopes, self.moves), had, strict=True):
                new[: self.end] = old[kept]
        self.end += count

    def _knot(self, at: int) -> int:
        """The knot at a step or the last one before it."""
        return bisect_right(self._steps, at, self.first, self.end) - 1

    def evaluate_between(self, start: int, end: int) -> np.ndarray:
        """Evaluate at two steps with no knot between them, (2, …): from the right at the first, from the left at the second."""
        k = self._knot(start)
        at, value = self._steps[k], self.values[k]
        if not self.moves[k]:
            return np.array([value, value])
        slope = self.slopes[k]
        return np.array([value + (start - at) * self.step * slope, value + (end - at) * self.step * slope])

    def next_knot(self, after: int, otherwise: int) -> int:
        """The first knot after a step, or `otherwise`."""
        k = self._knot(after) + 1
        return self._steps[k] if k < self.end else otherwise

    def constant(self, at: int) -> bool:
        """Whether the value does not change between this step and the next knot."""
        return not self.moves[self._knot(at)]

    def forget(self, before: int) -> None:
        """Drop knots that a time from `before` on does not need."""
        self.first = self._knot(before)


def knots(time: np.ndarray, step: float) -> np.ndarray:
    """Numbers of whole steps from the first time to each of times (rows,) in s, (rows,).

    Raises:
        InputError: they do not increase by at least a step.
    """
    steps = np.round((time - time[0]) / step).astype(int)
    if (np.diff(steps) <= 0).any():
        raise InputError(f"set points: times must increase by at least the simulation's step of {step:g} s")
    return steps
