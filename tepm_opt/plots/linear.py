"""Figures of small motions: shapes of modes, Bode diagram, step response of the full and of a reduced system."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator

from tepm_opt.jobs.modes import ModesRun
from tepm_opt.plots.figure import STYLE
from tepm_opt.plots.palette import AXES, MEASURED, ROBOT, Role, actuator
from tepm_opt.solvers.linear.modes import Mode, direction_in_words
from tepm_opt.solvers.linear.reduction import Reduced
from tepm_opt.solvers.linear.state_space import Linear

SHOWN = 6  # mode shapes in a figure
SWING = 0.06  # m a node goes at most in the drawing
SEEN = 1e-4  # of the largest output: smaller ones are not drawn


def modes_figures(run: ModesRun) -> dict[str, Figure]:
    """Figures of an operating point by name: modes, Bode diagram and step response."""
    at = run.linear.equilibrium
    title = f"{at.model.robot.name} about tip ({', '.join(f'{1e3 * value + 0.0:.0f}' for value in at.tip.round(6))}) mm"
    system = run.linear.select(run.reduced.inputs, run.reduced.outputs)
    duration = 4 * max([mode.time_constant for mode in run.modes if mode.oscillates] or [run.modes[0].time_constant])
    return {
        "modes": shapes_figure(run.modes, title),
        "bode": bode_figure(system, title),
        "step": step_figure(system, run.reduced, duration, title),
    }


def shapes_figure(modes: Sequence[Mode], title: str) -> Figure:
    """The slowest modes of motion (not of memory), one of those that share a frequency: the arm at both ends of its swing."""
    drawn: list[Mode] = []
    for mode in modes:
        if not mode.memory and not (drawn and mode.multiplicity > 1 and np.isclose(mode.value, drawn[-1].value)):
            drawn.append(mode)
    figure = Figure(figsize=(12.5, 6.2), **STYLE)  # type: ignore[arg-type]
    panels = figure.subplots(1, SHOWN, sharey=True)
    for axes, mode in zip(panels, drawn, strict=False):
        _draw_mode(axes, mode)
    width = 1.05 * max(np.abs(axes.dataLim.intervalx - axes.dataLim.intervalx.mean()).max() for axes in panels[: len(drawn)])
    for axes in panels[: len(drawn)]:
        middle = axes.dataLim.intervalx.mean()
        axes.set_xlim(middle - width, middle + width)
        axes.xaxis.set_major_locator(MaxNLocator(3))
    for axes in panels[len(drawn) :]:
        axes.set_axis_off()
    panels[0].set_ylabel("z in mm")
    figure.set_size_inches(12.5, 2.6 + 12.0 / SHOWN * panels[0].dataLim.height / (2 * width))
    figure.suptitle(f"{title}: slowest modes. Grey: equilibrium; solid and dashed: the ends of a swing of {1e3 * SWING:.0f} mm")
    return figure


def _draw_mode(axes: Axes, mode: Mode) -> None:
    """Muscles and module ends, seen across the horizontal direction in which they move most."""
    equilibrium = mode.linear.equilibrium
    mount, modules = equilibrium.model.robot.mount, equilibrium.model.layout.modules
    moved = (mode.levels @ mount.rotation.T).mean(axis=1)[:, :2]
    bent = equilibrium.points[:, :2] - np.array(mount.base_position_m)[:2]
    known = moved if np.abs(moved).max() > 0.1 else bent if np.abs(bent).max() > 0.01 else np.array([[1.0, 0.0]])
    sideways = np.append(np.linalg.svd(known)[2][0], 0.0)
    sideways *= 1.0 if sideways[np.argmax(np.abs(sideways))] > 0 else -1.0
    for part, color, style, width in ((0.0, MEASURED.color, "-", 0.8), (1.0, ROBOT.color, "-", 1.3), (-1.0, ROBOT.color, "--", 1.3)):
        nodes = (equilibrium.nodes + part * SWING * mode.levels) @ mount.rotation.T + np.array(mount.base_position_m)
        across, up = 1e3 * nodes @ sideways, 1e3 * nodes[..., 2]
        axes.plot(across, up, style, color=color, linewidth=width)
        for level in range(0, len(nodes), (len(nodes) - 1) // modules):
            axes.plot(np.append(across[level], across[level, 0]), np.append(up[level], up[level, 0]), color=color, linewidth=width)
    axes.set_aspect("equal")
    axes.grid(alpha=0.3)
    axes.set_xlabel(f"{direction_in_words(sideways)} in mm", fontsize=9)
    often = {1: "", 2: ", twice"}.get(mode.multiplicity, f", {mode.multiplicity} times")
    speed = f"{mode.frequency:.2f} Hz, ζ = {mode.damping:.3f}" if mode.oscillates else f"time constant {mode.time_constant:.3g} s"
    axes.set_title("\n".join([*wrap(mode.words, 24), speed + often]), fontsize=9)


def _unit(name: str) -> tuple[str, float]:
    """Unit of an input for people, and its size in SI."""
    return ("kPa", 1e3) if name.startswith("pressure_") else ("N", 1.0)


def _visible(values: np.ndarray) -> list[int]:
    """Outputs that are not but rounding errors beside the largest; values are (…, outputs)."""
    size = np.abs(values).reshape(-1, values.shape[-1]).max(axis=0)
    return [int(k) for k in np.flatnonzero(size > SEEN * size.max())] if size.max() > 0 else []


def _style(system: Linear, output: int) -> dict[str, str]:
    """Colour by axis where there are axes to tell apart, else in turn."""
    name = system.outputs[output]
    point, _, axis = name.rpartition("_")
    alone = sum(other.endswith(f"_{axis}") for other in system.outputs) == 1
    role = AXES[axis] if axis in AXES and alone and point else Role(actuator(output))
    return {"color": role.color, "label": name}


def bode_figure(system: Linear, title: str, count: int = 500) -> Figure:
    """Amplitude and phase of the outputs by every input, a column each, from 0.05 to 100 Hz; the delay is exact."""
    frequencies = np.geomspace(0.05, 100.0, count)
    values = 1e3 * system.response(frequencies)
    columns = len(system.inputs)
    figure = Figure(figsize=(max(5.8 * columns, 7.0), 7.2), **STYLE)  # type: ignore[arg-type]
    panels = figure.subplots(2, columns, sharex=True, squeeze=False)
    for column, name in enumerate(system.inputs):
        unit, size = _unit(name)
        amplitude, phase = panels[:, column]
        for k in _visible(values[:, :, column]):
            response = size * values[:, k, column]
            style = _style(system, k)
            amplitude.loglog(frequencies, np.abs(response), **style)
            phase.semilogx(frequencies, np.rad2deg(_unwrap_phase(response)), **style)
        amplitude.set_title(f"by {name}")
        amplitude.set_ylabel(f"amplitude in mm/{unit}")
        phase.set_ylabel("phase in degrees")
        phase.set_xlabel("frequency in Hz")
        phase.yaxis.set_major_locator(MultipleLocator(90 if np.ptp(phase.get_ylim()) < 1000 else 360))
    _finish(figure, title)
    return figure


def _unwrap_phase(response: np.ndarray) -> np.ndarray:
    """Phase in rad without jumps, starting at 0 … -180° (a negative gain is a lag of 180°)."""
    phase = np.unwrap(np.angle(response))
    return phase - 2 * np.pi * np.ceil((phase[0] - 0.1) / (2 * np.pi))


def _finish(figure: Figure, title: str) -> None:
    """Grid, title and one legend for all panels, beside them."""
    known = {}
    for axes in figure.axes:
        axes.grid(alpha=0.3)
        if not axes.lines:
            axes.text(0.5, 0.5, "does not move", ha="center", transform=axes.transAxes)
        handles, labels = axes.get_legend_handles_labels()
        known |= dict(zip(labels, handles, strict=True))
    if known:
        labels = sorted(known, key=lambda label: known[label].get_linestyle() == "--")
        figure.legend([known[label] for label in labels], labels, loc="outside lower center", ncols=6, fontsize=9)
    figure.suptitle(title)


def step_figure(system: Linear, reduced: Reduced, duration: float, title: str, part: float = 0.01, count: int = 1001) -> Figure:
    """Outputs of the full and the reduced system after a step of every input, by python-control.

    Args:
        system: the full system.
        reduced: the reduced one, with the same inputs and outputs.
        duration: shown time in s.
        title: of the figure.
        part: height of the steps over the inputs' ranges.
        count: number of instants.
    """
    from control import step_response

    time = np.linspace(0.0, duration, count)
    full, few = (step_response(each.to_control(pade=0, scaled=True), time, squeeze=False) for each in (system, reduced))
    columns = len(system.inputs)
    figure = Figure(figsize=(max(5.8 * columns, 7.0), 6.4), **STYLE)  # type: ignore[arg-type]
    panels = figure.subplots(2, columns, sharex=True, squeeze=False, height_ratios=(2, 1))
    late = np.where(system.late, system.delay, 0.0)
    for column, name in enumerate(system.inputs):
        unit, size = _unit(name)
        axes, rest = panels[:, column]
        whole, approximate = (1e3 * part * np.asarray(each.outputs)[:, column] for each in (full, few))
        for k in _visible(whole.T):
            style = _style(system, k)
            axes.plot(time + late[column], whole[k], linewidth=1.6, **style)
            axes.plot(time + late[column], approximate[k], "--", color="black", linewidth=0.9)
            rest.plot(time + late[column], 1e3 * (approximate[k] - whole[k]), linewidth=0.9, color=style["color"])
            axes.lines[-1].set_label(f"{len(reduced.A)} states instead of {len(system.A)}")
        axes.set_title(f"step of {name} by {part * system.ranges[column] / size:.3g} {unit}")
        axes.set_ylabel("displacement in mm")
        rest.set_ylabel("error of the reduced in μm")
        rest.set_xlabel("time in s")
    _finish(figure, title)
    return figure
