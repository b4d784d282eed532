"""Small data sets made by the package's own simulation, for tests of what is done with data, not of how well it is explained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tepm_opt.data.datasets import DataSet, write_dataset
from tepm_opt.data.run import Run
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.mechanics.simulate import simulate
from tepm_opt.studies.blind.excitation import RATE, Excitation, excitations

NOISE = 3e-4  # m per axis
STEP = 5e-3  # s, shorter than any fit's
FACTORS = {"K_a": 1.02, "m_d": 0.985, "alpha_2": 1.03, "c_a": 0.9}  # of the robot file's values, within its priors
FILES = ("single_pressure.csv", "single_tension.csv", "elongation.csv", "mixed.csv")


def true_values(model: CompiledModel) -> dict[str, float]:
    """Parameters of a machine that differ from the robot file's."""
    return {name: factor * getattr(model.robot.parameters, name) for name, factor in FACTORS.items()}


def changed(model: CompiledModel, **values: float) -> CompiledModel:
    """The compiled model with other values of parameters by full name."""
    theta = model.theta.copy()
    for name, value in values.items():
        theta[model.network.parameter_names.index(name)] = value
    return model.with_theta(theta)


def planned(files: Sequence[str] = FILES, seed: int = 1) -> list[Excitation]:
    """Short runs by file name."""
    return [run for run in excitations(seed, short=True) if run.file in files]


def measured(model: CompiledModel, runs: Sequence[Excitation], seed: int = 1, noise: float = NOISE) -> list[Run]:
    """What a machine that is the model measures in runs."""
    random = np.random.default_rng(seed)
    found = []
    for run in runs:
        asked = run.setpoints
        points = simulate(model, asked, step=STEP).complete().points
        points = points + noise * random.normal(size=points.shape)
        found.append(Run(run.file, run.role, asked.time, asked.inputs, asked.tip_force, points))
    return found


def cut(run: Run, seconds: float) -> Run:
    """The beginning of a run."""
    kept = slice(round(seconds * RATE) + 1)
    return replace(run, time=run.time[kept], inputs=run.inputs[kept], tip_force=run.tip_force[kept], points=run.points[kept])


def dataset_of(model: CompiledModel, runs: Sequence[Run], noise: float | None = NOISE) -> DataSet:
    """A data set of `kang2017`."""
    return DataSet("small", "kang2017", channels_of(model.robot), tuple(runs), RATE, noise)


def write(dataset: DataSet, folder: Path) -> Path:
    """Write a data set, return its folder."""
    write_dataset(dataset, folder, overwrite=True)
    return folder
