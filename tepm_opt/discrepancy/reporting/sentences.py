"""Verdict in words: answer, notes, and reasons against rivals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from tepm_opt.data.metrics import axes_measured, error_over_time
from tepm_opt.data.run import Run, RunSet
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.assessment.residual_locations import error_unit
from tepm_opt.discrepancy.assessment.result import Errors, Named, Value, VerdictStatus, reduces_validation_error
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.reporting.effect_table import describe_sizes, with_unit
from tepm_opt.discrepancy.selection.alternatives import coincidence
from tepm_opt.discrepancy.selection.fitting import Hypothesis
from tepm_opt.discrepancy.selection.forward_backward import Explanation
from tepm_opt.discrepancy.selection.screening import Score
from tepm_opt.solvers.identification.identify import ParameterEstimate
from tepm_opt.solvers.identification.uncertainty import unidentifiable
from tepm_opt.solvers.numerics.text import format_quantity, percent

ONE_CLOCK = "put inputs and positions on one clock"


def next_step(status: VerdictStatus, is_shifted: bool = False) -> str:
    """Next step in words.

    Args:
        status: kind of answer.
        is_shifted: whether the clocks of inputs and positions differ.
    """
    steps = {
        VerdictStatus.NAMED: "see the corrected model beside a run",
        VerdictStatus.NO_DISCREPANCY: "see the recalibrated model beside a run",
        VerdictStatus.PARTIAL: "seek what else is missing",
        VerdictStatus.INDISTINGUISHABLE: "record a run in which they would differ",
        VerdictStatus.SETUP_ERROR: "mend the set-up or the data",
        VerdictStatus.UNEXPLAINED: "see what acts on the machine there and then, or give the library an effect that does",
    }
    return ONE_CLOCK if is_shifted else steps[status]


def describe_answer(
    status: VerdictStatus, named: Sequence[Named], errors: Errors, where: str, known: Mapping[str, Value], explanation: Explanation,
    unit: str,
) -> tuple[str, ...]:  # fmt: skip
    """Sentences of the answer: missing effects, fall of the errors, places where the model misses.

    Args:
        status: kind of answer.
        named: effects that the answer names, with their parameters.
        errors: of the models on validation runs.
        where: the model misses, in a sentence.
        known: recalibrated parameters by full name.
        explanation: result of the search.
        unit: of the errors.
    """
    nominal, recalibrated, corrected, bound, floor = (
        format_quantity(error, unit)
        for error in (errors.nominal, errors.recalibrated, errors.corrected, errors.black_box, errors.noise_floor)
    )
    falls = f"On validation runs the error falls from {nominal} (nominal) over {recalibrated} (recalibrated) to {corrected}"
    if status is VerdictStatus.NO_DISCREPANCY:
        changes = _describe_changes(known)
        return (
            f"Nothing is missing: with the known parameters recalibrated within their priors ({changes}) only noise is left.",
            f"On validation runs the error falls from {nominal} to {recalibrated} (noise {floor}).",
        )
    if status in (VerdictStatus.NAMED, VerdictStatus.PARTIAL):
        head = "Missing" if status is VerdictStatus.NAMED else "Partly explained"
        return (
            f"{head}: {_describe_effects(named)}.",
            f"{falls} (corrected; noise {floor}): {percent(errors.gap_closed_fraction)} of the gap is closed.",
            where,
        )
    if status is VerdictStatus.INDISTINGUISHABLE:
        return (
            f"{_describe_groups(named, explanation)}.",
            f"{falls} with the most probable in the model (noise {floor}).",
            where,
        )
    alone = [h for h in explanation.tried if len(h.effects) == 1]
    best = max([h for h in alone if not h.estimate.out_of_reach] or alone, key=explanation.closes, default=None)
    nearest = f"; {best.effects[0].label} alone would close {_percent(explanation.closes(best))}" if best else ""
    return (
        f"Unexplained: structure above the noise remains that no known effect explains{nearest}.",
        f"On validation runs the error is {nominal} (nominal) and {recalibrated} (recalibrated); "
        f"a black box without physics reaches {bound} (noise {floor}).",
        where,
    )


def collect_notes(
    dataset: RunSet, signals: Signals, explanation: Explanation, best: ParameterEstimate, noise: float | np.ndarray, errors: Errors
) -> tuple[str, ...]:
    """Sentences beside the answer: limits of the data, of identifiability and of priors.

    Args:
        dataset: the data.
        signals: names and unit of what is measured.
        explanation: result of the search.
        best: parameters of the best hypothesis.
        noise: of what is measured, 1 sigma per axis.
        errors: of the models on validation runs.
    """
    found = []
    if not any(np.isfinite(run.points).any() for run in dataset.validation):
        found.append("No run is kept for validation: errors are on the runs fitted to and flatter the model.")
    if len(dataset.fit) < 3:
        found.append("Fewer than three runs to fit to: held-out data are parts of runs, not whole ones.")
    silent = [name for k, name in enumerate(signals.points) if not any(np.isfinite(run.points[:, k]).any() for run in dataset.runs)]
    if silent:
        found.append(f"{', '.join(silent)}: not measured in any run.")
    alike = noise if np.ndim(noise) == 0 else 1.0
    unit = error_unit(signals, noise)
    found += describe_repeatability(dataset.runs, noise, unit) + describe_extrapolation(dataset, signals)
    if explanation.best.effects and dataset.validation and not reduces_validation_error(errors):
        found.append("On the runs kept for validation the gap does not shrink: what acts in the runs fitted to does not act there.")
    left, axes = explanation.best.excess, axes_measured(np.concatenate([run.points for run in dataset.fit]))
    if explanation.best.effects and left > 0.1 and not explanation.settings.chance_excess:
        found.append(
            f"Structure of {format_quantity(float(np.sqrt(axes * left) * alike), unit)} is left in the runs fitted to: "
            "the effect's form differs from the machine's, or something small is missing besides. It keeps probabilities below 1."
        )
    found += [f"{text}." for text in unidentifiable(best)]
    bound = [free.name for free, at in zip(best.problem.free, best.at_bound, strict=True) if at and not free.name.count(".")]
    if bound:
        found.append(f"At the limit of the prior: {', '.join(bound)}. The prior may be too narrow, or an effect takes its place.")
    narrowed = {name for effect in explanation.gauge_effects for name in effect.ranges}  # to what gauges show
    own = [free for free, at in zip(best.problem.free, best.at_bound, strict=True) if at and "." in free.name and not free.refines]
    own = [free for free in own if free.name not in narrowed]
    far = [free.name for free in own if abs(best.named[free.name] - free.high) < abs(best.named[free.name] - free.low)]
    if far:
        found.append(f"At the largest value that makes sense: {', '.join(far)}. The effect takes the place of something else.")
    return tuple(found)


def describe_extrapolation(dataset: RunSet, signals: Signals) -> list[str]:
    """Sentences on validation runs that leave the range of the runs fitted to by more than 20 %, so that the model extrapolates."""
    columns = [f"{point} {axis}".strip() for point in signals.points for axis in signals.axes]
    seen = np.concatenate([run.points.reshape(run.rows, -1) for run in dataset.fit])
    inputs = np.concatenate([run.inputs for run in dataset.fit])
    found = []
    for run in dataset.validation:
        reach = [
            *_relative_reach(run.points.reshape(run.rows, -1), seen, columns),
            *_relative_reach(run.inputs, inputs, list(signals.inputs)),
        ]
        name, times = max(reach, key=lambda pair: pair[1], default=("", 0.0))
        if times > 1.2:
            found.append(f"{run.file} leaves the range fitted to: {name} goes {times:.1f} times as far. There it extrapolates.")
    return found


def _relative_reach(values: np.ndarray, fitted: np.ndarray, names: Sequence[str]) -> list[tuple[str, float]]:
    """Largest distance of each column's values from the middle of the fitted range, over half the range."""
    found = []
    for name, column, others in zip(names, values.T, fitted.T, strict=True):
        here, there = column[np.isfinite(column)], others[np.isfinite(others)]
        half = float(np.ptp(there)) / 2 if there.size else 0.0
        if here.size and half > 0:
            found.append((name, float(np.abs(here - there.min() - half).max()) / half))
    return found


def describe_repeatability(runs: Sequence[Run], noise: float | np.ndarray, unit: str = "m") -> list[str]:
    """Repeatability of the machine, a sentence for each pair of runs from rest with the same inputs and tip forces."""
    found = []
    for one, other in combinations([run for run in runs if run.start == "equilibrium" and run.inputs.size], 2):
        same = one.inputs.shape == other.inputs.shape and np.array_equal(one.inputs, other.inputs)
        if same and np.array_equal(one.tip_force, other.tip_force):
            size = noise if np.ndim(noise) else 1.0
            differ = error_over_time(one.points / size, other.points / size) / np.sqrt(2)
            if not np.isfinite(differ):  # nothing that both of them measured
                continue
            alone = float(np.sqrt(axes_measured(one.points)) * (1.0 if np.ndim(noise) else noise))
            each, noise_alone = format_quantity(differ, unit), format_quantity(alone, unit)
            found.append(f"{one.file} and {other.file} repeat the same inputs: {each} each (noise alone: {noise_alone}).")
    return found


def rejection_reason(explanation: Explanation, effect: Candidate, hypothesis: Hypothesis) -> str:
    """Reason against a hypothesis with another effect in the place of `effect`."""
    closes, best = explanation.closes(hypothesis), explanation.closes(explanation.best)
    rest = explanation.best_without(effect) or explanation.without
    same = coincidence(rest, explanation.best, hypothesis)
    most = "at most " if hypothesis.estimate.out_of_reach else ""
    text = (
        f"in the place of {effect.label} it leaves {most}{_percent(1 - closes)} of the gap on held-out data, "
        f"{effect.label} {_percent(1 - best)}"
    )
    text += f"; their outputs nearly coincide in these runs (cosine {same:.3f})" if same > explanation.settings.min_coincidence else ""
    return text + _objections(explanation, hypothesis)


def single_effect_reason(explanation: Explanation, hypothesis: Hypothesis) -> str:
    """Reason against an effect that was fitted alone."""
    if not hypothesis.evidence.held_out:
        return "alone it closes too little to be fitted to the end"
    least = "at least " if hypothesis.estimate.out_of_reach else ""
    return f"alone it closes {least}{_percent(explanation.closes(hypothesis))} of the gap on held-out data" + _objections(
        explanation, hypothesis
    )


def _objections(explanation: Explanation, hypothesis: Hypothesis) -> str:
    """Objections to a hypothesis that closes at least 90 % of the gap: more causes, values it would need, its excess."""
    best, effects = explanation.best, hypothesis.effects
    if explanation.closes(hypothesis) < 0.9 or hypothesis is best or not best.effects:
        return ""  # where nothing is named, the remarks say why
    if hypothesis.estimate.out_of_reach:
        return "; its fit was ended early, as what it promised would still leave far more than the answer does"
    reasons = []
    if len(effects) > len(best.effects):
        reasons.append(
            f"it takes {len(effects)} causes in the place of {len(best.effects)}, "
            f"each {explanation.settings.one_cause_odds:g} times less probable beforehand"
        )
    if sum(bool(c.runs) for c in effects) > sum(bool(c.runs) for c in best.effects):
        reasons.append(f"it would act in some runs only, {explanation.settings.all_runs_odds:g} times less probable beforehand")
    reasons += _required_values(best, hypothesis)
    left, there = hypothesis.excess, best.excess
    if left > 1.2 * there:  # else it leaves as much
        reasons.append(f"what it leaves is {np.sqrt(left):.2g} times the noise, the answer {np.sqrt(there):.2g} times")
    elif hypothesis.evidence.parameters > best.evidence.parameters:
        more = hypothesis.evidence.parameters - best.evidence.parameters
        reasons.append(f"it needs {more} parameter{'s' if more > 1 else ''} more to leave as little")
    return "".join(f"; {reason}" for reason in reasons)


def _required_values(best: Hypothesis, hypothesis: Hypothesis) -> list[str]:
    """The first three values that a hypothesis would need at the ends of their ranges, or far from the answer's."""
    others, estimate = {name for effect in best.effects for name in effect.parameters}, hypothesis.estimate
    bound, apart, far = [], [], 0.25  # of the width of a range
    for free, value, at in zip(estimate.problem.free, estimate.values, estimate.at_bound, strict=True):
        there, width = best.estimate.named.get(free.name, free.start), free.high - free.low
        if free.refines or free.name in others:
            continue
        if at and abs(value - there) > far * min(width, abs(value)):
            bound.append(f"{free.name} at the end of its range ({with_unit(value, free.unit)})")
        elif "." not in free.name and abs(value - there) > far * width:
            apart.append(f"{free.name} {with_unit(value, free.unit)} instead of {with_unit(there, free.unit)}")
    found = [*bound, *apart][:3]
    return [f"it would need {', '.join(found)}"] if found else []


def not_fitted_reason(score: Score) -> str:
    """Reason why an effect was not fitted."""
    return f"to first order it could close {_percent(min(max(score.gain, 0.0) + 0.0, 1.0))} of the gap"


def _describe_effects(named: Sequence[Named]) -> str:
    """The effects, up to three of them with their sizes; the table of effects has all sizes."""
    few, texts = len(named) <= 3, {True: list[str](), False: list[str]()}
    for each in named:
        size = f"{', '.join(describe_sizes(each))}; probability " if few else ""
        runs = f"; only in {', '.join(each.runs)}" if each.runs else ""
        texts[each.probability >= 0.5].append(f"{each.candidate.label} ({size}{each.probability:.2f}{runs})")
    names = "; perhaps also ".join((" and " if few else ", ").join(part) for part in texts.values() if part)
    return names if few else f"{len(named)} effects, with their probabilities: {names}"


def _describe_groups(named: Sequence[Named], explanation: Explanation) -> str:
    """The sure effects, and those that these runs cannot tell apart; effects of the best hypothesis that are not named have no place."""
    told = {each.candidate: f"{each.candidate.label} (probability {each.probability:.2f})" for each in named}
    sure, unclear = [], []
    for effect, group in explanation.groups.items():
        sets = [[c for c in hypothesis.effects if c in told and c not in explanation.best.effects] for hypothesis, _ in group]
        others = [" with ".join(told[c] for c in others) for others in sets if others]
        if either := [*([told[effect]] if effect in told else ()), *dict.fromkeys(others)]:
            (unclear if others else sure).append(" or ".join(either))
    missing = f"Missing: {' and '.join(sure)}; besides, " if sure else "Missing: "
    return missing + "; ".join(f"{text}, which these runs cannot tell apart" for text in unclear)


def _describe_changes(known: Mapping[str, Value]) -> str:
    moved = [f"{name} {100 * (v.value / v.nominal - 1):+.1f} %" for name, v in known.items() if v.nominal]
    return ", ".join(moved) or "none is free"


def _percent(part: float) -> str:
    return f"{100 * part:.2g} %" if abs(part) < 0.995 else f"{100 * part:.1f} %"
