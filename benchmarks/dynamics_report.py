"""The tables of motion: cost as a real-time factor, error of the tip."""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.dynamics import exponents
from benchmarks.limit import LINES, Limit
from benchmarks.timing import Contender, Task

MOTION_LIMITS = ("midpoint", "alpha", "explicit")


def _text(value: float, form: str) -> str:
    return "–" if np.isnan(value) else format(value, form)


def _row(task: Task, contender: Contender) -> list[str]:
    low, high = (1e3 * time for time in contender.spread)
    factor = task.simulated / contender.median
    return [
        contender.name,
        _text(1e3 * contender.median, ".2f"),
        f"{low:.2f} … {high:.2f}" if contender.times else "–",
        _text(contender.over(task.contenders[0]), ".2f"),
        _text(factor, ".0f" if factor >= 10 else ".2f"),
        _text(1e3 * contender.error, ".2g"),
        str(len(contender.times)),
        "" if contender.right else contender.verdict,
    ]


def print_motion(console: Console, tasks: list[Task], limit: Limit) -> None:
    """Print the table of the tasks that simulate, with the practical limit's rows in the first."""
    table = Table(title="Motion, calls made from Python, robot kang2017", title_justify="left")
    table.add_column("task and method", no_wrap=True)
    for heading in ("median, ms", "10 … 90 %", "over first", "x real time", "error, mm", "calls"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("")
    for task in tasks:
        table.add_section()
        table.add_row(f"[bold]{task.title}[/]")
        for contender in task.contenders:
            table.add_row(*_row(task, contender), style="cyan" if contender.ours else None)
        if task.key == "motion" and not limit.absent:
            for key in MOTION_LIMITS:
                time, error = limit.median(key), 1e3 * limit.errors.get(key, np.nan)
                ratio = time / task.contenders[0].median
                cells = [f"{1e3 * time:.2f}", "–", _text(ratio, ".2f"), f"{task.simulated / time:.0f}", _text(error, ".2g")]
                table.add_row(f"limit: {LINES[key]}", *cells, style="dim")
        if task.key == "segments":
            fitted, last = exponents(task)
            table.add_row(f"exponent of cost over n_e {_text(fitted, '.2f')}, of the largest two {_text(last, '.2f')}")
    console.print(table)
    console.print("Error of a closed loop: root mean square of the true tip; of a run on the rig: from the first row.")
    console.print("Error: largest distance of the tip at 50 Hz from a run at 0.25 ms (limit: its own RK4; data set: its points or 1 ms);")
    console.print(
        "sensitivities: from central differences along all parameters at once, in mm per 100 %. Times of the limit: other minutes."
    )
