"""Findings of checks of data, and the statistics that the checks share: robust ones, so that noise raises no alarm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from tepm_opt.data.channels import Channels
from tepm_opt.data.outliers import strays, stuck
from tepm_opt.data.run import Run

Severity = Literal["error", "warning"]
COARSE = 1e-4  # m, steps of a tracker that are no jumps
MAD = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution."""


@dataclass(frozen=True)
class Finding:
    """Something wrong or doubtful in a data set.

    Attributes:
        severity: "error" where a fit to the data would mislead, "warning" where a person should know.
        file: name in the data set's folder.
        row: line in the file (the header is line 1) where it begins; None where no line can be named.
        last_row: line where it ends.
        channel: column or reference point; empty where it concerns the file.
        message: one line.
        is_setup: whether it is a set-up error that the discrepancy workflow finds and mends itself.
    """

    severity: Severity
    file: str
    row: int | None
    last_row: int | None
    channel: str
    message: str
    is_setup: bool = False


@dataclass(frozen=True, eq=False)
class Subject:
    """A run under examination, with what several checks need of it."""

    run: Run
    channels: Channels
    rate: float | None

    def __repr__(self) -> str:
        return f"Subject({self.run!r})"

    def make_finding(
        self, severity: Severity, channel: str, message: str, rows: Sequence[int] | np.ndarray = (), is_setup: bool = False
    ) -> Finding:
        """Make a finding about rows of the run; the message names their lines in the file.

        Args:
            severity: how bad it is.
            channel: column or reference point that it is about; empty where it concerns the file.
            message: what was found, in one line.
            rows: numbers of the rows, from 0; empty where it is about the whole run.
            is_setup: see `Finding`.
        """
        lines = [self.run.line(int(row)) for row in rows]
        where = f"{lines_text(lines)}: " if lines else ""
        ends = (lines[0], lines[-1]) if lines else (None, None)
        return Finding(severity, self.run.file, *ends, channel, where + message, is_setup)

    @cached_property
    def step(self) -> float:
        """Median time between rows in s; what the rate says where time is of no use; 0 in data of equilibria."""
        steps = np.diff(self.run.time)
        steps = steps[np.isfinite(steps) & (steps > 0)]
        if steps.size:
            return float(np.median(steps))
        return 1 / self.rate if self.rate else 0.0

    @cached_property
    def points(self) -> np.ndarray:
        """The run's points without samples whose coordinates are all 0, a code for a lost one, (rows, points, 3)."""
        return np.where(np.all(self.run.points == 0, axis=2, keepdims=True), np.nan, self.run.points)

    @cached_property
    def driven(self) -> np.ndarray:
        """Inputs and tip force together, (rows, inputs + 3)."""
        return np.hstack([self.run.inputs, self.run.tip_force])

    @cached_property
    def steady_rows(self) -> int:
        """Rows from the start during which inputs and tip force keep their first value."""
        changed = np.any(self.driven != self.driven[0], axis=1)
        return int(np.argmax(changed)) if changed.any() else self.run.rows

    @cached_property
    def noise(self) -> np.ndarray:
        """Noise of each coordinate in m, 1 sigma, from second differences, (points, 3); NaN where there are too few samples."""
        return noise_level(self.points)

    @cached_property
    def strays(self) -> np.ndarray:
        """Samples that jump away from their neighbours and back, (rows, points)."""
        return strays(self.run.time, self.points, noise=COARSE)

    @cached_property
    def stuck(self) -> np.ndarray:
        """Samples that are exactly those before them for long, (rows, points)."""
        return stuck(self.points)

    @cached_property
    def repeated(self) -> float:
        """Typical share of samples at rest within 1 µm of the one before: near 1 in data without noise."""
        rows = self.steady_rows if self.steady_rows >= 6 else self.run.rows
        points = self.points[:rows]
        pairs = np.isfinite(points[1:]) & np.isfinite(points[:-1])
        with np.errstate(invalid="ignore"):
            same = (np.abs(np.diff(points, axis=0)) < 1e-6) & pairs
        counts = pairs.sum(axis=0)
        shares = same.sum(axis=0)[counts > 0] / counts[counts > 0]
        return float(np.median(shares)) if shares.size else 1.0

    @cached_property
    def noisy(self) -> bool:
        """Whether the tracker's noise is visible, so that a value repeated for long is no measurement."""
        return self.repeated < 0.5


def noise_level(values: np.ndarray) -> np.ndarray:
    """Standard deviation of white noise on smooth signals (rows, …) from the MAD of their second differences."""
    second = np.diff(values, n=2, axis=0)
    if not len(second):
        return np.full(values.shape[1:], np.nan)
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(second)
    level = np.full(values.shape[1:], np.nan)
    for index in np.ndindex(level.shape):
        column = second[(slice(None), *index)][finite[(slice(None), *index)]]
        if len(column) >= 8:
            level[index] = MAD * np.median(np.abs(column)) / np.sqrt(6)
    return level


def intervals(mask: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of each stretch of a boolean array (rows,) that is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(first), int(last) - 1) for first, last in zip(edges[::2], edges[1::2], strict=True)]


def longest(mask: np.ndarray) -> tuple[int, int, int]:
    """Length, first and last index of the longest stretch that is true; length 0 where there is none."""
    return max(((last - first + 1, first, last) for first, last in intervals(mask)), default=(0, 0, 0), key=lambda found: found[0])


def lines_text(lines: Sequence[int], most: int = 4) -> str:
    """Line numbers for people: "line 7", "lines 7 to 12", "lines 7, 9, 30, 31 and 12 more"."""
    if len(lines) == 1:
        return f"line {lines[0]}"
    if len(lines) > 2 and lines[-1] - lines[0] == len(lines) - 1:
        return f"lines {lines[0]} to {lines[-1]}"
    shown = ", ".join(str(line) for line in lines[:most])
    return f"lines {shown}" + (f" and {len(lines) - most} more" if len(lines) > most else "")


def spread(values: np.ndarray) -> np.ndarray:
    """Largest minus smallest finite value along the rows, 0 where there is none."""
    low = np.where(np.isfinite(values), values, np.inf).min(axis=0, initial=np.inf)
    high = np.where(np.isfinite(values), values, -np.inf).max(axis=0, initial=-np.inf)
    return np.where(high >= low, high - low, 0.0)
