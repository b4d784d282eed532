"""Figures of blind trials: rates, detection against size, reliability of stated probabilities, confusion."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from tepm_opt.plots.figure import STYLE, save_figures
from tepm_opt.plots.palette import BAD, GOOD, MEASURED, TARGET, UNJUDGED
from tepm_opt.studies.blind.analysis import NO_CAUSE, Analysis, Reliability
from tepm_opt.studies.blind.judged import NOTHING
from tepm_opt.studies.blind.run import BlindRun

FEW = 12
"""Columns of the confusion matrix for what is said most often; the others are one more."""


def draw_blind_trials(run: BlindRun, folder: str | Path) -> dict[str, Path]:
    """Draw the figures of blind trials into a folder that is there.

    Returns:
        The files by the figures' names.

    Raises:
        InputError: the folder cannot be written to.
    """
    return save_figures(blind_figures(run.analysis), folder)


def blind_figures(found: Analysis) -> dict[str, Figure | None]:
    """All figures of an analysis, by name; None where there is nothing to draw."""
    return {
        "rates": rates_figure(found) if found.judged else None,
        "detection": detection_figure(found) if any(every.of for _, every, _ in found.detection) else None,
        "reliability": None if found.reliability is None else reliability_figure(found.reliability),
        "confusion": confusion_figure(found) if found.confusion else None,
    }


def rates_figure(found: Analysis) -> Figure:
    """Every rate with its 95 % interval, and the limits that it shall keep."""
    rates = [rate for rate in found.rates if rate.of][::-1]
    figure = Figure(figsize=(9.5, 1.0 + 0.27 * len(rates)), **STYLE)  # type: ignore[arg-type]
    axes = figure.add_subplot()
    for row, rate in enumerate(rates):
        low, high = rate.interval
        role = UNJUDGED if rate.kept is None else GOOD if rate.kept else BAD
        axes.plot([100 * low, 100 * high], [row, row], color=role.color, lw=2, alpha=0.5, solid_capstyle="butt")
        axes.plot(100 * rate.value, row, **role.marked, ms=5)
        for limit in {rate.least, rate.most} - {0.0, 1.0} if rate.most else {0.0}:
            axes.plot([100 * limit, 100 * limit], [row - 0.38, row + 0.38], color=TARGET.color, lw=1.5)
    axes.set_yticks(range(len(rates)), [f"{rate.name} ({rate.of})" for rate in rates], fontsize=8)
    axes.set_xlim(-2, 102)
    axes.set_ylim(-0.7, len(rates) - 0.3)
    axes.set_xlabel(
        "% of trials (their number in brackets), Wilson's 95 % intervals\nblack: limits; dot: kept, cross: missed, diamond: none set"
    )
    axes.grid(axis="x", alpha=0.3)
    return figure


def detection_figure(found: Analysis) -> Figure:
    """Draw the rate at which a single effect is found, and the whole answer right, over the misfit it leaves."""
    figure = Figure(figsize=(7.0, 4.4), **STYLE)  # type: ignore[arg-type]
    axes = figure.add_subplot()
    bins = [entry for entry in found.detection if entry[1].of]
    middles = np.array([at for at, _, _ in bins])
    for shift, role, name, rates in (
        (0.97, UNJUDGED, "found with its detail", [rate for _, rate, _ in bins]),
        (1.03, GOOD, "the answer is right", [rate for _, _, rate in bins]),
    ):
        values = np.array([100 * rate.value for rate in rates])
        spread = np.abs(100 * np.array([rate.interval for rate in rates]).T - values)
        axes.errorbar(shift * middles, values, spread, fmt=role.marker, **role.lined, capsize=3, label=name)
    for at, every, _ in bins:
        axes.annotate(str(every.of), (at, 3.0), ha="center", fontsize=8, color=MEASURED.color)
    axes.set_xscale("log")
    axes.set_xticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
    axes.minorticks_off()
    axes.set_ylim(0, 104)
    axes.set_xlabel("misfit that it leaves after recalibration, over the noise (grey: number of trials)")
    axes.set_ylabel("% of single effects of the library")
    axes.grid(alpha=0.3)
    axes.legend(loc="center right")
    return figure


def reliability_figure(found: Reliability) -> Figure:
    """Stated probabilities against how often what they were stated of acts."""
    figure = Figure(figsize=(5.2, 5.2), **STYLE)  # type: ignore[arg-type]
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], **TARGET.lined, lw=1, label="calibrated")
    label = f"{len(found.counts)} bins of {found.counts.min()} effects or one more, 95 % band"
    spread = np.clip([found.acts - found.low, found.high - found.acts], 0.0, None)
    axes.errorbar(found.stated, found.acts, spread, fmt=UNJUDGED.marker, **UNJUDGED.lined, capsize=3, label=label)
    low, high = found.band
    axes.set_title(f"calibration error {found.error:.3f} ({low:.3f} … {high:.3f})", fontsize=10)
    axes.set_xlim(0, 1.02)
    axes.set_ylim(0, 1.02)
    axes.set_xlabel("stated probability of a listed effect")
    axes.set_ylabel("how often it acts")
    axes.set_aspect("equal")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left")
    return figure


def confusion_figure(found: Analysis) -> Figure:
    """Draw answers by hidden cause; an outlined field is the right answer. Causes without a name stand below."""
    total = Counter[str]()
    for said in found.confusion.values():
        total.update(said)
    own = [name for name in found.confusion if name in total]
    forms = [name for name in found.confusion if " (" in name]
    hidden = [*own, *forms, *(name for name in found.confusion if name not in (*own, *forms))]
    others = [name for name, _ in total.most_common() if name not in own]
    columns = [*own, *others[:FEW], *(["others"] if len(others) > FEW else [])]
    counts = np.zeros((len(hidden), len(columns)))
    for row, name in enumerate(hidden):
        for said, count in found.confusion[name].items():
            counts[row, columns.index(said if said in columns else "others")] += count
    shares = counts / counts.sum(axis=1, keepdims=True)
    figure = Figure(figsize=(2.8 + 0.33 * len(columns), 2.2 + 0.25 * len(hidden)), **STYLE)  # type: ignore[arg-type]
    axes = figure.add_subplot()
    axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for row, column in np.argwhere(counts):
        color = "white" if shares[row, column] > 0.6 else "black"
        axes.text(column, row, f"{counts[row, column]:.0f}", ha="center", va="center", fontsize=7, color=color)
        if columns[column] == (NOTHING if hidden[row] == NO_CAUSE else hidden[row].split(" (")[0]):
            axes.add_patch(Rectangle((column - 0.47, row - 0.45), 0.94, 0.9, fill=False, edgecolor=GOOD.color, lw=1.5))
    axes.set_xticks(range(len(columns)), columns, rotation=90, fontsize=8)
    axes.set_yticks(range(len(hidden)), hidden, fontsize=8)
    axes.set_xlabel("said (the most probable name, or the status where nothing is named)")
    axes.set_ylabel("hidden alone")
    return figure
