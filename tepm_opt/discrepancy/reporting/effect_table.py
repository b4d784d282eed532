"""Table of the answer: for each effect its place, size, probability, and the share of the gap that only it closes.

Terminal and page begin with it, then the errors in one sentence; places where the model misses come later.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tepm_opt.discrepancy.assessment.result import Named, Verdict, VerdictStatus
from tepm_opt.solvers.numerics.text import format_names, percent, with_deviation

HEAD = ("effect", "where", "size ± std", "probability", "gap only it closes")
WHERE = HEAD.index("where")
EVERYWHERE = "–"


def effect_table(verdict: Verdict) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows of the table of a verdict's effects; without the column `where` if all of them act everywhere and always."""
    rows = effect_rows(verdict.effects)
    if any(row[WHERE] not in ("", EVERYWHERE) for row in rows):
        return HEAD, rows
    head, *rows = [(*row[:WHERE], *row[WHERE + 1 :]) for row in (HEAD, *rows)]
    return head, rows


def effect_rows(effects: Sequence[Named]) -> list[tuple[str, ...]]:
    """Rows below `HEAD`: the first of an effect with its first size, further ones with one more size each.

    Args:
        effects: of a verdict, the surest first or in any other order that is to be kept.
    """
    rows: list[tuple[str, ...]] = []
    for effect in effects:
        first, *more = describe_sizes(effect) or ["–"]
        rows.append((effect.candidate.name, describe_place(effect), first, f"{effect.probability:.2f}", percent(effect.closes)))
        rows += [("", "", size, "", "") for size in more]
    return rows


def sentences_beside_table(verdict: Verdict, places: str) -> tuple[str, ...]:
    """Sentences of a verdict that its table does not replace; with `INDISTINGUISHABLE` which effects stand for each other.

    Args:
        verdict: the answer.
        places: sentence about where the model misses, which is left out.
    """
    told = bool(verdict.effects) and verdict.status is not VerdictStatus.INDISTINGUISHABLE
    return tuple(sentence for sentence in verdict.sentences[told:] if sentence != places)


def describe_place(effect: Named) -> str:
    """The part and the runs in which an effect acts; a dash where that is everywhere and always."""
    candidate = effect.candidate
    parts = [f"{candidate.part or ''} {candidate.detail}".strip()] if candidate.detail else []
    return ", ".join([*parts, *(["only in " + ", ".join(effect.runs)] if effect.runs else [])]) or EVERYWHERE


def describe_sizes(effect: Named) -> list[str]:
    """Values of an effect's parameters; those not significantly different from nominal by name only, or not at all where of its shape.

    Where no strength differs and there is a shape, it acts, but how strongly is known only together with the shape: all values are told.
    """
    parts, null = [], dict[str, list[str]]()
    shapes = {name for name in effect.parameters if f"{effect.candidate.label}.{name}" in effect.candidate.shapes}
    strengths = [value for name, value in effect.parameters.items() if name not in shapes or not value.nominal]
    together = bool(shapes) and not any(value.clear for value in strengths)
    for name, value in effect.parameters.items():
        if not value.clear and not together:
            if name not in shapes:
                null.setdefault(with_unit(value.nominal, value.unit) if value.nominal else "0", []).append(name.replace("_", " "))
            continue
        factor, unit = _readable_unit(value.unit)
        if factor * abs(value.value) >= 1e4:  # too long a number in a small unit
            factor, unit = 1.0, value.unit
        parts.append(f"{name.replace('_', ' ')} {with_deviation(factor * value.value, factor * value.std)} {unit}")
    if together:
        return [*parts, "known only together"]
    some = {at: " and ".join(names) if len(names) < 3 else format_names(names, 3) for at, names in null.items()}
    return parts + [f"{names} not significantly different from {nominal}" for nominal, names in some.items()]


def with_unit(value: float, unit: str) -> str:
    """A value of an SI unit in a readable unit."""
    factor, shown = _readable_unit(unit)
    return f"{factor * value:.3g} {'' if shown == '-' else shown}".strip()


def _readable_unit(unit: str) -> tuple[float, str]:
    """Factor from an SI unit to a readable unit, and its name."""
    readable = {
        "Pa": (1e-3, "kPa"), "m": (1e3, "mm"), "kg": (1e3, "g"), "rad": (180 / np.pi, "deg"), "s": (1e3, "ms"), "1": (100.0, "%"),
        "1/Pa": (1e5, "%/kPa"), "1/N": (100.0, "%/N"), "s/Pa": (1e6, "ms/kPa"),
    }  # fmt: skip
    return readable.get(unit, (1.0, unit))
