"""Predictions of what runs should have measured, with their derivatives by a model's parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tepm_opt.data.run import Run
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.mechanics.plant import Prediction, PredictionError
from tepm_opt.solvers.mechanics.simulate import Directions, SimulationError, simulate
from tepm_opt.solvers.mechanics.statics import solve_statics
from tepm_opt.solvers.numerics.parallel import give_way, in_parallel

LONGEST_STEP = 0.02  # s: 0.01 mm RMS on the reference runs, up to 0.1 mm where inputs jump within a sample


def predict(model: CompiledModel, run: Run, names: Sequence[str] = (), static: bool = False, step: float = LONGEST_STEP) -> Prediction:
    """Reference points of a run as a model has them, from the equilibrium under the run's first row.

    Args:
        model: compiled model with its effects.
        run: its inputs and tip forces; its positions are not looked at.
        names: parameters by full name by which to differentiate.
        static: whether rows are equilibria, not samples of a motion.
        step: longest time step in s.

    Raises:
        InputError: no such parameter.
        PredictionError: the model has no stable equilibrium or no motion under these inputs, or they are outside the robot's limits.
    """
    telling = [name for name in names if name not in model.without_size]
    directions = Directions.from_names(model, telling)
    if static:
        found = _equilibria(model, run, directions)
    else:
        setpoints, along = SetPoints(run.time, run.inputs, run.tip_force), directions if telling else None
        try:
            motion = simulate(model, setpoints, step=step, directions=along, progress=_give_way, began=run.began).complete()
        except (SimulationError, InputError) as error:
            raise PredictionError(f"{run.file}: {error}") from error
        found = Prediction(motion.points, motion.sensitivities)
    if len(telling) == len(names):
        return found
    by = np.zeros((len(names), *found.points.shape))
    by[[name in telling for name in names]] = found.by
    return Prediction(found.points, by)


def predict_all(
    model: CompiledModel, runs: Sequence[Run], names: Sequence[str] = (), static: bool = False, step: float = LONGEST_STEP,
) -> list[Prediction]:  # fmt: skip
    """Predictions of several runs by `predict`, at once on the machine's cores.

    Args:
        model: compiled model with its effects.
        runs: their inputs and tip forces; their positions are not looked at.
        names: parameters by full name by which to differentiate.
        static: whether rows are equilibria, not samples of a motion.
        step: longest time step in s.

    Raises:
        InputError, PredictionError: as for `predict`.
    """
    return in_parallel(lambda run: predict(model, run, names, static, step), runs, lambda run: run.rows, model.is_c)


def _give_way(stage: str, done: float, of: float) -> None:
    """Let others work, as the progress of a run that nobody looks at."""
    give_way()


def _equilibria(model: CompiledModel, run: Run, directions: Directions) -> Prediction:
    layout = model.layout
    rows = np.eye(3 * layout.points, 3 * layout.points + layout.inputs // 2)
    points = np.empty((run.rows, layout.points, 3))
    by = np.zeros((len(directions.names), run.rows, layout.points, 3))
    last = None
    for row, (inputs, force) in enumerate(zip(run.inputs, run.tip_force, strict=True)):
        give_way()
        try:
            found = solve_statics(model, inputs, force, start=last)
        except InputError as error:
            raise PredictionError(f"{run.file}: set points: row {row + 1}: {str(error).removeprefix('inputs: ')}") from error
        if not found.solved:
            raise PredictionError(f"{run.file}: row {row + 1}: {found.outcome.message}")
        points[row], last = found.points, found
        if directions.names:
            _, _, _, by_theta = model.statics.sensitivity(found.x, found.load_case, rows, True)
            by[:, row] = (directions.parameters @ np.asarray(by_theta).T).reshape(-1, layout.points, 3)
    return Prediction(points, by)
