"""Figures of a simulated motion: the tip over time with the inputs below it, and the actuators' lengths."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tepm_opt.jobs.simulate import SimulateRun
from tepm_opt.plots.figure import STYLE
from tepm_opt.plots.palette import AXES, MEASURED, NOMINAL, Role, actuator, channel

NOTHING = 0.3  # height of the panel of inputs that are zero throughout
LEAST_SPAN = 2.0  # mm, so that a robot at rest is not drawn as rounding errors
FROM_NULL, STEADY = 0.5, 0.02  # of the largest input: smallest one from which null is not shown, and least span then


def tip_figure(run: SimulateRun) -> Figure:
    """Tip coordinates (dots: measured), Eq. (5) where measured, tip force where there is one, and the inputs, over one time axis."""
    setpoints, half = run.simulation.setpoints, run.model.layout.inputs // 2
    errors = run.errors()
    loaded = bool(setpoints.tip_force.any())
    driven = (("pressure\nin kPa", 1e-3 * setpoints.inputs[:, :half]), ("tension\nin N", setpoints.inputs[:, half:]))
    heights = [1.3, 1.3, 1.3, *([1.0] if errors is not None else []), *([0.8] if loaded else [])]
    heights += [1.1 if values.any() else NOTHING for _, values in driven]
    figure = Figure(figsize=(10.0, 1.5 * sum(heights) + 0.8), **STYLE)  # type: ignore[arg-type]
    panels: list[Axes] = list(figure.subplots(len(heights), 1, sharex=True, height_ratios=heights))
    rest = iter(panels)
    for k, (name, role) in enumerate(AXES.items()):
        _tip_axes(next(rest), run, k, name, role, errors is not None)
    if errors is not None:
        _error_axes(next(rest), run, errors)
    if loaded:
        force = next(rest)
        for k, (name, role) in enumerate(AXES.items()):
            _inputs(force, run, setpoints.tip_force[:, k], role, f"F{name}")
        _finish(force, "tip force\nin N", setpoints.tip_force)
    for kind, values in driven:
        _driven_axes(next(rest), run, kind, values)
    panels[-1].set_xlabel("time in s")
    figure.align_ylabels(panels)
    figure.suptitle(_title(run, "tip in frame G, and what drives it"))
    return figure


def lengths_figure(run: SimulateRun) -> Figure:
    """Lengths of the actuators, a panel a module, all with one scale."""
    layout, simulation = run.model.layout, run.simulation
    lengths = 1e3 * simulation.lengths
    figure = Figure(figsize=(10.0, 2.6 * layout.modules + 0.9), **STYLE)  # type: ignore[arg-type]
    panels: list[Axes] = list(np.atleast_1d(figure.subplots(layout.modules, 1, sharex=True, sharey=True)))
    for h, axes in enumerate(panels):
        for j in range(layout.actuators):
            k = h * layout.actuators + j
            axes.plot(simulation.setpoints.time, lengths[:, k], color=actuator(j), linewidth=1.3, label=f"A{layout.actuator_names[k]}")
        axes.axhline(1e3 * run.model.values["L_0"], color="gray", linewidth=0.8, linestyle=":", label="at rest, $L_0$")
        _finish(axes, f"module {h + 1}\nlength in mm", lengths)
    panels[0].set_ylim(*_limits(np.append(lengths, 1e3 * run.model.values["L_0"])))
    panels[-1].set_xlabel("time in s")
    figure.suptitle(_title(run, "lengths of the actuators"))
    return figure


def _title(run: SimulateRun, what: str) -> str:
    early = "" if run.ok else f", ended early at {run.summary()['reached_s']:.3g} s"
    return f"{run.model.robot.name}: {what}{early}"


def _driven_axes(axes: Axes, run: SimulateRun, label: str, values: np.ndarray) -> None:
    """Pressures or tensions of all actuators; a line of text where there are none."""
    layout = run.model.layout
    if not values.any():
        axes.set_yticks([])
        axes.margins(x=0.01)
        axes.text(0.5, 0.5, f"no {label.split()[0]}", transform=axes.transAxes, ha="center", va="center", fontsize=9, color="gray")
        return
    for k, name in enumerate(layout.actuator_names):
        _inputs(axes, run, values[:, k], channel(layout, k), f"A{name}")
    _finish(axes, label, None, ncols=layout.modules)
    axes.set_ylim(*_input_limits(values))


def _inputs(axes: Axes, run: SimulateRun, values: np.ndarray, role: Role, label: str) -> None:
    draw = "steps-post" if run.hold else "default"
    axes.plot(run.simulation.setpoints.time, values, **role.lined, linewidth=1.2, drawstyle=draw, label=label)  # type: ignore[arg-type]


def _tip_axes(axes: Axes, run: SimulateRun, coordinate: int, name: str, role: Role, measured: bool) -> None:
    modelled = 1e3 * run.simulation.tip[:, coordinate]
    shown = modelled
    axes.plot(run.simulation.setpoints.time, modelled, color=role.color, linewidth=1.3, label="simulated", zorder=3)
    if measured and run.measured is not None:
        tip = 1e3 * run.measured[:, -1, coordinate]
        axes.plot(run.time, tip, ".", color=MEASURED.color, markersize=3, label="measured")
        shown = np.concatenate([modelled, tip[np.isfinite(tip)]])
    _finish(axes, f"tip {name}\nin mm", shown, legend=measured and coordinate == 0)


def _error_axes(axes: Axes, run: SimulateRun, errors: np.ndarray) -> None:
    rms = run.summary()["measured"]["error_rms_m"]
    axes.plot(run.time, 1e3 * errors, color=NOMINAL.color, linewidth=1.1, label="each instant")
    axes.axhline(1e3 * rms, color="black", linewidth=0.9, linestyle="--", label=f"RMS {1e3 * rms:.3g} mm")
    _finish(axes, "Eq. (5)\nin mm", None)
    axes.set_ylim(bottom=0.0)


def _limits(values: np.ndarray) -> tuple[float, float]:
    """Limits that hold all values, never narrower than what can be told from rounding."""
    middle, half = (values.max() + values.min()) / 2, max(float(np.ptp(values)) / 2, LEAST_SPAN / 2)
    return float(middle - 1.08 * half), float(middle + 1.08 * half)


def _input_limits(values: np.ndarray) -> tuple[float | None, float | None]:
    """Limits of inputs from 0, but where that would squeeze them all into a stripe."""
    low, high = float(values.min()), float(values.max())
    if low < FROM_NULL * high:
        return 0.0, None
    middle, half = (low + high) / 2, max(high - low, STEADY * high) / 2
    return middle - 1.08 * half, middle + 1.08 * half


def _finish(axes: Axes, label: str, values: np.ndarray | None, ncols: int = 1, legend: bool = True) -> None:
    axes.set_ylabel(label)
    axes.margins(x=0.01)
    axes.grid(alpha=0.3)
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
    if values is not None and label.startswith("tip ") and "force" not in label:
        axes.set_ylim(*_limits(values))
    if legend and axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, ncols=ncols, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
