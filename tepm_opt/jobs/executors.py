"""Executors of many independent pieces of work: processes of this machine, or a cluster's workers."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager, nullcontext
from operator import itemgetter
from typing import TypeVar

from tepm_opt.errors import InputError
from tepm_opt.jobs.output import collect
from tepm_opt.progress import Progress, silent, track
from tepm_opt.solvers.numerics.parallel import cores, each_done

PATIENCE = 10.0  # s until a scheduler has to answer
Item = TypeVar("Item")
Result = TypeVar("Result")


def sweep(
    work: Callable[[Item], Result], items: Sequence[Item], executor: Executor | None = None, jobs: int | None = None,
    stage: str = "sweep", progress: Progress = silent,
) -> tuple[list[Result], bool]:  # fmt: skip
    """Results of many independent pieces of work in the order of the items, or those until the user interrupts, and True.

    Each has one core; results do not depend on where, or on how many at once.

    Args:
        work: a function that other processes can import, and that takes what they can: models and robot files, not open devices.
        items: what to work on.
        executor: where: processes of this machine where None, a cluster's workers (`cluster`) or any other of `concurrent.futures`.
        jobs: how many processes; as many as there are cores where None, and with 1 this process.
        stage: what is going on, for the progress.
        progress: told how many are done.

    Raises:
        Exception: what the work on an item has raised.
    """
    workers = min(jobs or cores(), max(len(items), 1))
    opened = nullcontext(executor) if executor is not None or workers == 1 else processes(workers)
    with opened as found:
        done, interrupted = collect(track(each_done(work, items, found), progress, stage, len(items)))
    return [result for _, result in sorted(done, key=itemgetter(0))], interrupted


@contextmanager
def processes(jobs: int) -> Iterator[Executor]:
    """Processes of this machine that share nothing with this one; they end at once where the user interrupts."""
    others = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_let_it_end)
    try:
        yield executor
    except KeyboardInterrupt:
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


def _let_it_end() -> None:
    """End silently on Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """Workers of a Dask cluster, each of which has to have this package; what a worker that is lost was doing, another does again.

    Args:
        address: of the scheduler, such as tcp://10.0.0.1:8786.

    Raises:
        InputError: Dask is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client  # pyright: ignore[reportMissingImports]  # an extra
    except ImportError as error:
        raise InputError("--scheduler needs Dask: pip install 'tepm-opt[cluster]'") from error
    try:
        client = Client(address, timeout=PATIENCE)
    except (OSError, ValueError) as error:
        raise InputError(f"scheduler {address!r} does not answer: {error}; valid: an address such as tcp://10.0.0.1:8786") from error
    with client, client.get_executor() as executor:
        yield executor
