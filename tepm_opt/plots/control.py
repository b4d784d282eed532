"""Figures of closed loops: path, errors, inputs split in coarse and fine with their spectrum, durations of the control steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from tepm_opt.jobs.closed_loop import BANDS, ClosedLoop
from tepm_opt.models.layout import Layout
from tepm_opt.plots.figure import STYLE
from tepm_opt.plots.palette import BOTH, GOOD, LIMIT, MEASURED, PRESSURE, TARGET, TENSION, actuator, controller

TOLERANCE = 2.0  # mm, shaded
AXES = "xyz"
SPARE = 0.06  # of a span, around paths


def _true(loop: ClosedLoop) -> bool:
    """Whether the rig knows where the tip really is."""
    return bool(np.isfinite(loop.truth).any())


def _label(loop: ClosedLoop) -> str:
    """Controller with its error."""
    rms = 1e3 * loop.rms(_true(loop))
    return loop.setup.kind.title + (f", {rms:.3g} mm rms" if np.isfinite(rms) else "")


def _tip(loop: ClosedLoop, true: bool) -> np.ndarray:
    """Tip in mm, (samples, 3), true or tracked."""
    return 1e3 * (loop.truth if true else loop.points[:, -1])


def path_figure(loops: Mapping[str, ClosedLoop]) -> Figure:
    """The tip's path from above, and its height over time, beside the targets; where errors count or, without that, everything.

    Of one loop the tracked tip is drawn, too.
    """
    figure = Figure(figsize=(11.0, 5.4), **STYLE)  # type: ignore[arg-type]
    above, height = figure.subplots(1, 2, width_ratios=(1, 1.15))
    single, drawn = len(loops) == 1, []
    for number, loop in enumerate(loops.values()):
        span = loop.span() if loop.counted.any() else slice(None)
        target, time, true = 1e3 * loop.targets[span], loop.time[span], _true(loop)
        if number == 0:
            above.plot(target[:, 0], target[:, 1], **TARGET.lined, linewidth=1.4, label="target", zorder=4)
            height.plot(time, target[:, 2], **TARGET.lined, linewidth=1.4, label="target", zorder=4)
        role, drawn = controller(loop.setup.controller), [*drawn, target]
        if single or not true:
            tracked = _tip(loop, False)[span]
            style = (
                {**MEASURED.lined, "linewidth": 0.8, "label": "tracked"}
                if true
                else {**role.lined, "linewidth": 1.3, "label": _label(loop)}
            )
            above.plot(tracked[:, 0], tracked[:, 1], **style)  # type: ignore[arg-type]
            height.plot(time, tracked[:, 2], **style)  # type: ignore[arg-type]
            drawn.append(tracked)
        if true:
            tip = _tip(loop, True)[span]
            above.plot(tip[:, 0], tip[:, 1], **role.lined, linewidth=1.5, label=_label(loop))
            height.plot(time, tip[:, 2], **role.lined, linewidth=1.5, label=_label(loop))
            drawn.append(tip)
    _path_limits(above, np.vstack(drawn) if drawn else np.zeros((1, 3)))
    above.set(xlabel="x in mm", ylabel="y in mm", title="from above")
    height.set(xlabel="time in s", ylabel="z in mm", title="height")
    low, high = height.get_ylim()
    height.set_ylim(min(low, (low + high) / 2 - 10), max(high, (low + high) / 2 + 10))
    for axes in (above, height):
        axes.grid(alpha=0.3)
    above.legend(fontsize=8, loc="center")
    figure.suptitle(_title(loops, "path of the tip in frame G"))
    return figure


def _path_limits(axes: Axes, values: np.ndarray) -> None:
    values = values[np.isfinite(values).all(axis=1)]
    if not len(values):
        return
    centre, half = (values.max(axis=0) + values.min(axis=0))[:2] / 2, max(float(np.ptp(values[:, :2], axis=0).max()) / 2, 5.0)
    axes.set_xlim(centre[0] - (1 + SPARE) * half, centre[0] + (1 + SPARE) * half)
    axes.set_ylim(centre[1] - (1 + SPARE) * half, centre[1] + (1 + SPARE) * half)
    axes.set_aspect("equal")


def _title(loops: Mapping[str, ClosedLoop], what: str) -> str:
    first = next(iter(loops.values()))
    controller = f"{first.setup.kind.title} on {first.setup.rig}: " if len(loops) == 1 else ""
    early = "" if all(loop.ok for loop in loops.values()) else " (ended early)"
    return f"{first.model.robot.name}, {controller}{what}{early}"


def _shade(axes: Axes, loop: ClosedLoop) -> None:
    """Grey out the time in which errors do not count."""
    edges = np.flatnonzero(np.diff(np.concatenate([[1], loop.counted.astype(int), [1]])))
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        axes.axvspan(float(loop.time[start]), float(loop.time[min(end, len(loop.time) - 1)]), color="0.93", zorder=0, linewidth=0)


def error_figure(loop: ClosedLoop) -> Figure:
    """The tip's error by axis over time, true and tracked, with a tolerance; grey where it does not count."""
    figure = Figure(figsize=(10.0, 6.6), **STYLE)  # type: ignore[arg-type]
    panels = list(figure.subplots(3, 1, sharex=True, sharey=True))
    true = _true(loop)
    shown = [1e3 * loop.errors(False), *([1e3 * loop.errors(True)] if true else [])]
    for k, axes in enumerate(panels):
        _shade(axes, loop)
        axes.axhspan(-TOLERANCE, TOLERANCE, color=GOOD.color, alpha=0.12, linewidth=0, label=f"±{TOLERANCE:g} mm")
        axes.axhline(0.0, color="black", linewidth=0.6)
        axes.plot(loop.time, shown[0][:, k], color=MEASURED.color, linewidth=0.7, label="tracked")
        if true:
            axes.plot(loop.time, shown[1][:, k], **controller(loop.setup.controller).lined, linewidth=1.2, label="true")
        axes.set_ylabel(f"{AXES[k]} error in mm")
        axes.grid(alpha=0.3)
        axes.margins(x=0.01)
    finite = np.abs(np.concatenate(shown))
    span = float(np.nanmax(finite)) if np.isfinite(finite).any() else 1.0
    panels[0].set_ylim(-max(1.08 * span, 1.5 * TOLERANCE), max(1.08 * span, 1.5 * TOLERANCE))
    panels[0].legend(fontsize=8, ncols=3, loc="upper right")
    panels[-1].set_xlabel("time in s" + (" (grey: does not count)" if not loop.counted.all() else ""))
    rms = f", {1e3 * loop.rms(true):.3g} mm rms where it counts" if np.isfinite(loop.rms(true)) else ""
    figure.suptitle(_title({"": loop}, f"error of the tip{rms}"))
    return figure


def distance_figure(loops: Mapping[str, ClosedLoop]) -> Figure:
    """Distance of the tip from its target over time of several controllers, on a logarithmic axis."""
    figure = Figure(figsize=(10.0, 3.8), **STYLE)  # type: ignore[arg-type]
    axes = figure.subplots()
    for number, loop in enumerate(loops.values()):
        if number == 0:
            _shade(axes, loop)
        distance = 1e3 * np.linalg.norm(loop.errors(_true(loop)), axis=1)
        axes.semilogy(loop.time, np.maximum(distance, 1e-2), **controller(loop.setup.controller).lined, linewidth=1.2, label=_label(loop))
    axes.set(xlabel="time in s (grey: does not count)", ylabel="distance from the target in mm", ylim=(0.05, None))
    axes.grid(alpha=0.3, which="both")
    axes.margins(x=0.01)
    axes.legend(fontsize=8, loc="lower right")
    figure.suptitle(_title(loops, "error of the tip over time"))
    return figure


def inputs_figure(loop: ClosedLoop) -> Figure:
    """Coarse above (pressures as forces), fine below (tensions in their range), a column a module; then how they share the work."""
    layout = Layout.from_robot(loop.model.robot)
    figure = Figure(figsize=(11.5, 10.0), **STYLE)  # type: ignore[arg-type]
    rows: Sequence[SubFigure] = list(figure.subfigures(2, 1, height_ratios=(2.1, 1.0)))  # type: ignore[arg-type]
    panels = rows[0].subplots(2, layout.modules, sharex=True, sharey="row", squeeze=False)
    area, most = loop.model.values["A"], loop.model.robot.actuation.tension_max_N
    acting = loop.acting[0]
    for k, name in enumerate(layout.actuator_names):
        module, place = divmod(k, layout.actuators)
        coarse, fine = panels[:, module]
        coarse.plot(loop.time, area * loop.pressures[:, k], color=actuator(place), linewidth=0.9, drawstyle="steps-post", label=f"A{name}")
        coarse.plot(loop.time, acting[:, k], color=actuator(place), linewidth=1.6, alpha=0.45)
        fine.plot(loop.time, loop.tensions[:, k], color=actuator(place), linewidth=0.9, drawstyle="steps-post", label=f"A{name}")
    for module in range(layout.modules):
        coarse, fine = panels[:, module]
        coarse.set_title(f"module {module + 1}")
        coarse.set_ylim(0.0, 1.15 * max(area * float(loop.pressures.max(initial=0.0)), 1.0))
        coarse.legend(fontsize=8, ncols=layout.actuators, loc="upper right")
        fine.axhspan(0.0, most, color="0.94", zorder=0)
        fine.axhline(most / 2, color="black", linestyle=":", linewidth=1.0, zorder=4)
        fine.set_ylim(-0.04 * most, 1.04 * most)
        fine.set_xlabel("time in s")
        for axes in (coarse, fine):
            axes.grid(alpha=0.3)
            axes.margins(x=0.01)
    panels[0, 0].set_ylabel("coarse: pressure · area in N\nsteps: commanded, pale: behind the lag")
    panels[1, 0].set_ylabel("fine: tension in N\ngrey: its range, dotted: the middle")
    spectrum, share = rows[1].subplots(1, 2, width_ratios=(1.4, 1))
    _spectrum_axes(spectrum, loop)
    _share_axes(share, loop)
    figure.suptitle(_title({"": loop}, "what pressure and tension do"))
    return figure


def _spectrum_axes(axes: Axes, loop: ClosedLoop) -> None:
    frequencies, powers = loop.spectrum()
    axes.set(xlabel="frequency in Hz", ylabel="amplitude in N", title="spectrum of what acts on the muscles")
    axes.grid(alpha=0.3, which="both")
    if len(frequencies) < 2:
        return
    for name, role, label in (("pressure", PRESSURE, "pressure"), ("tension", TENSION, "tension"), ("force", BOTH, "both, $F_a$")):
        amplitude = np.sqrt(2 * powers[name][1:] / len(loop.names))
        axes.loglog(frequencies[1:], amplitude, **role.lined, linewidth=0.8 if name == "force" else 1.3, label=label)
        axes.set_ylim(bottom=max(axes.get_ylim()[0], 1e-6))
    for low, _ in BANDS[1:]:
        axes.axvline(low, color="0.6", linewidth=0.8, linestyle=":")
    axes.legend(fontsize=8)


def _share_axes(axes: Axes, loop: ClosedLoop) -> None:
    axes.set(ylabel="share of the power in %", title="who moves, by frequency", ylim=(0, 100))
    shares = loop.shares()
    tension = [100 * (band["share_of_tension"] or 0.0) for band in shares]
    there = [100.0 * (band["share_of_tension"] is not None) for band in shares]
    labels = [f"{band['from_Hz']:g} … {band['to_Hz']:g} Hz" for band in shares]
    axes.bar(labels, np.array(there) - tension, color=PRESSURE.color, label="pressure")
    axes.bar(labels, tension, bottom=np.array(there) - tension, color=TENSION.color, label="tension")
    for k, (part, whole) in enumerate(zip(tension, there, strict=True)):
        if whole:
            for value, height, ink in ((100 - part, (100 - part) / 2, "white"), (part, 100 - part / 2, "black")):
                if value >= 8:
                    axes.text(k, height, f"{value:.0f} %", ha="center", va="center", color=ink, fontsize=8)
    axes.tick_params(axis="x", labelsize=8)
    axes.legend(fontsize=8, ncols=2, loc="lower center", bbox_to_anchor=(0.5, -0.27))


def times_figure(loop: ClosedLoop) -> Figure:
    """Draw computing times of the control steps, and of their quadratic programs, beside the control period."""
    figure = Figure(figsize=(8.0, 3.6), **STYLE)  # type: ignore[arg-type]
    axes = figure.subplots()
    kinds = [("whole step", loop.seconds, controller(loop.setup.controller).color)]
    if "program_seconds" in loop.steps:
        kinds.append(("quadratic program", loop.steps["program_seconds"], MEASURED.color))
    found = np.concatenate([values for _, values, _ in kinds])
    found = 1e3 * found[found > 0]
    if len(found):
        edges = np.geomspace(found.min() * 0.9, max(found.max(), 1e3 * loop.period) * 1.1, 60)
        for label, seconds, color in kinds:
            middle, late = 1e3 * np.median(seconds), 1e3 * np.percentile(seconds, 99)
            axes.hist(1e3 * seconds, edges, color=color, alpha=0.7, label=f"{label}: median {middle:.2g} ms, 99 % within {late:.2g} ms")
        axes.set_xscale("log")
    axes.axvline(1e3 * loop.period, **LIMIT.lined, linewidth=1.4, label=f"control period, {1e3 * loop.period:g} ms")
    axes.set(xlabel="duration in ms", ylabel="control steps")
    axes.set_ylim(top=1.35 * axes.get_ylim()[1])
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="upper left")
    figure.suptitle(_title({"": loop}, "duration of the control steps"))
    return figure
