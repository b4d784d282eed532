"""Several controllers on simulated rigs, beside each other where there are processors for it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

from threadpoolctl import threadpool_limits

from tepm_opt.hw.simulation.rigfile import RigFile
from tepm_opt.jobs.closed_loop import ClosedLoop, LoopSetup
from tepm_opt.jobs.course import Course, whole_reference
from tepm_opt.jobs.mpc import run_closed_loop
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tepm_opt.outcome import Ending
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.planning.trajectories import Trajectory

LOOK = 0.2  # s between looks at how far the processes are


@dataclass(frozen=True)
class LoopTask:
    """One controller on a simulated rig, described so that another process can do it."""

    model: Model
    trajectory: Trajectory
    course: Course
    file: RigFile
    setup: LoopSetup


def compare(tasks: Sequence[LoopTask], workers: int = 1, progress: Progress = silent) -> list[ClosedLoop]:
    """Closed loops on simulated rigs, beside each other where there are processors for it; the results do not depend on that.

    Args:
        tasks: what to run.
        workers: processes.
        progress: told the controller's name and how much of its loop is done, in s.

    Raises:
        InputError: as for `whole_reference`.
        KeyboardInterrupt: one was interrupted.
    """
    if workers < 2 or len(tasks) < 2:
        found = [_alone(task, progress) for task in tasks]
    else:
        context = get_context("spawn")
        queue = context.SimpleQueue()
        with ProcessPoolExecutor(min(workers, len(tasks)), context, _set_queue, (queue,)) as pool:
            waiting = [pool.submit(_run_and_report, task) for task in tasks]
            try:
                _forward(waiting, queue, progress)
            except KeyboardInterrupt:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
            found = [job.result() for job in waiting]
    if any(loop.outcome.ending is Ending.INTERRUPTED for loop in found):
        raise KeyboardInterrupt
    return found


def _alone(task: LoopTask, progress: Progress) -> ClosedLoop:
    from tepm_opt.hw.simulation.rig import SimulatedRig

    model = compile_model(task.model)
    reference = whole_reference(model, task.trajectory, task.course)
    rig = SimulatedRig(task.file)
    rig.reseed(task.setup.seed)
    name = task.setup.controller
    return run_closed_loop(model, reference, rig, task.setup, progress=lambda stage, done, of: progress(name, done, of))


_QUEUE: Any = None  # of a process of the pool: where it says how far it is


def _set_queue(queue: Any) -> None:
    global _QUEUE
    _QUEUE = queue


def _run_and_report(task: LoopTask) -> ClosedLoop:
    """`_alone` in a process of its own, which compiles (or finds) the model for itself."""
    last = [0.0]

    def tell(stage: str, done: float, of: float) -> None:
        if time.monotonic() > last[0] + LOOK:
            last[0] = time.monotonic()
            _QUEUE.put((stage, done, of))

    with threadpool_limits(1, "blas"):  # as in the program itself
        return _alone(task, tell)


def _forward(waiting: Sequence[Future[ClosedLoop]], queue: Any, progress: Progress) -> None:
    """Pass on how far the processes are until all have ended."""
    while True:
        left = wait(waiting, LOOK).not_done
        while not queue.empty():
            progress(*queue.get())
        if not left:
            return
