"""Constancy of effects: a cause has the same size in every segment of the data, a stand-in has not."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.data.run import Run, RunSet
from tepm_opt.discrepancy.assessment.settings import DEFAULT, AssessmentSettings
from tepm_opt.discrepancy.problem.plant import Candidate, restrict_effects_to_runs, without_run_restriction
from tepm_opt.discrepancy.selection.linearised import Cell, Linearised
from tepm_opt.solvers.identification.identify import ParameterEstimate
from tepm_opt.solvers.identification.residuals import independent_after
from tepm_opt.solvers.mechanics.plant import Plant, PredictionError


@dataclass(frozen=True)
class SegmentSizes:
    """Sizes of an effect in segments of the data over that in all of them.

    Attributes:
        parts: "single_pressure.csv", 0 or 1 (the first and the second half of the runs), True or False (inputs that rise or fall).
        ratio, std: of each part.
        spread: standard deviation of the true ratios, see `estimate_spread`.
    """

    parts: tuple[Hashable, ...]
    ratio: np.ndarray
    std: np.ndarray
    spread: float


def effect_size_by_segment(linear: Linearised, effect: Candidate, settings: AssessmentSettings = DEFAULT) -> dict[str, SegmentSizes]:
    """Sizes of an effect of a fit by run, by half of the runs and by direction of the inputs, one Gauss-Newton step from the fit.

    Everything else that is fitted goes along, alike in all segments; what is at a bound stays. Only segments that show the effect count.
    """
    partitions: dict[str, Callable[[Cell], Hashable]] = {
        "run": lambda cell: cell.run,
        "half": lambda cell: cell.half,
        "direction": lambda cell: cell.rising,
    }
    memory = _memory(linear)
    found = {name: _size_by(key, linear, effect, memory, settings.visible_excess) for name, key in partitions.items()}
    return {name: sizes for name, sizes in found.items() if sizes is not None}


def constancy_probability(found: Mapping[str, SegmentSizes], settings: AssessmentSettings = DEFAULT) -> float:
    """Probability that an effect with these sizes is one cause, not a stand-in."""
    most = max((each.spread for each in found.values()), default=0.0)
    return 1 / (1 + (most / settings.spread_even_odds) ** 2)


def _size_by(key: Callable[[Cell], Hashable], linear: Linearised, effect: Candidate, memory: float, visible: float) -> SegmentSizes | None:
    """Sizes of an effect in segments of the data; None where fewer than two show it.

    Args:
        key: the segment that a cell belongs to.
        linear: the fit, with the effect.
        effect: to be sized.
        memory: samples after which residuals forget.
        visible: mean square over the noise's by which the effect must change a segment.
    """
    estimate = linear.estimate
    free = zip(estimate.problem.free, estimate.at_bound, strict=True)
    at = [linear.columns[f.name] for f, bound in free if f.name not in effect.null and not bound]
    own = [linear.columns[name] for name in effect.parameters]
    size = np.array([estimate.named[name] - effect.null[name] for name in effect.parameters])
    active = linear.acts(effect)
    groups = [key(cell) for cell in linear.cells]
    parts = list(dict.fromkeys(group for group, acts in zip(groups, active, strict=True) if acts))
    n = len(at)
    square, slope = np.zeros((n + len(parts), n + len(parts))), np.zeros(n + len(parts))
    cost, count = np.zeros(len(parts)), np.zeros(len(parts))
    for k in np.flatnonzero(active):
        g = parts.index(groups[k])
        whole, pull = linear.square[k], linear.slope[k]
        square[:n, :n] += whole[np.ix_(at, at)]
        slope[:n] += pull[at]
        square[:n, n + g] += whole[np.ix_(at, own)] @ size
        square[n + g, n + g] += size @ whole[np.ix_(own, own)] @ size
        slope[n + g] += pull[own] @ size
        cost[g] += linear.cost[k]
        count[g] += linear.count[k]
    square[n:, :n] = square[:n, n:].T
    seen = np.diag(square)[n:] > visible * np.maximum(count, 1)
    if seen.sum() < 2:
        return None
    kept = np.append(np.ones(n, dtype=bool), seen)
    scale = np.sqrt(np.maximum(np.diag(square)[kept], 1e-30))
    inverse = np.linalg.inv(square[np.ix_(kept, kept)] / np.outer(scale, scale) + 1e-9 * np.eye(int(kept.sum()))) / np.outer(scale, scale)
    left = cost[seen] / np.maximum(count[seen], 1)
    ratio = 1 - (inverse @ slope[kept])[n:]
    structure = 1 + (memory - 1) * np.clip(left - 1, 0, 1)  # noise is forgotten at once
    std = np.sqrt(np.diag(inverse)[n:] * np.maximum(left, 1) * structure)
    return SegmentSizes(tuple(part for part, keep in zip(parts, seen, strict=True) if keep), ratio, std, estimate_spread(ratio, std))


def extend_to_validation_runs(plant: Plant, effects: Iterable[Candidate], dataset: RunSet) -> Plant:
    """A plant whose effects that act in the last run fitted to act in the validation runs, too.

    Args:
        plant: with the effects.
        effects: that act in it, with the runs in which they do.
        dataset: all runs.
    """
    last, later = dataset.fit[-1].file, tuple(run.file for run in dataset.validation)
    extended = [replace(e, runs=(*e.runs, *later)) if last in e.runs else e for e in effects]
    return restrict_effects_to_runs(without_run_restriction(plant), extended)


def active_runs(
    effect: Candidate, best: ParameterEstimate, dataset: RunSet, noise: float | np.ndarray, settings: AssessmentSettings = DEFAULT
) -> tuple[str, ...]:
    """Files of the runs in which an effect acts, in those kept for validation, too; none where it acts in all that show it.

    In a run kept for validation it acts where it fits better in at least half the size that it has in the runs fitted to, everything
    else as it was there.

    Args:
        effect: of the fit.
        best: the fit.
        dataset: all runs.
        noise: of what is measured, 1 sigma per axis.
        settings: when a run shows an effect.
    """
    problem = replace(best.problem, plant=without_run_restriction(best.plant), runs=dataset.validation, noise=noise).sparse
    files = [run.file for run in dataset.fit if not effect.runs or run.file in effect.runs]
    idle = len(dataset.fit) - len(files)
    if problem.runs and problem.plant.states:
        return tuple(files) if idle else ()
    try:
        residuals = problem.residuals(best.values, effect.parameters) if problem.runs else []
    except PredictionError:
        residuals = []
    weight = np.array([best.named[name] - effect.null[name] for name in effect.parameters])
    for r in residuals:
        change, left = r.by @ weight, r.values.ravel()
        seen = float(change @ change)
        size = 1 - float(change @ left) / seen if seen > settings.visible_excess * max(r.count, 1) else 1.0
        if size >= 0.5:
            files.append(r.file)
        else:
            idle += 1
    return tuple(files) if idle else ()


def estimate_spread(ratio: np.ndarray, std: np.ndarray) -> float:
    """Standard deviation of true ratios, without chance (DerSimonian and Laird, Controlled Clinical Trials 7, 1986).

    Args:
        ratio: as measured.
        std: standard deviation of each.
    """
    weight = 1 / np.maximum(std, 1e-6) ** 2
    mean = float(np.sum(weight * ratio) / np.sum(weight))
    excess = float(np.sum(weight * (ratio - mean) ** 2)) - (len(ratio) - 1)
    scale = float(np.sum(weight) - np.sum(weight**2) / np.sum(weight))
    return float(np.sqrt(max(excess, 0.0) / max(scale, 1e-30)))


def _memory(linear: Linearised) -> float:
    """Samples after which the residuals forget."""
    runs: Sequence[Run] = linear.estimate.problem.runs
    if linear.estimate.problem.plant.static:
        return 1.0
    step = float(np.median([np.median(np.diff(run.time)) for run in runs if run.rows > 1]))
    return max(independent_after(linear.estimate.residuals, runs) / step, 1.0)
