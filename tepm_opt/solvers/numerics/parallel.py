"""Independent pieces of work: on the machine's cores, where compiled C lets other threads run, or wherever an executor has them done."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from typing import TypeVar, cast

from threadpoolctl import threadpool_limits

Item = TypeVar("Item")
Result = TypeVar("Result")
Other = TypeVar("Other")

_most: ContextVar[int | None] = ContextVar("_most", default=None)  # cores that may be used, where that is limited
_interrupted: ContextVar[threading.Event | None] = ContextVar("_interrupted", default=None)  # set where the user has ended the whole


def cores() -> int:
    """Cores this process may run on, and this piece of work may use."""
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(there, _most.get() or there)


@contextmanager
def on_cores(most: int) -> Iterator[None]:
    """Limit work in the block to so many cores, as others work beside it."""
    before = _most.set(most)
    try:
        yield
    finally:
        _most.reset(before)


def in_parallel(
    work: Callable[[Item], Result], items: Sequence[Item], size: Callable[[Item], float] | None = None, threads: bool = True
) -> list[Result]:
    """Results in the order of the items, the same whatever the number of cores.

    Args:
        work: may work in parallel itself; long work calls `give_way` now and then, so that Ctrl-C ends it.
        items: what to work on.
        size: how long an item takes, in any unit: the longest begin first, so that the cores end together.
        threads: whether the work is thread-safe; one item after the other where it is not.

    Raises:
        KeyboardInterrupt: the user interrupted it; nothing runs on.
        Exception: what the work on the first of the items that fail has raised.
    """
    workers = min(cores(), len(items)) if threads else 1
    if workers < 2:
        return [work(item) for item in items]
    stop = _interrupted.get() or threading.Event()

    def work_interruptibly(item: Item) -> Result:
        _interrupted.set(stop)
        return work(item)

    order = sorted(range(len(items)), key=lambda k: -size(items[k])) if size else range(len(items))
    pool = ThreadPoolExecutor(workers)
    try:
        futures = {k: pool.submit(copy_context().run, work_interruptibly, items[k]) for k in order}
        return [futures[k].result() for k in range(len(items))]
    except KeyboardInterrupt:
        stop.set()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def each_done(work: Callable[[Item], Result], items: Sequence[Item], executor: Executor | None = None) -> Iterator[tuple[int, Result]]:
    """Numbers of the items and results, as they come; each piece of work has one core.

    What is not begun is taken back where the caller stops asking, or an item fails.

    Args:
        work: a function that other processes can import.
        items: what to work on; they and the results are pickled.
        executor: where; here, one after the other, where None. It has to import this package, and is left open.

    Raises:
        Exception: what the work on an item has raised.
    """
    if executor is None:
        yield from ((number, _on_one_core(work, item)) for number, item in enumerate(items))
        return
    numbers = {executor.submit(_on_one_core, work, item): number for number, item in enumerate(items)}
    try:
        for future in as_completed(numbers):
            yield numbers[future], future.result()
    finally:
        for future in numbers:
            future.cancel()


def _on_one_core(work: Callable[[Item], Result], item: Item) -> Result:
    with on_cores(1), threadpool_limits(1, "blas"):
        return work(item)


def run_concurrently(one: Callable[[], Result], other: Callable[[], Other], threads: bool = True) -> tuple[Result, Other]:
    """Do two different pieces of work at the same time, see `in_parallel`; their results."""
    first, second = in_parallel(lambda work: work(), [one, other], threads=threads)
    return cast("Result", first), cast("Other", second)


def give_way() -> None:
    """End this piece of work if the user has interrupted the whole.

    Raises:
        KeyboardInterrupt: the user has.
    """
    stop = _interrupted.get()
    if stop is not None and stop.is_set():
        raise KeyboardInterrupt
