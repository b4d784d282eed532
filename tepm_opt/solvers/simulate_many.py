"""Many simulations of one robot at once: parameter sets, initial states and input histories side by side in the lanes of a core."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock

import numpy as np

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.models.backends.interface import Effort
from tepm_opt.models.backends.many import ManyStepper
from tepm_opt.models.backends.many import Motion as Lane
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Ending
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.parallel import cores, give_way, in_parallel
from tepm_opt.solvers.simulate import Directions, Job, Method, Simulation, prepare, run


@dataclass(frozen=True, eq=False)
class Motion:
    """What one of many simulations is of.

    Attributes:
        setpoints: inputs over time; it starts from the equilibrium under the first row.
        theta: values of the parameters, (parameters,) in SI; by default the model's.
        loads: further known forces on the reference points in G, (samples, points, 3) in N.
        began: time in the session in s at the first row, for effects that ask.
    """

    setpoints: SetPoints
    theta: np.ndarray | None = None
    loads: np.ndarray | None = None
    began: float = 0.0

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Motion({len(self.setpoints.time)} samples, parameters {'the model’s' if self.theta is None else 'of its own'})"


def simulate_many(
    model: CompiledModel, motions: Sequence[Motion], method: Method = "implicit", step: float | None = None, hold: bool = False,
    directions: Directions | None = None, tolerance: float = 1e-6, progress: Progress = silent, error: float | None = None,
) -> list[Simulation]:  # fmt: skip
    """Simulate many motions, each as `simulate` does, on all cores and in the lanes of each core's vectors.

    Every motion takes the steps it takes alone, up to rounding, whatever the others do: it fails alone, too. With directions, without
    compiled C, or where motions would leave most lanes empty, each is one call of `simulate`. Ctrl-C leaves what there is of each.

    Args:
        model: compiled model, with its effects.
        motions: what to simulate; durations and samples are their own.
        method, step, hold, tolerance, error: see `simulate`.
        directions: what to differentiate by.
        progress: told how many simulated seconds of all are done.

    Raises:
        InputError: as for `simulate`, with the number of the motion, before any of them moves.
    """
    jobs: list[Job] = []
    _ = model.stepper  # compiled now: models with other parameters share it
    for number, motion in enumerate(motions, start=1):
        try:
            its = model if motion.theta is None else model.with_theta(motion.theta)
            jobs.append(prepare(its, motion.setpoints, method, step, hold, motion.loads, directions, tolerance, error, motion.began))
        except InputError as wrong:
            raise InputError(f"motion {number}: {wrong}") from wrong
    many = None if directions is not None or len(jobs) < 2 else model.many
    group = _Group(jobs, progress)
    try:
        if many is None or 2 * len(jobs) < many.lanes:
            in_parallel(group.alone, range(len(jobs)), group.length, model.is_c)
        else:
            in_parallel(lambda _: group.beside(many), range(min(cores(), -(-len(jobs) // many.lanes))))
    except KeyboardInterrupt:
        pass
    return [job.interrupted(0, Effort()) if found is None else found for found, job in zip(group.found, jobs, strict=True)]


class _Group:
    """Simulations that are prepared, and what has come out of them; for several threads."""

    def __init__(self, jobs: Sequence[Job], progress: Progress) -> None:
        self._jobs, self._progress, self._done, self._lock = jobs, progress, 0.0, Lock()
        self._waiting = deque(sorted(range(len(jobs)), key=lambda k: -self.length(k)))  # the longest first, so that lanes end together
        self.found: list[Simulation | None] = [None] * len(jobs)

    def length(self, k: int) -> float:
        """Duration of a motion in s."""
        time = self._jobs[k].drive.time
        return float(time[-1] - time[0])

    def alone(self, k: int) -> None:
        """Simulate one.

        Raises:
            KeyboardInterrupt: the user interrupted it; what there is of it is kept.
        """
        self._keep(k, run(self._jobs[k], lambda stage, done, of: give_way()))

    def beside(self, many: ManyStepper) -> None:
        """Simulate what waits, side by side; a lane that is over takes the next.

        Raises:
            KeyboardInterrupt: the user interrupted it; what there is of them is kept.
        """
        pool, moving = many.pool(self._jobs[0].scheme), dict[int, int]()
        try:
            while True:
                for lane in pool.empty:
                    with suppress(IndexError):
                        k = self._waiting.popleft()
                        job = self._jobs[k]
                        pool.enter(lane, Lane(job.start.x, job.drive, job.model.theta, job.scheme.step, job.ends, job.record))
                        moving[lane] = k
                if not moving:
                    return
                pool.move()
                for lane, k in list(moving.items()):
                    over, status, effort, parts = pool.look(lane)
                    if over:
                        pool.leave(lane)
                        del moving[lane]
                        self._keep(k, self._jobs[k].ended(status, parts, effort))
                give_way()
        finally:
            for lane, k in moving.items():
                _, _, effort, parts = pool.look(lane)
                self.found[k] = self._jobs[k].interrupted(parts, effort)

    def _keep(self, k: int, found: Simulation) -> None:
        self.found[k] = found
        if found.outcome.ending is Ending.INTERRUPTED:
            raise KeyboardInterrupt
        with self._lock:
            self._done += self.length(k)
            self._progress("simulation", self._done, sum(map(self.length, range(len(self._jobs)))))
