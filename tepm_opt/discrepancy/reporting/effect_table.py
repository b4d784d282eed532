"""The answer as a table: for each effect where it acts, its size, its probability, and the share of the gap that only it closes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tepm_opt.discrepancy.assessment.result import Named, Verdict, VerdictStatus
from tepm_opt.solvers.text import percent, with_deviation

HEAD = ("effect", "where", "size", "probability", "share of the gap")
SHOWN = {
    "Pa": (1e-3, "kPa"), "m": (1e3, "mm"), "kg": (1e3, "g"), "rad": (180 / np.pi, "deg"), "s": (1e3, "ms"), "1": (100.0, "%"),
    "1/Pa": (1e5, "%/kPa"), "1/N": (100.0, "%/N"), "s/Pa": (1e6, "ms/kPa"),
}  # fmt: skip
LONG = 1e4  # of a small unit, from which on the SI unit is shown


def effect_rows(effects: Sequence[Named]) -> list[tuple[str, ...]]:
    """Rows below `HEAD`: the first of an effect with its first size, further ones with one more size each.

    Args:
        effects: of a verdict, the surest first or in any other order that is to be kept.
    """
    rows: list[tuple[str, ...]] = []
    for effect in effects:
        first, *more = sizes(effect) or ["–"]
        rows.append((effect.candidate.name, place(effect), first, f"{effect.probability:.2f}", percent(effect.closes)))
        rows += [("", "", size, "", "") for size in more]
    return rows


def sentences_beside_table(verdict: Verdict) -> tuple[str, ...]:
    """Sentences of a verdict that say what its table does not; with `INDISTINGUISHABLE` which effects stand for each other."""
    told = bool(verdict.effects) and verdict.status is not VerdictStatus.INDISTINGUISHABLE
    return verdict.sentences[1:] if told else verdict.sentences


def place(effect: Named) -> str:
    """The part and the runs in which an effect acts; a dash where that is everywhere and always."""
    candidate = effect.candidate
    parts = [f"{candidate.part or ''} {candidate.detail}".strip()] if candidate.detail else []
    return ", ".join([*parts, *(["only in " + ", ".join(effect.runs)] if effect.runs else [])]) or "–"


def sizes(effect: Named) -> list[str]:
    """Values of an effect's parameters, and which are not told from null; not those of its shape that are not told from the usual ones."""
    parts, null = [], dict[str, list[str]]()
    for name, value in effect.parameters.items():
        if not value.clear:
            if f"{effect.candidate.label}.{name}" not in effect.candidate.shapes:
                null.setdefault(with_unit(value.nominal, value.unit) if value.nominal else "0", []).append(name.replace("_", " "))
            continue
        factor, unit = SHOWN.get(value.unit, (1.0, value.unit))
        if factor * abs(value.value) >= LONG:
            factor, unit = 1.0, value.unit
        parts.append(f"{name.replace('_', ' ')} {with_deviation(factor * value.value, factor * value.std)} {unit}")
    return parts + [f"{' and '.join(names)} not significantly different from {nominal}" for nominal, names in null.items()]


def with_unit(value: float, unit: str) -> str:
    """A value as people say it."""
    factor, shown = SHOWN.get(unit, (1.0, unit))
    return f"{factor * value:.3g} {'' if shown == '-' else shown}".strip()
