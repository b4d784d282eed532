"""A plant that is linear in its parameters, for which everything that is predicted can be had by plain least squares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.solvers.mechanics.plant import Free, Prediction

KNOWN = ("stiffness", "mass")
ROWS = 40


def effect(name: str, smooth: bool = True, **probe: float) -> Candidate:
    """A candidate with null values 0 and one probe."""
    full = {f"{name}.{key}": value for key, value in probe.items()}
    return Candidate(name, null=dict.fromkeys(full, 0.0), probes=(full,), smooth=smooth)


@dataclass(frozen=True, eq=False)
class Straight:
    """Coordinates are sums of fixed columns times parameters, drawn by run and parameter."""

    candidates: tuple[Candidate, ...]
    values: Mapping[str, float]
    known: tuple[str, ...] = KNOWN
    prior: float = 0.5
    alike: Mapping[str, tuple[str, float]] = field(default_factory=dict)

    name, static, quick, concurrent, derivatives_apart, modules = "straight", False, False, False, 0.0, 1
    states: Mapping[str, float] = field(default_factory=dict)

    equilibria = None

    @property
    def without_candidates(self) -> Straight:
        return self

    @property
    def signals(self) -> Signals:
        raise NotImplementedError

    def corrected_model(self, kept: Sequence[Candidate]) -> object:
        return kept

    @staticmethod
    def of(*candidates: Candidate, **alike: tuple[str, float]) -> Straight:
        """With these candidates; `alike` names those whose first column is another's and so much of a direction of its own."""
        values = dict.fromkeys(KNOWN, 1.0) | {name: 0.0 for c in candidates for name in c.null}
        return Straight(candidates, values, alike=alike)

    def column(self, run: Run, name: str) -> np.ndarray:
        seed = sum(map(ord, run.file)) * 1000 + sum(k * ord(letter) for k, letter in enumerate(name, 1))
        own = np.random.default_rng(seed).normal(size=(run.rows, 1, 3))
        if name.partition(".")[0] in self.alike:
            other, part = self.alike[name.partition(".")[0]]
            return self.column(run, other) + part * own
        return own

    def with_values(self, values: Mapping[str, float]) -> Straight:
        return replace(self, values={**self.values, **values})

    def free(self, names: Sequence[str]) -> tuple[Free, ...]:
        found = []
        for name in names:
            if name in KNOWN:
                width = self.prior * np.sqrt(12) / 2
                found.append(Free(name, "-", self.values[name], 1.0 - width, 1.0 + width, 0.1))
            else:
                found.append(Free(name, "-", self.values[name], -10.0, 10.0, 0.1))
        return tuple(found)

    def predict(self, run: Run, by: Sequence[str] = (), step: float = np.inf) -> Prediction:
        points = sum(value * self.column(run, name) for name, value in self.values.items())
        return Prediction(np.asarray(points), np.array([self.column(run, name) for name in by]).reshape(len(by), run.rows, 1, 3))


def planned(*files: str) -> list[Run]:
    """Runs of which nothing has been measured."""
    empty = np.zeros((ROWS, 2)), np.zeros((ROWS, 3)), np.full((ROWS, 1, 3), np.nan)
    return [Run(file, "fit", np.arange(ROWS) / 10, *empty) for file in files]
