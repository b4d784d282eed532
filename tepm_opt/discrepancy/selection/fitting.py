"""Hypotheses which effects act: fitted, judged on held-out data, kept in a file."""

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
from tepm_opt.discrepancy.problem.plant import Candidate, SearchablePlant, acting, freed
from tepm_opt.discrepancy.selection.cross_validation import Evidence, leave_out
from tepm_opt.discrepancy.selection.linearised import MEMORY, Linearised, linearised
from tepm_opt.discrepancy.selection.screening import Score, screen
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.identify import OUT_OF_REACH, ParameterEstimate, Problem, identify
from tepm_opt.solvers.parallel import in_parallel
from tepm_opt.solvers.plant import Free, PredictionError
from tepm_opt.solvers.text import listed, shortened

LOST = 2.0  # how many times the squares of a rival a fit must be sure to leave to be ended early
SURE = 3.0  # standard deviations from which a refinement counts as a parameter more
SPAN = 2  # parameters that the runs are worth in which alone an effect acts: the first and the last
Effects = tuple[Candidate, ...]


@dataclass(frozen=True)
class SearchSettings:
    """Thresholds of the search: when structure counts and when an effect is believed.

    Squares are means over the measured coordinates; the excess is what they have beyond the noise's, over the noise's (1: as much
    structure as noise).

    Attributes:
        max_noise_excess: excess that counts as noise: 0.05 is 22 % of the noise's standard deviation.
        min_excess_removed: excess that an effect must take away alone to be named: 0.15 is 39 % of the noise's standard deviation.
        min_probability: by which one more effect must beat going without it to be tried along, 0 … 1.
        even_odds_ratio: how many times the excess left the part that only this effect takes away must be for even odds that it is
            a cause, not a stand-in for something outside the library.
        even_odds_exact: the same where the forms of all effects that act are known exactly.
        even_odds_noise: the same where no more is left than counts as noise.
        fits_first_round, fits_later_rounds: most candidates fitted in the first round and in each that follows.
        max_effects: most effects at once.
        max_unexplained_ratio: part of the motion's standard deviation that may be left unexplained; where more is, nothing is named.
        max_iterations: most Gauss-Newton steps of a fit; what the answer rests on takes as many again where it needs them.
        tolerance: part of the structure left for which a fit makes no further step.
        min_share_closed: part of the excess left on held-out data that one more effect must take away to be tried along.
        least_share: how many times the excess left an effect must take away alone to stay in the model.
        beam: how many sets of effects are followed at the same time.
        starts: from how many of its probes an effect is fitted, where several promise much.
    """

    max_noise_excess: float = 0.05
    min_excess_removed: float = 0.15
    min_probability: float = 0.95
    even_odds_ratio: float = 3.0
    even_odds_exact: float = 200.0
    even_odds_noise: float = 1.0
    fits_first_round: int = 5
    fits_later_rounds: int = 3
    max_effects: int = 6
    max_unexplained_ratio: float = 0.1
    max_iterations: int = 7
    tolerance: float = 5e-3
    min_share_closed: float = 0.2
    least_share: float = 1.0
    beam: int = 1
    starts: int = 1

    @staticmethod
    def of(plant: SearchablePlant) -> SearchSettings:
        """The usual ones; a plant that is quick bears a wider search, and its forms are said to be exact by whoever wrote them."""
        if not plant.quick:
            return SearchSettings()
        found = SearchSettings(max_effects=3, min_share_closed=0.3, max_unexplained_ratio=0.2, even_odds_exact=10.0)
        return replace(found, max_iterations=30, tolerance=1e-4, beam=2, starts=2)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Effects with their fit and how well it predicts held-out data."""

    effects: Effects
    estimate: ParameterEstimate
    evidence: Evidence

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Hypothesis({shortened(labels(self), 60)}, excess {self.excess:.3g})"

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
        """Excess that the noise of so few samples may have by chance (3 sigma)."""
        return float(3 * np.sqrt(2 / max(self.estimate.count, 1)))

    @property
    def form_error(self) -> np.ndarray:
        """Standard deviation of the free parameters that comes from structure left, (parameters,): scatter over left-out runs."""
        return np.sqrt(self.excess / (1 + self.excess)) * self.evidence.scatter


def labels(hypothesis: Hypothesis) -> str:
    """Its effects, in short."""
    return listed([effect.told for effect in hypothesis.effects], 3) or "no effect"


@dataclass(eq=False)
class Fits:
    """Fits of one data set, each done once; kept in a file, so that an interrupted search goes on where it was.

    Attributes:
        problem: with the known parameters free; its model has all candidates at their null values.
        settings: iterations.
        store: a file, or None.
        key: what the file must have been made from.
        progress: told of every fit.
        seen: effects that gauges have shown already, and `values` of their parameters by full name to fit from.
    """

    problem: Problem
    settings: SearchSettings
    store: Path | None = None
    key: str = ""
    progress: Progress = silent
    seen: Effects = ()
    values: Mapping[str, float] = field(default_factory=dict)
    done: dict[Effects, Hypothesis] = field(default_factory=dict)
    screened: dict[Effects, list[Score]] = field(default_factory=dict)
    linearised: dict[Effects, Linearised] = field(default_factory=dict)
    _kept: dict[str, Any] = field(default_factory=dict)
    _gone_on: set[Effects] = field(default_factory=set)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Fits({len(self.done)} fits of {self.problem})"

    def __post_init__(self) -> None:
        """Read what an earlier search left."""
        if self.store is not None and self.store.exists():
            try:
                content = json.loads(self.store.read_text(encoding="utf-8"))
            except (OSError, ValueError):
                return
            if isinstance(content, dict) and content.get("key") == self.key:
                self._kept = content

    def fit(self, effects: Effects, start: dict[str, float]) -> Hypothesis | None:
        """The hypothesis that these effects act, fitted from these values by full name; None where the model cannot do the runs."""
        return self.fit_all([(effects, start)])[0]

    def fit_all(
        self, asked: Sequence[tuple[Effects, dict[str, float]]], rival: Hypothesis | None = None, bound: float = np.inf
    ) -> list[Hypothesis | None]:
        """Several hypotheses from their first values, at once on the machine's cores.

        Against a rival, or a bound of the squares, fits that cannot come near it any more end early; asked for without, they go on from
        there.
        """
        wanted = [(tuple(sorted(effects, key=lambda c: c.told)), start) for effects, start in asked]
        missing: dict[Effects, list[dict[str, float]]] = {}
        for effects, start in wanted:
            if not self._has(effects, rival is not None or np.isfinite(bound)):
                missing.setdefault(effects, []).append(start)
        for effects in missing:
            self.progress(_stage(effects), 0, 0)
        reached = bound if rival is None else min(bound, LOST * max(rival.estimate.cost, rival.estimate.count))
        found = in_parallel(lambda item: self._fitted(*item, reached), list(missing.items()), threads=self._at_once(missing))
        self.done |= {effects: hypothesis for effects, hypothesis in zip(missing, found, strict=True) if hypothesis is not None}
        return [self.done.get(effects) for effects, _ in wanted]

    def known(self, effects: Effects) -> Hypothesis | None:
        """The fit that these effects have; None where they have none."""
        return self.done.get(tuple(sorted(effects, key=lambda c: c.told)))

    def anew(self, effects: Effects, start: dict[str, float]) -> Hypothesis | None:
        """The better of the fit that these effects have, if there is one, and of another one from these first values."""
        effects, before = tuple(sorted(effects, key=lambda c: c.told)), self.known(effects)
        if before is None:
            return self.fit(effects, start)
        found = self._fitted(effects, [start], np.inf, "anew")
        if found is not None and found.estimate.cost < before.estimate.cost:
            self.done[effects] = found
        return self.done[effects]

    def finished(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis with its fit gone on to the end, if it ended early or for want of steps."""
        found = self.fit(hypothesis.effects, hypothesis.estimate.named) or hypothesis
        if found.estimate.solved or found.effects in self._gone_on or self.problem.plant.quick:
            return found
        self._gone_on.add(found.effects)
        self.done[found.effects] = self._fitted(found.effects, [], np.inf, "more") or found
        return self.done[found.effects]

    def _has(self, effects: Effects, early: bool) -> bool:
        return effects in self.done and (early or not self.done[effects].estimate.out_of_reach)

    def _at_once(self, hypotheses: Iterable[Effects]) -> bool:
        """Whether fits may run at the same time: in C, and with derivatives that take little memory."""
        problem = self.problem
        most = len(problem.free) + max((sum(len(c.parameters) for c in effects) for effects in hypotheses), default=0)
        return problem.plant.concurrent and 8 * most * sum(run.points.size for run in problem.runs) < MEMORY

    def _fitted(self, effects: Effects, starts: Sequence[dict[str, float]], reached: float, stage: str = "fit") -> Hypothesis | None:
        """The best fit from some first values, or from where an earlier one ended; an earlier search's fit as it was."""
        label = " ".join(c.told for c in effects)
        early = np.isfinite(reached) and f"early {label}" in self._kept
        kept = self._kept.get(f"early {label}" if early else f"{stage} {label}")
        begun = [self.done[effects].estimate.named] if effects in self.done and stage != "anew" else starts
        free = freed(self.problem.free, self.problem.plant, effects)
        problem = replace(self.problem, plant=acting(self.problem.plant, effects))
        steps, fits = 0 if kept else self.settings.max_iterations, []

        def tell(stage: str, done: float, of: float) -> None:
            self.progress(_stage(effects), done, of)

        for start in [kept] if kept else begun:
            begin = tuple(_starting(f, start.get(f.name, f.start)) for f in free)
            with suppress(PredictionError):
                fits.append(identify(replace(problem, free=begin), steps, tell, tolerance=self.settings.tolerance, reached=reached))
        self.progress(_stage(effects), self.settings.max_iterations, self.settings.max_iterations)
        if not fits:
            return None
        found = min(fits, key=lambda fit: fit.cost)
        if early:
            found = replace(found, outcome=Outcome(Ending.NOT_CONVERGED, OUT_OF_REACH))
        try:
            evidence = leave_out(found, {name for c in effects if c.runs for name in c.parameters})
        except PredictionError:
            return None
        evidence = replace(evidence, parameters=_sure(found, evidence) + SPAN * sum(bool(c.runs) for c in effects))
        self._keep(f"early {label}" if found.out_of_reach else f"{stage} {label}", found.named)
        return Hypothesis(effects, replace(found, residuals=[residual.bare for residual in found.residuals]), evidence)

    def linear(self, hypothesis: Hypothesis, missing: Sequence[Candidate]) -> Linearised:
        """A hypothesis to first order in the effects that it does not have; of a quick plant in those that are smooth."""
        effects = hypothesis.effects
        if effects not in self.linearised:
            others = [c for c in missing if may(c, effects) and (c.smooth or not self.problem.plant.quick)]
            beside = f" beside {', '.join(c.told for c in effects)}" if effects else ""
            self.progress(f"screening {len(others)} effects{beside}", 0, 0)
            self.linearised[effects] = linearised(hypothesis.estimate, self.problem.free, effects, others)
        return self.linearised[effects]

    def screen(self, hypothesis: Hypothesis, missing: Sequence[Candidate]) -> list[Score]:
        """First-order gains of the effects a hypothesis does not have."""
        effects = hypothesis.effects
        if effects not in self.screened:
            bent = [c for c in missing if may(c, effects) and not c.smooth and self.problem.plant.quick]
            self.screened[effects] = screen(self.linear(hypothesis, missing), bent)
        return self.screened[effects]

    def _keep(self, name: str, value: Any) -> None:
        with self._lock:
            if self.store is not None and name not in self._kept:
                self._kept[name] = value
                write_atomically(self.store, json.dumps({**self._kept, "key": self.key}))


def _stage(effects: Effects) -> str:
    """What is being fitted; of its steps the most that it may take are told."""
    return f"fitting {', '.join(c.told for c in effects) or 'the known parameters'}"


def _sure(estimate: ParameterEstimate, evidence: Evidence) -> int:
    """How many parameters a fit has but for refinements that may as well not be there: without those it is a plainer one."""
    doubt = np.hypot(estimate.std, evidence.scatter)
    free = zip(estimate.problem.free, estimate.values, doubt, strict=True)
    return sum(not f.refines or abs(value - f.prior_mean) > SURE * std for f, value, std in free)


def _starting(free: Free, value: float) -> Free:
    return replace(free, start=float(np.clip(value, free.low, free.high)))


def may(candidate: Candidate, others: Sequence[Candidate]) -> bool:
    """Whether a candidate may stand beside others: no other form of one of them, and with what it needs."""
    forms = {other.form_of for other in others}
    return candidate.form_of not in forms and (not candidate.beside or any(other.name in candidate.beside for other in others))
