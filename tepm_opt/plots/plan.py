"""Figure of a plan: the way with its obstacles, the tip's speed, the set points with their limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tepm_opt.jobs.plan import PlanRun
from tepm_opt.plots.figure import STYLE
from tepm_opt.plots.palette import GOOD, LIMIT, MEASURED, OBSTACLE, ROBOT, channel
from tepm_opt.solvers.planning.program import Box, Obstacle, Sphere
from tepm_opt.solvers.planning.result import MotionPlan

VIEWS = ((0, 2), (0, 1))


def plan_figure(run: PlanRun) -> Figure:
    """Reference points from the side and from above, then speed, pressures and tensions over time."""
    plan = run.plan
    figure = Figure(figsize=(11.5, 8.2), **STYLE)  # type: ignore[arg-type]
    grid = figure.add_gridspec(3, 2, width_ratios=(1.0, 1.2))
    for k, view in enumerate(VIEWS):
        axes = figure.add_subplot(grid[:2, 0] if k == 0 else grid[2, 0])
        _way(axes, plan, run.obstacles, view)
        if k == 0:
            axes.legend(fontsize=8, loc="best")
    speed, pressure, tension = (figure.add_subplot(grid[k, 1]) for k in range(3))
    speed.plot(plan.time, 1e3 * np.linalg.norm(np.gradient(plan.tips, plan.time, axis=0), axis=1), color=GOOD.color)
    speed.set_ylabel("tip speed in mm/s")
    layout, inputs = plan.model.layout, plan.setpoints.inputs
    half = layout.inputs // 2
    for k, name in enumerate(layout.actuator_names):
        role = channel(layout, k)
        pressure.plot(plan.time, 1e-3 * inputs[:, k], **role.lined, linewidth=1.2, label=f"A{name}")
        tension.plot(plan.time, inputs[:, half + k], **role.lined, linewidth=1.2)
    _draw_limits(pressure, "pressure in kPa", 1e-3 * float(plan.model.input_max[0]))
    _draw_limits(tension, "tension in N", float(plan.model.input_max[half]))
    pressure.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    tension.set_xlabel("time in s")
    for axes in (speed, pressure, tension):
        axes.grid(alpha=0.3)
        axes.margins(x=0.01)
    what = "fastest" if plan.objective.value == "time" else "least effort"
    figure.suptitle(f"{plan.model.robot.name}: plan of {plan.duration:.3g} s, {what}, from rest to rest")
    return figure


def _draw_limits(axes: Axes, label: str, limit: float) -> None:
    """Draw 0 and the limit of set points, and label their axis."""
    for value in (0.0, limit):
        axes.axhline(value, **LIMIT.lined, linewidth=0.9)
    axes.set_ylabel(label)


def _way(axes: Axes, plan: MotionPlan, obstacles: Sequence[Obstacle], view: tuple[int, int]) -> None:
    """Ways of the reference points and outlines of the obstacles along two axes of G."""
    points = 1e3 * plan.points[:, :, list(view)]
    for k, name in enumerate(plan.model.layout.point_names):
        last = k == points.shape[1] - 1
        label = "way of the tip" if last else "ways of the other points" if k == 0 else None
        axes.plot(*points[:, k].T, color=GOOD.color if last else MEASURED.color, linewidth=1.8 if last else 1.0, label=label)
        axes.annotate(name, points[-1, k], fontsize=8, xytext=(3, 3), textcoords="offset points")
    for row, label, style in ((0, "start", "o-"), (len(points) - 1, "end", "s--")):
        axes.plot(*points[row].T, style, color=ROBOT.color, markersize=3.5, linewidth=0.9, alpha=0.8, label=label)
    for obstacle in obstacles:
        axes.fill(*(1e3 * _outline(obstacle, view)).T, color=OBSTACLE.color, alpha=0.6, linewidth=0)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(f"{'xyz'[view[0]]} in mm")
    axes.set_ylabel(f"{'xyz'[view[1]]} in mm")
    axes.grid(alpha=0.3)


def _outline(obstacle: Obstacle, view: tuple[int, int]) -> np.ndarray:
    """Corners of an obstacle's shadow along two axes, (n, 2) in m; none of an unknown kind."""
    i, j = view
    if isinstance(obstacle, Sphere):
        angle = np.linspace(0, 2 * np.pi, 61)
        return np.array([obstacle.centre[i], obstacle.centre[j]]) + obstacle.radius * np.column_stack([np.cos(angle), np.sin(angle)])
    if isinstance(obstacle, Box):
        low, high = obstacle.low, obstacle.high
        return np.array([[low[i], low[j]], [high[i], low[j]], [high[i], high[j]], [low[i], high[j]]])
    return np.zeros((0, 2))
