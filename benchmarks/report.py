"""The table, the targets and the JSON file."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import scipy
from rich.console import Console
from rich.table import Table

from benchmarks import control, dynamics
from benchmarks.dynamics_report import print_motion
from benchmarks.goals import Goal
from benchmarks.limit import Limit
from benchmarks.timing import Contender, Task

Figures = list[tuple[Goal, Task, float]]


def figures(goals: Sequence[Goal], tasks: Sequence[Task], limit: Limit) -> Figures:
    """The targets of the tasks that there are, with what was measured."""
    of = {task.key: task for task in tasks}
    return [(goal, of[goal.task], goal.measured(tasks, limit)) for goal in goals if goal.task in of]


def _number(value: float, form: str = ".1f") -> str:
    return "–" if np.isnan(value) else format(value, form)


def _row(task: Task, contender: Contender, limit: Limit) -> list[str]:
    low, high = (1e6 * time for time in contender.spread)
    cells = [contender.name, _number(1e6 * contender.median), f"{_number(low)} … {_number(high)}" if contender.right else "–"]
    cells.append(_number(contender.over(task.contenders[0]), ".2f"))
    if not limit.absent:
        practical = limit.median(task.key)
        cells += [_number(1e6 * practical), _number(contender.median / practical if contender.right else np.nan, ".2f")]
    verdict = contender.verdict if np.isnan(contender.error) else f"{contender.verdict}, {contender.error:.0e} m"
    return [*cells, str(len(contender.times)), verdict]


def _verdict(met: bool | None) -> str:
    return {True: "[green]met[/]", False: "[red]missed[/]", None: "not measured"}[met]


def print_report(console: Console, measured: Figures, tasks: list[Task], limit: Limit, pinned: str, rounds: int) -> None:
    """Print the tables and the targets.

    Args:
        console: where.
        measured: of the targets.
        tasks: that were timed.
        limit: the practical limit.
        pinned: what is said of cores.
        rounds: of contenders' turns.
    """
    periods = [task for task in tasks if task.key in control.MODES]
    long = [task for task in tasks if task.once]
    moving = [task for task in tasks if not np.isnan(task.simulated)]
    still = [task for task in tasks if task not in (*periods, *long, *moving)]
    if still:
        _print_still(console, still, limit)
    if moving:
        print_motion(console, moving, limit)
    if periods:
        control.print_control(console, periods)
    if long:
        _print_long(console, long)
    if len(tasks) > len(long):
        console.print(f"{pinned}; contenders take turns, {rounds} rounds ({dynamics.rounds(rounds)} of motion); over ours: over the first")
        console.print("row in the same rounds, median of rounds.")
    if limit.absent:
        console.print(f"The figures of the practical limit are absent: {limit.absent}.")
    else:
        runs = len(limit.figures["warm"])
        console.print(f"Limit: median of {runs} runs of time_limit.py; for G its 3 x 6 by force. It has no inverse kinematics.")
    table = Table(title="Targets", title_justify="left")
    for heading in ("task", "ours should be", "measured", ""):
        table.add_column(heading)
    for goal, task, figure in measured:
        table.add_row(task.title, goal.text, text_of(figure), _verdict(goal.met(figure)))
    console.print(table)


def text_of(figure: float) -> str:
    """A figure with three digits or so."""
    return _number(figure, ".2g" if abs(figure) < 0.1 else ".2f" if abs(figure) < 10 else ".1f" if abs(figure) < 100 else ".0f")


def _print_long(console: Console, tasks: list[Task]) -> None:
    """Print the tasks that run once, in seconds."""
    table = Table(title="Long jobs, once each", title_justify="left")
    table.add_column("task", no_wrap=True)
    table.add_column("s", justify="right")
    table.add_column("answer")
    for task in tasks:
        table.add_section()
        table.add_row(f"[bold]{task.title}[/]")
        for contender in task.contenders:
            table.add_row(contender.name, _number(contender.median), contender.verdict)
    console.print(table)


def _print_still(console: Console, tasks: list[Task], limit: Limit) -> None:
    table = Table(title="Times of calls made from Python, robot kang2017", title_justify="left")
    table.add_column("task and method", no_wrap=True)
    headings = ["median, us", "10 … 90 %, us", "over ours"]
    headings += [] if limit.absent else ["limit, us", "over limit"]
    for heading in [*headings, "calls"]:
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("answer, deviation")
    for task in tasks:
        table.add_section()
        table.add_row(f"[bold]{task.title}[/]")
        for contender in task.contenders:
            table.add_row(*_row(task, contender, limit), style="cyan" if contender.ours else None)
    console.print(table)
    console.print("CasADi functions are called through buffers, the fastest way from Python, except where it says plain call.")


def write_json(path: Path, measured: Figures, tasks: list[Task], limit: Limit, pinned: str) -> None:
    """Write every figure, times in seconds; null where there is none."""

    def clean(value: float) -> float | None:
        return None if np.isnan(value) else value

    def contender(one: Contender) -> dict[str, Any]:
        figures = {"median": clean(one.median), "decile_1": clean(one.spread[0]), "decile_9": clean(one.spread[1])}
        return {"name": one.name, "ours": one.ours, "verdict": one.verdict, "error": clean(one.error), "calls": len(one.times), **figures}

    def whole(task: Task) -> dict[str, Any]:
        more = {} if np.isnan(task.simulated) else {"simulated_s": task.simulated}
        if task.key == "segments":
            more |= dict(zip(("exponent", "exponent_of_largest_two"), map(clean, dynamics.exponents(task)), strict=True))
        more |= {name: clean(value) for name, value in task.figures.items()}
        return {"key": task.key, "title": task.title, **more, "contenders": [contender(one) for one in task.contenders]}

    content = {
        "machine": {"processor": platform.processor() or platform.machine(), "system": platform.system(), "pinned": pinned},
        "versions": {"python": platform.python_version(), "casadi": ca.__version__, "numpy": np.__version__, "scipy": scipy.__version__},
        "limit": limit.absent or {key: clean(limit.median(key)) for key in limit.figures},
        "limit_errors": limit.errors,
        "tasks": [whole(task) for task in tasks],
        "targets": [{"task": g.task, "name": g.name, "target": g.text, "measured": clean(r), "met": g.met(r)} for g, _, r in measured],
    }
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
