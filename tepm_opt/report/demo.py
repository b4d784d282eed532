"""The page of the main job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tepm_opt.control.controllers import DEFAULT
from tepm_opt.jobs.demo import NAMES, DemoRun
from tepm_opt.models.model import Model
from tepm_opt.report.charts import distance_chart, robot_chart
from tepm_opt.report.template import Group, Row, symbol, write
from tepm_opt.solvers.numerics.text import digits, format_quantity


def write_page(path: str | Path, run: DemoRun, figures: Mapping[str, Path]) -> None:
    """Write the page of the main job.

    Args:
        path: of the page.
        run: with all its parts.
        figures: PNG files by name, put into the page: "ik", "gain" and, with loops, "path", "distance", "inputs".

    Raises:
        InputError: the folder cannot be written to.
        ValueError: the run was interrupted before its last part.
    """
    if run.hybrid is None or run.gains is None:
        raise ValueError(f"no page of {run!r}")
    hybrid, pressure, model = run.hybrid.summary(), run.pressure.summary(), run.pressure.model.model
    loops = {name: run.loops[name].summary(timing=False) for name in sorted(run.loops, key=lambda name: name != NAMES[DEFAULT])}
    write(
        path, "demo.html", figures, robot_chart(run.hybrid) | distance_chart(run.loops),
        ok=run.ok,
        verdict=_verdict(run, hybrid, loops),
        groups=_groups(run, pressure, hybrid, loops),
        robot=model.robot,
        parameters=[_parameters(model)],
        hybrid=hybrid,
        pressure=pressure,
        loops=loops,
        note=run.note,
    )  # fmt: skip


def _error(loop: Mapping[str, Any], key: str) -> float | None:
    """An error of the tip in m, true where the rig knows it, else tracked."""
    found = loop["errors"]["true"] or loop["errors"]["tracked"]
    return found[key] if found else None


def _verdict(run: DemoRun, hybrid: Mapping[str, Any], loops: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Sum the run up in sentences for the top of the page, the most important one first."""
    solved = f"{hybrid['solved']} of {hybrid['points']} points of the path are solved"
    if hybrid["solved"]:
        missed = format_quantity(hybrid["largest_rounded_tip_error_m"], "m")
        solved += f"; on the actuators' grids set points of pressure and tension miss them by {missed} at most"
    if not loops:
        return [f"{solved}.", f"No closed loop: {run.note}."]
    best, *others = [(name, format_quantity(_error(loop, "rms_m") or float("nan"), "m")) for name, loop in loops.items()]
    rest = ", ".join(f"{error} in {name}" for name, error in others)
    said = f"With the {best[0]} the simulated robot's tip stays within {best[1]} rms of its moving target" + (
        f" ({rest})." if rest else "."
    )
    ended = [f"{name} ended early: {loop['message']}." for name, loop in loops.items() if loop.get("message")]
    return [said, f"{solved}.", *ended]


def _parameters(model: Model) -> Group:
    """Every parameter with its unit and where it comes from."""
    return Group("Parameter", ["value", "from"], [Row(name, symbol(unit), [value, source]) for name, value, unit, source in model.table()])


def _tiny(error: float | None) -> str:
    """An error in mm that a solver leaves: below what anybody measures its size says nothing."""
    return "< 0.001" if error is not None and error < 1e-6 else digits(error, 1e3)


def _groups(
    run: DemoRun, pressure: Mapping[str, Any], hybrid: Mapping[str, Any], loops: Mapping[str, Mapping[str, Any]]
) -> Sequence[Group]:
    """The table of figures.

    Args:
        run: with its gains.
        pressure, hybrid: summaries of inverse kinematics.
        loops: summaries of closed loops by name, the best first.
    """
    groups = []
    if loops:
        each = list(loops.values())
        rows = [
            Row("tip error, rms", "mm", [digits(_error(loop, "rms_m"), 1e3) for loop in each]),
            Row("tip error, largest", "mm", [digits(_error(loop, "largest_m"), 1e3) for loop in each]),
            Row("pressure steps", "1/s", [digits(loop["pressure_moves_per_s"], form=".0f") for loop in each]),
            Row("motors on", "%", [digits(loop["motors_enabled"], 100, ".0f") for loop in each]),
            Row("mean tension over mid-range", "1", [digits(loop["mean_tension_of_mid_range"], form=".2f") for loop in each]),
        ]
        for k, band in enumerate(each[0]["actuation"]):
            name = f"tension's share of the power, {band['from_Hz']:g} … {band['to_Hz']:g} Hz"
            rows.append(Row(name, "%", [digits(loop["actuation"][k]["share_of_tension"], 100, ".0f") for loop in each]))
        groups.append(Group("Closed loop on the simulated rig", list(loops), rows))
    both = (pressure, hybrid)
    rows = [
        Row("points solved", f"of {hybrid['points']}", [str(each["solved"]) for each in both]),
        Row("tip error on the actuators' grids, rms", "mm", [digits(each["rounded_tip_error_rms_m"], 1e3) for each in both]),
        Row("tip error on the actuators' grids, largest", "mm", [digits(each["largest_rounded_tip_error_m"], 1e3) for each in both]),
        Row("tip error, exact set points, largest", "mm", [_tiny(each["largest_tip_error_m"]) for each in both]),
    ]
    groups.append(Group("Set points", ["pressure alone", "pressure and tension"], rows))
    spans = run.gains.spans() if run.gains else {}
    if spans:
        rows = [Row(f"by {kind} over its full range", "mm", [digits(value, 1e3, ".0f") for value in span]) for kind, span in spans.items()]
        groups.append(Group("Tip moved (singular values of G)", ["least", "most"], rows))
    return groups
