"""Figure of rounds of learning: their errors, and where on the way the first and the last one missed."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from tepm_opt.jobs.rounds import RoundsRun
from tepm_opt.plots.figure import STYLE
from tepm_opt.plots.palette import BAD, GOOD, controller


def rounds_figure(run: RoundsRun) -> Figure:
    """Root mean square error of every round; distance from the path over time in the first and in the last one."""
    figure = Figure(figsize=(10.0, 4.0), **STYLE)  # type: ignore[arg-type]
    errors, way = figure.subplots(1, 2, width_ratios=(1, 2))
    true, name = run.knows_truth, "true" if run.knows_truth else "tracked"
    rms = [1e3 * loop.rms(true) for loop in run.loops]
    numbers = np.arange(1, len(rms) + 1)
    errors.plot(numbers, rms, "o-", color=controller(run.loops[0].setup.controller).color)
    errors.set(xlabel="round", ylabel=f"{name} tip's error in mm rms", title="Error by round")
    errors.set_ylim(bottom=0)
    errors.set_xticks(numbers)
    errors.grid(alpha=0.3)
    rounds = ((run.loops[0], BAD, "round 1"), (run.loops[-1], GOOD, f"round {len(rms)}"))
    for loop, role, label in rounds[: len(rms)]:
        distance = 1e3 * np.linalg.norm(loop.errors(true), axis=1)
        way.plot(loop.time[loop.counted], distance[loop.counted], **role.lined, lw=1.2, label=label)
    way.set(xlabel="time in s", ylabel=f"{name} tip's distance from the path's target in mm", title="Where it missed")
    way.set_ylim(bottom=0)
    way.grid(alpha=0.3)
    way.legend()
    return figure
