"""Work on several cores: order, errors, Ctrl-C."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator

import pytest

from tepm_opt.solvers.numerics import parallel
from tepm_opt.solvers.numerics.parallel import give_way, in_parallel, run_concurrently


@pytest.fixture(autouse=True)
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "cores", lambda: 2)


def interrupt() -> None:
    """What Ctrl-C does."""
    signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


def endless(_: object = None) -> None:
    while True:
        give_way()
        time.sleep(1e-3)


def test_results_stand_in_the_order_of_the_items() -> None:
    second = threading.Event()

    def work(item: int) -> int:
        (second.set if item == 1 else second.wait)()
        return 10 * item

    assert in_parallel(work, [0, 1, 2]) == [0, 10, 20]
    assert in_parallel(work, []) == []


def test_the_longest_begin_first() -> None:
    begun: list[int] = []
    both = threading.Barrier(2)

    def work(item: int) -> None:
        begun.append(item)
        if item >= 5:
            both.wait()

    in_parallel(work, [1, 7, 2, 5], float)
    assert set(begun[:2]) == {7, 5}


def test_one_after_the_other_where_the_work_is_not_thread_safe() -> None:
    threads = in_parallel(lambda _: threading.current_thread(), [1, 2, 3], threads=False)
    assert threads == 3 * [threading.main_thread()]


def test_the_error_is_that_of_the_first_item_that_fails() -> None:
    failed = threading.Event()

    def work(item: int) -> None:
        if item == 2:
            failed.set()
        if item == 1:
            failed.wait()
        if item:
            raise ValueError(item)

    with pytest.raises(ValueError, match=r"^1$"):
        in_parallel(work, [0, 1, 2])


def test_two_different_pieces() -> None:
    assert run_concurrently(lambda: 1, lambda: "two") == (1, "two")


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="signals to a thread are POSIX")
class TestCtrlC:
    @pytest.fixture(autouse=True)
    def _heard(self) -> Iterator[None]:
        """A process that was started in the background ignores Ctrl-C and would wait for ever."""
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        yield
        signal.signal(signal.SIGINT, before)

    def test_ends_all_work_at_once(self) -> None:
        def work(item: int) -> None:
            if item == 1:
                interrupt()
            endless()

        with pytest.raises(KeyboardInterrupt):
            in_parallel(work, list(range(20)))
        give_way()  # what comes next is not meant

    def test_also_work_within_work(self) -> None:
        def work(item: int) -> None:
            if item == 1:
                interrupt()
            in_parallel(endless, [1, 2, 3])

        with pytest.raises(KeyboardInterrupt):
            in_parallel(work, [0, 1])
        assert in_parallel(lambda item: item, [1, 2]) == [1, 2]
