"""The page of a run: which targets are met, then the times."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.report import Figures, text_of
from benchmarks.timing import Contender, Task
from tepm_opt.report.template import Group, Row, write
from tepm_opt.solvers.numerics.text import digits


def write_benchmark_page(path: str | Path, measured: Figures, tasks: Sequence[Task], pinned: str) -> None:
    """Write the page, on the template of the package's own.

    Args:
        path: of the page.
        measured: of the targets.
        tasks: that were timed.
        pinned: what is said of cores.

    Raises:
        InputError: the folder cannot be written to.
    """
    targets = [
        {"task": task.title, "wanted": goal.text, "measured": text_of(figure), "met": goal.met(figure)} for goal, task, figure in measured
    ]
    missed = [f"{each['task']}: {each['measured']}, should be {each['wanted']}" for each in targets if each["met"] is False]
    judged = sum(each["met"] is not None for each in targets)
    write(
        path, "benchmarks.html",
        targets=targets,
        missed=missed,
        met=judged - len(missed),
        judged=judged,
        absent=len(targets) - judged,
        groups=[_group(task) for task in tasks],
        machine=f"{platform.processor() or platform.machine()}, {platform.system()}; {pinned}",
    )  # fmt: skip


def _group(task: Task) -> Group:
    """Times of a task's contenders, in seconds where it runs once."""
    factor, unit = (1.0, "s") if task.once else (1e6, "µs")
    rows = [Row(one.name, unit, _cells(one, task.contenders[0], factor)) for one in task.contenders]
    return Group(task.title, ["median", "10 … 90 %", "over ours", "answer"], rows)


def _cells(one: Contender, ours: Contender, factor: float) -> list[str]:
    low, high = one.spread
    spread = f"{digits(low, factor)} … {digits(high, factor)}" if np.isfinite(low) else "–"
    return [digits(one.median, factor), spread, digits(one.over(ours), form=".2f"), one.verdict]
