"""What laws at many places would change in the measured points, to first order, from one pass through the runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tepm_opt.data.run import Run, spaced
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.discrepancy.symbolic.places import ALL, Course, Place
from tepm_opt.errors import InputError
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.identify import Problem
from tepm_opt.solvers.network_plant import NetworkPlant
from tepm_opt.solvers.parallel import in_parallel
from tepm_opt.solvers.plant import PredictionError
from tepm_opt.solvers.residuals import Residual
from tepm_opt.solvers.simulate import Directions, SimulationError, simulate
from tepm_opt.solvers.statics import solve_statics

APART = 0.08  # s between the samples of the pass: two forces are told apart by what they do to the sway, not within a sample


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations of a run's blocks of time, of the free parameters and then a place's coefficients.

    Attributes:
        square: JᵀJ, (blocks, columns, columns).
        slope: Jᵀr, (blocks, columns).
        squares: rᵀr, (blocks,).
        counts: coordinates measured, (blocks,).
    """

    square: np.ndarray
    slope: np.ndarray
    squares: np.ndarray
    counts: np.ndarray

    def __repr__(self) -> str:
        """The main numbers, in a line."""
        return f"Normal({len(self.counts)} blocks, {self.slope.shape[1]} columns)"


def courses(plant: NetworkPlant, runs: Sequence[Run]) -> list[Course]:
    """The runs as the plant does them, at the samples of the pass.

    Raises:
        PredictionError: the plant cannot do a run.
    """
    model = plant.model

    def done(run: Run) -> Course:
        if plant.static:
            held = _equilibria(model, run)
            return Course(model, run, np.stack([h.points for h in held]), np.stack([h.lengths.ravel() for h in held]), static=True)
        sparse = spaced(run, APART)
        found = _simulated(model, sparse)
        return Course(model, sparse, found.points, found.lengths)

    return in_parallel(done, runs, lambda run: run.rows, plant.concurrent)


def _simulated(model: CompiledModel, run: Run, directions: Directions | None = None):
    try:
        return simulate(
            model, SetPoints(run.time, run.inputs, run.tip_force), step=APART, directions=directions, began=run.began
        ).complete()
    except (SimulationError, InputError) as error:
        raise PredictionError(f"{run.file}: {error}") from error


def _equilibria(model: CompiledModel, run: Run) -> list:
    last, found = None, []
    for row, (inputs, force) in enumerate(zip(run.inputs, run.tip_force, strict=True)):
        last = solve_statics(model, inputs, force, start=last)
        if not last.solved:
            raise PredictionError(f"{run.file}: row {row + 1}: {last.outcome.message}")
        found.append(last)
    return found


def moved(course: Course, places: Sequence[Place], free: Sequence[str]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Change of the points with the free parameters, (samples, parameters, points, 3), and with each place's coefficients.

    What acts on all actuators alike is the sum of what acts on each where both are asked for with the same shape.

    Args:
        course: the run, and the model with the values that hold.
        places: what may act.
        free: parameters by full name.
    """
    model, samples = course.model, course.run.rows
    layout = model.layout
    alone = {p.of for p in places if p.kind == "axial" and p.target != ALL}
    summed = [p for p in places if p.kind == "axial" and p.target == ALL and p.of in alone]
    acting = [p for p in places if p.kind != "measurement" and p not in summed]
    of_parameters = Directions.of(model, free).parameters
    sizes = [place.size for place in acting]
    ends = np.cumsum([len(free), *sizes])
    inputs, loads = np.zeros((samples, ends[-1], layout.inputs)), np.zeros((samples, ends[-1], layout.points, 3))
    for place, end in zip(acting, ends[1:], strict=True):
        columns = place.columns(course, layout)
        at = slice(end - place.size, end)
        if place.kind == "axial":
            inputs[:, at, : layout.inputs // 2] = columns / model.values["A"]
        else:
            loads[:, at] = columns
    theta = np.vstack([of_parameters, np.zeros((ends[-1] - len(free), len(model.theta)))])
    found = _response(course, theta, inputs, loads)
    known = {p: found[:, end - p.size : end] for p, end in zip(acting, ends[1:], strict=True)}
    for place in summed:
        parts = [known[p] for p in acting if p.kind == "axial" and p.of == place.of]
        known[place] = np.sum(parts, axis=0)
    known |= {p: p.columns(course, layout) for p in places if p.kind == "measurement"}
    return found[:, : len(free)], [known[place] for place in places]


def _response(course: Course, theta: np.ndarray, inputs: np.ndarray, loads: np.ndarray) -> np.ndarray:
    """Change of the points along directions, (samples, directions, points, 3)."""
    model, layout = course.model, course.model.layout
    if not course.static:
        directions = Directions(tuple(map(str, range(len(theta)))), theta, inputs, loads)
        return np.moveaxis(_simulated(model, course.run, directions).sensitivities, 0, 1)
    rows, found = np.eye(3 * layout.points, 3 * layout.points + layout.inputs // 2), []
    for k, held in enumerate(_equilibria(model, course.run)):
        _, by_u, by_load, by_theta = model.statics.sensitivity(held.x, held.inputs, False, held.loads.ravel(), model.theta, rows, True)
        along = theta @ np.asarray(by_theta).T + inputs[k] @ by_u.T + loads[k].reshape(len(theta), -1) @ by_load.T
        found.append(along.reshape(len(theta), layout.points, 3))
    return np.stack(found)


def normals(problem: Problem, residuals: Sequence[Residual], made: Sequence[Course], places: Sequence[Place]) -> list[list[Normal]]:
    """Normal equations of every place and every run, [place][run].

    Args:
        problem: what was fitted.
        residuals: measured less modelled of every run.
        made: the runs as the model with the fitted values does them.
        places: what may act.
    """
    free = [f.name for f in problem.free]

    def of_run(work: tuple[Run, Residual, Course, float | np.ndarray]) -> list[Normal]:
        run, residual, course, noise = work
        by_free, by_place = moved(course, places, free)
        still = _columns(run, residual, course, by_free, noise)
        return [_normal(residual, np.hstack([still, _columns(run, residual, course, by, noise)])) for by in by_place]

    found = in_parallel(
        of_run, list(zip(problem.runs, residuals, made, problem.noises, strict=True)), lambda work: work[0].rows, problem.plant.concurrent
    )
    return [list(of_place) for of_place in zip(*found, strict=True)]


def _columns(run: Run, residual: Residual, course: Course, by: np.ndarray, noise: float | np.ndarray) -> np.ndarray:
    """Change of a run's residuals, (coordinates, columns), from that of the points at the samples of the pass."""
    whole = Residual.of(run, np.zeros_like(residual.values), by.swapaxes(0, 1), noise, None if course.static else course.time)
    return whole.by


def _normal(residual: Residual, columns: np.ndarray) -> Normal:
    first = residual.block - residual.block[0]
    rows = residual.values.size // len(first)
    starts = np.flatnonzero(np.diff(first, prepend=-1))
    ends = [*starts[1:], len(first)]
    values = residual.values.ravel()
    square, slope = np.empty((len(starts), columns.shape[1], columns.shape[1])), np.empty((len(starts), columns.shape[1]))
    for k, (start, end) in enumerate(zip(starts, ends, strict=True)):
        part = columns[rows * start : rows * end]
        square[k], slope[k] = part.T @ part, part.T @ values[rows * start : rows * end]
    squares = np.add.reduceat((residual.values**2).reshape(len(first), -1).sum(axis=1), starts)
    counts = np.add.reduceat(residual.present.reshape(len(first), -1).sum(axis=1), starts)
    return Normal(square, slope, squares, counts)
