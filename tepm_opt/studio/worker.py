"""One thread that does the newest of what is asked for; what is older and was not begun is dropped."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Hashable
from typing import Any

Task = Callable[[], object]
FRAME = 1 / 60  # s, at least, between two pieces of work


class Worker:
    """A thread with a place for one task of each kind; kinds take turns, the one that waits longest first.

    Args:
        failed: told what a task raised; the thread goes on.
        frame: shortest time in s between the beginnings of two tasks of one kind.

    Attributes:
        done, dropped: number of tasks done, and of those that newer ones took the place of.
    """

    def __init__(self, failed: Callable[[Exception], None], frame: float = FRAME) -> None:
        self.done = self.dropped = 0
        self._failed, self._frame = failed, frame
        self._tasks: dict[Hashable, Task] = {}
        self._began: dict[Hashable, float] = {}
        self._changed = threading.Condition()
        self._open = True
        self._busy = False
        self._thread = threading.Thread(target=self._run, name="studio", daemon=True)
        self._thread.start()

    def ask(self, kind: Hashable, task: Task) -> None:
        """Have a task done soon, instead of the one of its kind that waits."""
        with self._changed:
            self.dropped += kind in self._tasks
            self._tasks[kind] = task
            self._changed.notify_all()

    def settle(self, timeout: float = 10.0) -> bool:
        """Wait until nothing is left to do; whether that came within the time in s."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._tasks and not self._busy, timeout)

    def close(self) -> None:
        """End the thread; what waits is dropped."""
        with self._changed:
            self._open = False
            self._tasks.clear()
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout=5.0)

    def _next(self) -> tuple[Hashable, Task] | None:
        """The next task when its time has come; None where the worker is closed."""
        with self._changed:
            while self._open:
                now = time.monotonic()
                due = {kind: self._began.get(kind, -self._frame) + self._frame for kind in self._tasks}
                first = min(due, key=lambda kind: due[kind], default=None)
                if first is not None and due[first] <= now:
                    self._began[first], self._busy = now, True
                    return first, self._tasks.pop(first)
                self._changed.wait(None if first is None else due[first] - now)
            return None

    def _run(self) -> None:
        while (found := self._next()) is not None:
            try:
                found[1]()
            except Exception as error:
                self._failed(error)
            with self._changed:
                self.done, self._busy = self.done + 1, False
                self._changed.notify_all()


def asks(worker: Worker, kind: Hashable, task: Task) -> Callable[[Any], None]:
    """A callback for viser's controls that asks for a task when a person, not the program, has moved them."""

    def ask_again(event: Any) -> None:
        if event.client is not None:
            worker.ask(kind, task)

    return ask_again
