"""Figures of runs. Matplotlib without a screen; a figure is written whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tepm_opt.data.files import atomic_path
from tepm_opt.jobs.runs import GainRun, IkRun, StaticsRun
from tepm_opt.solvers.backbone import backbone
from tepm_opt.solvers.gain import Curve, WorkspaceMap
from tepm_opt.solvers.kinematics import ActuationMode
from tepm_opt.solvers.statics import Equilibrium

PRESSURE, TENSION, TARGET, REACHED, MISSED = "#1f5fa8", "#c8571b", "#8a8a8a", "#1b7f4b", "#b3202c"
SMALLEST_SPAN = 50.0  # mm, half of the least axis of the 3-D view
STYLE = {"dpi": 130, "layout": "constrained"}


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG.

    Raises:
        InputError: the folder cannot be written to.
    """
    FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})


def _backbone(at: Equilibrium) -> np.ndarray:
    """Backbone in G in mm, (points on it, 3)."""
    return 1e3 * backbone(np.array(at.model.robot.mount.base_position_m), at.points)


def ik_figure(run: IkRun) -> Figure:
    """Robot along the path, what rounding to the actuators' grids costs, and the set points."""
    figure = Figure(figsize=(11.5, 8.2), **STYLE)  # type: ignore[arg-type]
    grid = figure.add_gridspec(2, 2)
    _robot_axes(figure.add_subplot(grid[0, 0], projection="3d"), run)
    _error_axes(figure.add_subplot(grid[0, 1]), run)
    half, setpoints = run.model.layout.inputs // 2, run.setpoints()
    pressure, tension = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])
    _input_axes(pressure, setpoints.time, setpoints.inputs[:, :half] / 1e3, run, joined=True)
    pressure.set_ylabel("pressure in kPa")
    tension.set_ylabel("tension in N")
    if run.mode is ActuationMode.HYBRID:
        _input_axes(tension, setpoints.time, setpoints.inputs[:, half:], run, joined=False)
        tension.set_title("what the pressure grid leaves to the tendons")
        tension.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    else:
        tension.set_axis_off()
        tension.text(0.5, 0.5, "tendons slack (mode 1)", ha="center", transform=tension.transAxes)
        pressure.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    solved = sum(c.solved for c in run.configurations)
    figure.suptitle(
        f"{run.model.robot.name}: equal-curvature inverse kinematics, {run.mode.value} mode, {solved} of {run.asked} points solved"
    )
    return figure


def _robot_axes(axes: Axes, run: IkRun) -> None:
    targets = 1e3 * run.trajectory.positions
    closed = np.vstack([targets, targets[:1]]) if run.trajectory.closed else targets
    axes.plot(*closed.T, color=TARGET, linewidth=1, label="targets")
    every = max(1, len(targets) // 8)
    curves = [_backbone(at) for at in run.reached if at.solved]
    for curve in curves[::every]:
        axes.plot(*curve.T, color=PRESSURE, alpha=0.5, linewidth=1.6)
    good = np.array([c.solved for c in run.configurations], dtype=bool)
    tips = 1e3 * np.array([at.tip for at in run.reached])
    axes.plot(*tips[good].T, ".", color=REACHED, label="tip, solved")
    if not good.all():
        axes.plot(*tips[~good].T, "x", color=MISSED, label="nearest reachable point")
        for tip, target in zip(tips[~good], targets[~good], strict=True):
            axes.plot(*np.stack([tip, target]).T, color=MISSED, linewidth=0.6)
    everything = np.vstack([targets, *curves])
    centre, half_span = (everything.max(axis=0) + everything.min(axis=0)) / 2, np.maximum(np.ptp(everything, axis=0) / 2, SMALLEST_SPAN)
    for name, middle, reach in zip("xyz", centre, half_span, strict=True):
        getattr(axes, f"set_{name}lim")(middle - reach, middle + reach)
        getattr(axes, f"{name}axis").set_major_locator(MaxNLocator(4))
        getattr(axes, f"set_{name}label")(f"{name} in mm")
    axes.set_title("backbone and tip in frame G")
    axes.set_aspect("equal")
    axes.legend(loc="upper left", bbox_to_anchor=(-0.25, 1.0), fontsize=8)


def _error_axes(axes: Axes, run: IkRun) -> None:
    number = np.arange(1, len(run.configurations) + 1)
    good = np.array([c.solved for c in run.configurations], dtype=bool)
    if good.any():
        exact = 1e3 * run.errors(run.reached)[good].max()
        errors = np.where(good, 1e3 * run.errors(run.rounded), np.nan)
        axes.plot(number, errors, ".-", color=PRESSURE, label="solved, set points on the actuators' grids")
        axes.plot([], [], " ", label=f"exact set points: at most {exact:.0e} mm")
    if not good.all():
        axes.plot(number[~good], 1e3 * run.errors(run.reached)[~good], "x", color=MISSED, label="out of reach")
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0)
    axes.set_xlabel("point")
    axes.set_ylabel("distance of the tip from its target in mm")
    axes.set_title("tip error, statics solved again from the set points")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=8)


def _input_axes(axes: Axes, time: np.ndarray, values: np.ndarray, run: IkRun, joined: bool) -> None:
    layout = run.model.layout
    for k, name in enumerate(layout.actuator_names):
        module, actuator = divmod(k, layout.actuators)
        style = ("-", "--", ":", "-.")[module % 4] if joined else "none"
        mark = ("o", "s", "^", "D")[module % 4]
        axes.plot(time, values[:, k], linestyle=style, color=f"C{actuator}", marker=mark, markersize=3, linewidth=1.2, label=f"A{name}")
    axes.set_xlabel("time in s")
    axes.grid(alpha=0.3)


def gain_figure(run: GainRun, curves: Mapping[tuple[str, str], Curve], workspace: WorkspaceMap | None = None) -> Figure:
    """Singular values along the set points, G at the first, Fig. 11's curves and, where given, a map of the workspace.

    `curves` are by actuation ("pressure" or "tension") and interval ("10–20 %").
    """
    figure = Figure(figsize=(11.5, 8.2) if workspace is None else (11.5, 12.0), **STYLE)  # type: ignore[arg-type]
    grid = figure.add_gridspec(2 if workspace is None else 3, 2)
    _singular_axes(figure.add_subplot(grid[0, 0]), run)
    _matrix_axes(figure, figure.add_subplot(grid[0, 1]), run)
    for column, interval in enumerate(dict.fromkeys(label for _, label in curves)):
        _curve_axes(figure.add_subplot(grid[1, column]), interval, curves)
    if workspace is not None:
        _map_axes(figure, figure.add_subplot(grid[2, :]), workspace)
    layout = run.statics.model.layout
    point = next((gain.point for gain in run.gains if gain), layout.points - 1)
    figure.suptitle(f"{run.statics.model.robot.name}: open-loop gain G of {layout.point_names[point]}, normalised by the inputs' ranges")
    return figure


def _singular_axes(axes: Axes, run: GainRun) -> None:
    found = [(k + 1, gain) for k, gain in enumerate(run.gains) if gain]
    axes.set_xlabel("operating point")
    axes.set_ylabel("singular values in mm per full range")
    if not found:
        axes.set_title("no stable operating point")
        return
    number = [k for k, _ in found]
    for kind, color in (("pressure", PRESSURE), ("tension", TENSION)):
        values = np.array([1e3 * gain.singular_values(kind) for _, gain in found])  # type: ignore[arg-type]
        for k, style in enumerate(("-", "--", ":")):
            axes.semilogy(number, values[:, k], style, color=color, marker=".", label=f"{kind}, σ{k + 1}")
    axes.set_title("pressure moves far, tension finely")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.3, which="both")
    axes.set_ylim(top=5 * axes.get_ylim()[1])
    axes.legend(fontsize=8, ncols=3, loc="upper center")


def _matrix_axes(figure: Figure, axes: Axes, run: GainRun) -> None:
    first = next((gain for gain in run.gains if gain), None)
    if first is None:
        axes.set_axis_off()
        return
    matrix = 1e3 * first.normalised()
    span = np.abs(matrix).max()
    image = axes.imshow(matrix, cmap="RdBu_r", vmin=-span, vmax=span, aspect="auto")
    names = first.equilibrium.model.layout.actuator_names
    axes.set_xticks(range(2 * len(names)), [f"p{n}" for n in names] + [f"λ{n}" for n in names], rotation=90, fontsize=8)
    axes.set_yticks(range(3), ["x", "y", "z"])
    if matrix.shape[1] <= 24:
        for (row, column), value in np.ndenumerate(np.round(matrix) + 0.0):
            axes.text(
                column, row, f"{value:.0f}", ha="center", va="center", fontsize=7, color="white" if abs(value) > 0.6 * span else "black"
            )
    axes.set_title("G at the first operating point, mm per full range")
    figure.colorbar(image, ax=axes, shrink=0.8)


def _curve_axes(axes: Axes, interval: str, curves: Mapping[tuple[str, str], Curve]) -> None:
    for kind, color in (("pressure", PRESSURE), ("tension", TENSION)):
        if curve := curves.get((kind, interval)):
            axes.plot(100 * curve.part, 1e3 * curve.tip[:, 2], color=color, label=kind)
    axes.set_xlabel("input, % of its range")
    axes.set_ylabel("tip z in mm")
    axes.set_title("third actuator of module 1 alone, as Fig. 11")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="best")


def _map_axes(figure: Figure, axes: Axes, workspace: WorkspaceMap) -> None:
    values = workspace.values(lambda gain: 1e3 * float(gain.singular_values("tension")[-1]))
    image = axes.pcolormesh(1e3 * workspace.across, 1e3 * workspace.height, values, shading="nearest", cmap="viridis")
    axes.set_xlabel("across the base's axis in mm")
    axes.set_ylabel("along it in mm")
    axes.set_title("where the tip can be, and how far tension moves it in its weakest direction")
    axes.set_aspect("equal", anchor="C")
    figure.colorbar(image, ax=axes, shrink=0.9, pad=0.02, label="mm per full range")


def statics_figure(run: StaticsRun) -> Figure:
    """Robot shapes seen from two sides, coloured by order."""
    figure = Figure(figsize=(10.5, 5.2), **STYLE)  # type: ignore[arg-type]
    panels: Sequence[Axes] = figure.subplots(1, 2, sharey=True)
    solved = [at for at in run.equilibria if at.solved]
    for axes, across, name in zip(panels, (0, 1), ("x", "y"), strict=True):
        for k, at in enumerate(solved):
            color = f"C{k}" if len(solved) <= 10 else PRESSURE
            curve, points = _backbone(at), 1e3 * at.points
            label = f"row {run.equilibria.index(at) + 1}"
            axes.plot(curve[:, across], curve[:, 2], color=color, linewidth=1.5, alpha=1.0 if len(solved) <= 10 else 0.4, label=label)
            axes.plot(points[:, across], points[:, 2], "o", color=color, markersize=3)
        if 1 < len(solved) <= 10:
            axes.legend(fontsize=8)
        axes.set_xlabel(f"{name} in mm")
        axes.set_ylabel("z in mm")
        axes.set_aspect("equal", adjustable="datalim")
        axes.grid(alpha=0.3)
    figure.suptitle(
        f"{run.model.robot.name}: equilibria, {len(solved)} of {len(run.equilibria)} solved; dots are the reference points in G"
    )
    return figure
