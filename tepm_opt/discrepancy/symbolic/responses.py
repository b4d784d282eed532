"""First-order responses of the measured points to laws at many places, from one pass through the runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tepm_opt.data.run import Run, thin_out
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.discrepancy.problem.plant import Network
from tepm_opt.discrepancy.symbolic.places import ALL, Course, Place
from tepm_opt.discrepancy.symbolic.settings import DEFAULT, SymbolicSettings
from tepm_opt.errors import InputError
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.identification.identify import ParameterEstimate
from tepm_opt.solvers.identification.residuals import Residual
from tepm_opt.solvers.mechanics.plant import PredictionError
from tepm_opt.solvers.mechanics.simulate import Directions, Simulation, SimulationError, simulate
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.numerics.parallel import in_parallel


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


def simulate_courses(plant: Network, runs: Sequence[Run], settings: SymbolicSettings = DEFAULT) -> list[Course]:
    """Simulate runs with a network, at the samples of the first-order pass.

    Raises:
        PredictionError: the plant cannot do a run.
    """
    model, step = plant.model, settings.sample_spacing

    def follow(run: Run) -> Course:
        if plant.static:
            held = _equilibria(model, run)
            return Course(model, run, np.stack([h.points for h in held]), np.stack([h.lengths.ravel() for h in held]), static=True)
        sparse = thin_out(run, step)
        found = _simulate_run(model, sparse, step)
        return Course(model, sparse, found.points, found.lengths)

    return in_parallel(follow, runs, lambda run: run.rows, plant.concurrent)


def _simulate_run(model: CompiledModel, run: Run, step: float, directions: Directions | None = None) -> Simulation:
    setpoints = SetPoints(run.time, run.inputs, run.tip_force)
    try:
        return simulate(model, setpoints, step=step, directions=directions, began=run.began).complete()
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


def point_responses(
    course: Course, places: Sequence[Place], free: Sequence[str], settings: SymbolicSettings = DEFAULT
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Change of the points with the free parameters, (samples, parameters, points, 3), and with each place's coefficients.

    A law of all actuators alike is the sum of those of each, where both are asked for with the same shape.

    Args:
        course: the run, and the model with the values that hold.
        places: where laws may act.
        free: parameters by full name.
        settings: of the search.
    """
    model, samples = course.model, course.run.rows
    layout = model.layout
    alone = {p.of for p in places if p.kind == "axial" and p.target != ALL}
    summed = [p for p in places if p.kind == "axial" and p.target == ALL and p.of in alone]
    acting = [p for p in places if p.kind != "measurement" and p not in summed]
    ends = np.cumsum([len(free), *(place.size for place in acting)])
    inputs, loads = np.zeros((samples, ends[-1], layout.inputs)), np.zeros((samples, ends[-1], layout.points, 3))
    for place, end in zip(acting, ends[1:], strict=True):
        at = slice(end - place.size, end)
        if place.kind == "axial":
            inputs[:, at, : layout.inputs // 2] = place.columns(course) / model.values["A"]
        else:
            loads[:, at] = place.columns(course)
    theta = np.vstack([Directions.from_names(model, free).parameters, np.zeros((ends[-1] - len(free), len(model.theta)))])
    found = _responses_along(course, theta, inputs, loads, settings.sample_spacing)
    known = {p: found[:, end - p.size : end] for p, end in zip(acting, ends[1:], strict=True)}
    known |= {place: np.sum([known[p] for p in acting if p.kind == "axial" and p.of == place.of], axis=0) for place in summed}
    known |= {p: p.columns(course) for p in places if p.kind == "measurement"}
    return found[:, : len(free)], [known[place] for place in places]


def _responses_along(course: Course, theta: np.ndarray, inputs: np.ndarray, loads: np.ndarray, step: float) -> np.ndarray:
    """Change of the points along directions, (samples, directions, points, 3).

    Args:
        course: the run and its model.
        theta: change of the parameters, (directions, parameters).
        inputs: change of the inputs, (samples, directions, inputs) in Pa or N.
        loads: change of the forces on points, (samples, directions, points, 3) in N.
        step: longest time step in s.
    """
    model, layout = course.model, course.model.layout
    if not course.static:
        directions = Directions(tuple(map(str, range(len(theta)))), theta, inputs, loads)
        return np.moveaxis(_simulate_run(model, course.run, step, directions).sensitivities, 0, 1)
    rows, found = np.eye(3 * layout.points, 3 * layout.points + layout.inputs // 2), []
    for k, held in enumerate(_equilibria(model, course.run)):
        _, by_u, by_load, by_theta = model.statics.sensitivity(held.x, held.load_case, rows, True)
        along = theta @ np.asarray(by_theta).T + inputs[k] @ by_u.T + loads[k].reshape(len(theta), -1) @ by_load.T
        found.append(along.reshape(len(theta), layout.points, 3))
    return np.stack(found)


def normal_equations_by_place(
    estimate: ParameterEstimate, made: Sequence[Course], places: Sequence[Place], settings: SymbolicSettings = DEFAULT
) -> list[list[Normal]]:
    """Normal equations of every place and every run, [place][run].

    Args:
        estimate: the fit whose residuals are explained.
        made: its runs as its model does them.
        places: where laws may act.
        settings: of the search.
    """
    problem, free = estimate.problem, [f.name for f in estimate.problem.free]

    def of_run(work: tuple[Run, Residual, Course, float | np.ndarray]) -> list[Normal]:
        run, residual, course, noise = work
        by_free, by_place = point_responses(course, places, free, settings)
        still = _columns(run, residual, course, by_free, noise)
        return [_normal(residual, np.hstack([still, _columns(run, residual, course, by, noise)])) for by in by_place]

    work = list(zip(problem.runs, estimate.residuals, made, problem.noises, strict=True))
    found = in_parallel(of_run, work, lambda one: one[0].rows, problem.plant.concurrent)
    return [list(of_place) for of_place in zip(*found, strict=True)]


def _columns(run: Run, residual: Residual, course: Course, by: np.ndarray, noise: float | np.ndarray) -> np.ndarray:
    """Change of a run's residuals, (coordinates, columns), from that of the points at the samples of the pass."""
    return Residual.from_prediction(
        run, np.zeros_like(residual.values), by.swapaxes(0, 1), noise, None if course.static else course.time
    ).by


def _normal(residual: Residual, columns: np.ndarray) -> Normal:
    """Normal equations of a run's blocks, for columns as of `_columns`."""
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
