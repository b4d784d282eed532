"""How a plant that is simulated in no time is judged: by fits of its own to what is left when a part is taken away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.data.run import Run, RunSet
from tepm_opt.data.signals import Signals
from tepm_opt.discrepancy.adapters.equations import Equations
from tepm_opt.discrepancy.assessment.result import VerdictStatus
from tepm_opt.discrepancy.pipeline import discover
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.reporting.sentences import describe_extrapolation
from tepm_opt.discrepancy.selection.cross_validation import leave_out
from tepm_opt.discrepancy.selection.linearised import linearise
from tepm_opt.discrepancy.selection.screening import screen
from tepm_opt.solvers.identification.identify import Problem, identify
from tepm_opt.solvers.identification.residuals import Residual, independent_after

STEP, NOISE = 0.02, 0.01
FOLDS = SearchSettings().fold_count


def tank(**laws: object) -> Equations:
    """A level that falls by itself: ẋ = u - x / time."""
    m = Equations("tank", time=0.5, **laws)  # type: ignore[arg-type]
    level, inflow = m.state("level"), m.input("inflow", size=1.0)
    m.rate(level, inflow - m.parameter("leak", 2.0, "1/s", within=0.9) * level)
    m.output("level", level, "m", size=0.5)
    return m


def runs(count: int, leak: float, rows: int = 200, seed: int = 0) -> tuple[Run, ...]:
    """Exact levels under inflows that go in straight lines, with noise."""
    random, found = np.random.default_rng(seed), []
    for k in range(count):
        time = np.arange(rows) * STEP
        u = np.interp(time, np.linspace(0, time[-1], 12), random.uniform(0.2, 1.5, 12))
        x = np.empty(rows)
        x[0] = u[0] / leak
        for i in range(rows - 1):  # ẋ = a + b t - leak x, exactly
            b = (u[i + 1] - u[i]) / STEP
            settled = (u[i] - b / leak) / leak
            x[i + 1] = settled + b * STEP / leak + (x[i] - settled) * np.exp(-leak * STEP)
        points = (x + NOISE * random.normal(size=rows))[:, None, None]
        found.append(Run(f"r{k}.csv", "fit", time, u[:, None], np.zeros((rows, 3)), points))
    return tuple(found)


def problem(measured: tuple[Run, ...]) -> Problem:
    plant = tank(laws=()).plant()
    return Problem(plant, measured, plant.free(plant.known), NOISE)


@pytest.mark.parametrize("count", [FOLDS, 1])
def test_left_out_data_are_predicted_by_fits_to_the_rest(count: int) -> None:
    """Against fits that never saw a fold: whole runs, or parts of the one run there is."""
    asked = problem(runs(count, leak=2.6))
    estimate = identify(asked)
    found = leave_out(estimate, SearchSettings.for_plant(estimate.plant))
    fold = np.arange(count * 200) // 200 if count > 1 else np.arange(200) * 24 // 200 % FOLDS
    total = 0.0
    for k in range(FOLDS):
        hidden = (fold == k).reshape(count, 200)
        left = tuple(
            replace(run, points=np.where(rows[:, None, None], np.nan, run.points)) for run, rows in zip(asked.runs, hidden, strict=True)
        )
        other = identify(replace(asked, runs=tuple(run for run in left if np.isfinite(run.points).any())))
        total += sum(float(np.sum(r.values[rows] ** 2)) for r, rows in zip(asked.residuals(other.values, []), hidden, strict=True))
    assert found.squares.sum() == pytest.approx(total, rel=1e-4)
    assert found.squares.sum() > sum(r.squares for r in estimate.residuals)
    assert found.count == count * 200


def test_neighbours_in_time_count_as_what_they_say() -> None:
    """A coordinate is worth a block's share: as many independent measurements as there are blocks."""
    estimate = identify(replace(problem(runs(2, leak=2.6)), block=0.5))
    found = leave_out(estimate, SearchSettings.for_plant(estimate.plant))
    assert len(found.counts) == 2 * 8
    assert found.worth == pytest.approx(16 / 400)


@pytest.mark.parametrize("kept", [0.0, 0.6, 0.9])
def test_residuals_forget_after_their_integrated_correlation(kept: float) -> None:
    """An autoregressive sequence of order 1 has (1 + kept) / (1 - kept) samples."""
    random, rows = np.random.default_rng(3), 40_000
    values, noise = np.zeros(rows), random.normal(size=rows)
    for k in range(1, rows):
        values[k] = kept * values[k - 1] + noise[k]
    (run,) = runs(1, 2.0, rows=2)
    run = replace(run, time=np.arange(rows) * STEP, inputs=np.zeros((rows, 1)), tip_force=np.zeros((rows, 3)), points=values[:, None, None])
    residual = Residual.from_prediction(run, np.zeros((rows, 1, 1)), np.zeros((0, rows, 1, 1)), 1.0)
    assert independent_after([residual], [run]) / STEP == pytest.approx((1 + kept) / (1 - kept), rel=0.12)


def test_a_probe_is_judged_by_what_a_few_steps_gain() -> None:
    """A lag of the inflow, from probes of all sizes: the gain is real, the start is on the way to it."""
    machine, lag = tank().plant(), 0.15
    true = machine.with_values({"input_lag[inflow].time": lag, "leak": 2.3})
    measured = tuple(
        replace(run, points=true.predict(run).points + NOISE * np.random.default_rng(k).normal(size=(run.rows, 1, 1)))
        for k, run in enumerate(runs(4, 2.0))
    )
    estimate = identify(Problem(machine, measured, machine.free(machine.known), NOISE))
    settings = SearchSettings.for_plant(machine)
    scores = screen(linearise(estimate, estimate.problem.free, (), (), settings), settings, machine.candidates)
    score = next(s for s in scores if s.candidate.name == "input_lag")
    assert score.gain > 0.9
    assert score.start["input_lag[inflow].time"] == pytest.approx(lag, rel=0.3)
    assert score.start["leak"] == pytest.approx(2.3, rel=0.1), "what is known follows"


def test_no_probe_gains_more_than_there_is() -> None:
    """One of the runs that are simulated holds all of the misfit: shares are of what is there, as those of first order are."""
    machine = tank().plant()
    true = machine.with_values({"input_lag[inflow].time": 0.15})
    first, *others = runs(8, 2.0)
    measured = (replace(first, points=true.predict(first).points), *others)
    estimate = identify(Problem(machine, measured, machine.free(machine.known), NOISE))
    settings = SearchSettings.for_plant(machine)
    scores = screen(linearise(estimate, estimate.problem.free, (), (), settings), settings, [c for c in machine.candidates if not c.smooth])
    assert 0.5 < next(score.gain for score in scores if score.candidate.name == "input_lag") <= 1.05
    assert max(score.gain for score in scores) <= 1.05


def test_validation_beyond_what_was_fitted_to_is_told() -> None:
    near, far = runs(2, 2.0)
    signals = Signals.from_names(["inflow"], ["level"], "m")
    low, high = near.points.min(), near.points.max()
    far = replace(far, role="validation", inputs=near.inputs, points=np.full_like(far.points, (low + high) / 2 + 2.1 * (high - low) / 2))
    (line,) = describe_extrapolation(RunSet.from_runs("levels", [near, far]), signals)
    assert "r1.csv leaves the range fitted to: level goes 2.1 times as far" in line
    assert describe_extrapolation(RunSet.from_runs("levels", [near, replace(far, points=near.points)]), signals) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("values", "names"),
    [
        ({"input_gain[inflow].loss": 0.2}, {"input_gain", "sensor_gain"}),  # smooth: by first order
        ({"input_lag[inflow].time": 0.15}, {"input_lag", "sensor_lag"}),  # found in the runs that it helps
    ],
)
def test_an_effect_that_begins_between_runs_is_told_with_its_runs(values: dict[str, float], names: set[str]) -> None:
    """Before the tank and behind it are the same to the data: both are told, neither surely."""
    machine, random = tank().plant(), np.random.default_rng(7)
    measured = []
    for k, run in enumerate(runs(8, leak=2.0)):
        true = machine.with_values(values) if k >= 3 else machine
        points = true.predict(run).points + NOISE * random.normal(size=run.points.shape)
        measured.append(replace(run, points=points, role="validation" if k > 5 else "fit"))
    verdict = discover(RunSet.from_runs("tank", measured), tank().plant(), NOISE).verdict
    told = {each.candidate.name: each for each in verdict.effects if each.probability > 0.3}
    assert verdict.status is VerdictStatus.INDISTINGUISHABLE
    assert set(told) == names
    assert {each.candidate.runs for each in told.values()} == {("r3.csv", "r4.csv", "r5.csv")}
    (name,) = values
    assert told[name.partition("[")[0]].parameters[name.rpartition(".")[2]].value == pytest.approx(values[name], rel=0.05)
