"""Parameters of a model or of any machine from data sets."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from tepm_opt.data.datasets import DataSet
from tepm_opt.data.files import output_folder, write_atomically
from tepm_opt.data.frames import Tabular
from tepm_opt.data.metrics import error_over_time
from tepm_opt.data.noise import noise_of
from tepm_opt.data.run import Run
from tepm_opt.data.trials import Trials, read_trials
from tepm_opt.discrepancy.adapters.network import with_selected_candidates
from tepm_opt.discrepancy.problem.plant import SearchablePlant
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.stages import with_initial_states
from tepm_opt.errors import InputError, unknown_name
from tepm_opt.jobs.advice import VALUES
from tepm_opt.jobs.discrepancy import MODEL, checked_dataset
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.model import write_model
from tepm_opt.outcome import Outcome
from tepm_opt.progress import Progress, silent
from tepm_opt.solvers.identification.identify import ParameterEstimate, Problem
from tepm_opt.solvers.identification.initial_state import predictions
from tepm_opt.solvers.identification.prior import JointPrior
from tepm_opt.solvers.identification.uncertainty import multi_start, profile, unidentifiable
from tepm_opt.solvers.mechanics.network_plant import NetworkPlant, free_parameters
from tepm_opt.solvers.mechanics.plant import Plant, PredictionError

SUMMARY, POSTERIOR = "identified.json", "posterior.json"
FAR = 1.5  # times the noise from which on residuals hold what no parameter explains
STEP = 0.005  # s; longer ones damp a little by themselves, which biases the damping found


def open_datasets(folders: Sequence[Path], despite_errors: bool = False) -> list[DataSet]:
    """Read data sets that are fitted together; their runs are named by folder and file.

    Args:
        folders: at least one.
        despite_errors: whether to go on where the check of the data finds errors.

    Raises:
        InputError: the check of one finds errors, they are of different robots, or some are static and some not.
    """
    found = []
    for folder in folders:
        dataset, _ = checked_dataset(folder, despite_errors)
        runs = tuple(replace(run, file=f"{folder.name}/{run.file}") for run in dataset.runs)
        found.append(replace(dataset, runs=runs))
        if dataset.channels != found[0].channels:
            raise InputError(
                f"{folder}: its robot {dataset.robot} has other channels than that of {folders[0]}; identify one robot at a time"
            )
        if dataset.static != found[0].static:
            raise InputError(f"{folder}: static data and motion cannot be fitted together; identify from one kind, then from the other")
    return found


def open_trials(folders: Sequence[Path], plant: SearchablePlant) -> list[Trials]:
    """Read data sets of a plant's machine that are fitted together; their runs are named by folder and file.

    Args:
        folders: at least one.
        plant: says which columns are inputs and outputs.

    Raises:
        InputError: see `read_trials`.
    """
    found = [(folder, read_trials(folder, plant.signals, plant.static)) for folder in folders]
    return [replace(each, runs=tuple(replace(run, file=f"{folder.name}/{run.file}") for run in each.runs)) for folder, each in found]


@dataclass(frozen=True, eq=False)
class IdentifyRun(Tabular):
    """Parameters fitted to measured runs, judged on others.

    Attributes:
        before: the model before, or the plant.
        estimate: what was found.
        intervals: of 95 %, lowest and highest value by the parameter's name, within its bounds.
        validation: error on runs not fitted to, "before" and "after": Eq. (5) over time in m, of a plant the root mean square over the
            noise; None where there are none.
        cannot_tell: what the runs cannot tell, a line each.
    """

    before: CompiledModel | SearchablePlant
    estimate: ParameterEstimate
    intervals: dict[str, tuple[float, float]]
    validation: dict[str, float | None]
    cannot_tell: list[str]

    def __repr__(self) -> str:
        names = ", ".join(free.name for free in self.estimate.problem.free)
        return f"<IdentifyRun {self.outcome}; {names} of {self.machine}>"

    @property
    def machine(self) -> str:
        """Name of the robot or the plant."""
        return self.before.robot.name if isinstance(self.before, CompiledModel) else self.before.name

    @property
    def outcome(self) -> Outcome:
        """Outcome of the fit."""
        return self.estimate.outcome

    @property
    def ok(self) -> bool:
        """Whether the fit converged and nothing speaks against the model."""
        return self.outcome.solved and not self.doubts

    @property
    def over_noise(self) -> float:
        """Residual over noise, both root mean squares."""
        return float(np.sqrt(self.estimate.cost / max(self.estimate.count, 1)))

    @property
    def posterior(self) -> JointPrior:
        """Joint distribution of the parameters."""
        free = self.estimate.problem.free
        return JointPrior(tuple(f.name for f in free), self.estimate.values, self.estimate.covariance, units=tuple(f.unit for f in free))

    @property
    def doubts(self) -> list[str]:
        """Signs that the parameters stand in for something that the model lacks, a line each."""
        found = []
        if self.over_noise > FAR:
            found.append(f"residuals are {self.over_noise:.3g} times the noise: these parameters do not explain the runs")
        free = zip(self.estimate.problem.free, self.estimate.at_bound, strict=True)
        if bound := [each.name for each, at in free if at and not each.refines]:
            found.append(f"at the end of what is thought possible: {', '.join(bound)}: they may stand in for something else")
        return found

    def summary(self) -> dict[str, Any]:
        """Numbers of the fit."""
        estimate, values = self.estimate, {}
        correlation = estimate.covariance / np.maximum(np.outer(estimate.std, estimate.std), 1e-300)
        for k, free in enumerate(estimate.problem.free):
            low, high = self.intervals[free.name]
            values[free.name] = {
                "value": float(estimate.values[k]), "std": float(estimate.std[k]), "low": low, "high": high, "unit": free.unit,
                "before": self.before.values[free.name], "at_bound": bool(estimate.at_bound[k]),
            }  # fmt: skip
        return {
            "parameters": values,
            "correlation": correlation.round(4).tolist(),
            "residual_over_noise": self.over_noise,
            "validation_rmse_m" if isinstance(self.before, CompiledModel) else "validation_over_noise": self.validation,
            "cannot_tell": self.cannot_tell,
            "iterations": estimate.iterations,
            "converged": self.outcome.solved,
            "doubts": self.doubts,
            "message": self.outcome.message,
        }

    def columns(self) -> dict[str, np.ndarray]:
        """Parameters as `summary` has them, a row each."""
        found = self.summary()["parameters"]
        columns = {key: np.array([value[key] for value in found.values()]) for key in next(iter(found.values()), {})}
        return {"parameter": np.array(list(found)), **columns}

    def save(self, folder: str | Path) -> None:
        """Write identified.json, posterior.json, and model.toml, for --model of every command, or of a plant values.json.

        Raises:
            InputError: the folder cannot be written to.
        """
        folder = output_folder(folder)
        if isinstance(self.before, CompiledModel):
            write_model(with_selected_candidates(self.before.model, self.estimate.plant.values, ()), folder / MODEL)
        else:
            write_atomically(folder / VALUES, json.dumps(self.estimate.named, indent=2) + "\n")
        write_atomically(folder / SUMMARY, json.dumps(self.summary(), indent=2) + "\n")
        write_atomically(folder / POSTERIOR, json.dumps(self.posterior.as_json(), indent=2) + "\n")


@dataclass(frozen=True)
class FitOptions:
    """Options of a fit of parameters.

    Attributes:
        starts: number of fits, all but the first from random values; the best counts.
        profiles: whether to find profile intervals: slower, right where bounds are near.
        robust: whether outliers are weighted down.
        seed: of the random starts.
        prior: joint distribution of some of the parameters that other data tell, such as an earlier fit's posterior; None for none.
    """

    starts: int = 1
    profiles: bool = False
    robust: bool = True
    seed: int = 0
    prior: JointPrior | None = None


def run_identify(
    model: CompiledModel,
    datasets: Sequence[DataSet],
    parameters: Sequence[str] | None = None,
    options: FitOptions | None = None,
    progress: Progress = silent,
    executor: Executor | None = None,
) -> IdentifyRun:
    """Fit parameters to the runs of role fit within their priors and judge them on those of role validation.

    Args:
        model: compiled model.
        datasets: of its robot, as `open_datasets` reads them.
        parameters: full names of those to fit; those with priors where absent.
        options: of the fit.
        progress: told what is being done.
        executor: where the fits run; here, one after the other, where None.

    Raises:
        InputError: nothing to fit, an unknown parameter, fewer than one start, or a model that cannot do the runs.
    """
    options = options or FitOptions()
    free = free_parameters(model, parameters)
    if not free:
        raise InputError(f"robot {model.robot.name} has no priors: name the parameters to fit")
    runs = [(run, noise_of(dataset)) for dataset in datasets for run in dataset.fit]
    plant, noise = NetworkPlant(model, datasets[0].static), tuple(sigma for _, sigma in runs)
    problem = Problem(plant, tuple(run for run, _ in runs), free, noise, options.robust, STEP)
    judged = [run for dataset in datasets for run in dataset.validation]
    return _fit(model, problem, lambda plant: _error(plant, judged), options, progress, executor)


def run_identify_plant(
    plant: SearchablePlant,
    datasets: Sequence[Trials],
    parameters: Sequence[str] | None = None,
    options: FitOptions | None = None,
    progress: Progress = silent,
) -> IdentifyRun:
    """Fit values of any machine that are known roughly, as `run_identify` does of a robot.

    Args:
        plant: of a plant file.
        datasets: as `open_trials` reads them.
        parameters: names of those to fit; all known ones where absent.
        options: of the fit.
        progress: told what is being done.

    Raises:
        InputError: nothing to fit, an unknown parameter, fewer than one start, or a plant that cannot do the runs.
    """
    options = options or FitOptions()
    if not plant.known:
        raise InputError(f"{plant.name}: nothing to fit; valid: a plant with m.parameter(…) for each value that is known roughly")
    for name in parameters or ():
        if name not in plant.known:
            raise unknown_name("parameter", name, plant.known)
    runs = [(run, dataset.noise) for dataset in datasets for run in dataset.fit]
    if not runs:
        raise InputError(f"{datasets[0].name}: no run has the role 'fit'; there is nothing to learn from")
    free, noise = plant.free(list(parameters or plant.known)), tuple(sigma for _, sigma in runs)
    plain, apart = plant.without_candidates, plant.derivatives_apart
    problem = Problem(plain, tuple(run for run, _ in runs), free, noise, options.robust, derivatives_apart=apart)
    judged = [(run, dataset.noise) for dataset in datasets for run in dataset.validation]
    problem = with_initial_states(problem, SearchSettings.for_plant(plant))
    return _fit(plant, problem, lambda plant: _error_over_noise(plant, judged), options, progress)


@threadpool_limits.wrap(limits=1, user_api="blas")  # the cores have runs to simulate; and numbers do not depend on how many there are
def _fit(
    model: CompiledModel | SearchablePlant, problem: Problem, error: Callable[[Plant], float | None], options: FitOptions,
    progress: Progress, executor: Executor | None = None,
) -> IdentifyRun:  # fmt: skip
    """Fit the parameters of a problem and judge them by an error on other runs."""
    if options.starts < 1:
        raise InputError(f"starts {options.starts}; valid: at least 1")
    if options.prior is not None:
        fitted = [free.name for free in problem.free]
        if not set(fitted) & set(options.prior.names):
            raise unknown_name("parameter", next(iter(options.prior.names), ""), fitted, "prior")
        problem = replace(problem, joint=options.prior)
    try:
        progress("compiling the motion", 0, 0)
        estimate = multi_start(problem, options.starts, options.seed, progress=progress, executor=executor)
        progress("judging", 0, 0)
        intervals = _intervals(estimate, options.profiles)
        validation = {name: error(which) for name, which in (("before", problem.plant), ("after", estimate.plant))}
        return IdentifyRun(model, estimate, intervals, validation, unidentifiable(estimate))
    except PredictionError as failure:
        raise InputError(f"the model cannot do the runs: {failure}") from failure


def _intervals(estimate: ParameterEstimate, profiles: bool) -> dict[str, tuple[float, float]]:
    """Intervals of 95 % within the bounds, by profiles or from the standard deviations."""
    found = {}
    for free, value, std in zip(estimate.problem.free, estimate.values, estimate.std, strict=True):
        low, high = profile(estimate, free.name) if profiles else (float(value - 1.96 * std), float(value + 1.96 * std))
        found[free.name] = max(low, free.low), min(high, free.high)
    return found


def _error(plant: Plant, runs: Sequence[Run]) -> float | None:
    """Eq. (5) over time on runs not fitted to; None where there are none."""
    if not runs:
        return None
    found = predictions(plant, runs, 1.0)
    return error_over_time(np.concatenate([run.points for run in runs]), np.concatenate([each.points for each in found]))


def _error_over_noise(plant: Plant, judged: Sequence[tuple[Run, np.ndarray]]) -> float | None:
    """Root mean square error over the noise on runs not fitted to; None where there are none."""
    parts = [((run.points - predictions(plant, [run], noise)[0].points) / noise).ravel() for run, noise in judged]
    return float(np.sqrt(np.nanmean(np.square(np.concatenate(parts))))) if parts else None
