"""Which effects explain the data: screen, fit, judge on held-out data; forward until nothing improves, then backward."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.data.files import write_atomically
from tepm_opt.discrepancy.evidence import Evidence, leave_out, weights
from tepm_opt.discrepancy.plant import Candidate, SearchablePlant
from tepm_opt.discrepancy.screen import MEMORY, Score, screen, screen_pairs
from tepm_opt.outcome import Ending, Outcome
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.identify import OUT_OF_REACH, ParameterEstimate, Problem, identify
from tepm_opt.solvers.parallel import in_parallel
from tepm_opt.solvers.plant import Free, PredictionError
from tepm_opt.solvers.text import listed, shortened

# part of the squared output of the other effects that their forms may be wrong by (5 % of the size); an effect that takes away less
# beside them may only mend their forms
FORM_ERROR_RATIO = 0.0025
MIN_SHARE_CLOSED = 0.1  # part of the excess left on held-out data that one more effect must take away to be tried along
PAIRED = 10  # candidates, those that promise most alone, that are tried in pairs where none of them helps alone
LOST = 2.0  # how many times the squares of a rival a fit must be sure to leave to be ended early
PLAIN = 0.9  # part of a form's gain from which a plainer form of the same is fitted in its place
MIN_GAIN_RATIO = 0.25  # part of the best candidate's first-order gain below which others are not worth a fit
Effects = tuple[Candidate, ...]
Shares = dict[Candidate, float]


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
        fits_first_round, fits_later_rounds: most candidates fitted in the first round and in each that follows.
        max_effects: most effects at once.
        max_unexplained_ratio: part of the motion's standard deviation that may be left unexplained; where more is, nothing is named.
        max_iterations: most Gauss-Newton steps of a fit.
        tolerance: part of the structure left for which a fit makes no further step.
        beam: how many sets of effects are followed at the same time.
        starts: from how many of its probes an effect is fitted, where several promise much.
    """

    max_noise_excess: float = 0.05
    min_excess_removed: float = 0.15
    min_probability: float = 0.95
    even_odds_ratio: float = 3.0
    fits_first_round: int = 5
    fits_later_rounds: int = 3
    max_effects: int = 3
    max_unexplained_ratio: float = 0.1
    max_iterations: int = 10
    tolerance: float = 2e-3
    beam: int = 1
    starts: int = 1

    @staticmethod
    def of(plant: SearchablePlant) -> SearchSettings:
        """The usual ones; a plant that is quick bears a wider search."""
        return SearchSettings(max_iterations=30, tolerance=1e-4, beam=2, starts=2) if plant.quick else SearchSettings()


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Effects with their fit and how well it predicts held-out data."""

    effects: Effects
    estimate: ParameterEstimate
    evidence: Evidence

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Hypothesis({shortened(_labels(self), 60)}, excess {self.excess:.3g})"

    @property
    def excess(self) -> float:
        """Mean square of held-out errors beyond the noise, over the noise's."""
        return self.evidence.excess

    @property
    def left(self) -> float:
        """Structure that is surely left: the smaller of the excess on held-out data and on the data fitted to."""
        return min(self.excess, max(self.estimate.cost / max(self.estimate.count, 1) - 1, 0.0))

    @property
    def form_error(self) -> np.ndarray:
        """Standard deviation of the free parameters that comes from structure left, (parameters,): scatter over left-out runs."""
        return np.sqrt(self.excess / (1 + self.excess)) * self.evidence.scatter


def _labels(hypothesis: Hypothesis) -> str:
    return listed([effect.label for effect in hypothesis.effects], 3) or "no effect"


Groups = dict[Candidate, list[tuple[Hypothesis, float]]]


@dataclass(frozen=True, eq=False)
class Explanation:
    """What the search found.

    Attributes:
        without: the known parameters recalibrated, no effect added.
        best: effects that stand out, all fitted together with the parameters; none where nothing does.
        widest: the most that was tried along.
        tried: every hypothesis fitted, in order.
        scores: first-order gains of all candidates against `without`.
        shares: for each effect of `best`: how many times the structure left only this effect takes away.
        groups: for each effect of `best`: hypotheses that have another one in its place, `best` first, and their probabilities.
    """

    without: Hypothesis
    best: Hypothesis
    widest: Hypothesis
    tried: list[Hypothesis]
    scores: list[Score]
    shares: Shares
    groups: Groups

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Explanation({shortened(_labels(self.best), 60)}, closes {self.closes(self.best):.0%}, {len(self.tried)} fits)"

    def closes(self, hypothesis: Hypothesis) -> float:
        """Part of the structure left by recalibration that a hypothesis takes away."""
        return 1 - hypothesis.excess / max(self.without.excess, 1e-12)


@dataclass(eq=False)
class Fits:
    """Fits of one data set, each done once; kept in a file, so that an interrupted search goes on where it was.

    Attributes:
        problem: with the known parameters free; its model has all candidates at their null values.
        settings: iterations.
        store: a file, or None.
        key: what the file must have been made from.
        progress: told of every fit.
    """

    problem: Problem
    settings: SearchSettings
    store: Path | None = None
    key: str = ""
    progress: Progress = silent
    done: dict[Effects, Hypothesis] = field(default_factory=dict)
    screened: dict[Effects, list[Score]] = field(default_factory=dict)
    _kept: dict[str, Any] = field(default_factory=dict)
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

    def fit_all(self, asked: Sequence[tuple[Effects, dict[str, float]]], rival: Hypothesis | None = None) -> list[Hypothesis | None]:
        """Several hypotheses from their first values, at once on the machine's cores.

        Against a rival, fits that cannot come near it any more end early; asked for without one, they go on from there.
        """
        wanted = [(tuple(sorted(effects, key=lambda c: c.label)), start) for effects, start in asked]
        missing: dict[Effects, list[dict[str, float]]] = {}
        for effects, start in wanted:
            if not self._has(effects, rival):
                missing.setdefault(effects, []).append(start)
        for effects in missing:
            self.progress(f"fitting {', '.join(c.label for c in effects) or 'the known parameters'}", 0, 0)
        reached = np.inf if rival is None else LOST * max(rival.estimate.cost, rival.estimate.count)
        found = in_parallel(lambda item: self._fitted(*item, reached), list(missing.items()), threads=self._at_once(missing))
        self.done |= {effects: hypothesis for effects, hypothesis in zip(missing, found, strict=True) if hypothesis is not None}
        return [self.done.get(effects) for effects, _ in wanted]

    def finished(self, hypothesis: Hypothesis) -> Hypothesis:
        """The hypothesis with its fit gone on to the end, if it ended early."""
        return self.fit(hypothesis.effects, hypothesis.estimate.named) or hypothesis

    def _has(self, effects: Effects, rival: Hypothesis | None) -> bool:
        return effects in self.done and not (rival is None and self.done[effects].estimate.out_of_reach)

    def _at_once(self, hypotheses: Iterable[Effects]) -> bool:
        """Whether fits may run at the same time: in C, and with derivatives that take little memory."""
        problem = self.problem
        most = len(problem.free) + max((sum(len(c.parameters) for c in effects) for effects in hypotheses), default=0)
        return problem.plant.concurrent and 8 * most * sum(run.points.size for run in problem.runs) < MEMORY

    def _fitted(self, effects: Effects, starts: Sequence[dict[str, float]], reached: float) -> Hypothesis | None:
        """The best fit from some first values, or from where an earlier one ended; an earlier search's fit as it was."""
        label = " ".join(c.label for c in effects)
        early = np.isfinite(reached) and f"early {label}" in self._kept
        kept = self._kept.get(f"early {label}" if early else f"fit {label}")
        begun = [self.done[effects].estimate.named] if effects in self.done else starts
        names = [parameter for c in effects for parameter in c.parameters]
        free = (*self.problem.free, *self.problem.plant.free(names))
        steps, fits = 0 if kept else self.settings.max_iterations, []
        for start in [kept] if kept else begun:
            begin = tuple(_starting(f, start.get(f.name, f.start)) for f in free)
            with suppress(PredictionError):
                fits.append(identify(replace(self.problem, free=begin), steps, tolerance=self.settings.tolerance, reached=reached))
        if not fits:
            return None
        found = min(fits, key=lambda fit: fit.cost)
        if early:
            found = replace(found, outcome=Outcome(Ending.NOT_CONVERGED, OUT_OF_REACH))
        try:
            evidence = leave_out(found)
        except PredictionError:
            return None
        self._keep(f"early {label}" if found.out_of_reach else f"fit {label}", found.named)
        return Hypothesis(effects, replace(found, residuals=[residual.bare for residual in found.residuals]), evidence)

    def screen(self, hypothesis: Hypothesis, missing: Sequence[Candidate]) -> list[Score]:
        """First-order gains of the effects a hypothesis does not have."""
        effects = hypothesis.effects
        if effects not in self.screened:
            name = "screen " + " ".join(c.label for c in effects)
            others = [c for c in missing if c not in effects and (not c.beside or any(other.name in c.beside for other in effects))]
            if name in self._kept:
                known = {candidate.label: candidate for candidate in others}
                self.screened[effects] = [
                    Score(known[label], gain, start, tuple(also)) for label, gain, start, also in self._kept[name] if label in known
                ]
            else:
                beside = f" beside {', '.join(c.label for c in effects)}" if effects else ""
                self.progress(f"screening {len(others)} effects{beside}", 0, 0)
                self.screened[effects] = screen(hypothesis.estimate, others)
                self._keep(name, [[score.candidate.label, score.gain, score.start, score.also] for score in self.screened[effects]])
        return self.screened[effects]

    def _keep(self, name: str, value: Any) -> None:
        with self._lock:
            if self.store is not None and name not in self._kept:
                self._kept[name] = value
                write_atomically(self.store, json.dumps({**self._kept, "key": self.key}))


def _starting(free: Free, value: float) -> Free:
    return replace(free, start=float(np.clip(value, free.low, free.high)))


def explain(fits: Fits, missing: Sequence[Candidate], seed: int) -> Explanation:
    """Search the effects that explain what recalibration leaves.

    Raises:
        PredictionError: the model cannot do the runs even without an effect.
    """
    settings = fits.settings
    without = fits.fit((), {})
    if without is None:
        fits.problem.residuals(fits.problem.start)
        raise PredictionError("the model cannot do the runs")
    best, front = without, [without]
    while front and best.left > settings.max_noise_excess:
        grown = {h.effects: h for base in front for h in _grown(fits, base, missing, seed)}
        front = _most_probable(list(grown.values()), seed, settings.beam)
        best = _most_probable([best, *front], seed, 1)[0] if settings.beam > 1 else next(iter(front), best)
    widest = best
    best, shares, groups = _settled(fits, best, missing, seed)
    for _ in range(settings.max_effects):
        weakest = min(groups.values(), key=lambda group: group[0][1], default=[(best, 1.0)])
        better, weight = max(weakest, key=lambda pair: pair[1])
        if better is best or weight < 0.5:
            break
        best, shares, groups = _settled(fits, fits.finished(better), missing, seed)
    if best.excess > settings.max_unexplained_ratio**2 * _motion(fits.problem):
        best, shares, groups = without, {}, {}
    return Explanation(without, best, widest, list(fits.done.values()), fits.screen(without, missing), shares, groups)


def _settled(fits: Fits, best: Hypothesis, missing: Sequence[Candidate], seed: int) -> tuple[Hypothesis, Shares, Groups]:
    """What is left of a hypothesis after the way back, with the shares of its effects and their rivals."""
    best, shares = _backward(fits, best)
    return best, shares, {effect: _alternatives(fits, best, effect, missing, seed) for effect in best.effects}


def _motion(problem: Problem) -> float:
    """Mean square of the measured motion about each run's mean position, over the noise's."""
    total, count = 0.0, 0
    for run, sigma in zip(problem.runs, problem.noises, strict=True):
        for column in run.points.reshape(run.rows, -1).T:
            seen = column[np.isfinite(column)] / sigma
            total, count = total + float(np.var(seen) if seen.size else 0.0) * seen.size, count + seen.size
    return total / max(count, 1)


def _grown(fits: Fits, base: Hypothesis, missing: Sequence[Candidate], seed: int) -> list[Hypothesis]:
    """The most probable of what surely explains more than `base` with one effect more, or with a first pair where no single one does."""
    settings = fits.settings
    if len(base.effects) >= settings.max_effects:
        return []
    for trials in (_round, _pairs):
        first = _most_probable([base, *trials(fits, base, missing)], seed, settings.beam)
        better = [fits.finished(trial) for trial in first if trial is not base]
        if better := [h for h in better if h.excess <= (1 - MIN_SHARE_CLOSED) * base.excess and _beats(h, base, seed, settings)]:
            return better
    return []


def _round(fits: Fits, base: Hypothesis, missing: Sequence[Candidate], rival: Hypothesis | None = None) -> list[Hypothesis]:
    """Fits of the candidates that promise most beside those of `base`; what competes with a rival, or with the first, may end early."""
    settings = fits.settings
    scores = [score for score in fits.screen(base, missing) if _may(score.candidate, base.effects)]
    if not scores:
        return []
    most = settings.fits_later_rounds if base.effects else settings.fits_first_round
    promising = _plainest([score for score in scores if score.gain >= MIN_GAIN_RATIO * scores[0].gain])[:most]
    asked = [
        [((*base.effects, score.candidate), {**base.estimate.named, **start}) for start in score.starts[: settings.starts]]
        for score in promising
    ]
    trials = fits.fit_all(asked[0])[:1] if asked and not rival else []
    trials += fits.fit_all([each for one in asked[len(trials) :] for each in one], rival or next(iter(trials), None))
    return list(dict.fromkeys(trial for trial in trials if trial is not None))


def _plainest(scores: Sequence[Score]) -> list[Score]:
    """Scores without other forms of what a form with fewer parameters promises nearly as well."""
    return [
        score
        for score in scores
        if not any(
            other.candidate.form_of == score.candidate.form_of
            and len(other.candidate.parameters) < len(score.candidate.parameters)
            and other.gain >= PLAIN * score.gain
            for other in scores
        )
    ]


def _may(candidate: Candidate, others: Sequence[Candidate]) -> bool:
    """Whether a candidate may stand beside others: no other form of one of them, and with what it needs."""
    forms = {other.form_of for other in others}
    return candidate.form_of not in forms and (not candidate.beside or any(other.name in candidate.beside for other in others))


def _pairs(fits: Fits, base: Hypothesis, missing: Sequence[Candidate]) -> list[Hypothesis]:
    """Fits of the pairs that promise most together where there is no effect yet: each may hide the other."""
    scores = [score for score in fits.screen(base, missing) if _may(score.candidate, base.effects)]
    if len(scores) < 2 or base.effects or fits.settings.max_effects < 2:
        return []
    pairs = [
        (pair, start) for pair, _, start in screen_pairs(base.estimate, _plainest(scores), PAIRED) if pair[0].form_of != pair[1].form_of
    ]
    asked = [((*base.effects, *pair), {**base.estimate.named, **start}) for pair, start in pairs[: fits.settings.fits_first_round]]
    return [trial for trial in fits.fit_all(asked) if trial is not None]


def _most_probable(hypotheses: Sequence[Hypothesis], seed: int, most: int) -> list[Hypothesis]:
    """So many of some hypotheses, the most probable first."""
    order = np.argsort(-weights([h.evidence for h in hypotheses], seed), kind="stable") if hypotheses else []
    return [hypotheses[k] for k in order[:most]]


def _beats(one: Hypothesis, other: Hypothesis, seed: int, settings: SearchSettings) -> bool:
    return bool(weights([one.evidence, other.evidence], seed)[0] > settings.min_probability)


def _backward(fits: Fits, best: Hypothesis) -> tuple[Hypothesis, dict[Candidate, float]]:
    """Drop effects one by one, the least needed first, until all that are left stand out from the structure left.

    Structure as small as the errors that effects' forms may have is neither an effect of its own nor held against the others.
    """
    settings = fits.settings
    while True:
        shares, smaller = {}, {}
        doubt = {effect: FORM_ERROR_RATIO * _output(best, effect) for effect in best.effects}
        left = best.excess + settings.max_noise_excess / 10
        rests = [tuple(c for c in best.effects if c != effect) for effect in best.effects]
        without = fits.fit_all([(rest, best.estimate.named) for rest in rests])
        for effect, rest, found in zip(best.effects, rests, without, strict=True):
            shares[effect] = np.inf  # where the model cannot do the runs without it
            if found is not None:
                smaller[effect] = found
                taken = found.excess - best.excess
                shares[effect] = taken / left if taken >= max(settings.min_excess_removed, sum(doubt[c] for c in rest)) else 0.0
        weakest = min(shares, key=shares.__getitem__, default=None)
        if weakest is None or shares[weakest] >= settings.even_odds_ratio:
            return best, shares
        best = smaller[weakest]


def _output(hypothesis: Hypothesis, effect: Candidate) -> float:
    """Mean square of what one effect of a hypothesis changes in the modelled positions, over the noise's; 0 where that cannot be told."""
    estimate = hypothesis.estimate
    problem = replace(estimate.problem, plant=estimate.plant.with_values(effect.null), free=())
    try:
        without = problem.residuals(np.zeros(0))
    except PredictionError:  # the model cannot do the runs without it
        return 0.0
    changed = sum(float(np.sum((a.values - b.values) ** 2)) for a, b in zip(without, estimate.residuals, strict=True))
    return changed / max(estimate.count, 1)


def _alternatives(
    fits: Fits, best: Hypothesis, effect: Candidate, missing: Sequence[Candidate], seed: int
) -> list[tuple[Hypothesis, float]]:
    """`best` and what it would be with another effect in the place of `effect`, with probabilities."""
    rest = fits.fit(tuple(c for c in best.effects if c != effect), best.estimate.named)
    others = [] if rest is None else [h for h in _round(fits, rest, missing, best) if effect not in h.effects]
    others = [h for h in others if _beats(h, best, seed, fits.settings) or all(c.form_of != effect.form_of for c in h.effects)]
    group = [best, *(h for h in others if h is not best)]
    return list(zip(group, weights([h.evidence for h in group], seed).tolist(), strict=True))
