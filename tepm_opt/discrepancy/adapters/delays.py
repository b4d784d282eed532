"""Dead times: what an input was some time ago, between its samples too, with its derivative by that time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

Late = Sequence[tuple[int, float]]
"""Numbers of inputs, and how long ago each is asked for, in s."""


SYMBOLS = 5
"""Symbols of each dead time: value and slope of the input then, each without what was before the run and by that, and the time."""


@dataclass(frozen=True, eq=False)
class DeadTime:
    """An input as it was some time ago, as more inputs of the equations.

    Attributes:
        label: of the effect that asks for it.
        number: of the input.
        time: how long ago in s, in symbols of the parameters.
        before: the input before the run, a state that stays.
        symbols: of the input's value then and of its slope, each as a constant and a factor of `before`, and of the time for which they
            were looked up.
    """

    label: str
    number: int
    time: ca.SX
    before: ca.SX
    symbols: tuple[ca.SX, ...]

    @staticmethod
    def with_symbols(label: str, number: int, time: ca.SX, before: ca.SX) -> DeadTime:
        """A dead time with symbols of its own.

        Args:
            label: of the effect that asks for it.
            number: of the input.
            time: how long ago in s, in symbols of the parameters.
            before: the input before the run.
        """
        names = "value", "value by before", "slope", "slope by before", "time"
        return DeadTime(label, number, time, before, tuple(ca.SX.sym(f"{label} {name}") for name in names))

    @property
    def signal(self) -> ca.SX:
        """The input then; its derivative by the dead time is the slope's negative."""
        value, weight, slope, steep, at = self.symbols
        return value + weight * self.before - (slope + steep * self.before) * (self.time - at)


def interpolate_delayed(at: np.ndarray, time: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Values and slopes of a column at other times, (times, 4): each as a constant and a factor of what was before the first sample.

    Samples are joined by straight lines. Before the first one the column has one value, from which it goes to the first sample within a
    step. Where slopes of two lines meet, that of the earlier line counts: it is the one towards longer dead times.

    Args:
        at: times that are asked for, (times,) in s.
        time: of the samples, (rows,) in s.
        column: (rows,).
    """
    step = time[1] - time[0] if len(time) > 1 else 1.0
    times, unit = np.append(time[0] - step, time), np.zeros(len(time) + 1)
    unit[0] = 1.0
    line = np.searchsorted(times, at, side="left") - 1
    found = []
    for values in (np.append(0.0, column), unit):
        slopes = np.append(np.diff(values) / np.diff(times), 0.0)
        found += [np.interp(at, times, values), np.where(line >= 0, slopes[line], 0.0)]
    return np.stack([found[0], found[2], found[1], found[3]], axis=1)


def with_past(columns: np.ndarray, time: np.ndarray, late: Late) -> np.ndarray:
    """Inputs with the symbols' values of each dead time behind them, (times, inputs + `SYMBOLS` · dead times).

    Args:
        columns: inputs, (times, inputs).
        time: of the rows, (times,) in s.
        late: inputs that are asked for, and how long ago.
    """
    more = [
        np.column_stack([interpolate_delayed(time - seconds, time, columns[:, number]), np.full(len(time), seconds)])
        for number, seconds in late
    ]
    return np.hstack([columns, *more])
