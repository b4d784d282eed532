"""The paper's figures from the results: published values and ours in one figure."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tepm_opt.plots.figure import STYLE, save_figures
from tepm_opt.plots.palette import AXES, INPUTS, LINES, MARKERS, MEASURED, NOMINAL, ROBOT, TARGET, actuator
from tepm_opt.solvers.kinematics.backbone import backbone
from tepm_opt.studies.paper.published import PUBLISHED
from tepm_opt.studies.paper.result import ExperimentResult
from tepm_opt.studies.paper.run import Study

MODEL, PROTOTYPE = NOMINAL, MEASURED


def draw_experiments(study: Study, folder: str | Path) -> dict[str, Path]:
    """Draw a figure for every finished experiment into a folder that is there.

    Returns:
        The files by the experiments' names, "table1", "fig6" …

    Raises:
        InputError: the folder cannot be written to.
    """
    base = np.array(study.setting.model.robot.mount.base_position_m)
    return save_figures({result.figure: experiment_figure(result, base) for result in study.results}, folder)


def experiment_figure(result: ExperimentResult, base: np.ndarray) -> Figure:
    """Figure of a result; `base` is the base plate's centre in G, (3,) in m."""
    return _DRAWN[result.figure](result, base)


def _panels(columns: int, width: float = 11.0, height: float = 4.6) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(width, height), **STYLE)  # type: ignore[arg-type]
    return figure, list(np.atleast_1d(figure.subplots(1, columns)))


def _label(axes: Axes, x: str, y: str, title: str = "", legend: bool = True) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_title(title, fontsize=11)
    axes.grid(alpha=0.3)
    if legend:
        axes.legend(fontsize=8)


def _table1(result: ExperimentResult, base: np.ndarray) -> Figure:
    data = result.data
    figure, (left, right) = _panels(2)
    count = len(data["pressures"]) // 2 + 1
    left.plot(1e-6 * data["pressures"][:count], 1e3 * data["grown"][:count], "o-", color=PROTOTYPE.color, label="rising pressure")
    left.plot(1e-6 * data["pressures"][count - 1 :], 1e3 * data["grown"][count - 1 :], "s--", color=ROBOT.color, label="falling pressure")
    left.plot([0, 0.5], [0, PUBLISHED["free_length"].value], **TARGET.lined, label="published: 0 … 70 mm")
    _label(left, "pressure in MPa", "ΔL in mm", f"free actuator, K_a = {result.numbers['K_a']:.1f} N/m")
    right.plot(data["time"], 1e3 * data["length"], "o", color=PROTOTYPE.color, markersize=4, label="measured, mean of the releases")
    right.plot(data["time"], 1e3 * data["fitted"], **MODEL.lined, label="mass on spring and damper")
    _label(right, "time in s", "length in mm", f"tendon let go, c_v = {result.numbers['c_v']:.1f} N s/m")
    return figure


def _fig6(result: ExperimentResult, base: np.ndarray) -> Figure:
    figure, panels = _panels(2)
    for axes, mode in zip(panels, (1, 2), strict=True):
        rounds = result.data[f"mode{mode}"]
        for k, held in enumerate(rounds):
            axes.plot(held.time, 1e3 * held.lengths[:, 0], color=actuator(k), linewidth=0.6, alpha=0.8, label=f"run {k + 1}")
        wanted = [220 + 10 * k for k in rounds[0].target]
        axes.plot(rounds[0].time, wanted, color="black", linewidth=1.2, label="set point")
        axes.set_ylim(198, 248)
        lines = [
            f"{n} mm: {result.numbers[f'fig6_error_mode{mode}_{n}']:.2f} ± {result.numbers[f'fig6_sd_mode{mode}_{n}']:.2f} "
            f"(paper {PUBLISHED[f'fig6_error_mode{mode}_{n}'].value:.2f} ± {PUBLISHED[f'fig6_sd_mode{mode}_{n}'].value:.2f})"
            for n in (220, 230, 240)
        ]
        axes.text(0.97, 0.04, "mean error ± SD in mm\n" + "\n".join(lines), transform=axes.transAxes, ha="right", va="bottom", fontsize=8)
        _label(axes, "time in s", "length in mm", f"mode {mode}: {'pressure alone' if mode == 1 else 'pressure and tendon'}")
        axes.legend(fontsize=8, loc="upper left")
    return figure


def _shape(axes: Axes, model: np.ndarray, prototype: np.ndarray, base: np.ndarray, across: int) -> None:
    for points, role, label, mark in ((model, MODEL, "model", "s"), (prototype, PROTOTYPE, "prototype", "o")):
        curve = 1e3 * backbone(base, points)
        axes.plot(curve[:, across], curve[:, 2], **role.lined, linewidth=1.6)
        axes.plot(1e3 * points[:, across], 1e3 * points[:, 2], mark, color=role.color, markersize=5, label=label)
    axes.plot(*(1e3 * base[[across, 2]]), "k^", markersize=7)
    _label(axes, f"{'xy'[across]} in mm", "z in mm")
    axes.set_aspect("equal", adjustable="datalim")


def _errors(axes: Axes, result: ExperimentResult) -> None:
    errors, figure = result.data["errors"], result.figure
    names = [f"s{k + 1}" for k in range(len(errors))]
    axes.bar(names, errors, color=PROTOTYPE.color, alpha=0.75, label="ours")
    for k, name in enumerate(names):
        if entry := PUBLISHED.get(f"{figure}_{name}"):
            axes.plot(k, entry.value, "D", color="black", label="published" if k == 0 else None)
    rmse = PUBLISHED[f"{figure}_rmse"].value
    _label(axes, "reference point", "error in mm", f"RMSE {result.numbers[f'{figure}_rmse']:.2f} mm, published {rmse:.2f} mm")


def _static(result: ExperimentResult, base: np.ndarray) -> Figure:
    figure, panels = _panels(3)
    for axes, across in zip(panels, (0, 1), strict=False):
        _shape(axes, result.data["model"], result.data["prototype"], base, across)
    _errors(panels[2], result)
    return figure


def _fig9(result: ExperimentResult, base: np.ndarray) -> Figure:
    figure, (left, right) = _panels(2)
    time, model, prototype = (result.data[name] for name in ("time", "model", "prototype"))
    for k, instant in enumerate((0.0, 1.0, 2.0, 3.0)):
        at = int(np.argmin(np.abs(time - instant)))
        for points, style, name in ((model, "-", "model"), (prototype, "--", "prototype")):
            curve = 1e3 * backbone(base, points[at])
            label = f"{name}, {instant:.0f} s" if name == "model" else None
            left.plot(curve[:, 1], curve[:, 2], style, color=actuator(k), marker=MARKERS[k], markevery=[-1], markersize=5, label=label)
    left.plot([], [], "k--", label="prototype")
    _label(left, "y in mm", "z in mm", "whole-arm bend")
    left.set_aspect("equal", adjustable="datalim")
    for k in range(model.shape[1]):
        right.plot(time, result.data["errors"][:, k], LINES[k % len(LINES)], color=actuator(k), linewidth=1.2, label=f"s{k + 1}")
    entry = PUBLISHED["fig9_largest"].value
    right.plot(PUBLISHED["fig9_time"].value, entry, "D", color="black", label=f"published largest: {entry:g} mm (s2)")
    _label(right, "time in s", "error in mm", f"largest {result.numbers['fig9_largest']:.1f} mm", legend=False)
    right.set_ylim(0, 1.45 * result.data["errors"].max())
    right.legend(fontsize=8, ncols=2, loc="upper left")
    return figure


def _fig10(result: ExperimentResult, base: np.ndarray) -> Figure:
    figure, panels = _panels(3)
    _shape(panels[0], result.data["model"], result.data["prototype"], base, 0)
    panels[0].set_title("2.5 N along x", fontsize=11)
    _errors(panels[1], result)
    force, angle = result.data["force"], result.data["angle"]
    bent, top = (angle - angle[0]) / np.ptp(angle), int(np.argmax(force))
    panels[2].plot(force[: top + 1] / force.max(), bent[: top + 1], color=PROTOTYPE.color, label="bending")
    panels[2].plot(force[top:] / force.max(), bent[top:], "--", color=ROBOT.color, label="return")
    title = f"hysteresis {result.numbers['fig10_hysteresis']:.1f} %, published {PUBLISHED['fig10_hysteresis'].value:g} %"
    _label(panels[2], "force, of its largest", "bending angle, of its largest", title)
    return figure


def _fig11(result: ExperimentResult, base: np.ndarray) -> Figure:
    figure, panels = _panels(2)
    for axes, interval in zip(panels, ("10–20 %", "45–55 %"), strict=True):
        low, high = (float(word) / 100 for word in interval.removesuffix(" %").split("–"))
        for kind, role in INPUTS.items():
            part, height = result.data["curves"][kind]
            inside = (part >= low) & (part <= high)
            curve = result.data["model"][kind, interval]
            axes.plot(100 * part[inside], 1e3 * height[inside], ".", color=role.color, markersize=3, label=f"{kind}, prototype")
            axes.plot(100 * curve.part, 1e3 * curve.tip[:, 2], "--", color=role.color, label=f"{kind}, model")
        _label(axes, "input of A13, % of its range", "z of s4 in mm", interval)
    return figure


def _fig12(result: ExperimentResult, base: np.ndarray) -> Figure:
    figure = Figure(figsize=(11.0, 8.2), **STYLE)  # type: ignore[arg-type]
    panels = figure.subplots(2, 2)
    target = result.data["target"]
    degrees = 360 / 32 * np.arange(len(target))
    round_trip = np.vstack([target, target[:1]]) if len(target) == 32 else target
    for column, mode in enumerate((1, 2)):
        tip = result.data[f"mode{mode}"]
        path, errors = panels[0, column], panels[1, column]
        path.plot(*(1e3 * round_trip[:, :2].T), **TARGET.lined, label="desired")
        path.plot(*(1e3 * tip[:, :2].T), "o", color=PROTOTYPE.color, markersize=4, label="reached, mean of the runs")
        rmse, paper = result.numbers[f"fig12_mode{mode}"], PUBLISHED[f"fig12_mode{mode}"].value
        _label(path, "x in mm", "y in mm", f"mode {mode}: RMSE {rmse:.2f} mm, published {paper:.2f} mm")
        path.set_aspect("equal", adjustable="datalim")
        for k, (axis, role) in enumerate(AXES.items()):
            errors.plot(degrees, 1e3 * (tip - target)[:, k], **role.lined, marker=role.marker, markersize=4, label=axis)
        _label(errors, "angle on the circle in °", "error in mm")
    largest = max(abs(limit) for axes in panels[1] for limit in axes.get_ylim())
    for axes in panels[1]:
        axes.set_ylim(-largest, largest)
    return figure


_DRAWN: dict[str, Callable[[ExperimentResult, np.ndarray], Figure]] = {
    "table1": _table1, "fig6": _fig6, "fig7": _static, "fig8": _static, "fig9": _fig9, "fig10": _fig10, "fig11": _fig11, "fig12": _fig12,
}  # fmt: skip
