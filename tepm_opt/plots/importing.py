"""The preview of an import: samples as the files have them and rows as the data set will, inputs, what is measured, and steps of time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tepm_opt.data.channels import TIME
from tepm_opt.data.importing.runs import ImportedRun
from tepm_opt.data.importing.samples import Samples
from tepm_opt.jobs.import_data import ImportRun
from tepm_opt.plots.figure import STYLE
from tepm_opt.plots.palette import ACTUATORS, AXES, BAD, TARGET

NAMED = 12  # lines that a legend names
MOST = 3  # runs that are drawn
WIDE = 4.0  # times the usual step, from which on steps are drawn on a logarithmic scale
SCALES = {"pressure": (1e-3, "kPa"), "force": (1.0, "N"), "length": (1e3, "mm")}
DIRECTIONS = tuple(role.color for role in AXES.values())
STYLES = ("-", "--", ":", "-.")


def preview_figure(run: ImportRun) -> Figure:
    """A column for each of the first three runs: every entry of the map that moves, then the steps between samples."""
    shown = run.runs[:MOST]
    places = list(
        dict.fromkeys(s.wanted.place for each in shown for s in each.samples if s.column is not None and s.values.dtype.kind == "f")
    )
    machine = [kind for kind in ("inputs", "outputs", "extra") if any(place.startswith(f"{kind}.") for place in places)]
    panels = [place for place in places if "." not in place] + machine
    timed = run.rate is not None
    count = len(panels) + timed
    figure = Figure(figsize=(max(4.6 * len(shown), 8.0), 1.9 * count + 0.9), **STYLE)  # type: ignore[arg-type]
    grid = np.asarray(figure.subplots(count, len(shown), squeeze=False, sharex="col" if timed else False))
    for column, each in enumerate(shown):
        for row, panel in enumerate(panels):
            _values(grid[row, column], each, panel, timed, (column == 0, column == len(shown) - 1))
        if timed:
            _steps(grid[-1, column], each, first=column == 0)
        grid[0, column].set_title(f"{each.file} ({each.role}), {each.rows} rows", fontsize=10)
        grid[-1, column].set_xlabel("time in s" if timed else "row")
        grid[-1, column].set_xlim(left=0)
    figure.align_ylabels(list(grid[:, 0]))
    more = f", first {MOST} of {len(run.runs)} runs" if len(run.runs) > MOST else ""
    rate = f"{run.rate:g} rows a second" if run.rate else "equilibria"
    figure.suptitle(f"what becomes a data set: {rate}{more}; dots: samples in the files, lines: rows")
    return figure


def _values(axes: Axes, run: ImportedRun, panel: str, timed: bool, outer: tuple[bool, bool]) -> None:
    own = [s for s in run.samples if s.column is not None and s.values.dtype.kind == "f" and s.wanted.place.partition(".")[0] == panel]
    if panel == "position":
        own = own[-3:]  # of the last point, as it moves away from its first row
    scale, unit = SCALES.get(own[0].wanted.dimension or "", (1.0, "")) if own else (1.0, "")
    time = run.columns[TIME] if timed else np.arange(1, run.rows + 1)
    for k, each in enumerate(own):
        colour, style = (DIRECTIONS if panel == "position" else ACTUATORS)[k % 3], STYLES[k // 3 % 4]
        zero = float(np.nan_to_num(run.columns[each.target][0])) if panel == "position" else 0.0
        if each.clock is not None:
            axes.plot(each.clock.time - run.start, scale * (each.values - zero), ".", color=colour, markersize=2.5, alpha=0.35)
        marker = "" if timed else "o"
        # of the files' axes, as the dots are: the frame is turned later
        axes.plot(time, scale * (run.columns[each.target] - zero), style, marker=marker, color=colour, linewidth=1.1, label=_label(each))
    name = "from the first\nrow on" if panel == "position" else panel
    axes.set_ylabel((f"{name}\nin {unit}" if unit else name) if outer[0] else "")
    axes.grid(alpha=0.3)
    if outer[1] and 0 < len(own) <= NAMED:
        axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)


def _label(each: Samples) -> str:
    """Its column of the data set, as short as can be told."""
    return each.target if "." in each.wanted.place else each.target.rpartition("_")[0].replace("pressure_", "").replace("tension_", "")


def _steps(axes: Axes, run: ImportedRun, first: bool) -> None:
    """Steps between samples of each clock, so that jitter and gaps are seen."""
    clocks = {}
    for each in run.samples:
        if each.clock is not None:
            clocks.setdefault((id(each.sheet), len(each.clock.time), float(each.clock.time[0])), (each, each.clock))
    for k, (each, clock) in enumerate(clocks.values()):
        steps = 1e3 * np.diff(clock.time)
        wide = steps > 1.9e3 * clock.step
        name = each.wanted.place if len(clocks) > 1 else None
        axes.plot(clock.time[1:][~wide] - run.start, steps[~wide], ".", markersize=2.5, color=(TARGET.color, *ACTUATORS)[k % 4], label=name)
        axes.plot(
            clock.time[1:][wide] - run.start,
            steps[wide],
            "x",
            markersize=5,
            color=BAD.color,
            label=f"{wide.sum()} gaps" if wide.any() else None,
        )
    longest = max((float(1e3 * np.diff(clock.time).max()) for _, clock in clocks.values()), default=1.0)
    if longest > WIDE * max((1e3 * clock.step for _, clock in clocks.values()), default=1.0):
        axes.set_yscale("log")
    else:
        axes.set_ylim(0, 1.2 * longest)
    axes.set_ylabel("step between\nsamples in ms" if first else "")
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=7, loc="best")
