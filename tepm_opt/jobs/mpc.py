"""Running a closed loop on any rig, and keeping everything while it happens.

A journal beside the log grows sample by sample, so that a program that dies leaves what it has.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from tepm_opt.control.controllers import DEFAULT
from tepm_opt.control.diagnostics import monitor
from tepm_opt.control.loop import INTERRUPTED, Guard, LoopRecord, close_loop
from tepm_opt.control.references.reference import Reference
from tepm_opt.data.files import output_folder
from tepm_opt.data.journal import Journal
from tepm_opt.data.tables import column_texts
from tepm_opt.errors import InputError
from tepm_opt.hw.rig import Command, Rig, Sample
from tepm_opt.jobs.closed_loop import LOG, ClosedLoop, LoopSetup
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import CompiledModel
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.progress import Progress, silent
from tepm_opt.recording.measure import GOOD, STATUS, journal_path

Observer = Callable[[Sample, Command, np.ndarray], None]
"""Callback of a live view: takes every sample, what was commanded then, and the tip's target, (3,) in m. The controller's doubts are among
the sample's faults."""

GATHER = 0.05
"""Seconds for which rows of the journal are gathered: that much is lost at most where the program is killed."""


class _Keeper:
    """A journal that a thread of its own writes, so that the loop never waits for the disk; some rows at once, which costs a quarter."""

    def __init__(self, path: Path, part: Callable[[slice], ClosedLoop]) -> None:
        self.path, self._part, self._count = path, part, 0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._write, name="log", daemon=True)
        self._thread.start()

    def add(self, row: int) -> None:
        """Take a row, by its number; they come in order."""
        self._count = row + 1

    def _write(self) -> None:
        journal: Journal | None = None
        written, over = 0, False
        try:
            while not over:
                over = self._closing.wait(GATHER)
                if (count := self._count) > written:
                    columns = self._part(slice(written, count)).columns()
                    journal, written = journal or Journal(self.path, list(columns)), count
                    journal.append(*zip(*map(column_texts, columns.values()), strict=True))
        except InputError:  # the log is written as a whole in the end and says then what is wrong with the disk
            pass
        finally:
            if journal is not None:
                journal.close()

    def close(self) -> None:
        """Wait until all is written."""
        self._closing.set()
        self._thread.join()


@contextmanager
def _open_journal(folder: Path | None, part: Callable[[slice], ClosedLoop]) -> Iterator[Callable[[int], None]]:
    """Open a journal of rows in the folder; it is deleted at the end, where `log.csv` has all rows, and kept after an error."""
    if folder is None:
        yield lambda number: None
        return
    keeper = _Keeper(journal_path(output_folder(folder), Path(LOG).name), part)
    try:
        yield keeper.add
    except BaseException:
        keeper.close()
        raise
    keeper.close()
    keeper.path.unlink(missing_ok=True)


def _add_rig_status(loop: ClosedLoop, statuses: list[str]) -> ClosedLoop:
    """Add the rig's status at each sample; an interruption may have come before the last one was noted."""
    count = len(loop.time)
    said = [*statuses[:count], *[GOOD] * (count - len(statuses))]
    return replace(loop, steps={**loop.steps, STATUS: np.array(said, dtype=np.str_)})


def run_closed_loop(
    model: CompiledModel,
    reference: Reference,
    rig: Rig,
    setup: LoopSetup,
    folder: str | Path | None = None,
    guard: Guard | None = None,
    progress: Progress = silent,
    observer: Observer | None = None,
) -> ClosedLoop:
    """Follow a reference on a rig and write log.csv and summary.json; the rig is stopped whatever happens.

    An interruption, a guard that stops the loop and a rig that fails on the way end it early; the result says so and holds what was done.

    Args:
        model: the controller's.
        reference: see `whole_reference`.
        rig: not yet entered.
        setup: names what runs; the rig is `rig`, whatever it says.
        folder: for the results; None writes nothing. While the loop runs a journal is there, named log-….unfinished.csv.
        guard: when to stop.
        progress: told the stage and how much of it is done, in s.
        observer: given every sample with what was commanded then and the tip's target.

    Raises:
        InputError: unknown controller; the rig has another robot, or disagrees with the model before the loop is closed; a real arm that
            is inside an obstacle at rest; a folder that cannot be written to.
        RuntimeError, OSError: the rig failed before the loop was closed.
    """
    if channels_of(rig.robot) != channels_of(model.robot):
        raise InputError(
            f"the rig's robot is {rig.robot.name!r}, the model's {model.robot.name!r}; name the one that is there (--robot, --model)"
        )
    if rig.simulated is None and reference.keep_out is not None and (inside := reference.keep_out.at_rest()):
        raise InputError(inside)
    kind, settings = setup.kind, setup.chosen
    if rig.simulated is None:
        settings = settings.in_real_time(reference.period)
    controller = kind.make(model, reference, settings)
    if kind.name == DEFAULT:
        controller = monitor.attach_monitor(controller, model)
    done = LoopRecord(controller.reference)
    statuses: list[str] = []

    def part(rows: slice) -> ClosedLoop:
        return _add_rig_status(ClosedLoop.from_record(done, model, setup, rows), statuses[rows])

    with _open_journal(None if folder is None else Path(folder), part) as keep:

        def watch_sample(sample: Sample, target: np.ndarray) -> None:
            statuses.append(sample.status)
            keep(len(done.rows) - 1)
            if observer is not None:
                observer(replace(sample, faults=done.telemetry[-1].doubts), done.commands[-1], target)

        try:
            close_loop(rig, controller, model.robot, guard, progress, watch_sample, done)
        except KeyboardInterrupt:  # while the rig was being opened or stopped
            done.outcome = INTERRUPTED
        except (InputError, RuntimeError, OSError) as error:
            if not done.rows:
                raise
            done.outcome = Outcome(Ending.RIG_FAILED, " ".join(str(error).split()) or type(error).__name__)
        found = _add_rig_status(ClosedLoop.from_record(done, model, setup), statuses)
        if isinstance(controller, monitor.Watched):
            found = replace(found, changes=tuple(controller.monitor.changes))
        if folder is not None:
            found.save(folder)
    return found
