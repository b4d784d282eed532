"""Figures of the run of each job, and drawing them into its folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from tepm_opt.control.controllers import DEFAULT
from tepm_opt.discrepancy.state import Discovery
from tepm_opt.discrepancy.symbolic.invent import Invention
from tepm_opt.jobs.closed_loop import ClosedLoop
from tepm_opt.jobs.demo import NAMES, DemoRun
from tepm_opt.jobs.gain import GainRun
from tepm_opt.jobs.ik import IkRun
from tepm_opt.jobs.import_data import ImportRun
from tepm_opt.jobs.modes import ModesRun
from tepm_opt.jobs.plan import PlanRun
from tepm_opt.jobs.rounds import RoundsRun
from tepm_opt.jobs.simulate import SimulateRun
from tepm_opt.jobs.statics import StaticsRun
from tepm_opt.plots.control import distance_figure, error_figure, inputs_figure, path_figure, times_figure
from tepm_opt.plots.discrepancy import discovery_figures
from tepm_opt.plots.figure import Figures, save_figures
from tepm_opt.plots.gain import gain_figure
from tepm_opt.plots.ik import ik_figure
from tepm_opt.plots.importing import preview_figure
from tepm_opt.plots.law import law_figure
from tepm_opt.plots.linear import modes_figures
from tepm_opt.plots.motion import lengths_figure, tip_figure
from tepm_opt.plots.plan import plan_figure
from tepm_opt.plots.rounds import rounds_figure
from tepm_opt.plots.statics import statics_figure


def draw(run: Any, folder: str | Path) -> dict[str, Path]:
    """Draw all figures of a run into a folder that is there; an earlier figure that this run has none of goes.

    Args:
        run: of one of the jobs.
        folder: where its tables are.

    Returns:
        The files by the figures' names.

    Raises:
        InputError: the folder cannot be written to.
        TypeError: no job's run.
    """
    if type(run) not in FIGURES:
        raise TypeError(f"{run!r} has no figures; valid: {', '.join(kind.__name__ for kind in FIGURES)}")
    return {name.removeprefix(LOOP): path for name, path in save_figures(FIGURES[type(run)](run), folder).items()}


LOOP = "loop_"  # before the names of the demo's files of closed loops


def _ik(run: IkRun) -> Figures:
    return {"ik": ik_figure(run)} if run.configurations else {}


def _motion(run: SimulateRun) -> Figures:
    return {"tip": tip_figure(run), "actuator_lengths": lengths_figure(run)} if len(run.places) else {}


def _plan(run: PlanRun) -> Figures:
    return {"plan": plan_figure(run) if run.ok else None}


def _demo(run: DemoRun) -> Figures:
    found: dict[str, Figure | None] = {}
    if run.hybrid is not None:
        found |= _ik(run.hybrid)
    if run.gains is not None:
        found["gain"] = gain_figure(run.gains)
    loops = {
        "path": path_figure(run.loops) if run.loops else None,
        "distance": distance_figure(run.loops) if run.loops else None,
        "inputs": inputs_figure(run.loops[NAMES[DEFAULT]]) if run.loops else None,
    }
    return found | {f"{LOOP}{name}": figure for name, figure in loops.items()}


def _loop(run: ClosedLoop) -> Figures:
    if not len(run.time):
        return {}
    path = path_figure({run.setup.controller: run})
    return {"path": path, "errors": error_figure(run), "inputs": inputs_figure(run), "times": times_figure(run)}


FIGURES: Mapping[type, Callable[[Any], Figures]] = {
    IkRun: _ik,
    StaticsRun: lambda run: {"statics": statics_figure(run)},
    GainRun: lambda run: {"gain": gain_figure(run)},
    SimulateRun: _motion,
    ModesRun: modes_figures,
    PlanRun: _plan,
    DemoRun: _demo,
    ClosedLoop: _loop,
    Discovery: discovery_figures,
    Invention: lambda law: {law.written.name: law_figure(law)},
    ImportRun: lambda run: {"import": preview_figure(run)},
    RoundsRun: lambda run: {"rounds": rounds_figure(run)},
}
"""Function that draws the figures of a run, by the kind of run."""
