"""A controller's period: its quadratic program by several solvers, and the whole step, beside a step of do-mpc on the same problem.

See `control_problem` for the problem, `control_peers` for who solves it. do-mpc: Fiedler et al., Control Engineering Practice 140, 2023.
"""

from __future__ import annotations

import itertools
from importlib.util import find_spec

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.control_loop import RecordedLoop
from benchmarks.control_peers import Step, do_mpc, ours, peers
from benchmarks.control_problem import Problem, Program
from benchmarks.goals import Goal
from benchmarks.parts import Session
from benchmarks.timing import Contender, Task

CLOSE = 1e-3  # N
MODES = {"control": 10, "control_small": 6}  # by task
QP, AGAIN = "tepm_opt QpSolver", "tepm_opt QpSolver, the Hessian of before"
DO_MPC, WHOLE = "do-mpc, a step", "tepm_opt, a whole step of the controller"
FEEDBACK = "tepm_opt, of these from a sample to the command"


def _contender(problem: Problem, name: str, solve: Step, own: bool = False) -> Contender:
    """Goes through the programs in turn; its answer is how far its first tensions are from the best ones."""
    turn = itertools.cycle(problem.programs)

    def step() -> tuple[Program, np.ndarray]:
        program = next(turn)
        return program, solve(program)

    return Contender(name, step, lambda found: found[1][: len(problem.rest)] - found[0].best, own)


def whole_step(loop: RecordedLoop, actuators: int = 6) -> list[Contender]:
    """A controller's step with its log, and its feedback; what it commands is judged by other tests."""

    def nothing(_: object) -> np.ndarray:
        return np.zeros(actuators)

    whole = Contender(WHOLE, loop.whole, nothing, ours=True, ready=loop.begin)
    return [whole, Contender(FEEDBACK, loop.feedback, nothing, ours=True, ready=loop.prepare)]


def tasks(session: Session) -> list[Task]:
    """The problem with 20 and with 12 states; the controller's whole step is timed beside the former."""
    model, found = session.scene.model, []
    for key, modes in MODES.items():
        problem = Problem.of(model, modes)
        contenders = [_contender(problem, QP, ours(problem), True), _contender(problem, AGAIN, ours(problem, again=True), True)]
        if not found:
            contenders += whole_step(RecordedLoop(model), len(problem.rest))
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


def _over_do_mpc(key: str, name: str, what: str, factor: float, contender: str) -> Goal:
    text = f"{what}: at least {factor:g} times faster than a step of do-mpc"
    return Goal(key, f"{name}, over do-mpc", text, lambda task, _: _ratio(task, contender), factor, True)


def _steady(name: str, what: str, contender: str, times: float = 2) -> Goal:
    text = f"{what}: 99 % of all within {times:g} medians"
    return Goal("control", f"{name}, 99 % over median", text, lambda task, _: _steadiness(task, contender), times)


def _within(name: str, what: str, contender: str, seconds: float) -> Goal:
    text = f"{what}: at most {1e6 * seconds:.0f} us"
    return Goal("control", f"{name}, s", text, lambda task, _: task.named(contender).median, seconds)


SIZES = {key: f"{2 * modes} states" for key, modes in MODES.items()}
GOALS = (
    *(_over_do_mpc(key, f"program, {size}", "the program", 100, QP) for key, size in SIZES.items()),
    *(_over_do_mpc(key, f"program again, {size}", "the program with the Hessian of before", 100, AGAIN) for key, size in SIZES.items()),
    _steady("program", "the program", QP),
    _over_do_mpc("control", "controller's step", "the whole step", 100, WHOLE),
    _within("controller's step", "the whole step", WHOLE, 250e-6),
    _within("controller's feedback", "from a sample to the command", FEEDBACK, 60e-6),
    _steady("controller's step", "the whole step", WHOLE, 1.5),
    _steady("controller's feedback", "from a sample to the command", FEEDBACK, 1.5),
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
