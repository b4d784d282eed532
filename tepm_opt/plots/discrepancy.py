"""Figures of a model's discrepancy: where it misses, how far correction closes the gap, and what the evidence says."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from tepm_opt.data.metrics import point_errors, shape_error
from tepm_opt.data.run import Run, RunSet
from tepm_opt.data.setpoints import AXES
from tepm_opt.discrepancy.selection.fitting import Hypothesis
from tepm_opt.discrepancy.state import Discovery
from tepm_opt.plots.figure import STYLE
from tepm_opt.plots.palette import CORRECTED, MEASURED, NOISE, RECALIBRATED, UNJUDGED, Role
from tepm_opt.plots.palette import MODELS as ROLES

HATCHES = {"nominal": None, "recalibrated": "//", "corrected": None}
PALE = "0.72"  # of what is neither named nor a rival
Predictions = Mapping[str, Sequence[np.ndarray]]
"""Modelled points of every run, (rows, points, 3) in m, by the model's name: "nominal", "recalibrated", "corrected"."""

MODELS = ("nominal", "recalibrated", "corrected")
SPREAD = 8.0  # largest over smallest value from which an axis is logarithmic
WINDOW = 8.0  # s shown of the tip
MOST_LABELS = 3  # effects at once that are named in a figure
FEW, MANY = 60, 3000  # samples, at least and at most, where a machine is slow or quick
SMALLEST_SPAN = 2.0  # mm, so that noise is not drawn as motion
ENOUGH_ROOM = 14  # columns of the heat map that fit in its usual width
SHOWN = 20  # candidates shown of the evidence


def discovery_figures(result: Discovery) -> dict[str, Figure]:
    """All figures of an answer by the names that its page gives them; "evidence" only where something was fitted."""
    seen, verdict, place, unit = select_comparison(result), result.verdict, result.localisation, result.verdict.unit
    by_point = {name: _rms_by_point([run.points for run in seen.runs], points) for name, points in seen.predictions.items()}
    errors = {name.replace("_", " "): value for name, value in vars(verdict.errors).items()}
    data, lines = seen.data, (seen.runs, seen.predictions)
    found = {
        "heat": heat_figure(place.heat, place.runs, place.points, unit),
        "gap": gap_figure(errors, data, unit),
        "points": points_figure(place.points, by_point, verdict.errors.noise_floor, data, unit),
        "over_time": over_time_figure(*lines, verdict.errors.noise_floor, unit),
        "tip": tip_figure(*lines, seen.of, unit),
    }
    explanation = result.explanation
    fitted = [h for h in explanation.tried if len(h.effects) == 1 and h.evidence.held_out]
    fitted += [explanation.best] * (len(explanation.best.effects) > 1)
    if fitted:
        closes = {_label(h): explanation.closes(h) for h in fitted}
        sure = {_label(explanation.best), *(effect.label for effect in explanation.best.effects)}
        named = {each.candidate.label for each in verdict.effects}
        found["evidence"] = evidence_figure(closes, sure & closes.keys(), (named - sure) & closes.keys())
    return found


@dataclass(frozen=True, eq=False)
class Compared:
    """Runs, and models' predictions for them, that figures compare.

    Attributes:
        runs: those that models are judged by; a single one where each is one equilibrium.
        predictions: of every model for these runs.
        data: what the runs are called.
        of: what the last point is called.
        floor: what noise alone leaves.
        unit: of what is measured.
    """

    runs: Sequence[Run]
    predictions: Predictions
    data: str
    of: str
    floor: float
    unit: str


def select_comparison(result: Discovery) -> Compared:
    """Select the validation runs, or the fit runs where there are no others, with every model's predictions of them."""
    result = _comparable(result)
    runs = result.dataset.validation or result.dataset.runs
    at = [result.dataset.runs.index(run) for run in runs]
    predictions = {name: [points[k] for k in at] for name, points in result.predictions.items()}
    of = "tip" if runs[0].points.shape[-1] > 1 else result.localisation.points[-1]
    data = "validation runs" if result.dataset.validation else "fit runs"
    return Compared(*_join_equilibria(runs, predictions), data, of, result.verdict.errors.noise_floor, result.verdict.unit)


def _comparable(result: Discovery) -> Discovery:
    """The answer with quantities of different kinds over their noise."""
    noise = result.noise
    if not np.ndim(noise):
        return result
    runs = RunSet.from_runs(result.dataset.name, [replace(run, points=run.points / noise) for run in result.dataset.runs])
    predictions = {name: [points / noise for points in each] for name, each in result.predictions.items()}
    return replace(result, dataset=runs, predictions=predictions, noise=1.0)


def _join_equilibria(runs: Sequence[Run], predictions: Predictions) -> tuple[Sequence[Run], Predictions]:
    """Runs of a single equilibrium each as one of them all, a row each; others as they are."""
    if len(runs) < 2 or any(run.rows != 1 or np.isfinite(run.time).any() for run in runs):
        return runs, predictions
    parts = {name: np.concatenate([getattr(run, name) for run in runs]) for name in ("time", "inputs", "tip_force", "points")}
    whole = replace(runs[0], file=f"all {len(runs)} runs, a row each", extra={}, lines=(), **parts)
    return [whole], {name: [np.concatenate(each)] for name, each in predictions.items()}


def unit_shown(unit: str) -> tuple[float, str]:
    """Factor to, and name of, the unit that figures have."""
    return (1e3, "mm") if unit == "m" else (1.0, unit or "its unit")


def error_name(unit: str) -> str:
    """Name the error measure of a unit."""
    return "Eq. (5)" if unit == "m" else "error"


def _label(hypothesis: Hypothesis) -> str:
    few = len(hypothesis.effects) <= MOST_LABELS
    return " + ".join(effect.label for effect in hypothesis.effects) if few else f"{len(hypothesis.effects)} effects together"


def _rms_by_point(measured: Sequence[np.ndarray], modelled: Sequence[np.ndarray]) -> np.ndarray:
    squares = point_errors(np.concatenate(measured), np.concatenate(modelled)) ** 2
    count = np.isfinite(squares).sum(axis=0)
    return np.sqrt(np.where(count, np.nansum(squares, axis=0) / np.maximum(count, 1), np.nan))


def heat_figure(heat: np.ndarray, runs: Sequence[str], points: Sequence[str], unit: str = "m") -> Figure:
    """Draw the model's errors by run and reference point.

    Args:
        heat: structure beyond the noise by run and reference point, (runs, points); NaN where not measured.
        runs, points: names of its rows and columns.
        unit: of it.
    """
    factor, shown = unit_shown(unit)
    values = factor * np.asarray(heat)
    figure = Figure(figsize=(3.6 + 0.75 * min(len(points), ENOUGH_ROOM), 1.5 + 0.36 * len(runs)), **STYLE)  # type: ignore[arg-type]
    axes = figure.subplots()
    top = float(np.nanmax(values, initial=0.0)) or 1.0
    image = axes.imshow(values, cmap="YlOrRd", vmin=0.0, vmax=top, aspect="auto")
    axes.set_facecolor("0.9")
    axes.set_xticks(range(len(points)), list(points))
    axes.set_yticks(range(len(runs)), list(runs))
    for (row, column), value in np.ndenumerate(values):
        color = "white" if value > 0.65 * top else "black"
        axes.text(column, row, _digits(value) if np.isfinite(value) else "–", ha="center", va="center", fontsize=9, color=color)
    figure.colorbar(image, ax=axes, label=shown, pad=0.03)
    axes.set_title(f"RMS error beyond the noise, in {shown}", fontsize=11)
    return figure


def gap_figure(errors: Mapping[str, float], data: str = "validation runs", unit: str = "m") -> Figure:
    """Draw the gap of every model: root mean square of Eq. (5) in m ("noise floor", "nominal", …; NaN leaves one out)."""
    factor, label = unit_shown(unit)
    shown = {name: factor * value for name, value in errors.items() if np.isfinite(value)}
    figure = Figure(figsize=(7.5, 1.3 + 0.42 * len(shown)), **STYLE)  # type: ignore[arg-type]
    axes = figure.subplots()
    logarithmic = _scale_of_x(axes, list(shown.values()))
    floor = shown.get("noise floor", 0.0)
    left = floor if logarithmic else 0.0
    for row, (name, value) in enumerate(shown.items()):
        role = ROLES.get(name, UNJUDGED)
        axes.plot([left, value], [row, row], color=role.color, linewidth=3, alpha=0.45, solid_capstyle="butt")
        axes.plot(value, row, **role.marked, markersize=9)
        axes.annotate(f"{value:.3g} {label}", (value, row), (9, 0), textcoords="offset points", va="center", fontsize=9)
    if floor:
        axes.axvline(floor, **NOISE.lined, linewidth=1, zorder=0)
    axes.set_yticks(range(len(shown)), list(shown))
    axes.set_ylim(len(shown) - 0.5, -0.5)
    axes.margins(x=0.18 if logarithmic else 0.12)
    if not logarithmic:
        axes.set_xlim(left=0.0)
    axes.set_xlabel(f"{error_name(unit)}, RMS over time in {label}")
    axes.set_title(f"{data}: the gap between model and machine", fontsize=11)
    axes.grid(alpha=0.3, axis="x", which="both")
    return figure


def points_figure(
    points: Sequence[str], errors: Mapping[str, np.ndarray], floor: float, data: str = "validation runs", unit: str = "m"
) -> Figure:
    """Error of every reference point by model, against the noise floor.

    Args:
        points: names of the points.
        errors: root mean square distances by the model's name, (points,) in m each.
        floor: what noise alone makes of it in m.
        data: what the errors are taken over, for the title.
        unit: of the errors.
    """
    factor, label = unit_shown(unit)
    figure = Figure(figsize=(max(6.5, 1.1 * len(points) + 2.5), 3.6), **STYLE)  # type: ignore[arg-type]
    axes = figure.subplots()
    width = 0.8 / max(len(errors), 1)
    for k, (name, values) in enumerate(errors.items()):
        at = np.arange(len(points)) + (k - (len(errors) - 1) / 2) * width
        heights = factor * np.asarray(values)
        axes.bar(at, heights, 0.92 * width, color=ROLES.get(name, UNJUDGED).color, hatch=HATCHES.get(name), edgecolor="white", label=name)
        if len(points) * len(errors) <= 30:
            for x, height in zip(at[np.isfinite(heights)], heights[np.isfinite(heights)], strict=True):
                axes.annotate(_digits(height), (x, height), (0, 2), textcoords="offset points", ha="center", fontsize=7)
    axes.axhline(factor * floor, **NOISE.lined, linewidth=1.2, label=f"noise, {factor * floor:.2g} {label}")
    axes.set_xticks(range(len(points)), list(points))
    axes.set_ylabel(f"distance, RMS in {label}")
    axes.margins(y=0.1)
    axes.set_title(f"{data}: error by reference point", fontsize=11)
    axes.grid(alpha=0.3, axis="y")
    axes.set_axisbelow(True)
    axes.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def over_time_figure(runs: Sequence[Run], predictions: Predictions, floor: float, unit: str = "m") -> Figure:
    """Eq. (5) of every model at every instant, a panel a run; over the rows where there is no time.

    Args:
        runs: measured.
        predictions: of every model.
        floor: what noise alone leaves.
        unit: of what is measured.
    """
    factor, shown = unit_shown(unit)
    figure = Figure(figsize=(10.0, 1.0 + 1.9 * len(runs)), **STYLE)  # type: ignore[arg-type]
    panels: list[Axes] = list(figure.subplots(len(runs), 1, sharey=True, squeeze=False)[:, 0])
    errors = {
        name: [factor * shape_error(run.points, at) for run, at in zip(runs, each, strict=True)] for name, each in predictions.items()
    }
    every = np.concatenate([series[np.isfinite(series)] for each in errors.values() for series in each] + [np.array([factor * floor])])
    typical = [float(np.median(series[np.isfinite(series)])) for each in errors.values() for series in each if np.isfinite(series).any()]
    for k, (axes, run) in enumerate(zip(panels, runs, strict=True)):
        at, label, mark = choose_horizontal_axis(run)
        for name, each in errors.items():
            axes.plot(at, each[k], **_style(ROLES.get(name, UNJUDGED), mark), linewidth=1.0, markersize=4, label=name)
        axes.axhline(factor * floor, **NOISE.lined, linewidth=1.2, label=f"noise, {factor * floor:.2g} {shown}")
        axes.set_title(run.file, fontsize=10, loc="left")
        axes.set_ylabel(f"{error_name(unit)} in {shown}")
        axes.margins(x=0.01)
        axes.grid(alpha=0.3)
        axes.set_xlabel(label if k == len(runs) - 1 or run.duration != runs[-1].duration else "")
    if floor > 0 and typical and max(typical) > SPREAD * floor:
        panels[0].set_yscale("log")
        panels[0].set_ylim(0.3 * factor * floor, 1.3 * float(every.max()))
        for axes in panels:
            _plain_decades(axes.yaxis)
    else:
        panels[0].set_ylim(0.0, 1.08 * float(every.max()) or 1.0)
    panels[0].legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def evidence_figure(closes: Mapping[str, float], named: Collection[str], rivals: Collection[str] = ()) -> Figure:
    """Part of the gap left by recalibration that every fitted candidate closes on held-out data, 0 … 1; named ones coloured."""
    order = sorted((name for name in closes if np.isfinite(closes[name])), key=lambda name: (-closes[name], name))
    kept = [name for k, name in enumerate(order) if k < SHOWN or name in named]
    figure = Figure(figsize=(8.0, 1.3 + 0.26 * max(len(kept), 2)), **STYLE)  # type: ignore[arg-type]
    axes = figure.subplots()
    values = np.clip([100 * closes[name] for name in kept], -100.0, 100.0)
    colors = [CORRECTED.color if name in named else RECALIBRATED.color if name in rivals else PALE for name in kept]
    axes.barh(range(len(kept)), values, 0.7, color=colors)
    for row, (name, value) in enumerate(zip(kept, values, strict=True)):
        text = f"{100 * closes[name]:.0f} %"
        axes.annotate(text, (max(value, 0.0), row), (4, 0), textcoords="offset points", va="center", fontsize=8)
    axes.set_yticks(range(len(kept)), list(kept), fontsize=8)
    for tick, name in zip(axes.get_yticklabels(), kept, strict=True):
        tick.set_fontweight("bold" if name in named else "normal")
    axes.set_ylim(max(len(kept), 1) - 0.4, -0.6)
    axes.set_xlim(min(0.0, 1.1 * float(values.min(initial=0.0))), 112.0)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_xlabel("part of the gap closed on held-out data, %")
    title = "each candidate alone, after recalibration" + ("; dark: named" if named else "")
    axes.set_title(title + ("; purple: cannot be told apart" if rivals else ""), fontsize=11)
    axes.grid(alpha=0.3, axis="x")
    axes.set_axisbelow(True)
    if not kept:
        axes.text(0.5, 0.5, "no candidate was worth a fit", transform=axes.transAxes, ha="center", va="center", color="gray")
    return figure


def tip_figure(runs: Sequence[Run], predictions: Predictions, of: str = "tip", unit: str = "m") -> Figure:
    """One coordinate of the tip, measured and modelled, in the run and the seconds in which correction matters most.

    Args:
        runs: measured.
        predictions: of every model.
        of: what the last point is called.
        unit: of what is measured.
    """
    (k, rows, axis), (factor, label_of) = most_corrected(runs, predictions), unit_shown(unit)
    run, shown = runs[k], [name for name in MODELS if name in predictions]
    at, label, mark = choose_horizontal_axis(run)
    measured = factor * run.points[rows, -1, axis]
    modelled = {name: factor * predictions[name][k][rows, -1, axis] for name in shown}
    figure = Figure(figsize=(9.5, 5.2), **STYLE)  # type: ignore[arg-type]
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.2, 1.0])
    above.plot(at[rows], measured, **MEASURED.marked, markersize=4, label="measured", zorder=1)
    for name, values in modelled.items():
        above.plot(at[rows], values, **_style(ROLES[name], mark), linewidth=1.3, markersize=5, label=name)
        below.plot(at[rows], values - measured, **_style(ROLES[name], mark), linewidth=1.0, markersize=5, label=name)
    least = SMALLEST_SPAN if unit == "m" else 0.0
    _span(above, [measured, *modelled.values()], least)
    _span(below, [values - measured for values in modelled.values()], least)
    above.set_ylabel(f"{of} {AXES[axis]} in {label_of}" if run.points.shape[-1] > 1 else f"{of} in {label_of}")
    below.set_ylabel(f"modelled − measured\nin {label_of}")
    below.set_xlabel(label)
    below.axhline(0.0, color="black", linewidth=0.8)
    for axes in (above, below):
        axes.margins(x=0.01)
        axes.grid(alpha=0.3)
    above.legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    above.set_title(f"{run.file}: {'the ' if of == 'tip' else ''}{of} where correction matters most", fontsize=11)
    figure.align_ylabels([above, below])
    return figure


def _span(axes: Axes, values: Sequence[np.ndarray], least: float) -> None:
    """Limits that hold all values, never narrower than what can be told from noise."""
    every = np.concatenate(values)
    every = every[np.isfinite(every)] if np.isfinite(every).any() else np.zeros(1)
    middle, half = (every.max() + every.min()) / 2, max(float(np.ptp(every)), least, 1e-12 + 1e-9 * float(np.abs(every).max())) / 2
    axes.set_ylim(middle - 1.08 * half, middle + 1.08 * half)


def most_corrected(runs: Sequence[Run], predictions: Predictions) -> tuple[int, slice, int]:
    """Run, rows and axis in which the squared error of the tip shrinks most from the nominal to the corrected model."""
    best, found = -np.inf, (0, slice(0, runs[0].rows), 0)
    for k, run in enumerate(runs):
        before, after = (run.points[:, -1] - predictions[name][k][:, -1] for name in ("nominal", "corrected"))
        less = np.vstack([np.zeros((1, run.points.shape[-1])), np.cumsum(np.nan_to_num(before**2 - after**2), axis=0)])
        if np.isfinite(run.time).all():
            step = float(np.median(np.diff(run.time))) if run.rows > 1 else WINDOW
            ends = np.searchsorted(run.time, run.time + np.clip(WINDOW, FEW * step, MANY * step), side="right")
            starts = np.flatnonzero(ends < run.rows) if ends[0] < run.rows else np.array([0])
        else:
            starts, ends = np.array([0]), np.array([run.rows])
        gained = less[ends[starts]] - less[starts]
        row, axis = np.unravel_index(gained.argmax(), gained.shape)
        if gained.max() > best:
            best, found = gained.max(), (k, slice(int(starts[row]), int(ends[starts[row]])), int(axis))
    return found


def choose_horizontal_axis(run: Run) -> tuple[np.ndarray, str, str]:
    """Choose the horizontal axis of a run: its values (rows,), its label, and matplotlib's format of what is drawn over it."""
    timed = bool(np.isfinite(run.time).all())
    return (run.time, "time in s", "-") if timed else (np.arange(1, run.rows + 1), "row", "o")


def _style(role: Role, mark: str) -> dict[str, Any]:
    """A role's line where rows are joined, else its markers."""
    return role.lined if mark == "-" else role.marked


def _scale_of_x(axes: Axes, values: Sequence[float]) -> bool:
    """Make the axis logarithmic where the values are far apart; whether it is."""
    positive = [value for value in values if value > 0]
    if len(positive) < len(values) or not positive or max(positive) <= SPREAD * min(positive):
        axes.xaxis.set_major_locator(MaxNLocator(6))
        return False
    axes.set_xscale("log")
    _plain_decades(axes.xaxis)
    return True


def _plain_decades(axis: Axis) -> None:
    """Ticks 1, 2, 5, 10, … without powers of ten."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _digits(value: float) -> str:
    """At most two decimals."""
    return f"{value:.{2 if value < 0.995 else 1 if value < 9.95 else 0}f}"
