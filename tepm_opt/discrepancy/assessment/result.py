"""What the workflow answers: plain data for people and programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.frames import Tabular
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.solvers.text import html_table, listed, shortened

SHRINKS = 0.1  # part of the squared gap on runs not used that must close
UNCLEAR = 2.0  # standard deviations within which a value is not told from what it was before


class VerdictStatus(Enum):
    """What became of the question which effect is missing."""

    NAMED = "named"
    PARTIAL = "partial"
    NO_DISCREPANCY = "no_discrepancy"
    INDISTINGUISHABLE = "indistinguishable"
    UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class Value:
    """A parameter found: value and standard deviation in its SI unit; `nominal` is what it was before."""

    value: float
    std: float
    unit: str
    nominal: float

    @property
    def clear(self) -> bool:
        """Whether it differs significantly from what it was before."""
        return abs(self.value - self.nominal) > UNCLEAR * self.std


@dataclass(frozen=True)
class Named:
    """An effect of the answer.

    Attributes:
        candidate: which effect, with its detail.
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
        return f"Named({self.candidate.label}, probability {self.probability:.3f}, {listed(list(self.parameters))})"


@dataclass(frozen=True)
class Rival:
    """An effect that was considered and not named.

    Attributes:
        candidate: which effect, with its detail.
        probability: that it, and not what was named, acts.
        why: what speaks against it (or why it cannot be told apart).
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
    def closed(self) -> float:
        """Part of the gap between nominal and noise that the corrected model closes."""
        gap = self.nominal - self.noise_floor
        return (self.nominal - self.corrected) / gap if gap > 0 else 1.0


def shrinks(errors: Errors) -> bool:
    """Whether the effects close the gap on runs not used, or recalibration leaves none there."""
    gap = errors.recalibrated**2 - errors.noise_floor**2
    return gap <= SHRINKS * errors.noise_floor**2 or errors.recalibrated**2 - errors.corrected**2 >= SHRINKS * gap


def widens(errors: Errors) -> bool:
    """Whether the gap on runs not used is wider with the effects than without, by as much as would have counted as closing it."""
    gap = errors.recalibrated**2 - errors.noise_floor**2
    return errors.corrected**2 - errors.recalibrated**2 > SHRINKS * max(gap, errors.noise_floor**2)


@dataclass(frozen=True)
class Verdict(Tabular):
    """The answer.

    Attributes:
        status: what became of the question.
        sentences: the answer in words: what is missing (the table of `answer.effect_rows` with more than one effect), where the model
            misses, how the errors fall.
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

    @property
    def paragraph(self) -> str:
        """The answer in words."""
        return " ".join(self.sentences)

    @property
    def step(self) -> str:
        """What to do now, in words and with the command."""
        return f"Next: {self.next}{': ' if self.command else '.'}{self.command}" if self.next else ""

    def __repr__(self) -> str:
        """The outcome and the main numbers, in a line."""
        effects = listed([f"{named.candidate.label} {named.probability:.2f}" for named in self.effects], 2)
        return f"Verdict({self.status.value}{', ' + shortened(effects, 60) if effects else ''}, {self.errors.closed:.0%} of the gap closed)"

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
        """What was considered, a row each: named effects, then rivals."""
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
            "effects": [
                {
                    "name": named.candidate.name,
                    "detail": named.candidate.detail,
                    "probability": _rounded(named.probability),
                    "parameters": {name: _value(value) for name, value in named.parameters.items()},
                    **({"runs": [Path(file).stem for file in named.runs]} if named.runs else {}),
                }
                for named in self.effects
            ],
            "rivals": [{"name": r.candidate.label, "probability": _rounded(r.probability), "why": r.why} for r in self.rivals],
            "where": [
                {
                    "by": p.by,
                    "name": p.name,
                    "rms_m" if self.unit == "m" else "rms": _rounded(p.rms),
                    "share": _rounded(p.share),
                    "p": _rounded(p.p),
                }
                for p in self.where
            ],
            "rmse_m" if self.unit == "m" else "rmse": {name: _rounded(value) for name, value in vars(self.errors).items()},
            "recalibrated": {name: _value(value) for name, value in self.recalibrated.items()},
            "paragraph": self.paragraph,
            "next": self.next,
            "command": self.command,
            "notes": list(self.notes),
            "fits": self.fits,
            "seconds": round(self.seconds, 1),
        }


def _value(value: Value) -> dict[str, Any]:
    return {"value": _rounded(value.value), "std": _rounded(value.std), "unit": value.unit}


def _rounded(number: float) -> float | None:
    """Six significant digits, so that the last bits of a sum do not make two files differ; None for what is not a number."""
    return float(f"{number:.6g}") if abs(number) < float("inf") else None
