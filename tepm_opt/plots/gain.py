"""Figure of the open-loop gain: singular values, G, the paper's curves, the workspace."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tepm_opt.jobs.gain import GainRun
from tepm_opt.plots.figure import STYLE
from tepm_opt.plots.palette import INPUTS
from tepm_opt.solvers.linear.gain import Actuation, Curve, WorkspaceMap

MOVES: tuple[tuple[Actuation, str], ...] = (("pressure", "pressures"), ("tension", "tensions"))
"""Kinds of maps, and what moves the tip in them."""


def gain_figure(run: GainRun) -> Figure:
    """Singular values along the set points, G at the first, Fig. 11's curves and, where there is one, the map of the workspace."""
    curves, workspace = run.curves, run.workspace
    figure = Figure(figsize=(11.5, 8.2) if workspace is None else (11.5, 12.0), **STYLE)  # type: ignore[arg-type]
    grid = figure.add_gridspec(2 if workspace is None else 3, 2)
    _singular_axes(figure.add_subplot(grid[0, 0]), run)
    _matrix_axes(figure, figure.add_subplot(grid[0, 1]), run)
    for column, interval in enumerate(dict.fromkeys(label for _, label in curves)):
        _curve_axes(figure.add_subplot(grid[1, column]), interval, curves)
    if workspace is not None:
        for column, (kind, moves) in enumerate(MOVES):
            _map_axes(figure, figure.add_subplot(grid[2, column]), workspace, kind, moves)
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
    for kind, role in INPUTS.items():
        values = np.array([1e3 * gain.singular_values(kind) for _, gain in found])  # type: ignore[arg-type]
        for k, style in enumerate(("-", "--", ":")):
            axes.semilogy(number, values[:, k], style, color=role.color, marker=role.marker, markersize=3, label=f"{kind}, σ{k + 1}")
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
    matrix = 1e3 * first.normalise()
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
    for kind, role in INPUTS.items():
        if curve := curves.get((kind, interval)):
            axes.plot(100 * curve.part, 1e3 * curve.tip[:, 2], **role.lined, label=kind)
    axes.set_xlabel("input, % of its range")
    axes.set_ylabel("tip z in mm")
    axes.set_title(f"third actuator of module 1 alone, {interval.replace('–', ' to ')}, as Fig. 11")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="best")


def _map_axes(figure: Figure, axes: Axes, workspace: WorkspaceMap, kind: Actuation, moves: str) -> None:
    values = workspace.values(lambda gain: 1e3 * float(gain.singular_values(kind)[-1]))
    image = axes.pcolormesh(1e3 * workspace.across, 1e3 * workspace.height, values, shading="nearest", cmap="viridis")
    axes.set_xlabel("across the base's axis in mm")
    axes.set_ylabel("along it in mm")
    axes.set_title(f"where the tip can be, and how far {moves}\nmove it in their weakest direction")
    axes.set_aspect("equal", anchor="C")
    figure.colorbar(image, ax=axes, shrink=0.9, pad=0.02, label="mm per full range")
