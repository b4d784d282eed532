"""Progress of long work: the one renderer behind `tepm_opt.progress.Progress`. Bars on a terminal, now and then a line elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Event, RLock, Thread

from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from tepm_opt.cli.common import stderr
from tepm_opt.models.backends.compiler import report_to

FORGOTTEN = 2.0  # s without news after which a stage gives way to the next one
EVERY = 10.0  # s between lines where there is no terminal


@dataclass
class _Stage:
    """Progress of a stage.

    Attributes:
        began, first: when it was heard of in s of the clock, and how much was done then.
        seen: when it was heard of last.
        done, of: how much is done of how much; 0 of 0 where nobody knows.
    """

    began: float
    first: float
    seen: float
    done: float = 0.0
    of: float = 0.0

    @property
    def over(self) -> bool:
        """Whether it may give way to the next one: done, or of unknown length."""
        return not self.of or self.done >= self.of

    def describe(self, name: str, now: float) -> str:
        """Describe the progress, and about how long the rest takes at the pace so far."""
        gone, passed = self.done - self.first, now - self.began
        left = f", about {_long(passed * (self.of - self.done) / gone)} left" if self.of > self.done and gone > 0 and passed > 0 else ""
        return f"{name}: {_format_amount(self.done, self.of)}{left}" if self.of else name


class Bars:
    """A bar a stage on the error stream, or a line every ten seconds where that is no terminal; what jobs take as `progress`."""

    def __init__(self, display: Progress, told: bool = False) -> None:
        """Bars of a display of rich; one that is disabled draws none.

        Args:
            display: where they are drawn.
            told: whether every stage is told in a line when it is heard of first, too.
        """
        self._display, self._told = display, told
        self._began, self._heard, self._lock = time.monotonic(), set[str](), RLock()  # several threads may tell at once
        self._stages: dict[str, _Stage] = {}
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: float, of: float) -> None:
        """Show how far a stage is; a new stage takes the place of those that are over."""
        with self._lock:
            now = time.monotonic()
            if self._told and stage not in self._heard:
                self._heard.add(stage)
                self._line(escape(stage), now)
            if stage not in self._stages:
                self._forget(now)
                self._stages[stage] = _Stage(now, done, now)
                if not self._display.disable:
                    self._tasks[stage] = self._display.add_task(escape(stage), total=None, passed="")
            at = self._stages[stage]
            at.seen, at.done, at.of = now, done, of
            if not self._display.disable:
                self._display.update(self._tasks[stage], completed=done, total=of or None, passed=_format_amount(done, of))

    def tell(self) -> None:
        """Say in a line how far all stages are that go on."""
        with self._lock:
            now, stages = time.monotonic(), list(self._stages.items())
            self._line(
                escape("; ".join(at.describe(name, now) for name, at in stages if at is stages[-1][1] or not at.over) or "working"), now
            )

    def _line(self, text: str, now: float) -> None:
        stderr.print(f"[dim]{now - self._began:6.1f} s[/]  {text}", highlight=False, soft_wrap=True)

    def _forget(self, now: float) -> None:
        """Remove the bars of stages that are done, of unknown length, or without news: what is left runs beside the next one."""
        for name, at in list(self._stages.items()):
            if at.over or now > at.seen + FORGOTTEN:
                del self._stages[name]
                if name in self._tasks:
                    self._display.remove_task(self._tasks.pop(name))

    def ask(self, request: str) -> None:
        """Ask a person to do something; on a terminal wait until it is done."""
        self._display.stop()
        stderr.print(f"[bold]{escape(request)}[/]", soft_wrap=True, highlight=False)
        if sys.stdin.isatty():
            stderr.input("Enter when it is done, Ctrl-C to stop here: ")
        self._display.start()


@contextmanager
def show_progress(quiet: bool, told: bool = False) -> Iterator[Bars]:
    """Show bars with the time left, which vanish in the end; where the error stream is no terminal, a line every ten seconds.

    Args:
        quiet: whether to show nothing, as with --json.
        told: whether every new stage is told in a line that stays, on a terminal or not: for work of many minutes.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[passed]}"), TimeRemainingColumn())
    with Progress(*columns, console=stderr, transient=True, disable=quiet or not stderr.is_terminal) as display:
        bars = Bars(display, told and not quiet)
        if quiet or stderr.is_terminal:
            with report_to(bars):
                yield bars
            return
        over = Event()
        clock = Thread(target=_tell_now_and_then, args=(bars, over), daemon=True)
        clock.start()
        try:
            with report_to(bars):
                yield bars
        finally:
            over.set()
            clock.join()


def _tell_now_and_then(bars: Bars, over: Event) -> None:
    """Let bars say how far they are until work is over, whether anything was heard of it or not."""
    while not over.wait(EVERY):
        bars.tell()


def _format_amount(done: float, of: float) -> str:
    """Format the amount done of the whole, in whole numbers where both are; empty where the whole is unknown."""
    if not of:
        return ""
    whole = float(done).is_integer() and float(of).is_integer()
    return f"{done:.0f} of {of:.0f}" if whole else f"{done:.1f} of {of:.1f}"


def _long(seconds: float) -> str:
    """A time to wait, to what is worth knowing of it."""
    if seconds < 60:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 3600 else f"{seconds / 3600:.1f} h"
