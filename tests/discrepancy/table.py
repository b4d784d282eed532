"""A table of what every set of effects leaves, in the place of fits, for tests of a search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.network import candidate
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.cross_validation import Evidence
from tepm_opt.discrepancy.selection.fitting import Effects, Hypothesis
from tepm_opt.discrepancy.selection.screening import Score

BLOCKS, SAMPLES, NOISE = 20, 90, 3e-4
EFFECTS = {label: replace(candidate("sensor_offset", label), exact=False) for label in ("s1", "s2", "s3", "s4")}
ROWS, MOTION = 100, 20.0  # samples, and how many times the noise the measured motion is, RMS


def hypothesis(effects: Effects, excess: float, uneven: float = 0.0) -> Hypothesis:
    """One that leaves an excess, unevenly over the blocks of time if asked to."""
    counts = np.full(BLOCKS, SAMPLES)
    squares = SAMPLES * (1 + excess + uneven * np.cos(np.arange(BLOCKS)) - uneven * np.cos(np.arange(BLOCKS)).mean())
    problem = SimpleNamespace(free=())
    counted = {"cost": float(squares.sum()), "count": int(counts.sum())}
    estimate: Any = SimpleNamespace(named={}, **counted, out_of_reach=False, problem=problem, at_bound=())
    return Hypothesis(effects, estimate, Evidence(squares, counts, 1, np.zeros(1)))


@dataclass
class Table:
    """What `Fits` offers a search: hypotheses by their effects' details, in a given order of promise."""

    settings: SearchSettings
    excess: dict[str, float]
    gains: dict[str, float]
    uneven: dict[str, float] = field(default_factory=dict)
    again: tuple[Effects, ...] = ()
    gauge_effects: Effects = ()
    done: dict[Effects, Hypothesis] = field(default_factory=dict)

    @property
    def problem(self) -> Any:
        """Runs whose points swing by `MOTION` times the noise."""
        points = MOTION * NOISE * np.sqrt(2) * np.sin(2 * np.pi * np.arange(ROWS) / ROWS)[:, None, None] * np.ones((1, 4, 3))
        run = Run("swing.csv", "fit", np.arange(ROWS) / 50, np.zeros((ROWS, 12)), np.zeros((ROWS, 3)), points)
        plant = SimpleNamespace(static=False, quick=False, concurrent=False)
        return SimpleNamespace(runs=(run,), noise=NOISE, noises=(NOISE,), joint=None, plant=plant)

    def fit(self, effects: Effects, _: object) -> Hypothesis:
        effects = tuple(sorted(effects, key=lambda c: c.label))
        key = " ".join(str(c.detail) for c in effects)
        if effects not in self.done:
            self.done[effects] = hypothesis(effects, self.excess.get(key, 1e3), self.uneven.get(key, 0.0))
        return self.done[effects]

    def fit_all(self, asked: Sequence[tuple[Effects, object]], _: object = None, bound: float = np.inf) -> list[Hypothesis]:
        return [self.fit(effects, start) for effects, start in asked]

    def complete(self, found: Hypothesis) -> Hypothesis:
        return found

    def find(self, effects: Effects) -> Hypothesis | None:
        return self.done.get(tuple(sorted(effects, key=lambda c: c.label)))

    def refit(self, effects: Effects, start: object, _: str = "") -> Hypothesis | None:
        self.again = (*self.again, effects)
        return self.fit(effects, start)

    def linearise_in(self, base: Hypothesis, some: Sequence[Candidate]) -> Any:
        return self.linear(base, some)

    def linear(self, base: Hypothesis, _: object) -> Any:
        """What promises nothing in pairs, or in the place of others."""
        return SimpleNamespace(
            gain=lambda effects: (-1.0, {}), able=list(EFFECTS.values()), effects=base.effects, excess=base.excess, count=np.ones(1)
        )

    def screen(self, base: Hypothesis, _: object) -> list[Score]:
        scores = [Score(EFFECTS[label], gain, {}) for label, gain in self.gains.items() if EFFECTS[label] not in base.effects]
        return sorted(scores, key=lambda score: -score.gain)
