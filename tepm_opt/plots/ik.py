"""Figure of inverse kinematics: robot along the path, tip errors, set points."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tepm_opt.jobs.ik import IkRun
from tepm_opt.plots.figure import STYLE, backbone_mm
from tepm_opt.plots.palette import BAD, GOOD, ROBOT, TARGET, channel
from tepm_opt.solvers.kinematics.actuation_mode import ActuationMode

SMALLEST_SPAN = 50.0  # mm, half of the least axis of the 3-D view


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
    pressure.set_title("pressures of the muscles")
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
    axes.plot(*closed.T, **TARGET.lined, linewidth=1, label="targets")
    every = max(1, len(targets) // 8)
    curves = [backbone_mm(at) for at in run.reached if at.solved]
    for curve in curves[::every]:
        axes.plot(*curve.T, color=ROBOT.color, alpha=0.5, linewidth=1.6)
    good = np.array([c.solved for c in run.configurations], dtype=bool)
    tips = 1e3 * np.array([at.tip for at in run.reached])
    axes.plot(*tips[good].T, ".", color=GOOD.color, label="tip, solved")
    if not good.all():
        axes.plot(*tips[~good].T, "x", color=BAD.color, label="nearest reachable point")
        for tip, target in zip(tips[~good], targets[~good], strict=True):
            axes.plot(*np.stack([tip, target]).T, color=BAD.color, linewidth=0.6)
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
        axes.plot(number, errors, ".-", color=GOOD.color, label="solved, set points on the actuators' grids")
        axes.plot([], [], " ", label=f"exact set points: at most {exact:.0e} mm")
    if not good.all():
        axes.plot(number[~good], 1e3 * run.errors(run.reached)[~good], "x", color=BAD.color, label="out of reach")
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
        role = channel(layout, k)
        style = role.lined | {"marker": role.marker} if joined else role.marked
        axes.plot(time, values[:, k], **style, markersize=3, linewidth=1.2, label=f"A{name}")  # type: ignore[arg-type]
    axes.set_xlabel("time in s")
    axes.grid(alpha=0.3)
