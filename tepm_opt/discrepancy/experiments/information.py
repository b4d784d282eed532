"""Fisher information of planned runs on effects that may be missing, to first order."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.experiments.settings import DEFAULT, ExperimentSettings
from tepm_opt.discrepancy.problem.plant import Candidate, SearchablePlant, free_candidate_parameters
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.solvers.mechanics.plant import Free, PredictionError
from tepm_opt.solvers.numerics.parallel import in_parallel


@dataclass(frozen=True, eq=False)
class Move:
    """A change of an effect from where it vanishes whose signature is looked at.

    Attributes:
        candidate: the effect.
        null, probe: values by full name before and after; the probe is what is counted in multiples.
        along: by column of the information, how much of it the whole probe is.
        most: the largest multiple within the ranges of its values.
    """

    candidate: Candidate
    null: Mapping[str, float]
    probe: Mapping[str, float]
    along: Mapping[str, float]
    most: float = np.inf

    def values_at(self, multiple: float) -> dict[str, float]:
        """Values by full name at a multiple of the probe."""
        return {name: self.null[name] + multiple * (value - self.null[name]) for name, value in self.probe.items()}


@dataclass(frozen=True, eq=False)
class Separability:
    """Sizes at which planned runs show an effect, in multiples of its probe; infinite where it cannot be as large.

    Attributes:
        move: the change of the effect.
        found: size at which it is found beside known parameters that are free within their priors.
        material: size from which its output is as large as an effect must be to be named, whatever its significance.
        rival: the effect that does most alike; None where there is no other.
        cosine: between their signatures, the known parameters' part taken out; of several parameters the best combination.
        apart: size at which the rival, fitted to it, is told apart.
    """

    move: Move
    found: float
    material: float
    rival: Candidate | None
    cosine: float
    apart: float

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        rival = self.rival.label if self.rival else "nothing"
        return f"Separability({self.move.candidate.label}, cosine {self.cosine:.3f} with {rival})"


@dataclass(frozen=True, eq=False)
class Information:
    """Fisher information of runs by everything that may act: the sum of JᵀJ over the noise (Atkinson, Donev, Tobias 2007, ch. 9).

    Attributes:
        known: parameters that are free whatever acts.
        moves: of all effects that the model can take.
        own: columns of each effect's parameters, or of its probe where derivatives do not exist, by label.
        columns: number of the column by name.
        square: JᵀJ, (columns, columns).
        count: coordinates measured.
    """

    known: tuple[Free, ...]
    moves: tuple[Move, ...]
    own: Mapping[str, tuple[str, ...]]
    columns: Mapping[str, int]
    square: np.ndarray
    count: int

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Information({len(self.own)} effects, {len(self.known)} known parameters, {self.count} coordinates)"

    def residual_norm(self, move: Move, beside: Candidate | None = None) -> float:
        """Norm over the noise of a move's signature that the known parameters, and a rival's, cannot reproduce.

        The priors of known parameters count as normal distributions with the same standard deviation. A value that is said to be wrong
        beyond its prior, by the move or by the rival, has none.
        """
        names = [*move.along]
        freed = {name for one in (move.candidate, beside) if one is not None for name in one.parameters}
        free = [f for f in self.known if f.name not in freed]
        own = () if beside is None else tuple(name for name in self.own[beside.label] if name not in names)
        rows = [self.columns[name] for name in (*(f.name for f in free), *own)]
        at, along = [self.columns[name] for name in names], np.array([*move.along.values()])
        pull = self.square[np.ix_(rows, at)] @ along
        prior = np.concatenate([[f.spread**-2.0 for f in free], np.zeros(len(own))])
        whole = float(along @ self.square[np.ix_(at, at)] @ along)
        inner = self.square[np.ix_(rows, rows)] + np.diag(prior)
        scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
        taken = float((pull / scale) @ np.linalg.pinv(inner / np.outer(scale, scale), rcond=1e-11, hermitian=True) @ (pull / scale))
        rest = whole - taken
        return float(np.sqrt(rest)) if rest > 1e-9 * whole else 0.0  # what rounding leaves of nothing

    def separability(self, move: Move, excess: float, settings: ExperimentSettings = DEFAULT) -> Separability:
        """Sizes at which a move is shown; `excess` is the one an effect must remove to be named, over the noise's squares."""
        alone, is_wide = self.residual_norm(move), SearchSettings().is_wide
        candidates = {each.candidate.label: each.candidate for each in self.moves}.values()
        compared = alone > 0 and not is_wide(move.candidate)
        others = [c for c in candidates if compared and c.label != move.candidate.label and not is_wide(c)]
        rests = [self.residual_norm(move, other) for other in others]
        nearest = int(np.argmin(rests)) if rests else -1
        rest = rests[nearest] if rests else alone

        def multiple(wanted: float, size: float) -> float:
            return float(wanted / size) if size * move.most >= wanted else float("inf")

        return Separability(
            move,
            found=multiple(settings.found_sigmas, alone),
            material=multiple(np.sqrt(excess * self.count), alone),
            rival=others[nearest] if rests else None,
            cosine=float(np.sqrt(max(1 - (rest / alone) ** 2, 0.0))) if rests else 0.0,
            apart=multiple(settings.apart_sigmas, rest),
        )


def information(plant: SearchablePlant, runs: Sequence[Run], noise: float, candidates: Iterable[Candidate]) -> Information:
    """Information of runs on effects at their null values: derivatives of those that are smooth, finite probes of others.

    An effect that begins at an instant does so half-way through the session.

    Args:
        plant: with the effects at their null values.
        runs: planned; their measured points are not used.
        noise: of a coordinate, 1 sigma.
        candidates: effects that may be missing; one that the model cannot take in these runs is left out.

    Raises:
        PredictionError: the model cannot do the runs as it is.
    """
    candidates = tuple(candidates)
    halfway = max((run.began + run.duration for run in runs), default=0.0) / 2
    plant = plant.with_values({c.happens: halfway for c in candidates if c.happens})
    known, smooth = plant.free(plant.known), [c for c in candidates if c.smooth]
    names = list(dict.fromkeys([*(f.name for f in known), *(name for c in smooth for name in c.parameters)]))
    nonsmooth = [c for c in candidates if not c.smooth]
    square, count, taken = np.zeros((len(names) + len(nonsmooth),) * 2), 0, np.ones(len(nonsmooth), dtype=bool)
    for run in runs:
        found = plant.predict(run, names, plant.derivatives_apart or np.inf)
        base = plant.predict(run).points if nonsmooth else found.points
        changed = in_parallel(lambda c, run=run: _predict_probe(plant, c, run), nonsmooth, threads=plant.concurrent)
        taken &= np.array([points is not None for points in changed], dtype=bool)
        by = [*found.by, *((np.zeros_like(base) if points is None else points - base) for points in changed)]
        flat = np.stack([part.ravel() for part in by]) / noise
        square += flat @ flat.T
        count += base.size
    able = [c for c, good in zip(nonsmooth, taken, strict=True) if good]
    columns = {name: k for k, name in enumerate((*names, *(c.label for c in nonsmooth)))}
    moves = [*(move for c in smooth for move in _smooth_moves(plant, c)), *(_move(plant, c, _first_probe(c), {c.label: 1.0}) for c in able)]
    own = {c.label: c.parameters for c in smooth} | {c.label: (c.label,) for c in able}
    return Information(known, tuple(moves), own, columns, square, count)


def _predict_probe(plant: SearchablePlant, candidate: Candidate, run: Run) -> np.ndarray | None:
    """Points of a run with an effect at its first probe; None where the model cannot take it."""
    try:
        return plant.with_values(candidate.probes[0]).predict(run).points
    except PredictionError:
        return None


def _first_probe(candidate: Candidate) -> dict[str, float]:
    """The first probe, without parameters that only say how the effect acts."""
    return {name: value for name, value in candidate.probes[0].items() if name not in candidate.shapes}


def _smooth_moves(plant: SearchablePlant, candidate: Candidate) -> list[Move]:
    """A move for every parameter that says how strongly an effect acts; one for all of those that scatter."""
    probe = {name: value for name, value in _first_probe(candidate).items() if value != candidate.null[name]}
    parts = [probe] if SearchSettings().is_wide(candidate) else [{name: value} for name, value in probe.items()]
    return [_move(plant, candidate, part, {n: v - candidate.null[n] for n, v in part.items()}) for part in parts]


def _move(plant: SearchablePlant, candidate: Candidate, probe: Mapping[str, float], along: Mapping[str, float]) -> Move:
    """A move with the largest multiple that its parameters' ranges allow."""
    ranges, most = {free.name: free for free in free_candidate_parameters(plant, candidate)}, np.inf
    for name, value in probe.items():
        change = value - candidate.null[name]
        if change:
            end = ranges[name].high if change > 0 else ranges[name].low
            most = min(most, (end - candidate.null[name]) / change)
    return Move(candidate, candidate.null, probe, along, most)
