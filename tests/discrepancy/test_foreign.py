"""Runs from another set-up, of two masses on springs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.data.run import Run, RunSet
from tepm_opt.discrepancy.adapters.casadi_plant import CasadiPlant
from tepm_opt.discrepancy.assessment.result import Named, VerdictStatus
from tepm_opt.discrepancy.pipeline import discover
from tepm_opt.discrepancy.problem.plant import Candidate
from tepm_opt.discrepancy.reporting.report import _is_another_machine
from tepm_opt.discrepancy.setup.foreign import is_outermost, odd_run
from tests.discrepancy.test_setup import two_masses

NOISE = 2e-4


def recorded(plant: CasadiPlant, number: int, size: float = 1.0) -> Run:
    """A run with sines of its own on both inputs."""
    random, time = np.random.default_rng(number), np.arange(0, 8, 0.02)
    waves = [np.sin(random.uniform(1, 4) * time + phase) - np.sin(phase) for phase in random.uniform(0, 6, 4)]
    inputs = size * np.stack([waves[0] + waves[1], waves[2] + waves[3]], axis=1)
    asked = Run(f"{number}.csv", "validation" if number == 5 else "fit", time, inputs, np.zeros((400, 3)), np.zeros((400, 2, 1)))
    points = plant.predict(asked).points
    return replace(asked, points=points + NOISE * random.normal(size=points.shape))


@pytest.mark.slow
def test_a_run_of_another_machine_is_told_and_left_out() -> None:
    """Its springs are not those of the other five runs, to whose model nothing is missing then."""
    plant, other = two_masses(), two_masses().with_values({"spring": 60.0, "between": 20.0})
    runs = [recorded(other if number == 2 else plant, number) for number in range(6)]
    verdict = discover(RunSet.from_runs("two masses", runs), plant, NOISE).verdict
    assert verdict.status is VerdictStatus.SETUP_ERROR
    assert [(error.kind, error.channels) for error in verdict.setup] == [("foreign_run", ("2.csv",))]
    assert not verdict.effects
    assert abs(verdict.recalibrated["spring"].value - 40.0) < 3 * verdict.recalibrated["spring"].std


@pytest.mark.parametrize(("size", "number"), [(1.0, 2), (3.0, None)])
def test_what_goes_where_no_other_run_does_is_not_foreign(size: float, number: int | None) -> None:
    """What the model misses in larger motions alone may be physics that begins there."""
    plant = two_masses()
    runs = [recorded(plant, k, size if k == 2 else 1.0) for k in range(6)]
    most = np.max([np.abs(run.inputs) for k, run in enumerate(runs) if k != 2])
    beyond = (np.abs(runs[2].inputs).max(axis=1) > most) if number is None else np.full(400, True)
    runs[2] = replace(runs[2], points=runs[2].points * np.where(beyond, 1.2, 1.0)[:, None, None])
    found = odd_run(runs, [plant.predict(run).points for run in runs], NOISE)
    assert (found and found[0]) == number


def test_first_and_last_runs_of_a_session_are_outermost() -> None:
    runs = [replace(recorded(two_masses(), number), began=began) for number, began in enumerate((10.0, 0.0, 30.0, 20.0))]
    assert [is_outermost(runs, number) for number in range(4)] == [False, True, True, False]
    assert not is_outermost([replace(run, began=0.0) for run in runs], 2), "where nobody says when a run was made"


@pytest.mark.parametrize(("probability", "is_told"), [(0.95, True), (0.69, False)])
def test_a_value_of_its_own_that_is_unclear_blames_no_run(probability: float, is_told: bool) -> None:
    """A verdict that doubts what differs in a run does not call the run foreign."""
    plant = two_masses()
    runs = [recorded(plant, number) for number in range(3)]
    effect = Candidate("parameter", "spring", {"parameter[spring].value": 40.0}, part="parameter")
    named = Named(effect, probability, {}, 0.5, ("2.csv",))
    assert _is_another_machine(named, runs) is is_told
