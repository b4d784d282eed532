"""A run of an arm that carries more than its model, as a data set with a verdict on it."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from tepm_opt.data.datasets import DataSet, write_dataset
from tepm_opt.data.run import Run
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import CompiledModel, compile_model
from tepm_opt.models.model import Model, write_model
from tepm_opt.solvers.mechanics.simulate import simulate

KNOWN = Model.from_robot("kang2017")
HEAVY = KNOWN.with_effect("payload", None, mass=0.03)
VERDICT = {
    "status": "named",
    "effects": [{"name": "payload", "detail": None, "probability": 0.998, "parameters": {}}],
    "paragraph": "Missing: payload.",
    "table": [["effect", "size ± std", "probability", "gap only it closes"], ["payload", "mass 30 ± 1 g", "1.00", "100 %"]],
    "answer": "The arm carries more than the model: ![no](picture.png).",
    "data": ["../bench"],
    "model": None,
}


@cache
def heavy() -> CompiledModel:
    """The arm that was measured."""
    return compile_model(HEAVY)


@cache
def bend(noise: float = 0.0, samples: int = 60) -> Run:
    """One second of bending, with or without noise in m; a point is lost at the third row."""
    time = 0.02 * np.arange(samples)
    inputs = np.zeros((samples, 12))
    inputs[:, [2, 5]] = 8e4 * np.clip(time, 0, 1)[:, None]
    motion = simulate(heavy(), SetPoints(time, inputs, np.zeros((samples, 3))))
    points = motion.points + noise * np.random.default_rng(0).normal(size=motion.points.shape)
    points[2, 1] = np.nan
    return Run("bend.csv", "fit", time, inputs, np.zeros((samples, 3)), points)


def write(folder: Path) -> Path:
    """Folders "bench" (the data set) and "found" (the verdict) in a folder; the latter's path."""
    run = bend(3e-4)
    judging = replace(run, file="other.csv", role="validation")
    write_dataset(DataSet("a bench", "kang2017", channels_of(KNOWN.robot), (run, judging), 50.0, 3e-4), folder / "bench")
    found = folder / "found"
    found.mkdir()
    write_model(HEAVY, found / "model.toml")
    (found / "verdict.json").write_text(json.dumps(VERDICT), encoding="utf-8")
    return found
