"""A controller's period: its quadratic program by several solvers, and the whole step, beside a step of do-mpc on the same problem.

See `control_problem` for the problem, `control_peers` for who solves it. do-mpc: Fiedler et al., Control Engineering Practice 140, 2023.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.control_peers import Step, do_mpc, ours, peers
from benchmarks.control_problem import Problem, Program
from benchmarks.dynamics import Goal
from benchmarks.timing import Contender, Task
from tepm_opt.models.compile import CompiledModel

CLOSE = 1e-3  # N
MODES = {"control": 10, "control_small": 6}  # by task
QP, AGAIN = "tepm_opt QpSolver", "tepm_opt QpSolver, the Hessian of before"
DO_MPC, WHOLE = "do-mpc, a step", "tepm_opt, a whole step of the controller"


def _contender(problem: Problem, name: str, solve: Step, own: bool = False) -> Contender:
    """Goes through the programs in turn; its answer is how far its first tensions are from the best ones."""
    turn = itertools.cycle(problem.programs)

    def step() -> tuple[Program, np.ndarray]:
        program = next(turn)
        return program, solve(program)

    return Contender(name, step, lambda found: found[1][: len(problem.rest)] - found[0].best, own)


def whole_step(step: Callable[[], None], actuators: int = 6) -> Contender:
    """A controller's step, from the measurements to the commands; what it commands is judged by other tests."""
    return Contender(WHOLE, step, lambda _: np.zeros(actuators), ours=True)


def tasks(model: CompiledModel, step: Callable[[], None] | None = None) -> list[Task]:
    """The problem with 20 and with 12 states; `step`, where given, is timed beside the former."""
    found = []
    for key, modes in MODES.items():
        problem = Problem.of(model, modes)
        contenders = [_contender(problem, QP, ours(problem), True), _contender(problem, AGAIN, ours(problem, again=True), True)]
        if step is not None and not found:
            contenders.append(whole_step(step, len(problem.rest)))
        contenders += [_contender(problem, name, solve) for name, solve in peers(problem)]
        if find_spec("do_mpc"):
            contenders.append(_contender(problem, DO_MPC, do_mpc(problem)))
        title = f"A controller's step, {2 * modes} states, {len(problem.rows)} tensions, {len(problem.programs)} programs in turn"
        found.append(Task(key, title, np.zeros(len(problem.rest)), contenders, CLOSE))
    return found


def tail(contender: Contender) -> float:
    """99th percentile of the times in s."""
    return float(np.quantile(contender.times, 0.99)) if contender.times else np.nan


def _ratio(task: Task, own: str) -> float:
    names = {one.name for one in task.contenders}
    return task.named(DO_MPC).over(task.named(own)) if {own, DO_MPC} <= names else np.nan


def _steadiness(task: Task, name: str) -> float:
    found = next((one for one in task.contenders if one.name == name), None)
    return tail(found) / found.median if found else np.nan


PROGRAM = "at least 100 times faster than a step of do-mpc"
GOALS = (
    *(Goal(key, f"the program: {PROGRAM}", lambda task, _: _ratio(task, QP), 100, True) for key in MODES),
    *(Goal(key, f"the program with the Hessian of before: {PROGRAM}", lambda task, _: _ratio(task, AGAIN), 100, True) for key in MODES),
    Goal("control", "the program: 99 % of all within twice the median", lambda task, _: _steadiness(task, QP), 2),
    Goal("control", "the whole step: at least 10 times faster than a step of do-mpc", lambda task, _: _ratio(task, WHOLE), 10, True),
    Goal("control", "the whole step: 99 % of all within twice the median", lambda task, _: _steadiness(task, WHOLE), 2),
)


def print_control(console: Console, tasks: list[Task]) -> None:
    """Print the table of these tasks."""
    table = Table(title="A controller's period, calls made from Python, robot kang2017", title_justify="left")
    table.add_column("task and method", no_wrap=True)
    for heading in ("median, us", "99 %, us", "99 % over median", "over ours", "calls"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("answer, deviation")
    for task in tasks:
        table.add_section()
        table.add_row(f"[bold]{task.title}[/]")
        for one in task.contenders:
            figures = [
                (1e6 * one.median, ".0f"),
                (1e6 * tail(one), ".0f"),
                (tail(one) / one.median, ".2f"),
                (one.over(task.contenders[0]), ".2f"),
            ]
            cells = ["–" if np.isnan(value) else format(value, form) for value, form in figures]
            verdict = one.verdict if np.isnan(one.error) else f"{one.verdict}, {one.error:.0e} N"
            table.add_row(one.name, *cells, str(len(one.times)), verdict, style="cyan" if one.ours else None)
    console.print(table)
