"""Many motions at once on one core: parameter sets in the lanes of vectors, beside one after the other."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.dynamics import random_runs
from benchmarks.goals import Goal
from benchmarks.limit import Limit
from benchmarks.parts import Session
from benchmarks.timing import Contender, Task
from tepm_opt.solvers.simulate import Simulation, simulate
from tepm_opt.solvers.simulate_many import Motion, simulate_many

SETS, SCATTER = 32, 0.05  # parameter sets, and how far they are spread
RUN = 2  # of the made-up runs
MANY, ALONE = "tepm_opt simulate_many", "tepm_opt simulate, one after the other"
WAYS = {"many": ("steps that adapt", {}), "many_equal": ("equal steps of 10 ms", {"step": 10e-3})}
SAME = 1e-12  # m


def _task(session: Session, key: str, title: str, how: dict[str, Any]) -> Task:
    """Answers are largest differences of the levels from those of one after the other."""
    model, random = session.scene.model, np.random.default_rng(5)
    run = random_runs(model)[RUN]
    thetas = model.theta * random.uniform(1 - SCATTER, 1 + SCATTER, (SETS, len(model.theta)))

    def alone() -> list[Simulation]:
        return [simulate(model.with_theta(theta), run, **how).complete() for theta in thetas]

    def together() -> list[Simulation]:
        return [found.complete() for found in simulate_many(model, [Motion(run, theta) for theta in thetas], **how)]

    expected = alone()

    def differences(found: list[Simulation]) -> np.ndarray:
        return np.array([abs(one.levels - other.levels).max() for one, other in zip(found, expected, strict=True)])

    contenders = [Contender(MANY, together, differences, ours=True), Contender(ALONE, alone, differences, ours=True)]
    duration = SETS * float(run.time[-1] - run.time[0])
    return Task(key, f"{SETS} parameter sets on one core, {title}", np.zeros(SETS), contenders, 1e-6, duration)


def tasks(session: Session) -> list[Task]:
    """A task for steps that adapt and one for equal ones."""
    return [_task(session, key, *way) for key, way in WAYS.items()]


def _throughput(task: Task, _: Limit) -> float:
    return task.named(ALONE).over(task.contenders[0])


GOALS = (
    Goal("many", "many at once, over one after the other", "at least 2.5 times the throughput on one core", _throughput, 2.5, True),
    Goal("many_equal", "many at once in equal steps, over one after the other", "the same, equal steps", _throughput, 2.5, True),
    Goal("many", "many at once, largest difference in m", "the same motions", lambda task, _: task.contenders[0].error, SAME),
)
