"""Figure of equilibria: shapes from two sides."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tepm_opt.jobs.statics import StaticsRun
from tepm_opt.plots.figure import STYLE, backbone_mm
from tepm_opt.plots.palette import ACTUATORS, LINES, ROBOT, actuator


def statics_figure(run: StaticsRun) -> Figure:
    """Robot shapes seen from two sides, coloured by order."""
    figure = Figure(figsize=(10.5, 5.2), **STYLE)  # type: ignore[arg-type]
    panels: Sequence[Axes] = figure.subplots(1, 2, sharey=True)
    solved = [at for at in run.equilibria if at.solved]
    for axes, across, name in zip(panels, (0, 1), ("x", "y"), strict=True):
        for k, at in enumerate(solved):
            few = len(solved) <= 10
            color, style = (actuator(k), LINES[k // len(ACTUATORS)]) if few else (ROBOT.color, "-")
            curve, points = backbone_mm(at), 1e3 * at.points
            label = f"row {run.equilibria.index(at) + 1}"
            axes.plot(curve[:, across], curve[:, 2], style, color=color, linewidth=1.5, alpha=1.0 if few else 0.4, label=label)
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
