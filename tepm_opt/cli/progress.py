"""Progress of long work on a terminal: the one renderer behind `tepm_opt.progress.Progress`."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from tepm_opt.cli.common import stderr

FORGOTTEN = 2.0  # s without news after which a stage gives way to the next one


class Bars:
    """A bar a stage on the error stream; what jobs take as `progress`."""

    def __init__(self, display: Progress, told: bool = False) -> None:
        """Bars of a display of rich; one that is disabled shows nothing.

        Args:
            display: where they are drawn.
            told: whether every new stage is told in a line, too.
        """
        self._display, self._told = display, told
        self._began, self._last = time.monotonic(), ""
        self._stages: dict[str, tuple[TaskID, float]] = {}

    def __call__(self, stage: str, done: float, of: float) -> None:
        """Show how far a stage is; a new stage takes the place of those that are over."""
        now = time.monotonic()
        if self._told and stage != self._last:
            self._last = stage
            stderr.print(f"[dim]{now - self._began:6.1f} s[/]  {escape(stage)}", highlight=False)
        if self._display.disable:
            return
        if stage not in self._stages:
            self._forget(now)
            self._stages[stage] = self._display.add_task(escape(stage), total=None, passed=""), now
        task, _ = self._stages[stage]
        self._display.update(task, completed=done, total=of or None, passed=_passed(done, of))
        self._stages[stage] = task, now

    def _forget(self, now: float) -> None:
        """Remove the bars of stages that are done, of unknown length, or without news: what is left runs beside the next one."""
        for name, (task, seen) in list(self._stages.items()):
            bar = next(one for one in self._display.tasks if one.id == task)
            if bar.total is None or bar.completed >= bar.total or now > seen + FORGOTTEN:
                self._display.remove_task(task)
                del self._stages[name]

    def ask(self, request: str) -> None:
        """Ask a person to do something; on a terminal wait until it is done."""
        self._display.stop()
        stderr.print(f"[bold]{escape(request)}[/]", soft_wrap=True, highlight=False)
        if sys.stdin.isatty():
            stderr.input("Enter when it is done, Ctrl-C to stop here: ")
        self._display.start()


@contextmanager
def shown(quiet: bool, told: bool = False) -> Iterator[Bars]:
    """Bars with the time left, which vanish in the end; nothing where the error stream is no terminal.

    Args:
        quiet: whether to show nothing, as with --json.
        told: whether every new stage is told in a line that stays, on a terminal or not: for work of many minutes.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[passed]}"), TimeRemainingColumn())
    with Progress(*columns, console=stderr, transient=True, disable=quiet or not stderr.is_terminal) as display:
        yield Bars(display, told and not quiet)


def _passed(done: float, of: float) -> str:
    """What is done of how much, in whole numbers where both are; nothing where nobody knows."""
    if not of:
        return ""
    whole = float(done).is_integer() and float(of).is_integer()
    return f"{done:.0f} of {of:.0f}" if whole else f"{done:.1f} of {of:.1f}"
