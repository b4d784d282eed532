"""Dead times: what an input was some time ago, between its samples too, with its derivative by that time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

Late = Sequence[tuple[int, float]]
"""Numbers of inputs, and how long ago each is asked for, in s."""


@dataclass(frozen=True, eq=False)
class DeadTime:
    """An input as it was some time ago, as three more inputs of the equations.

    Attributes:
        label: of the effect that asks for it.
        number: of the input.
        time: how long ago in s, in symbols of the parameters.
        symbols: of the input's value then, of its slope, and of the time for which both were looked up.
    """

    label: str
    number: int
    time: ca.SX
    symbols: tuple[ca.SX, ca.SX, ca.SX]

    @staticmethod
    def of(label: str, number: int, time: ca.SX) -> DeadTime:
        """With symbols of its own."""
        value, slope, at = (ca.SX.sym(f"{label} {name}") for name in ("value", "slope", "time"))
        return DeadTime(label, number, time, (value, slope, at))

    @property
    def signal(self) -> ca.SX:
        """The input then; its derivative by the dead time is the slope's negative."""
        value, slope, at = self.symbols
        return value - slope * (self.time - at)


def delayed(at: np.ndarray, time: np.ndarray, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and slopes of a column at other times, (times,) each, in straight lines between samples.

    Before the first sample the column stands still. Where slopes of two lines meet, that of the earlier line counts: it is the one
    towards longer dead times.

    Args:
        at: times that are asked for, (times,) in s.
        time: of the samples, (rows,) in s.
        column: (rows,).
    """
    if len(time) < 2:
        return np.full(len(at), column[0]), np.zeros(len(at))
    line = np.searchsorted(time, at, side="left") - 1
    slopes = np.append(np.diff(column) / np.diff(time), 0.0)
    return np.interp(at, time, column), np.where(line >= 0, slopes[line], 0.0)


def with_past(columns: np.ndarray, time: np.ndarray, late: Late) -> np.ndarray:
    """Inputs with the symbols' values of each dead time behind them, (times, inputs + 3 · dead times).

    Args:
        columns: inputs, (times, inputs).
        time: of the rows, (times,) in s.
        late: inputs that are asked for, and how long ago.
    """
    more = [np.stack([*delayed(time - seconds, time, columns[:, number]), np.full(len(time), seconds)], axis=1) for number, seconds in late]
    return np.hstack([columns, *more])
