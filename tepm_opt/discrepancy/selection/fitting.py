"""Fit hypotheses (sets of effects that act), cross-validate them and keep the fits in a file."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.files import write_atomically
from tepm_opt.discrepancy.problem.plant import Candidate, collect_free_parameters, restrict_effects_to_runs
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.problem.time_limit import TimeLimit
from tepm_opt.discrepancy.selection.cross_validation import Evidence, leave_out
from tepm_opt.discrepancy.selection.linearised import Linearised, linearise
from tepm_opt.discrepancy.selection.screening import Score, screen
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.identification.identify import OUT_OF_REACH, ParameterEstimate, Problem, compute_cost, identify
from tepm_opt.solvers.mechanics.plant import PredictionError
from tepm_opt.solvers.numerics.parallel import in_parallel
from tepm_opt.solvers.numerics.text import format_names, shorten

Effects = tuple[Candidate, ...]
FIRST_STEPS = (1.0, 0.5, 0.25, 0.125)
"""Parts of the step from the fit of some effects to first values for more of them."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A set of effects with its fit and the evidence of left-out data."""

    effects: Effects
    estimate: ParameterEstimate
    evidence: Evidence

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Hypothesis({shorten(labels(self), 60)}, excess {self.excess:.3g})"

    @property
    def excess(self) -> float:
        """Mean square of held-out errors beyond the noise, over the noise's."""
        return self.evidence.excess

    @property
    def left(self) -> float:
        """Structure that is surely left: the smaller of the excess on held-out data and on the data fitted to."""
        return min(self.excess, max(self.estimate.cost / max(self.estimate.count, 1) - 1, 0.0))

    def only_noise(self, settings: SearchSettings) -> bool:
        """Whether no more is left than counts as noise, or than chance may make it."""
        return self.left <= max(settings.max_noise_excess, self.by_chance)

    @property
    def by_chance(self) -> float:
        """Excess that the noise of so few samples may have by chance (3 sigma); 0 where the excess is beyond chance already."""
        if self.evidence.chance:
            return 0.0
        return float(3 * np.sqrt(2 / max(self.estimate.count, 1)))

    @property
    def form_error(self) -> np.ndarray:
        """Standard deviation of the free parameters that comes from structure left, (parameters,): scatter over left-out runs."""
        return np.sqrt(self.excess / (1 + self.excess)) * self.evidence.scatter


def labels(hypothesis: Hypothesis) -> str:
    """Short text with the effects of a hypothesis."""
    return format_names([effect.full_label for effect in hypothesis.effects], 3) or "no effect"


@dataclass(eq=False)
class Fits:
    """Fits of one data set, each done once and kept in a file, so that an interrupted search can go on.

    Attributes:
        problem: with the known parameters free; its model has all candidates at their null values.
        settings: of the search.
        store: a file, or None.
        key: identifies the data and the model that the file must have been made from.
        progress: told of every fit.
        gauge_effects: effects that gauges have shown already, and `values` of their parameters by full name to fit from.
        limit: after which no further set of effects is fitted, but those that gauges have shown.
    """

    problem: Problem
    settings: SearchSettings
    store: Path | None = None
    key: str = ""
    progress: Progress = silent
    gauge_effects: Effects = ()
    values: Mapping[str, float] = field(default_factory=dict)
    done: dict[Effects, Hypothesis] = field(default_factory=dict)
    limit: TimeLimit = field(default_factory=TimeLimit)
    screened: dict[Effects, list[Score]] = field(default_factory=dict)
    linearised: dict[Effects, Linearised] = field(default_factory=dict)
    _kept: dict[str, Any] = field(default_factory=dict)
    _resumed: set[Effects] = field(default_factory=set)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Fits({len(self.done)} fits of {self.problem})"

    def __post_init__(self) -> None:
        """Read the fits that an earlier search kept."""
        if self.store is not None and self.store.exists():
            try:
                content = json.loads(self.store.read_text(encoding="utf-8"))
            except (OSError, ValueError):
                return
            if isinstance(content, dict) and content.get("key") == self.key:
                self._kept = content

    def fit(self, effects: Effects, start: dict[str, float]) -> Hypothesis | None:
        """Fit the hypothesis that these effects act, from values by full name; None where the model cannot do the runs."""
        return self.fit_all([(effects, start)])[0]

    def fit_all(
        self, asked: Sequence[tuple[Effects, dict[str, float]]], rival: Hypothesis | None = None, bound: float = np.inf
    ) -> list[Hypothesis | None]:
        """Fit several hypotheses from their first values, in parallel.

        With a rival, or a bound of the squares, fits that cannot come near it any more end early. Asked for without, they go on from there.
        """
        wanted = [(_sort(effects), start) for effects, start in asked]
        missing: dict[Effects, list[dict[str, float]]] = {}
        for effects, start in wanted:
            if not self._has(effects, rival is not None or np.isfinite(bound)) and start not in missing.setdefault(effects, []):
                missing[effects].append(start)
        for effects in missing:
            self.progress(_describe_fit(effects), 0, 0)
        if rival is not None:
            bound = min(bound, self.settings.early_end_ratio * max(rival.estimate.cost, rival.estimate.count))
        found = in_parallel(lambda item: self._fit_best(*item, bound), list(missing.items()), threads=self._allow_threads(missing))
        self.done |= {effects: hypothesis for effects, hypothesis in zip(missing, found, strict=True) if hypothesis is not None}
        return [self.done.get(effects) for effects, _ in wanted]

    def find(self, effects: Effects) -> Hypothesis | None:
        """The fit of these effects, if it has been done."""
        return self.done.get(_sort(effects))

    def refit(self, effects: Effects, start: dict[str, float], stage: str = "anew") -> Hypothesis | None:
        """The better of the fit of these effects, if it has been done, and another one from these first values, kept by its stage."""
        effects, before = _sort(effects), self.find(effects)
        if before is None:
            return self.fit(effects, start)
        found = self._fit_best(effects, [start], np.inf, stage)
        if found is not None and found.estimate.cost < before.estimate.cost:
            self.done[effects] = found
        return self.done[effects]

    def complete(self, hypothesis: Hypothesis) -> Hypothesis:
        """Continue the fit of a hypothesis, if it ended early or for want of steps."""
        found = self.fit(hypothesis.effects, hypothesis.estimate.named) or hypothesis
        if found.estimate.solved or found.effects in self._resumed or not self.settings.resume_fits:
            return found
        self._resumed.add(found.effects)
        self.done[found.effects] = self._fit_best(found.effects, [], np.inf, "more") or found
        return self.done[found.effects]

    def _has(self, effects: Effects, early: bool) -> bool:
        return effects in self.done and (early or not self.done[effects].estimate.out_of_reach)

    def _allow_threads(self, hypotheses: Iterable[Effects]) -> bool:
        """Whether fits may run at the same time: in C, and with derivatives that take little memory."""
        problem = self.problem
        most = len(problem.free) + max((sum(len(c.parameters) for c in effects) for effects in hypotheses), default=0)
        return problem.plant.concurrent and 8 * most * sum(run.points.size for run in problem.runs) < self.settings.max_derivative_bytes

    def _fit_best(self, effects: Effects, starts: Sequence[dict[str, float]], bound: float, stage: str = "fit") -> Hypothesis | None:
        """The best fit from some first values, or from where an earlier one ended; an earlier search's fit as it was kept."""
        settings, label = self.settings, " ".join(c.full_label for c in effects)
        early = np.isfinite(bound) and f"early {label}" in self._kept
        kept = self._kept.get(f"early {label}" if early else f"{stage} {label}")
        begun = [self.done[effects].estimate.named] if effects in self.done and stage in ("fit", "more") else _vary_shapes(effects, starts)
        free = collect_free_parameters(self.problem.free, self.problem.plant, effects)
        problem = replace(self.problem, plant=restrict_effects_to_runs(self.problem.plant, effects))
        steps, fits = 0 if kept else settings.max_iterations, []

        def tell(stage: str, done: float, of: float) -> None:
            self.progress(_describe_fit(effects), done, of)
            if set(effects) - set(self.gauge_effects):
                self.limit.check(effects)

        for start in [kept] if kept else begun:
            begin = replace(problem, free=tuple(replace(f, start=float(np.clip(start.get(f.name, f.start), f.low, f.high))) for f in free))
            with suppress(PredictionError):
                tell(stage, 0, settings.max_iterations)
                if not kept and problem.derivatives_apart:  # one without derivatives costs little
                    begin = self._shorten_first_step(begin, effects)
                fits.append(identify(begin, steps, tell, tolerance=settings.tolerance, reached=bound))
        self.progress(_describe_fit(effects), settings.max_iterations, settings.max_iterations)
        if not fits:
            return None
        found = min(fits, key=lambda fit: fit.cost)
        if early:
            found = replace(found, outcome=Outcome(Ending.NOT_CONVERGED, OUT_OF_REACH))
        try:
            evidence = leave_out(found, settings, {name for c in effects if c.runs for name in c.parameters})
        except PredictionError:
            return None
        evidence = replace(evidence, parameters=self._count_parameters(found, evidence, effects))
        self._keep(f"early {label}" if found.out_of_reach else f"{stage} {label}", found.named)
        return Hypothesis(effects, replace(found, residuals=[residual.bare for residual in found.residuals]), evidence)

    def _shorten_first_step(self, problem: Problem, effects: Effects) -> Problem:
        """The problem with first values so near those of the best fit of some of the effects that they leave less than it.

        A step from there that leaves more is halved (backtracking; Nocedal and Wright 2006, ch. 3). Shapes of effects that the other fit
        does not have are kept: there they change nothing.
        """
        nested = [h for h in self.done.values() if set(h.effects) < set(effects)]
        if not nested:
            return problem
        best = min(nested, key=lambda h: h.estimate.cost)
        new = [effect for effect in effects if effect not in best.effects]
        shapes = {name for effect in new for name in (*effect.shapes, effect.happens)}
        known = {name: value for effect in new for name, value in effect.null.items() if name not in shapes} | best.estimate.named
        start = problem.start
        base = np.array([known.get(f.name, f.start) for f in problem.free])
        for part in FIRST_STEPS:
            values = base + part * (start - base)
            with suppress(PredictionError):
                if compute_cost(problem, values) <= best.estimate.cost:
                    break
        else:
            return problem
        return replace(problem, free=tuple(replace(f, start=float(v)) for f, v in zip(problem.free, values, strict=True)))

    def linear(self, hypothesis: Hypothesis, missing: Sequence[Candidate]) -> Linearised:
        """The linearised fit of a hypothesis in the effects that it does not have; smooth ones only where others are screened by fits."""
        effects = hypothesis.effects
        if effects not in self.linearised:
            others = [c for c in missing if may_act_beside(c, effects) and (c.smooth or not self.settings.screen_by_fits)]
            work = _describe_screening(len(others), effects)
            others = others if not others or self.limit.allows(work) else []
            self.progress(work, 0, 0)
            self.linearised[effects] = linearise(hypothesis.estimate, self.problem.free, effects, others, self.settings)
        return self.linearised[effects]

    def linearise_in(self, hypothesis: Hypothesis, some: Sequence[Candidate]) -> Linearised:
        """The linearised fit of a hypothesis in a few effects, unless it has been linearised in all."""
        effects = hypothesis.effects
        able = dict.fromkeys(c for c in some if not c.runs and may_act_beside(c, effects))
        return self.linearised.get(effects) or linearise(hypothesis.estimate, self.problem.free, effects, list(able), self.settings)

    def screen(self, hypothesis: Hypothesis, missing: Sequence[Candidate]) -> list[Score]:
        """First-order gains of the effects a hypothesis does not have."""
        effects = hypothesis.effects
        if effects not in self.screened:
            nonsmooth = [c for c in missing if may_act_beside(c, effects) and not c.smooth and self.settings.screen_by_fits]
            nonsmooth = nonsmooth if not nonsmooth or self.limit.allows(_describe_screening(len(nonsmooth), effects)) else []
            self.screened[effects] = screen(self.linear(hypothesis, missing), self.settings, nonsmooth)
        return self.screened[effects]

    def _count_parameters(self, estimate: ParameterEstimate, evidence: Evidence, effects: Effects) -> int:
        """Parameters that a fit is charged for: all but insignificant refinements, and those of the choice of runs."""
        std = np.hypot(estimate.std, evidence.scatter)
        free = zip(estimate.problem.free, estimate.values, std, strict=True)
        sure = sum(not f.refines or abs(value - f.prior_mean) > self.settings.min_refinement_sigma * own for f, value, own in free)
        return sure + self.settings.run_choice_parameters * sum(bool(c.runs) for c in effects)

    def _keep(self, name: str, value: Any) -> None:
        with self._lock:
            if self.store is not None and name not in self._kept:
                self._kept[name] = value
                write_atomically(self.store, json.dumps({**self._kept, "key": self.key}))


def _sort(effects: Effects) -> Effects:
    return tuple(sorted(effects, key=lambda c: c.full_label))


def _vary_shapes(effects: Effects, starts: Sequence[dict[str, float]]) -> list[dict[str, float]]:
    """First values, and these with further shapes of effects, as long as no fit has changed what these would change."""

    def is_new(start: dict[str, float], effect: Candidate, shape: Mapping[str, float]) -> bool:
        changed = [name for name, value in shape.items() if value != effect.null[name]]
        return all(np.isclose(start.get(name, np.nan), effect.null[name], rtol=1e-3) for name in changed)

    further = [start | {**shape} for start in starts for c in effects for shape in c.further_shapes if is_new(start, c, shape)]
    return [*starts, *further]


def _describe_fit(effects: Effects) -> str:
    """Text of a fit for progress reports."""
    return f"fitting {', '.join(c.full_label for c in effects) or 'the known parameters'}"


def _describe_screening(count: int, effects: Effects) -> str:
    """Text of a screening for progress reports."""
    beside = f" beside {', '.join(c.full_label for c in effects)}" if effects else ""
    return f"screening {count} effects{beside}"


def may_act_beside(candidate: Candidate, others: Sequence[Candidate]) -> bool:
    """Whether a candidate may act beside others: none of them is another form of it, and one it needs is among them."""
    forms = {other.form_of for other in others}
    return candidate.form_of not in forms and (not candidate.beside or any(other.name in candidate.beside for other in others))
