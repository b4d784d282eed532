"""Results of blind trials as a table for people."""

from __future__ import annotations

import numpy as np

from tepm_opt.studies.blind.analysis import Analysis, Rate
from tepm_opt.studies.blind.engine import ENGINES

CALIBRATION = 0.03
"""Largest calibration error wanted."""


def markdown(analysis: Analysis) -> str:
    """The rates with their intervals and limits, then calibration, gap and time, in Markdown."""
    if not analysis.judged:
        return "No trial is done.\n"
    families = ", ".join(f"{count} {name}" for name, count in analysis.summary()["families"].items())
    lines = [
        f"{len(analysis.judged)} trials: {families}.",
        "",
        "| | rate | of | 95 % interval | wanted |",
        "| --- | --- | --- | --- | --- |",
        *(_row(rate) for rate in analysis.rates if rate.of),
    ]
    for name, truth in analysis.truth.items():
        numbers = f"{truth.value:.3f} | {truth.of} | {truth.low:.3f} … {truth.high:.3f}"
        lines.append(f"| {ENGINES[name].title}: mean probability stated of a true cause | {numbers} | |")
    found = analysis.reliability
    if found is not None:
        low, high = found.band
        wanted = f"≤ {CALIBRATION}, {'kept' if found.error <= CALIBRATION else '**missed**'}"
        numbers = f"{found.error:.3f} | {found.counts.sum()} | {low:.3f} … {high:.3f}"
        lines.append(f"| calibration error of stated probabilities | {numbers} | {wanted} |")
    lines.append("")
    for text, values, unit in (
        ("Gap that recalibration leaves on validation runs and that is closed where the answer is right", 100 * analysis.closed, "%"),
        ("Processor time of a verdict", analysis.seconds, "s"),
    ):
        if len(values):
            low, middle, high = np.percentile(values, [5, 50, 95])
            lines.append(f"{text}: median {middle:.0f} {unit}, 5 % to 95 % of all: {low:.0f} … {high:.0f} {unit}.")
    lines += [f"{count} without data: {error}." for error, count in analysis.failed.items()]
    return "\n".join(lines) + "\n"


def _row(rate: Rate) -> str:
    low, high = rate.interval
    limits = [f"≥ {100 * rate.least:.2g}%"] * (rate.least > 0) + [f"≤ {100 * rate.most:.2g}%"] * (rate.most < 1)
    wanted = "" if rate.kept is None else f"{', '.join(limits)}, {'kept' if rate.kept else '**missed**'}".replace("%", " %")
    return f"| {rate.name} | {100 * rate.value:.1f} % | {rate.of} | {100 * low:.1f} … {100 * high:.1f} % | {wanted} |"
