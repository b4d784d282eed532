"""The table, the targets and the JSON file."""

from __future__ import annotations

import json
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import scipy
from rich.console import Console
from rich.table import Table

from benchmarks import control, dynamics, gain, kinematics, statics
from benchmarks.dynamics_report import print_motion
from benchmarks.limit import Limit
from benchmarks.timing import Contender, Task


@dataclass(frozen=True)
class Target:
    """What ours should reach in a task: at least so many times faster than a peer, or at most so many times the limit."""

    task: str
    factor: float
    peer: str = ""

    def measured(self, tasks: list[Task], limit: Limit) -> float:
        """The ratio; NaN where one of the two figures is missing or the peer is wrong."""
        task = next(task for task in tasks if task.key == self.task)
        ours = task.contenders[0]
        if not ours.right:
            return np.nan
        if not self.peer:
            return ours.median / limit.median(self.task)
        return task.named(self.peer).over(ours)

    def met(self, ratio: float) -> bool | None:
        """Whether it is met; None where it was not measured."""
        if np.isnan(ratio):
            return None
        return ratio >= self.factor if self.peer else ratio <= self.factor

    @property
    def text(self) -> str:
        """In words."""
        return f"at least {self.factor:g} times faster than {self.peer}" if self.peer else f"at most {self.factor:g} times the limit"


TARGETS = (
    Target("warm", 5, statics.FAST_NEWTON),
    Target("warm", 3),
    Target("cold", 5, statics.FAST_NEWTON),
    Target("cold", 3),
    Target("gain", 15, gain.AD_C),
    Target("gain", 15, gain.AD_INTERPRETED),
    Target("gain", 3),
    Target("ik", 150, kinematics.SIMULTANEOUS_C),
    Target("ik", 150, kinematics.SIMULTANEOUS),
    Target("ik_cold", 150, kinematics.SIMULTANEOUS_C),
    Target("ik_cold", 150, kinematics.SIMULTANEOUS),
)


Goals = list[tuple[Target | dynamics.Goal, Task, float]]


def _goals(tasks: list[Task], limit: Limit) -> Goals:
    """The targets of the tasks that there are, with what was measured."""
    of = {task.key: task for task in tasks}
    return [(goal, of[goal.task], goal.measured(tasks, limit)) for goal in (*TARGETS, *dynamics.GOALS, *control.GOALS) if goal.task in of]


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


def print_report(console: Console, tasks: list[Task], limit: Limit, pinned: str, rounds: int) -> None:
    """Print the tables and the targets."""
    periods = [task for task in tasks if task.key in control.MODES]
    still = [task for task in tasks if np.isnan(task.simulated) and task not in periods]
    if still:
        _print_still(console, still, limit)
    if len(still) + len(periods) < len(tasks):
        print_motion(console, [task for task in tasks if task not in [*still, *periods]], limit)
    if periods:
        control.print_control(console, periods)
    console.print(f"{pinned}; contenders take turns, {rounds} rounds ({dynamics.rounds(rounds)} of motion); over ours: over the first")
    console.print("row in the same rounds, median of rounds.")
    if limit.absent:
        console.print(f"The figures of the practical limit are absent: {limit.absent}.")
    else:
        runs = len(limit.figures["warm"])
        console.print(f"Limit: median of {runs} runs of time_limit.py; for G its 3 x 6 by force. It has no inverse kinematics.")
    goals = Table(title="Targets", title_justify="left")
    for heading in ("task", "ours should be", "measured", ""):
        goals.add_column(heading)
    for goal, task, figure in _goals(tasks, limit):
        goals.add_row(task.title, goal.text, _number(figure, ".2f" if abs(figure) < 10 else ".1f"), _verdict(goal.met(figure)))
    console.print(goals)


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


def write_json(path: Path, tasks: list[Task], limit: Limit, pinned: str) -> None:
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
        return {"key": task.key, "title": task.title, **more, "contenders": [contender(one) for one in task.contenders]}

    content = {
        "machine": {"processor": platform.processor() or platform.machine(), "system": platform.system(), "pinned": pinned},
        "versions": {"python": platform.python_version(), "casadi": ca.__version__, "numpy": np.__version__, "scipy": scipy.__version__},
        "limit": limit.absent or {key: clean(limit.median(key)) for key in limit.figures},
        "limit_errors": limit.errors,
        "tasks": [whole(task) for task in tasks],
        "targets": [{"task": t.task, "target": t.text, "measured": clean(r), "met": t.met(r)} for t, _, r in _goals(tasks, limit)],
    }
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
