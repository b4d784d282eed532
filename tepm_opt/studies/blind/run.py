"""Blind trials: hide something in data, ask what it is, keep every answer; as many at once as there are workers."""

from __future__ import annotations

import json
import tempfile
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from tepm_opt.data.files import output_folder, write_atomically
from tepm_opt.errors import InputError
from tepm_opt.jobs.discrepancy import VERDICT, run_discrepancy
from tepm_opt.jobs.executors import processes
from tepm_opt.jobs.output import save_summary
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.progress import Progress, silent, track
from tepm_opt.solvers.numerics.parallel import cores, on_cores
from tepm_opt.studies.blind.analysis import Analysis, analyse_results
from tepm_opt.studies.blind.table import markdown
from tepm_opt.studies.blind.trial import Trial, TrialSeries, make

RESULTS, TABLE = "trials.jsonl", "summary.md"
DIED = "the process of this trial died"
Keep = Callable[[dict[str, Any]], None]
Examine = Callable[[Trial], dict[str, Any]]


@dataclass(frozen=True, eq=False)
class BlindRun:
    """Blind trials and what was said about each.

    Attributes:
        series: the trials.
        results: a line of `trials.jsonl` each, by number.
        interrupted: whether the user ended it before all were done.
    """

    series: TrialSeries
    results: tuple[dict[str, Any], ...]
    interrupted: bool = False

    @property
    def outcome(self) -> Outcome:
        """Solved where all trials have a result."""
        if len(self.results) == self.series.count:
            return Outcome()
        return Outcome(
            Ending.INTERRUPTED if self.interrupted else Ending.FAILED, f"{len(self.results)} of {self.series.count} trials are done"
        )

    @property
    def ok(self) -> bool:
        """Whether all trials have a result."""
        return self.outcome.solved

    @cached_property
    def analysis(self) -> Analysis:
        """Summary of all trials."""
        return analyse_results(self.results)

    def summary(self) -> dict[str, Any]:
        """All numbers, with what makes the trials again."""
        asked = {"trials": self.series.count, "seed": self.series.seed, "family": self.series.family, "version": version("tepm-opt")}
        return {"asked": asked, "interrupted": self.interrupted, **self.analysis.summary()}

    def save(self, folder: str | Path) -> None:
        """Write `summary.json` and the table, `summary.md`.

        Raises:
            InputError: the folder cannot be written to.
        """
        folder = output_folder(folder)
        save_summary(folder, "blind", self.summary())
        write_atomically(folder / TABLE, markdown(self.analysis))

    def __repr__(self) -> str:
        return f"<BlindRun {self.outcome}; {len(self.results)} trials, seed {self.series.seed}>"


def examine_trial(trial: Trial) -> dict[str, Any]:
    """Examine a trial; its result is plain data: label, verdict or why there is none, and the time taken.

    What goes wrong is a result, too.
    """
    result = {**_describe_trial(trial), "label": None, "verdict": None, "error": None}
    began, used = time.monotonic(), time.process_time()
    making, folder = 0.0, Path()
    try:
        with on_cores(1), threadpool_limits(limits=1, user_api="blas"), tempfile.TemporaryDirectory() as name:
            made, folder = make(trial), Path(name)
            result["label"] = made.label
            made.write(folder, "data")
            making = time.process_time() - used
            run_discrepancy(folder / "data", folder / "out")
            result["verdict"] = json.loads((folder / "out" / VERDICT).read_text(encoding="utf-8"))
    except Exception as error:  # a trial that fails says something about the workflow, and ends no other
        result["error"] = f"{type(error).__name__}: {error}".replace(f"{folder}/", "")  # the folder is gone, and another each time
    seconds = {"wall": time.monotonic() - began, "cpu": time.process_time() - used, "making": making}
    return {**result, "seconds": {name: round(value, 2) for name, value in seconds.items()}}


def run_blind(
    out: str | Path, series: TrialSeries, executor: Executor | None = None, jobs: int | None = None, progress: Progress = silent,
    examine: Examine = examine_trial,
) -> BlindRun:  # fmt: skip
    """Make trials, explain each, and append what is said about it to `trials.jsonl`; trials that stand there already are not repeated.

    Args:
        out: folder.
        series: the trials.
        executor: where trials run; processes of this machine where None. It has to import this package, and is left open.
        jobs: how many processes, as many as there are cores where None; each trial has one core.
        progress: told of every trial that is done.
        examine: what is done with each trial.

    Raises:
        InputError: no such family; the folder cannot be written to; an executor given does not work any more.
    """
    wanted, trials = series.trials, series.count
    path = output_folder(out) / RESULTS
    done = {_key(result): result for result in read_results(path)}
    left = [trial for trial in wanted if _identify_trial(trial) not in done]
    progress("trials", trials - len(left), trials)
    interrupted = False
    with path.open("a", encoding="utf-8") as file:

        def keep(result: dict[str, Any]) -> None:
            file.write(json.dumps(result) + "\n")
            file.flush()
            done[_key(result)] = result
            progress("trials", sum(_identify_trial(trial) in done for trial in wanted), trials)

        try:
            if executor is None:
                _in_processes(left, jobs or cores(), keep, examine)
            elif _spread(executor, left, len(left), keep, examine):
                raise InputError("the executor does not work any more; finished trials are kept, the same command goes on")
        except KeyboardInterrupt:
            interrupted = True
    return BlindRun(series, tuple(done[_identify_trial(trial)] for trial in wanted if _identify_trial(trial) in done), interrupted)


def write_trials(folder: str | Path, series: TrialSeries, progress: Progress = silent) -> None:
    """Write the data sets of trials, FAMILY_NUMBER each, and what is hidden in them, labels/FAMILY_NUMBER.json.

    Args:
        folder: for them.
        series: the trials.
        progress: told of every data set.

    Raises:
        InputError: no such family; the folder cannot be written to.
    """
    folder = output_folder(folder)
    for trial in track(series.trials, progress, "data sets", series.count):
        make(trial).write(folder, f"{trial.family}_{trial.number:03d}")


def read_results(path: str | Path) -> list[dict[str, Any]]:
    """All results in a `trials.jsonl`; a last line that was not finished is cut off.

    Raises:
        InputError: a line is no result.
    """
    path = Path(path)
    if not path.exists():
        return []
    text = path.read_bytes()
    whole = text[: text.rfind(b"\n") + 1]
    if len(whole) < len(text):
        path.write_bytes(whole)
    found = []
    for number, line in enumerate(whole.decode().splitlines(), start=1):
        try:
            found.append(json.loads(line))
            _key(found[-1])
        except (ValueError, TypeError, KeyError) as error:
            raise InputError(f"{path}, line {number}: no result of a trial; valid: lines that tepm study blind wrote") from error
    return found


def _describe_trial(trial: Trial) -> dict[str, Any]:
    return {"family": trial.family, "seed": trial.seed, "number": trial.number}


def _identify_trial(trial: Trial) -> tuple[str, int, int]:
    return trial.family, trial.seed, trial.number


def _key(result: dict[str, Any]) -> tuple[str, int, int]:
    return result["family"], result["seed"], result["number"]


def _describe_death(trial: Trial) -> dict[str, Any]:
    return {**_describe_trial(trial), "label": None, "verdict": None, "error": DIED, "seconds": {}}


def _spread(executor: Executor, trials: Sequence[Trial], at_once: int, keep: Keep, examine: Examine) -> list[Trial]:
    """Let an executor examine trials; those that were under way, and those not begun, where it broke.

    Args:
        executor: which.
        trials: what to examine.
        at_once: how many it is given at the same time.
        keep: told of every result.
        examine: what is done with each trial.

    Raises:
        KeyboardInterrupt: by the user; trials that are waiting are taken back.
    """
    waiting, under_way = deque(trials), dict[Future[dict[str, Any]], Trial]()
    try:
        while waiting or under_way:
            while waiting and len(under_way) < at_once:
                under_way[executor.submit(examine, waiting[0])] = waiting[0]
                waiting.popleft()
            for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                try:
                    result = future.result()
                except BrokenExecutor:
                    raise
                except Exception as error:  # such as a cluster's that lost its workers to this trial again and again
                    result = {**_describe_death(under_way[future]), "error": f"{type(error).__name__}: {error}"}
                del under_way[future]
                keep(result)
    except BrokenExecutor:
        return [*under_way.values(), *waiting]
    except KeyboardInterrupt:
        for future in under_way:
            if not future.cancel() and future.done() and future.exception() is None:
                keep(future.result())
        raise
    return []


def _in_processes(trials: Sequence[Trial], jobs: int, keep: Keep, examine: Examine) -> None:
    """Examine trials in processes; one that kills its process is found by trying those under way then one by one.

    Args:
        trials: what to examine.
        jobs: how many processes.
        keep: told of every result.
        examine: what is done with each trial.
    """
    left = list(trials)
    while left:
        with processes(jobs) as executor:
            left = _spread(executor, left, jobs, keep, examine)
        for suspect in left[:jobs]:
            with processes(1) as executor:
                if _spread(executor, [suspect], 1, keep, examine):
                    keep(_describe_death(suspect))
        left = left[jobs:]
