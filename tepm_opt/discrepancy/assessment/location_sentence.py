"""Sentence that says in which parts of the data a model misses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.assessment.result import Place
from tepm_opt.discrepancy.assessment.row_choices import ALONE
from tepm_opt.discrepancy.assessment.settings import AssessmentSettings
from tepm_opt.solvers.numerics.text import quantity


def describe_locations(
    rms: float, telling: Sequence[Place], found: Sequence[Place], unit: str, signals: Signals, settings: AssessmentSettings
) -> str:
    """The misfit and the places that tell most, in a sentence.

    Args:
        rms: structure of all data.
        telling: places that hold clearly more than elsewhere.
        found: all places that were looked at.
        unit: of residuals.
        signals: names and regimes.
        settings: thresholds.
    """
    best = {by: max((t for t in telling if t.by == by), key=_weight) for by in {t.by for t in telling}}
    spots = [f"in {best['run'].name} ({quantity(best['run'].rms, unit)})"] if "run" in best else []
    spots += [f"at {best['point'].name}" + ("" if spots else f" ({quantity(best['point'].rms, unit)})")] if "point" in best else []
    parts = [f"The model misses by {quantity(rms, unit)} beyond the noise" + (f", most {' and '.join(spots)}" if spots else "")]
    parts += [f"along {best['axis'].name}"] if "axis" in best else []
    parts += _describe_inputs(best, telling, found, settings.location_max_others)
    parts += _describe_regimes(telling, found, unit, signals, settings.location_max_chance)
    times = {"early": "at the start", "middle": "in the middle", "late": "at the end"}
    parts += [f"more {times[best['time'].name]} of the runs"] if "time" in best else []
    parts += [f"{100 * best['moment'].share:.0f} % of it from {best['moment'].name}"] if "moment" in best else []
    parts += [f"{100 * best['band'].share:.0f} % of it {best['band'].name}"] if "band" in best else []
    return "; ".join(parts if len(parts) > 1 or spots else [parts[0] + ", everywhere alike"]) + "."


def _describe_inputs(best: dict[str, Place], telling: Sequence[Place], found: Sequence[Place], max_others: float) -> list[str]:
    """Inputs in use where the model misses more: the one that stands out among its like, or all of a kind where all tell."""
    for by in ("actuator", "module", "input"):
        if by not in best:
            continue
        own = best[by].name.removesuffix(ALONE)
        name, _, kind = own.partition(" ")
        alike = {place: place.name.removesuffix(ALONE) for place in found if place.by == by}
        if by == "actuator":
            alike = {place: other for place, other in alike.items() if other.endswith(f" {kind}")}
        if all(_weight(place) <= max_others * _weight(best[by]) for place, other in alike.items() if other != own):
            alone = " and no other" if best[by].name.endswith(ALONE) else ""
            return [f"while {name}'s {kind}{alone} is in use" if by == "actuator" else f"while {best[by].name} is in use"]
        if by == "actuator" and {place.name for place in alike if not place.name.endswith(ALONE)} <= {place.name for place in telling}:
            return [f"while {kind}s are in use"]
    return []


def _weight(place: Place) -> float:
    """Weight of a place: large where it holds much of the structure in little of the data."""
    return place.share * float(np.log(max(place.ratio, 1e-9)))


def _describe_regimes(telling: Sequence[Place], found: Sequence[Place], unit: str, signals: Signals, max_chance: float) -> list[str]:
    """Regimes of motion in which the model misses more."""
    regimes = {place.name: place for place in found if place.by == "regime"}
    words = []
    if "at rest" in regimes and "moving" in regimes:
        rest, moving = (regimes["at rest"], "at rest"), (regimes["moving"], "in motion")
        (more, at), (less, other) = (rest, moving) if rest[0].rms > moving[0].rms else (moving, rest)
        if not more.rms > 1.5 * less.rms:
            words = ["at rest as much as in motion"]
        elif more.p <= max_chance:
            words = [f"more {at} ({quantity(more.rms, unit)}) than {other} ({quantity(less.rms, unit)})"]
    named = {"after a reversal": "after reversals", **{regime.name: regime.when for regime in signals.regimes}}
    return words + [f"more {when}" for name, when in named.items() if any(t.by == "regime" and t.name == name for t in telling)]
