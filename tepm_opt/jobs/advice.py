"""The command that does what a verdict advises: with the files of the run, so that it can be pasted."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.reporting.sentences import ONE_CLOCK
from tepm_opt.discrepancy.state import Discovery
from tepm_opt.jobs.record import LOG

MODEL, VALUES, MENDED = "model.toml", "values.json", "mended"
LAW = "seek a law where the library has no effect"
USE = "see the model with the law that was found beside a run"
OTHERS = "record runs in which they would differ, then ask again"


@dataclass(frozen=True)
class Asked:
    """Arguments of a `tepm discrepancy`.

    Attributes:
        folder: data set.
        out: of the results.
        model, plant: files; None where the data set says all.
        add: data sets recorded later.
        invent: whether a law was sought.
        despite_errors: whether the data were taken as they are.
        effects: files with effects of one's own.
        mend: whether mended data were written.
        baseline: an earlier data set with which they were compared.
        ended_early: whether the search left something untried for want of time.
    """

    folder: Path
    out: Path
    model: Path | None = None
    plant: Path | None = None
    add: Sequence[Path] = ()
    invent: bool = False
    despite_errors: bool = False
    effects: Sequence[Path] = ()
    mend: bool = False
    baseline: Path | None = None
    ended_early: bool = False

    def again(self, *more: str | Path) -> str:
        """The command once more, with further options."""
        options: list[str | Path] = [self.folder]
        for name, file in (("--model", self.model), ("--plant", self.plant)):
            options += [name, file] if file else []
        options += [part for each in self.add for part in ("--add", each)]
        options += ["--baseline", self.baseline] if self.baseline else []
        options += ["--despite-errors"] if self.despite_errors else []
        return _command("discrepancy", *options, *self._own, *more, "--out", self.out)

    def format_comparison_command(self, result: Discovery, model: Path, *more: str | Path) -> str:
        """Format the command that shows a model beside a run, a validation run if there is one; empty where no run has its own file."""
        runs = sorted(result.dataset.runs, key=lambda run: run.role != "validation")
        file = next((self.folder / run.file for run in runs if (self.folder / run.file).is_file()), None)
        if file is None:
            return ""
        verb = "statics" if getattr(result.dataset, "static", False) else "simulate"
        return _command(verb, file, "--model", model, *self._own, *more, "--out", self.out / "beside")

    @property
    def rig(self) -> str:
        """The rig that the data set was recorded on; its place where that is unknown."""
        try:
            return str(json.loads((self.folder / LOG).read_text(encoding="utf-8"))["rig"])
        except (OSError, ValueError, KeyError, TypeError):
            return "RIG"

    @property
    def _own(self) -> list[str | Path]:
        return [part for file in self.effects for part in ("--effects", file)]


def add_advice(result: Discovery, asked: Asked) -> Discovery:
    """Add the command with which to go on to a discovery's verdict."""
    step, command = _advice(result, asked)
    return replace(result, verdict=replace(result.verdict, next=step, command=command))


def _advice(result: Discovery, asked: Asked) -> tuple[str, str]:
    """Advise the next step in words, with the command for it."""
    verdict = result.verdict
    step, status = verdict.next, verdict.status
    if asked.ended_early and status is not VerdictStatus.SETUP_ERROR:
        return "let the search go on from there", asked.again()
    if status in (VerdictStatus.NAMED, VerdictStatus.NO_DISCREPANCY):
        if asked.plant:
            return f"take the values of {(asked.out / VALUES).as_posix()} over into {asked.plant.as_posix()}, then ask again", asked.again()
        return step, asked.format_comparison_command(result, asked.out / MODEL)
    if status is VerdictStatus.SETUP_ERROR:
        if asked.plant:
            return f"{step}, then ask again", asked.again()
        if asked.mend:
            return "look at the mended data, then ask again with them", _command("data", "check", asked.out / MENDED)
        return f"{step}; this writes mended data", asked.again("--mend")
    if status is VerdictStatus.INDISTINGUISHABLE:
        if asked.plant or getattr(result.dataset, "static", False):
            return OTHERS, asked.again()
        number = str(len(asked.add) + 1) if asked.add else ""  # what was recorded before stays
        run, extra = asked.out / f"run{number}.toml", asked.out / f"extra{number}"
        commands = _command("data", "next", asked.out, "--out", run), _command("record", run, "--rig", asked.rig, "--out", extra)
        return step, " && ".join((*commands, asked.again("--add", extra)))
    if result.law is not None:
        file = result.law.file
        return USE, asked.format_comparison_command(result, file.with_suffix(".toml"), "--effects", file)
    if step == ONE_CLOCK or asked.plant or asked.invent:
        return f"{step}, then ask again", asked.again()
    return LAW, asked.again("--invent")


def _command(verb: str, *parts: str | Path) -> str:
    """A command of the program that can be pasted into a shell."""
    return shlex.join(("tepm", verb, *(part.as_posix() if isinstance(part, Path) else part for part in parts)))
