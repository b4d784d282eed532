"""Verdict of the workflow: plain data for people and programs."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.frames import Tabular
from tepm_opt.discrepancy.assessment.settings import DEFAULT, AssessmentSettings
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.setup.errors import SetupError
from tepm_opt.solvers.numerics.text import format_names, html_table, shorten


class VerdictStatus(Enum):
    """Kind of answer to the question which effect is missing."""

    NAMED = "named"
    PARTIAL = "partial"
    NO_DISCREPANCY = "no_discrepancy"
    INDISTINGUISHABLE = "indistinguishable"
    UNEXPLAINED = "unexplained"
    SETUP_ERROR = "setup_error"


@dataclass(frozen=True)
class Value:
    """A parameter found: value and standard deviation in its SI unit; `nominal` is what it was before."""

    value: float
    std: float
    unit: str
    nominal: float

    @property
    def clear(self) -> bool:
        """Whether it differs by more than two standard deviations from what it was before."""
        return abs(self.value - self.nominal) > 2 * self.std


@dataclass(frozen=True)
class Named:
    """An effect of the answer.

    Attributes:
        candidate: the effect, with its detail.
        probability: that it acts in this machine.
        parameters: by the effect's own parameter names.
        closes: part of the gap left by recalibration that only this effect closes (held-out data), 0 … 1.
        runs: files of the runs in which it acts; none where it acts in all.
    """

    candidate: Candidate
    probability: float
    parameters: Mapping[str, Value]
    closes: float
    runs: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Named({self.candidate.label}, probability {self.probability:.3f}, {format_names(list(self.parameters))})"


@dataclass(frozen=True)
class Rival:
    """An effect that was considered and not named.

    Attributes:
        candidate: the effect, with its detail.
        probability: that it, and not what was named, acts.
        why: the objection to it (or why it cannot be told apart).
        closes: part of the gap left by recalibration that it would close (held-out data); None where it was not worth a fit.
    """

    candidate: Candidate
    probability: float
    why: str
    closes: float | None


@dataclass(frozen=True)
class Place:
    """A part of the data in which the model misses.

    Attributes:
        by: "run", "point", "axis", "actuator", "module", "time", "moment", "regime" or "band".
        name: which one: "steps.csv", "s4", "x", "13 pressure", "after a reversal", …
        rms: structure in m: root mean square of Eq. (5) in this part, noise taken off.
        share: of the whole squared structure, 0 … 1.
        ratio: squared structure per sample here over that everywhere.
        p: how often data with permuted blocks of time concentrate as much here.
    """

    by: str
    name: str
    rms: float
    share: float
    ratio: float
    p: float


@dataclass(frozen=True)
class Errors:
    """Root mean square over time of Eq. (5) in m on validation runs."""

    noise_floor: float
    nominal: float
    recalibrated: float
    corrected: float
    black_box: float

    @property
    def gap_closed_fraction(self) -> float:
        """Fraction of the gap between nominal and noise that the corrected model closes."""
        gap = self.nominal - self.noise_floor
        return (self.nominal - self.corrected) / gap if gap > 0 else 1.0

    @property
    def closed(self) -> float:
        """Deprecated name of `gap_closed_fraction`; it goes with version 0.4."""
        warnings.warn(
            "Errors.closed is now Errors.gap_closed_fraction; the old name goes with version 0.4", DeprecationWarning, stacklevel=2
        )
        return self.gap_closed_fraction


def reduces_validation_error(errors: Errors, settings: AssessmentSettings = DEFAULT) -> bool:
    """Whether the effects close the gap on runs not used, or recalibration leaves none there."""
    gap, least = errors.recalibrated**2 - errors.noise_floor**2, settings.min_gap_closed
    return gap <= least * errors.noise_floor**2 or errors.recalibrated**2 - errors.corrected**2 >= least * gap


def increases_validation_error(errors: Errors, settings: AssessmentSettings = DEFAULT) -> bool:
    """Whether the gap on runs not used is wider with the effects than without, by as much as would have counted as closing it."""
    gap = errors.recalibrated**2 - errors.noise_floor**2
    return errors.corrected**2 - errors.recalibrated**2 > settings.min_gap_closed * max(gap, errors.noise_floor**2)


@dataclass(frozen=True)
class Verdict(Tabular):
    """The answer.

    Attributes:
        status: kind of answer.
        sentences: the answer in words: the missing effects (a table by `effect_table.effect_table`), how the errors fall, where the model
            misses.
        next: what to do now, in words, and `command`, which does it, where it is known what was asked.
        effects: named ones; with `INDISTINGUISHABLE` the rivals; with `UNEXPLAINED` those that are sure nevertheless.
        rivals: considered and rejected, most probable first.
        where: where the recalibrated model misses (the nominal one where nothing is missing), largest first.
        recalibrated: the known parameters by name, as found together with the effects.
        errors: on validation runs (on fit runs where the data set has no others).
        model: with effects and values: a `Model`, or the values by name where the machine is given by equations.
        machine: its name.
        unit: of errors.
        fits: how many sets of effects were fitted.
        notes: what a reader should know: doubts about the data, directions the runs cannot tell, structure left.
        seconds: it took.
        setup: errors of the set-up, with their mends; the answer is about the data with the likeliest of each mended.
        baseline: name of the earlier data set, where the answer is about what changed since; else empty.
        cause_scores: how far candidates are from being ruled out, 0 to 1, largest first.
    """

    status: VerdictStatus
    sentences: tuple[str, ...]
    effects: tuple[Named, ...]
    rivals: tuple[Rival, ...]
    where: tuple[Place, ...]
    recalibrated: Mapping[str, Value]
    errors: Errors
    model: Any
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    machine: str = ""
    unit: str = "m"
    fits: int = 0
    next: str = ""
    command: str = ""
    setup: tuple[SetupError, ...] = ()
    baseline: str = ""
    cause_scores: tuple[tuple[str, float], ...] = ()

    @property
    def stated_set(self) -> tuple[str, ...]:
        """Labels of causes that are not ruled out, see `stated_set.score_causes`; docs/results/blind.md says how often it holds all."""
        return tuple(label for label, score in self.cause_scores if score >= DEFAULT.min_stated)

    @property
    def setup_sentences(self) -> tuple[str, ...]:
        """Sentences of the set-up errors; the last says that the rest of the answer is about mended data."""
        if not self.setup:
            return ()
        errors = tuple(f"Set-up error: {error.sentence}." for error in self.setup)
        mended = any(error.is_mended for error in self.setup)
        return (*errors, "All that follows is about the data with the first of these mended.") if mended else errors

    @property
    def paragraph(self) -> str:
        """The answer in words."""
        return " ".join((*self.setup_sentences, *self.sentences))

    @property
    def step(self) -> str:
        """Next step in words and with the command."""
        return f"Next: {self.next}{': ' if self.command else '.'}{self.command}" if self.next else ""

    def __repr__(self) -> str:
        """The outcome and the main numbers, in a line."""
        effects = format_names([f"{named.candidate.label} {named.probability:.2f}" for named in self.effects], 2)
        named = f", {shorten(effects, 60)}" if effects else ""
        return f"Verdict({self.status.value}{named}, {self.errors.gap_closed_fraction:.0%} of the gap closed)"

    def _repr_html_(self) -> str:
        """The answer in words and the effects with their parameters, as a table."""
        rows = [
            (named.candidate.label, f"{named.probability:.3f}", name, f"{value.value:.6g}", f"{value.std:.2g}", value.unit)
            for named in self.effects
            for name, value in named.parameters.items()
        ]
        head = ("effect", "probability", "parameter", "value", "standard deviation", "unit")
        return (
            f"<p>{escape(self.paragraph)}</p>"
            + (f"<p>{escape(self.step)}</p>" if self.next else "")
            + (html_table(head, rows) if rows else "")
        )

    def columns(self) -> dict[str, np.ndarray]:
        """Effects considered, a row each: named ones, then rivals."""
        considered = (*self.effects, *self.rivals)
        return {
            "effect": np.array([each.candidate.label for each in considered], dtype=np.str_),
            "named": np.arange(len(considered)) < len(self.effects),
            "probability": np.array([each.probability for each in considered], dtype=float),
            "closes": np.array([np.nan if each.closes is None else each.closes for each in considered], dtype=float),
        }

    def as_json(self) -> dict[str, Any]:
        """Content of verdict.json."""
        return {
            "status": self.status.value,
            **({"baseline": self.baseline} if self.baseline else {}),
            "effects": [
                {
                    "name": named.candidate.name,
                    "detail": named.candidate.detail,
                    "probability": _round_number(named.probability),
                    "parameters": {name: _value(value) for name, value in named.parameters.items()},
                    **({"runs": [Path(file).stem for file in named.runs]} if named.runs else {}),
                }
                for named in self.effects
            ],
            "stated_set": list(self.stated_set),
            "scores": {label: _round_number(score) for label, score in self.cause_scores},
            "setup": [error.as_json() for error in self.setup],
            "rivals": [{"name": r.candidate.label, "probability": _round_number(r.probability), "why": r.why} for r in self.rivals],
            "where": [
                {
                    "by": p.by,
                    "name": p.name,
                    "rms_m" if self.unit == "m" else "rms": _round_number(p.rms),
                    "share": _round_number(p.share),
                    "p": _round_number(p.p),
                }
                for p in self.where
            ],
            "rmse_m" if self.unit == "m" else "rmse": {name: _round_number(value) for name, value in vars(self.errors).items()},
            "recalibrated": {name: _value(value) for name, value in self.recalibrated.items()},
            "paragraph": self.paragraph,
            "next": self.next,
            "command": self.command,
            "notes": list(self.notes),
            "fits": self.fits,
            "seconds": round(self.seconds, 1),
        }


def _value(value: Value) -> dict[str, Any]:
    return {"value": _round_number(value.value), "std": _round_number(value.std), "unit": value.unit}


def _round_number(number: float) -> float | None:
    """Six significant digits, so that the last bits of a sum do not make two files differ; None for what is not a number."""
    return float(f"{number:.6g}") if abs(number) < float("inf") else None
