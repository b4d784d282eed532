"""Figures of runs. Matplotlib without a screen; a figure is written whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.interpolate import PchipInterpolator

from tepm_opt.data.files import atomic_path
from tepm_opt.runs import GainRun, IkRun, StaticsRun
from tepm_opt.solvers.gain import Curve, Map
from tepm_opt.solvers.kinematics import Mode
from tepm_opt.solvers.statics import Equilibrium

PRESSURE, TENSION, TARGET, REACHED, MISSED = "#1f5fa8", "#c8571b", "#8a8a8a", "#1b7f4b", "#b3202c"
STYLE = {"dpi": 130, "layout": "constrained"}


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG.

    Raises:
        InputError: the folder cannot be written to.
    """
    FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})


def backbone(at: Equilibrium, count: int = 41) -> np.ndarray:
    """Backbone in G through the base's centre and the reference points by PCHIP over their rest heights, (count, 3) in m."""
    base = np.array(at.model.robot.mount.base_position_m)
    knots = np.vstack([base, at.points])
    heights = np.arange(len(knots))
    return PchipInterpolator(heights, knots)(np.linspace(0, heights[-1], count))


def ik_figure(run: IkRun) -> Figure:
    """Robot along the path, path from above, set points, and what rounding to the actuators' grids costs."""
    figure = Figure(figsize=(11.5, 8.2), **STYLE)  # type: ignore[arg-type]
    grid = figure.add_gridspec(2, 2)
    _robot_axes(figure.add_subplot(grid[0, 0], projection="3d"), run)
    axes = figure.add_subplot(grid[0, 1])
    _error_axes(axes, run)
    half = run.model.layout.inputs // 2
    inputs = run.setpoints().inputs
    time = run.trajectory.time
    _input_axes(figure.add_subplot(grid[1, 0]), time, inputs[:, :half] / 1e3, run, "pressure in kPa")
    _input_axes(figure.add_subplot(grid[1, 1]), time, inputs[:, half:], run, "tension in N")
    solved = sum(c.solved for c in run.configurations)
    figure.suptitle(
        f"{run.model.robot.name}: equal-curvature inverse kinematics, {run.mode.value} mode, {solved} of {len(time)} points solved"
    )
    return figure


def _robot_axes(axes: Axes, run: IkRun) -> None:
    targets = 1e3 * run.trajectory.positions
    closed = np.vstack([targets, targets[:1]]) if run.trajectory.closed else targets
    axes.plot(*closed.T, color=TARGET, linewidth=1, label="targets")
    every = max(1, len(targets) // 8)
    for at in run.reached[::every]:
        axes.plot(*(1e3 * backbone(at)).T, color=PRESSURE, alpha=0.5, linewidth=1.6)
    good = np.array([c.solved for c in run.configurations], dtype=bool)
    tips = 1e3 * np.array([at.tip for at in run.reached])
    axes.plot(*tips[good].T, ".", color=REACHED, label="tip, solved")
    if not good.all():
        axes.plot(*tips[~good].T, "x", color=MISSED, label="nearest reachable point")
    axes.set_xlabel("x in mm")
    axes.set_ylabel("y in mm")
    axes.set_zlabel("z in mm")  # type: ignore[attr-defined]
    axes.set_title("backbone and tip in frame G")
    axes.set_aspect("equal")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):  # type: ignore[attr-defined]
        axis.set_major_locator(MaxNLocator(4))
    axes.legend(loc="upper left", fontsize=8)


def _error_axes(axes: Axes, run: IkRun) -> None:
    number = np.arange(1, len(run.configurations) + 1)
    good = np.array([c.solved for c in run.configurations], dtype=bool)
    if good.any():
        axes.semilogy(number[good], 1e3 * np.maximum(run.errors(run.reached)[good], 1e-12), ".-", color=REACHED, label="exact set points")
        axes.semilogy(number[good], 1e3 * run.errors(run.rounded)[good], ".-", color=PRESSURE, label="set points on the actuators' grids")
    if not good.all():
        axes.semilogy(number[~good], 1e3 * run.errors(run.reached)[~good], "x", color=MISSED, label="out of reach")
    axes.set_xlabel("point")
    axes.set_ylabel("distance of the tip from its target in mm")
    axes.set_title("what statics makes of the set points")
    axes.grid(alpha=0.3, which="major")
    axes.legend(fontsize=8)


def _input_axes(axes: Axes, time: np.ndarray, values: np.ndarray, run: IkRun, label: str) -> None:
    layout = run.model.layout
    for k, name in enumerate(layout.actuator_names):
        module, actuator = divmod(k, layout.actuators)
        style = ("-", "--", ":", "-.")[module % 4]
        axes.plot(time, values[:, k], style, color=f"C{actuator}", marker=".", markersize=3, linewidth=1.2, label=f"A{name}")
    axes.set_xlabel("time in s")
    axes.set_ylabel(label)
    if not np.nanmax(np.abs(values), initial=0.0):
        axes.set_title("tendons slack (pressure mode)" if run.mode is Mode.PRESSURE else "")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def gain_figure(run: GainRun, curves: Mapping[tuple[str, str], Curve], workspace: Map | None = None) -> Figure:
    """Singular values along the set points, G at the first, Fig. 11's curves and, where given, a map of the workspace.

    `curves` are by actuation ("pressure" or "tension") and interval ("10–20 %").
    """
    figure = Figure(figsize=(11.5, 8.2), **STYLE)  # type: ignore[arg-type]
    axes = figure.subplots(2, 2)
    _singular_axes(axes[0, 0], run)
    _matrix_axes(figure, axes[0, 1], run)
    _curve_axes(axes[1, 0], curves)
    if workspace is None:
        _column_axes(axes[1, 1], run)
    else:
        _map_axes(figure, axes[1, 1], workspace)
    layout = run.statics.model.layout
    point = next((gain.point for gain in run.gains if gain), layout.points - 1)
    figure.suptitle(f"{run.statics.model.robot.name}: open-loop gain G of {layout.point_names[point]}, normalised by the inputs' ranges")
    return figure


def _singular_axes(axes: Axes, run: GainRun) -> None:
    number = np.array([k + 1 for k, gain in enumerate(run.gains) if gain])
    for kind, color in (("pressure", PRESSURE), ("tension", TENSION)):
        values = np.array([1e3 * gain.singular_values(kind) for gain in run.gains if gain])  # type: ignore[arg-type]
        for k, style in enumerate(("-", "--", ":")):
            if len(values):
                axes.semilogy(number, values[:, k], style, color=color, marker=".", label=f"{kind}, σ{k + 1}")
    axes.set_xlabel("operating point")
    axes.set_ylabel("singular values in mm per full range")
    axes.set_title("pressure moves far, tension finely")
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=8, ncols=2)


def _matrix_axes(figure: Figure, axes: Axes, run: GainRun) -> None:
    first = next((gain for gain in run.gains if gain), None)
    if first is None:
        axes.set_title("no stable operating point")
        return
    matrix = 1e3 * first.normalised()
    span = np.abs(matrix).max()
    image = axes.imshow(matrix, cmap="RdBu_r", vmin=-span, vmax=span, aspect="auto")
    names = first.equilibrium.model.layout.actuator_names
    axes.set_xticks(range(2 * len(names)), [f"p{n}" for n in names] + [f"λ{n}" for n in names], rotation=90, fontsize=8)
    axes.set_yticks(range(3), ["x", "y", "z"])
    if matrix.shape[1] <= 24:
        for (row, column), value in np.ndenumerate(matrix):
            axes.text(
                column, row, f"{value:.0f}", ha="center", va="center", fontsize=7, color="white" if abs(value) > 0.6 * span else "black"
            )
    axes.set_title("G at the first operating point, mm per full range")
    figure.colorbar(image, ax=axes, shrink=0.8)


def _curve_axes(axes: Axes, curves: Mapping[tuple[str, str], Curve]) -> None:
    styles = {"pressure": PRESSURE, "tension": TENSION}
    marks = dict(zip(dict.fromkeys(label for _, label in curves), ("-", "--"), strict=False))
    for (kind, label), curve in curves.items():
        axes.plot(100 * (curve.part - curve.part[0]), 1e3 * curve.tip[:, 2], marks[label], color=styles[kind], label=f"{kind}, {label}")
    axes.set_xlabel("input above the interval's start, % of its range")
    axes.set_ylabel("tip z in mm")
    axes.set_title("third actuator of module 1 alone (Fig. 11)" if curves else "no stable curve for this robot")
    axes.grid(alpha=0.3)
    if curves:
        axes.legend(fontsize=8)


def _column_axes(axes: Axes, run: GainRun) -> None:
    number = [k + 1 for k, gain in enumerate(run.gains) if gain]
    for kind, color in (("pressure", PRESSURE), ("tension", TENSION)):
        axes.semilogy(number, [gain.condition(kind) for gain in run.gains if gain], ".-", color=color, label=kind)  # type: ignore[arg-type]
    axes.set_xlabel("operating point")
    axes.set_ylabel("condition number")
    axes.set_title("how evenly the directions can be driven")
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=8)


def _map_axes(figure: Figure, axes: Axes, workspace: Map) -> None:
    values = workspace.values(lambda gain: 1e3 * float(gain.singular_values("tension")[-1]))
    image = axes.pcolormesh(1e3 * workspace.across, 1e3 * workspace.height, values, shading="nearest", cmap="viridis")
    axes.set_xlabel("x from the base axis in mm")
    axes.set_ylabel("z in mm")
    axes.set_title("tension's weakest direction (blank: out of reach)")
    axes.set_aspect("equal")
    figure.colorbar(image, ax=axes, shrink=0.8, label="smallest singular value in mm per full range")


def statics_figure(run: StaticsRun) -> Figure:
    """Robot shapes seen from two sides, coloured by order."""
    figure = Figure(figsize=(10.5, 5.2), **STYLE)  # type: ignore[arg-type]
    panels: Sequence[Axes] = figure.subplots(1, 2, sharey=True)
    solved = [at for at in run.equilibria if at.solved]
    for axes, across, name in zip(panels, (0, 1), ("x", "y"), strict=True):
        for k, at in enumerate(solved):
            color = f"C{k}" if len(solved) <= 10 else PRESSURE
            curve, points = 1e3 * backbone(at), 1e3 * at.points
            axes.plot(curve[:, across], curve[:, 2], color=color, linewidth=1.5, alpha=1.0 if len(solved) <= 10 else 0.4)
            axes.plot(points[:, across], points[:, 2], "o", color=color, markersize=3)
        axes.set_xlabel(f"{name} in mm")
        axes.set_ylabel("z in mm")
        axes.set_aspect("equal", adjustable="datalim")
        axes.grid(alpha=0.3)
    figure.suptitle(
        f"{run.model.robot.name}: equilibria, {len(solved)} of {len(run.equilibria)} solved; dots are the reference points in G"
    )
    return figure
