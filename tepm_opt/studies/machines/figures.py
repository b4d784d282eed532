"""Figure of a controller on random machines: every run's error, machines in the order of their means."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from tepm_opt.plots.figure import STYLE, save_figures
from tepm_opt.plots.palette import BAD, GOOD, TARGET, controller
from tepm_opt.studies.machines.run import MachinesRun


def draw_machines(run: MachinesRun, folder: str | Path) -> dict[str, Path]:
    """Draw the errors on random machines into a folder that is there, as machines.png.

    Returns:
        The file by the figure's name; an earlier one goes where no machine was driven.

    Raises:
        InputError: the folder cannot be written to.
    """
    return save_figures({"machines": machines_figure(run) if run.drives else None}, folder)


def machines_figure(run: MachinesRun) -> Figure:
    """Root mean square errors of all runs, with their mean and the bound; a cross is a run that ended early."""
    figure = Figure(figsize=(9.0, 4.2), **STYLE)  # type: ignore[arg-type]
    axes, mean = figure.add_subplot(), controller(run.setup.controller).color
    errors, machines = 1e3 * run.errors, np.array([drive.machine for drive in run.drives])
    numbers = np.unique(machines)
    order = numbers[np.argsort([errors[machines == number].mean() for number in numbers])]
    place = {number: k for k, number in enumerate(order)}
    at, done = np.array([place[number] for number in machines]), np.isfinite(errors)
    top = 1.15 * max(float(errors[done].max()) if done.any() else 1.0, 1e3 * run.bound)
    good = done & (errors <= 1e3 * run.bound)
    axes.plot(at[good], errors[good], "o", ms=5, color=GOOD.color, label="within the bound")
    axes.plot(at[done & ~good], errors[done & ~good], "D", ms=5, color=BAD.color, label="beyond it")
    axes.plot(at[~done], np.full((~done).sum(), 0.97 * top), "x", ms=7, color=BAD.color, label="ended early")
    axes.axhline(1e3 * run.bound, color=TARGET.color, lw=1.0, label=f"bound, {1e3 * run.bound:g} mm")
    if done.any():
        axes.axhline(float(errors[done].mean()), color=mean, lw=1.2, ls="--", label=f"mean, {errors[done].mean():.2f} mm")
    axes.set(xlim=(-0.7, len(order) - 0.3), ylim=(0, top), xlabel="machine, in the order of its error", ylabel="true tip's error in mm rms")
    axes.set_xticks(range(len(order)), [str(number) for number in order], fontsize=7)
    axes.grid(alpha=0.3)
    handles, labels = axes.get_legend_handles_labels()
    shown = [(handle, label) for handle, label in zip(handles, labels, strict=True) if len(handle.get_xdata())]  # type: ignore[attr-defined]
    axes.legend(*zip(*shown, strict=True), fontsize=8, loc="lower right")
    axes.set_title(f"{run.setup.kind.title} on {len(order)} random machines, seed {run.family.seed}")
    return figure
