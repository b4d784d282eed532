"""Checks of a run's inputs and tip force, and of measured pressures and tensions beside them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tepm_opt.data.checks.findings import Finding, Subject, longest, spread
from tepm_opt.data.setpoints import FORCE_COLUMNS
from tepm_opt.data.sizes import PRESSURE, TENSION, Quantity, judge_force


@dataclass(frozen=True, eq=False)
class Measured:
    """Pressures or tensions of a run.

    Attributes:
        quantity: which.
        names: of the columns.
        values: (rows, actuators).
        limit: of all of them.
    """

    quantity: Quantity
    names: tuple[str, ...]
    values: np.ndarray
    limit: float

    @property
    def unit(self) -> str:
        """Unit of the values."""
        return self.quantity.unit


def quantities(subject: Subject) -> tuple[Measured, Measured]:
    """Pressures and tensions."""
    channels, count = subject.channels, len(subject.channels.actuators)
    inputs = subject.run.inputs
    return (
        Measured(PRESSURE, channels.inputs[:count], inputs[:, :count], channels.pressure_max),
        Measured(TENSION, channels.inputs[count:], inputs[:, count:], channels.tension_max),
    )


def check_inputs(subject: Subject) -> Iterator[Finding]:
    """Values that are missing, impossible, in another unit or at their limit for long; runs that excite nothing."""
    run = subject.run
    for name, values in zip((*subject.channels.inputs, *FORCE_COLUMNS), subject.driven.T, strict=True):
        if (rows := np.flatnonzero(~np.isfinite(values))).size:
            yield subject.make_finding(
                "error", name, f"= {values[rows[0]]:g}; valid: a finite number, what was commanded must be known", rows
            )
    for quantity in quantities(subject):
        yield from _range(subject, quantity)
    yield from _force(subject)
    if run.rows > 1 and not is_excited(subject):
        yield subject.make_finding("warning", "", "nothing is excited: no input or tip force changes by 0.5 % of its range")
    yield from _check_measured_inputs(subject)


def is_excited(subject: Subject) -> bool:
    """Whether an input or the tip force changes by more than 0.5 % of its range (where that is unknown: at all)."""
    tension = subject.channels.tension_max
    scale = np.append(subject.channels.limits, 3 * [tension])
    least = np.where(np.isfinite(scale), 5e-3 * scale, 0.0)
    return bool(np.any(spread(subject.driven) > least))


def _range(subject: Subject, quantity: Measured) -> Iterator[Finding]:
    values, limit = quantity.values, quantity.limit
    if (rows := np.flatnonzero(np.any(values < 0, axis=1))).size:
        column = int(np.argmin(np.nanmin(values, axis=0)))
        message = f"{np.nanmin(values):g} {quantity.unit} is negative; valid: 0 … {limit:g}"
        yield subject.make_finding("error", quantity.names[column], message, rows)
    if not np.isfinite(limit) or not values.size:
        return
    largest = float(np.nanmax(values, initial=0.0))
    if message := quantity.quantity.judge(largest, limit):
        rows = np.flatnonzero(np.any(values > limit, axis=1)) if largest > limit else ()
        column = int(np.argmax(np.nanmax(values, axis=0)))
        yield subject.make_finding("error", quantity.names[column], message, rows)
        return
    for name, column in zip(quantity.names, values.T, strict=True):
        full = column >= limit * (1 - 1e-3)
        length, first, last = longest(full)
        if length * subject.step > 2.0 or (full.mean() > 0.25 and length > 1):
            message = f"saturated: at its limit of {limit:g} {quantity.unit} in {100 * full.mean():.0f} % of the run"
            yield subject.make_finding("warning", name, message, range(first, last + 1))


def _force(subject: Subject) -> Iterator[Finding]:
    most = subject.channels.tension_max * len(subject.channels.actuators)
    force = np.linalg.norm(subject.run.tip_force, axis=1)
    if (rows := np.flatnonzero(force > most)).size:
        message = judge_force(float(np.nanmax(force)), most)
        yield subject.make_finding("error", FORCE_COLUMNS[int(np.argmax(np.nanmax(np.abs(subject.run.tip_force), axis=0)))], message, rows)


def _check_measured_inputs(subject: Subject) -> Iterator[Finding]:
    for quantity in quantities(subject):
        for name, command in zip(quantity.names, quantity.values.T, strict=True):
            column = f"{name.removesuffix(quantity.unit)}measured_{quantity.unit}"
            measured = subject.run.extra.get(column)
            if measured is None or measured.dtype.kind != "f":
                continue
            if np.isnan(measured).all():
                yield subject.make_finding("error", column, "empty in all rows; leave the column out where nothing is measured")
            elif spread(command) > 0.02 * (quantity.limit if np.isfinite(quantity.limit) else spread(command)):
                yield from _compare(subject, column, command, measured)


def _compare(subject: Subject, column: str, command: np.ndarray, measured: np.ndarray) -> Iterator[Finding]:
    """Measured values that stand still or are of another magnitude while the command moves."""
    if spread(measured) == 0:
        yield subject.make_finding("error", column, "frozen: one value in all rows while the command moves")
        return
    ratio = float(spread(measured) / spread(command))
    if not 0.02 < ratio < 50:
        yield subject.make_finding("error", column, f"moves {ratio:.2g} times as much as its command: another unit?")
