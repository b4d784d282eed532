"""A small data set made by hand: a robot of kang2017's size that bends and stretches with a lag, tracker noise of 0.3 mm."""

from __future__ import annotations

import numpy as np

from tepm_opt.data.channels import Channels
from tepm_opt.data.datasets import DataSet
from tepm_opt.data.run import Role, Run

ANGLES = np.deg2rad([90.0, 210.0, 330.0])
BASE = np.array([0.0, 0.0, -0.05])
LIMITS = np.repeat([5e5, 7.0], 6)
ACTUATORS, POINTS = ("11", "12", "13", "21", "22", "23"), ("s1", "s2", "s3", "s4")
NAMES = Channels(ACTUATORS, POINTS)
CHANNELS = Channels(ACTUATORS, POINTS, 5e5, 7.0, 0.4, (0.0, 0.0, -0.05))
RATE, LAG = 50.0, 0.15


def shape(inputs: np.ndarray) -> np.ndarray:
    """Points (4, 3) in m under u (12,) once it has settled."""
    parts = inputs / LIMITS
    pull = (parts[:6] - parts[6:]).reshape(2, 3).sum(axis=0)
    height = 0.1 * np.arange(1, 5)
    points = np.empty((4, 3))
    points[:, :2] = 0.8 * height[:, None] ** 2 * [pull @ np.cos(ANGLES), pull @ np.sin(ANGLES)]
    points[:, 2] = height * (1 + 0.1 * pull.sum())
    return points + BASE


def make_run(file: str, role: Role, seed: int, rows: int = 300, noise: float = 3e-4) -> Run:
    """Steps of some inputs after a second of rest."""
    random = np.random.default_rng(seed)
    time = np.arange(rows) / RATE
    inputs = np.tile(np.repeat([1e5, 0.0], 6), (rows, 1))
    for start in range(50, rows, 60):
        inputs[start : start + 40, random.integers(6)] = random.uniform(1.5e5, 2.5e5)
        inputs[start : start + 40, 6 + random.integers(6)] = random.uniform(1.0, 3.0)
    state, points = inputs[0].copy(), np.empty((rows, 4, 3))
    for k in range(rows):
        points[k] = shape(state)
        state += (1 - np.exp(-1 / RATE / LAG)) * (inputs[k] - state)
    points += noise * random.normal(size=points.shape)
    return Run(file, role, time, inputs, np.zeros((rows, 3)), points)


def make_dataset(noise: float = 3e-4) -> DataSet:
    """A run to fit to and one to judge by."""
    runs = (make_run("steps.csv", "fit", 1, noise=noise), make_run("other.csv", "validation", 2, noise=noise))
    return DataSet("made", "kang2017", NAMES, runs, RATE, noise)
