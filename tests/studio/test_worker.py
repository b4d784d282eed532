"""The thread that does the newest of what is asked for."""

from __future__ import annotations

import threading
import time
from itertools import pairwise

from tepm_opt.studio.worker import Worker, asks


def test_the_newest_wins() -> None:
    """What is asked for while another task runs is done once, the last of it; other kinds are not dropped."""
    done: list[str] = []
    begun, go = threading.Event(), threading.Event()
    worker = Worker(lambda error: None, frame=0.0)

    def first() -> None:
        begun.set()
        go.wait(10)
        done.append("first")

    worker.ask("a", first)
    assert begun.wait(10)
    for k in range(5):
        worker.ask("a", lambda k=k: done.append(f"a{k}"))
    worker.ask("b", lambda: done.append("b"))
    go.set()
    assert worker.settle()
    assert done[0] == "first"
    assert sorted(done[1:]) == ["a4", "b"]
    assert (worker.done, worker.dropped) == (3, 4)
    worker.close()


def test_frames_are_apart() -> None:
    """A task that asks for itself again runs at most once a frame; another kind does not wait for it."""
    times: list[float] = []
    worker = Worker(lambda error: None, frame=0.03)

    def again() -> None:
        times.append(time.monotonic())
        if len(times) < 4:
            worker.ask("frame", again)

    worker.ask("frame", again)
    assert worker.settle()
    assert all(later - earlier > 0.029 for earlier, later in pairwise(times))
    worker.close()


def test_errors_are_told_and_work_goes_on() -> None:
    errors: list[Exception] = []
    worker, done = Worker(errors.append), threading.Event()
    worker.ask("a", lambda: [][0])
    assert worker.settle()
    worker.ask("a", done.set)
    assert worker.settle()
    assert done.is_set()
    assert [type(error) for error in errors] == [IndexError]
    worker.close()
    worker.ask("a", lambda: errors.append(ValueError()))
    assert len(errors) == 1


def test_programs_do_not_ask() -> None:
    class Event:
        def __init__(self, client: object) -> None:
            self.client = client

    asked: list[int] = []
    worker = Worker(lambda error: None)
    changed = asks(worker, "a", lambda: asked.append(1))
    changed(Event(None))
    assert worker.settle()
    assert asked == []
    changed(Event("somebody"))
    assert worker.settle()
    assert asked == [1]
    worker.close()
