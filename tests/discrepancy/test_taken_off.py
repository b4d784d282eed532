"""What hung on the machine while the fit runs were recorded, and hangs there no more in the validation run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from tepm_opt.data.run import Role, Run, RunSet
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.adapters.callable_plant import Simulator
from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.laws.effect import Law, Quantity
from tepm_opt.discrepancy.pipeline import discover

NOISE = 1e-3
WEIGHT = "load[hook].weight"


def deflection(run: Run, values: Mapping[str, Any]) -> np.ndarray:
    """Of a spring with a weight on its hook."""
    return values["compliance"] * (run.inputs[:, 0] + values[WEIGHT])


def recorded(role: Role, seed: int, weight: float) -> Run:
    """A run with this weight."""
    random, rows = np.random.default_rng(seed), 300
    inputs = random.uniform(0.2, 1, (rows, 1))
    run = Run(f"{role}.csv", role, np.full(rows, np.nan), inputs, np.zeros((rows, 3)), np.zeros((rows, 1, 1)))
    points = deflection(run, {"compliance": 1.02, WEIGHT: weight}) + NOISE * random.normal(size=rows)
    return Run(run.file, role, run.time, inputs, run.tip_force, points[:, None, None])


@pytest.mark.parametrize(
    ("weight", "status", "runs"),
    [
        (0.1, VerdictStatus.NAMED, ()),
        (0.0, VerdictStatus.NAMED, ("fit.csv",)),
        (-0.1, VerdictStatus.PARTIAL, ("fit.csv",)),  # without it there the gap is as wide as before
    ],
)
def test_an_effect_that_is_absent_from_the_validation_run(weight: float, status: VerdictStatus, runs: tuple[str, ...]) -> None:
    m = Simulator("a spring", Signals.from_names(["force"], ["deflection"]))
    m.parameter("compliance", 1.0, std=0.05)
    m.effects([Law("load", "body", (Quantity("weight", "signal", 0.0, (0.01,), -1.0, 1.0),))], "hook", signal=1.0)
    dataset = RunSet.from_runs("hook", [recorded("fit", 1, 0.1), recorded("validation", 2, weight)])
    found = discover(dataset, m.plant(deflection, static=True), NOISE).verdict
    assert found.status is status
    [effect] = found.effects
    assert effect.runs == runs
    if status is VerdictStatus.NAMED:
        assert found.errors.corrected == pytest.approx(found.errors.noise_floor, rel=0.2)
