"""Linearised fit: residuals to first order in all candidates, to compare sets of effects before they are fitted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.data.run import Run, thin_out
from tepm_opt.discrepancy.problem.plant import Candidate, collect_free_parameters, free_candidate_parameters
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.shape_suggestions import apply_suggested_shapes
from tepm_opt.solvers.identification.identify import ParameterEstimate, Problem
from tepm_opt.solvers.identification.residuals import Residual
from tepm_opt.solvers.mechanics.plant import Free, PredictionError
from tepm_opt.solvers.numerics.least_squares import bounded_step
from tepm_opt.solvers.numerics.parallel import in_parallel, run_concurrently


@dataclass(frozen=True)
class Cell:
    """Rows of a run that count together.

    Attributes:
        run: number of the run.
        half: of the run, in time.
        rising: whether the inputs rise together then, rather than fall.
    """

    run: int
    half: int
    rising: bool


@dataclass(frozen=True, eq=False)
class Linearised:
    """Normal equations of a fit by the parameters of everything that may act, one set for each cell of rows.

    Attributes:
        estimate: the fit, with the samples that are used here.
        known: parameters that are fitted whatever acts.
        effects: those of the fit.
        able: candidates that the model can simulate.
        far_probed: smooth candidates that are also probed at larger sizes, where their derivatives no longer hold; as probed candidates.
        columns: number of the column by full name of a parameter, or by label of a probed candidate.
        cells: run, half and direction of each cell.
        square, slope: JᵀJ and Jᵀr of every cell, (cells, columns, columns) and (cells, columns).
        cost, count: squared residuals and coordinates of every cell, (cells,).
    """

    estimate: ParameterEstimate
    known: tuple[Free, ...]
    effects: tuple[Candidate, ...]
    able: tuple[Candidate, ...]
    far_probed: tuple[Candidate, ...]
    columns: dict[str, int]
    cells: tuple[Cell, ...]
    square: np.ndarray
    slope: np.ndarray
    cost: np.ndarray
    count: np.ndarray

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Linearised({len(self.able)} candidates beside {len(self.effects)} effects, {len(self.cells)} cells)"

    @property
    def excess(self) -> float:
        """Squares beyond the noise."""
        left = float(self.cost.sum() - self.count.sum())
        return max(left, 1e-9 * float(self.count.sum()))

    def gain(self, effects: Iterable[Candidate]) -> tuple[float, dict[str, float]]:
        """Gain of a set of effects in the place of the fit's, and values to fit from.

        The gain is the share of the squares beyond the noise that the set would remove. An effect of the fit that is not in the set is
        taken back to where it vanishes; one that acts in other runs, in those that it leaves.
        """
        effects = tuple(effects)
        named, present = self.estimate.named, {c.label: c for c in self.effects}
        problem = self.estimate.problem
        kept = [c for c in effects if c.label in present or c.smooth]
        probed = [c for c in effects if c not in kept]
        free = collect_free_parameters(self.known, problem.plant, kept)
        values = np.array([named.get(f.name, f.start) for f in free])
        own = {name: c for c in kept for name in c.parameters}
        at = [self.columns[f.name] for f in free] + [self.columns[c.label] for c in probed]
        masks = np.array([self.acts(own.get(f.name)) for f in free] + [self.acts(c) for c in probed], dtype=float).reshape(
            len(at), len(self.cells)
        )
        low = np.concatenate([np.array([f.low for f in free]) - values, np.zeros(len(probed))])
        high = np.concatenate([np.array([f.high for f in free]) - values, [_largest_multiple(problem, c) for c in probed]])
        scale = np.array([*(f.scale for f in free), *(1.0 for _ in probed)])
        square = np.einsum("cij,ic,jc->ij", self.square[:, at][:, :, at], masks, masks, optimize=True)
        slope = np.einsum("ci,ic->i", self.slope[:, at], masks)
        if problem.joint is not None:
            mean, precision = problem.joint.terms(free)
            square[: len(free), : len(free)] += precision
            slope[: len(free)] += precision @ (values - mean)
        lost = 0.0
        for effect in present.values():
            still = next((c for c in effects if c.label == effect.label), None)
            gone = self.acts(effect) & ~(self.acts(still) if still else np.zeros(len(self.cells), dtype=bool))
            if not gone.any():
                continue
            where = [self.columns[name] for name in effect.parameters]
            back = np.array([effect.null[name] - named[name] for name in effect.parameters])
            pull = self.square[:, :, where] @ back  # (cells, columns)
            slope = slope + np.einsum("ci,ic,c->i", pull[:, at], masks, gone.astype(float))
            lost += float(np.sum((2 * self.slope[:, where] @ back + pull[:, where] @ back) * gone))
        step, less = bounded_step(square, slope, np.minimum(low, 0), np.maximum(high, 0), scale)
        start = {f.name: float(value) for f, value in zip(free, values + step[: len(free)], strict=True)}
        for candidate, size in zip(probed, step[len(free) :], strict=True):
            start |= scale_from_null(candidate, candidate.probes[0], max(float(size), 0.1))  # at least a visible part of it
        return (less - lost) / self.excess, start

    def acts(self, candidate: Candidate | None) -> np.ndarray:
        """Cells in which a candidate acts, (cells,)."""
        files = [run.file for run in self.estimate.problem.runs]
        every = candidate is None or not candidate.runs
        return np.array([every or files[cell.run] in candidate.runs for cell in self.cells])  # type: ignore[union-attr]


def linearise(
    estimate: ParameterEstimate, known: Sequence[Free], effects: Sequence[Candidate], missing: Sequence[Candidate],
    settings: SearchSettings,
) -> Linearised:  # fmt: skip
    """Linearise a fit in all candidates: derivatives of smooth ones, finite probes of others and of larger sizes.

    Args:
        estimate: the fit.
        known: parameters that are fitted whatever acts.
        effects: those of the fit.
        missing: the candidates; one that the model cannot simulate is left out.
        settings: of the search.
    """
    smooth, nonsmooth = [c for c in missing if c.smooth], [c for c in missing if not c.smooth]
    far_probed = [replace(c, smooth=False, probes=c.probes[1:]) for c in smooth if len(c.probes) > 1 and not settings.screen_by_fits]
    names = list(dict.fromkeys([*(f.name for f in estimate.problem.free), *(name for c in smooth for name in c.parameters)]))
    names += [f.name for f in known if f.name not in names]
    estimate = apply_suggested_shapes(estimate, missing)
    estimate = thin_samples(estimate, len(names) + len(nonsmooth) + len(far_probed), settings.max_derivative_bytes)
    problem, threads = estimate.problem, estimate.problem.plant.concurrent

    def slopes() -> list[Residual]:
        return problem.residuals(estimate.values, names)

    variants = [replace(c, probes=(probe,)) for c in (*nonsmooth, *far_probed) for probe in c.probes]

    def probes() -> list[list[Residual] | None]:
        return in_parallel(lambda c: simulate_probe(estimate, c.probes[0]), variants, threads=threads)

    simulated, changed = run_concurrently(slopes, probes, threads)
    telling = _select_probes(estimate, simulated, [(c, found) for c, found in zip(variants, changed, strict=True) if found is not None])
    columns = {name: k for k, name in enumerate((*names, *(c.label for c, _ in telling)))}
    cells: list[Cell] = []
    squares, slope, cost, count = [], [], [], []
    for k, (r, s) in enumerate(zip(estimate.residuals, simulated, strict=True)):
        by = np.hstack([s.by, *(((found[k].values - s.values).ravel()[:, None]) for _, found in telling)])
        rows, values = len(r.values), r.values.ravel()
        for cell, inside in _split_into_cells(k, problem.runs[k], problem.plant.static):
            picked = np.repeat(inside, values.size // max(rows, 1))
            part, left = by[picked], values[picked]
            cells.append(cell)
            squares.append(part.T @ part)
            slope.append(part.T @ left)
            cost.append(float(left @ left))
            count.append(int(r.present.reshape(rows, -1)[inside].sum()))
    return Linearised(
        estimate,
        tuple(known),
        tuple(effects),
        (*smooth, *(c for c, _ in telling if c in nonsmooth)),
        tuple(c for c, _ in telling if c in far_probed),
        columns,
        tuple(cells),
        np.array(squares),
        np.array(slope),
        np.array(cost),
        np.array(count),
    )


def _select_probes(
    estimate: ParameterEstimate, simulated: Sequence[Residual], changed: Sequence[tuple[Candidate, list[Residual]]]
) -> list[tuple[Candidate, list[Residual]]]:
    """The probe of each candidate that, scaled freely, would remove most while all fitted parameters follow.

    Parameters at a bound follow, too: they may be there only because an effect is missing.
    """
    fitted, _ = np.linalg.qr(np.concatenate([s.by[:, : len(estimate.problem.free)] for s in simulated]))
    left = np.concatenate([r.values.ravel() for r in estimate.residuals])
    found: dict[Candidate, tuple[float, tuple[Candidate, list[Residual]]]] = {}
    for candidate, residuals in changed:
        change = np.concatenate([(c.values - s.values).ravel() for c, s in zip(residuals, simulated, strict=True)])
        change -= fitted @ (fitted.T @ change)
        gain = max(-float(change @ left), 0.0) ** 2 / max(float(change @ change), 1e-30)
        if candidate not in found or gain > found[candidate][0]:
            found[candidate] = (gain, (candidate, residuals))
    return [pair for _, pair in found.values()]


def _split_into_cells(number: int, run: Run, static: bool) -> list[tuple[Cell, np.ndarray]]:
    """The cells of a run, each with a mask of its rows."""
    rows = np.arange(run.rows)
    half = np.zeros(run.rows, dtype=int) if static else rows * 2 // max(run.rows, 1)
    size = np.maximum(np.abs(run.inputs).max(axis=0, initial=0.0), 1e-30)
    level = (run.inputs / size).sum(axis=1)
    rising = np.zeros(run.rows, dtype=bool) if static or run.rows < 2 else np.gradient(level) >= 0
    found = []
    for part in range(2):
        for up in (False, True):
            inside = (half == part) & (rising == up)
            if inside.any():
                found.append((Cell(number, part, up), inside))
    return found


def thin_samples(estimate: ParameterEstimate, columns: int, most_bytes: int) -> ParameterEstimate:
    """The estimate with the samples at which derivatives are taken, and no more of them than fit into memory.

    Args:
        estimate: the fit.
        columns: number of derivatives of every coordinate.
        most_bytes: memory in B for all derivatives together.
    """
    whole = estimate.problem
    problem = whole.sparse
    size = 8.0 * columns * sum(run.points.size for run in problem.runs)
    if size > most_bytes and not problem.plant.static and all(run.start == "equilibrium" for run in problem.runs):
        apart = max(float(np.median(np.diff(run.time))) for run in problem.runs if run.rows > 1) * size / most_bytes
        problem = replace(problem, runs=tuple(thin_out(run, apart) for run in problem.runs))
    if problem is whole:
        return estimate
    rows = [np.searchsorted(run.time, at.time) for run, at in zip(whole.runs, problem.runs, strict=True)]
    residuals = [
        replace(r, values=r.values[k], present=r.present[k], by=np.empty((r.values[k].size, 0)), block=r.block[k])
        for r, k in zip(estimate.residuals, rows, strict=True)
    ]
    return replace(estimate, problem=problem, residuals=residuals, cost=sum(r.squares for r in residuals))


def simulate_probe(estimate: ParameterEstimate, probe: Mapping[str, float]) -> list[Residual] | None:
    """Residuals of every run with the values of a probe; None where the model cannot do the runs with them."""
    try:
        return replace(estimate.problem, plant=estimate.plant.with_values(probe)).residuals(estimate.values, [])
    except PredictionError:
        return None


def _largest_multiple(problem: Problem, candidate: Candidate) -> float:
    """The largest multiple of its probe that a candidate's ranges allow."""
    probe, moved = candidate.probes[0], []
    for f in free_candidate_parameters(problem.plant, candidate):
        change = probe[f.name] - candidate.null[f.name]
        if change and f.name not in candidate.shapes:
            moved.append((f.high - candidate.null[f.name]) / change)
    return min(moved, default=1.0)


def scale_from_null(candidate: Candidate, values: Mapping[str, float], size: float) -> dict[str, float]:
    """Values of a candidate moved along the line from its null values, its shapes kept; a size of 1 changes nothing."""
    null = candidate.null
    return {name: value if name in candidate.shapes else null[name] + size * (value - null[name]) for name, value in values.items()}
