"""Runs that do not begin at rest: the state that they begin with, from what they measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.solvers.identification.residuals import Residual
from tepm_opt.solvers.mechanics.plant import START, Plant, Prediction, PredictionError
from tepm_opt.solvers.numerics.parallel import in_parallel

FIRST = 20  # samples that tell a state where a run begins as "measured"
STEPS, NEAR, SHORTER = 8, 2, 4  # of Gauss and Newton: from anywhere, from a guess, and shortenings of each
TINY = 1e-100  # times the noise, per unit of a state: nothing that can be told
STILL = 0.01, 1e-6  # of the noise's square, and of all squares: a step that promises less is not made; projection takes what it promises


def with_estimated_initial_state(plant: Plant, run: Run, noise: float | np.ndarray, step: float = np.inf) -> Run:
    """The run with the state that explains its first samples best, or all of them where it is free; as it is where it begins at rest.

    Args:
        plant: the model.
        run: what was measured; a state that it has is a guess.
        noise: of what is measured, 1 sigma per axis, or of each point, (points, 1).
        step: longest time step in s.

    Raises:
        PredictionError: the model cannot do the run.
    """
    if run.start == "equilibrium" or not plant.states:
        return run
    known = run.state is not None and len(run.state) == len(plant.states)  # another model may begin with more or less
    steps = NEAR if known else STEPS
    guess = np.array(list(plant.states.values())) if run.state is None or not known else run.state
    if run.start == "measured":
        return replace(run, state=_fit_state(plant, first(run, FIRST), noise, step, guess, steps))
    if not known:
        guess = _fit_state(plant, first(run, FIRST), noise, step, guess, steps)
    return replace(run, state=_fit_state(plant, run, noise, step, guess, steps))


def _fit_state(plant: Plant, run: Run, noise: float | np.ndarray, step: float, state: np.ndarray, steps: int) -> np.ndarray:
    """Fit the first state that explains a run best, from a guess: so many steps of Gauss and Newton, shortened where they fail."""
    names = [START + name for name in plant.states]
    left = _compute_residual(plant, run, noise, step, state, names)
    for _ in range(steps):
        scale = np.linalg.norm(left.by, axis=0)
        scale[scale < TINY] = 1.0  # a state that does not show stays
        change = -np.linalg.lstsq(left.by / scale, left.values.ravel(), rcond=1e-10)[0] / scale
        promised = left.squares - float(np.sum((left.values.ravel() + left.by @ change) ** 2))
        if promised < STILL[0] + STILL[1] * left.squares:
            break
        for _ in range(SHORTER):
            tried = _try_residual(plant, run, noise, step, state + change, names)
            if tried is not None and tried.squares < left.squares:
                break
            change = change / 4
        else:
            break
        state, left = state + change, tried
    return state


def _try_residual(
    plant: Plant, run: Run, noise: float | np.ndarray, step: float, state: np.ndarray, names: Sequence[str]
) -> Residual | None:
    """Residuals as of `_compute_residual`; None where the model cannot go from that state."""
    try:
        return _compute_residual(plant, run, noise, step, state, names)
    except PredictionError:
        return None


def _compute_residual(plant: Plant, run: Run, noise: float | np.ndarray, step: float, state: np.ndarray, names: Sequence[str]) -> Residual:
    """Residuals of a run that begins in a state, with their derivatives by that state."""
    found = plant.predict(replace(run, state=state), names, step)
    return Residual.from_prediction(run, found.points, found.by, noise)


def first(run: Run, rows: int) -> Run:
    """The first rows of a run."""
    return replace(
        run, time=run.time[:rows], inputs=run.inputs[:rows], tip_force=run.tip_force[:rows], points=run.points[:rows], extra={}, lines=()
    )


def without_start(residual: Residual, states: int) -> Residual:
    """Residuals whose last derivatives are those by the run's first state, as they are with the best state for whatever parameters.

    Variable projection (Golub and Pereyra 1973): what a change of the state can do is taken out of residuals and derivatives.
    """
    by, own = residual.by[:, :-states], residual.by[:, -states:]
    basis, size, _ = np.linalg.svd(own, full_matrices=False)
    basis = basis[:, size > 1e-9 * size.max(initial=1e-300)]
    values = residual.values.ravel()
    values = values - basis @ (basis.T @ values)
    return replace(residual, values=values.reshape(residual.values.shape), by=by - basis @ (basis.T @ by))


def predictions(plant: Plant, runs: Sequence[Run], noise: float | np.ndarray, step: float = np.inf) -> list[Prediction]:
    """Predictions of several runs, each from where it begins, at once on the machine's cores where the plant allows it.

    Args:
        plant: a model with values.
        runs: measured.
        noise: of what is measured, 1 sigma.
        step: longest time step in s.
    """
    return in_parallel(
        lambda run: plant.predict(with_estimated_initial_state(plant, run, noise, step), (), step),
        runs,
        lambda run: run.rows,
        plant.concurrent,
    )
