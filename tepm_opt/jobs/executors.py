"""Where many independent pieces of work run: processes of this machine, or a cluster's workers."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager

from tepm_opt.errors import InputError

PATIENCE = 10.0  # s until a scheduler has to answer


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
