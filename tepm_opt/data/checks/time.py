"""Checks of a run's time column."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tepm_opt.data.channels import TIME
from tepm_opt.data.checks.findings import Finding, Subject

UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds", 1 / 60: "minutes"}


def check_time(subject: Subject) -> Iterator[Finding]:
    """Time that is missing, does not increase, is in another unit, irregular, or at another rate than `sample_rate_hz`."""
    run = subject.run
    if (missing := np.flatnonzero(~np.isfinite(run.time))).size:
        yield subject.make_finding("error", TIME, "no time", missing)
        return
    if run.rows < 10:
        yield subject.make_finding("error", TIME, f"only {run.rows} rows; a run of a motion needs more")
    yield from _order(subject)
    if run.rows > 1:
        unit = _unit(subject)
        yield from [unit] if unit else (*_rate(subject), *_regularity(subject))


def _order(subject: Subject) -> Iterator[Finding]:
    run = subject.run
    steps = np.diff(run.time)
    values = np.column_stack([subject.driven, run.points.reshape(run.rows, -1)])
    same = np.all((values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1])), axis=1)
    if (rows := np.flatnonzero((steps == 0) & same) + 1).size:
        yield subject.make_finding("error", TIME, "a copy of the row before", rows)
    if (rows := np.flatnonzero((steps == 0) & ~same) + 1).size:
        yield subject.make_finding("error", TIME, "the time of the row before stands again", rows)
    if (rows := np.flatnonzero(steps < 0) + 1).size:
        first = rows[0]
        yield subject.make_finding("error", TIME, f"time goes back, from {run.time[first - 1]:g} to {run.time[first]:g} s", rows)


def _unit(subject: Subject) -> Finding | None:
    rate = subject.rate
    if rate is None:
        return None
    for factor, name in UNITS.items():
        if 0.8 < subject.step * rate / factor < 1.25:
            found = f"rows are {subject.step:g} apart and sample_rate_hz = {rate:g} means {1 / rate:g} s"
            return subject.make_finding("error", TIME, f"is in {name}, not seconds: {found}")
    return None


def _rate(subject: Subject) -> Iterator[Finding]:
    if subject.rate is None:
        return
    miss = abs(subject.step * subject.rate - 1)
    if miss > 0.005:
        message = f"rows come at {1 / subject.step:.4g} Hz, sample_rate_hz = {subject.rate:g}"
        yield subject.make_finding("error" if miss > 0.05 else "warning", TIME, message)


def _regularity(subject: Subject) -> Iterator[Finding]:
    run, step = subject.run, subject.step
    steps = np.diff(run.time)
    gaps = np.flatnonzero(steps > 1.5 * step)
    if gaps.size:
        rows, widest = gaps + 1, gaps[np.argmax(steps[gaps])]
        lost = round(float((steps[gaps] / step - 1).sum()))
        message = f"{lost} rows are missing in {gaps.size} gaps, the longest {steps[widest]:.3g} s before line {run.line(int(widest) + 1)}"
        unknown = [gap for gap in gaps if steps[gap] > 0.5 and np.any(subject.driven[gap] != subject.driven[gap + 1])]
        if unknown:
            message += "; inputs changed meanwhile, nobody knows how"
        yield subject.make_finding("error" if unknown else "warning", TIME, message, rows)
    odd = np.flatnonzero((steps > 0) & (steps <= 1.5 * step) & (np.abs(steps / step - 1) > 0.2)) + 1
    if odd.size > 0.02 * run.rows:
        message = f"{100 * odd.size / run.rows:.0f} % of the rows are irregular: more than a fifth off the step of {step:.4g} s"
        yield subject.make_finding("warning", TIME, message, odd)
