"""A dead time of an input: shifted inputs, derivatives by its size, and a made valve whose dead time is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tepm_opt.data.run import Run, RunSet
from tepm_opt.discrepancy.adapters.callable_plant import Simulator
from tepm_opt.discrepancy.adapters.casadi_plant import CasadiPlant
from tepm_opt.discrepancy.adapters.equations import Equations
from tepm_opt.discrepancy.adapters.inputs import Between
from tepm_opt.discrepancy.laws.signals import INPUT
from tepm_opt.discrepancy.pipeline import discover
from tepm_opt.discrepancy.preparation.beginnings import remove_beginnings
from tepm_opt.errors import InputError
from tepm_opt.solvers.mechanics.plant import START
from tests.paths import SHARED

STEP, ROWS = 0.02, 300
DELAY = "time_delay[command].delay"
CASE = SHARED / "cases" / "21-valve-dead-time"


def valve(between: Between = "hold", substeps: int = 2) -> CasadiPlant:
    m = Equations("valve", time=0.5)
    p, u = m.state("pressure"), m.input("command", size=10.0, unit="psi")
    m.rate(p, (u - p) / m.parameter("lag", 0.3, "s", low=0.02, high=2.0))
    m.output("gauge", p, "psi", size=10.0)
    return m.plant(substeps, between)


def commands(rows: int = ROWS, seed: int = 0) -> np.ndarray:
    random, time = np.random.default_rng(seed), STEP * np.arange(rows)
    return 5 + sum(random.normal() * np.sin(w * time + random.uniform(0, 6)) for w in (0.7, 1.9, 4.0))


def run_of(u: np.ndarray, points: np.ndarray | None = None, name: str = "a.csv", **others: object) -> Run:
    rows = len(u)
    measured = np.zeros((rows, 1, 1)) if points is None else points
    return Run(name, "fit", STEP * np.arange(rows), u[:, None], np.zeros((rows, 3)), measured, **others)  # type: ignore[arg-type]


@pytest.mark.parametrize("between", ["hold", "line"])
@given(steps=st.integers(1, 60))
@settings(max_examples=8, deadline=None)
def test_a_dead_time_of_whole_steps_shifts_the_input(between: Between, steps: int) -> None:
    u = commands()
    shifted = np.append(np.full(steps, u[0]), u[:-steps])
    late = valve(between).with_values({DELAY: steps * STEP}).predict(run_of(u)).points
    np.testing.assert_allclose(late, valve(between).predict(run_of(shifted)).points, atol=1e-9)


@pytest.mark.parametrize(("between", "substeps"), [("hold", 1), ("line", 3), ("band", 2)])
@pytest.mark.parametrize("seconds", [0.0137, 0.4111])
def test_derivative_by_the_dead_time(between: Between, substeps: int, seconds: float) -> None:
    plant, run, h = valve(between, substeps), run_of(commands()), 1e-6
    found = plant.with_values({DELAY: seconds}).predict(run, [DELAY, "lag"])
    high, low = (plant.with_values({DELAY: seconds + sign * h}).predict(run).points for sign in (1, -1))
    np.testing.assert_allclose(found.by[0], (high - low) / (2 * h), atol=1e-5)
    assert np.abs(found.by[0]).max() > 0.1


def test_what_was_before_is_part_of_the_state() -> None:
    plant, run = valve().with_values({DELAY: 0.4}), run_of(commands(), start="measured")
    before = "command before"
    assert tuple(plant.states) == ("pressure", before)
    assert tuple(valve().states) == ("pressure",)
    late = replace(run, state=np.array([3.0, 3.0]))
    found = plant.predict(late, [START + before, START + "pressure"])
    assert found.points[:20, 0, 0] == pytest.approx(3.0), "it stays until what was commanded at the start acts"
    moved = plant.predict(replace(run, state=np.array([3.0, 3.5]))).points
    np.testing.assert_allclose(found.points + 0.5 * found.by[0], moved, atol=1e-9)


def test_a_function_is_told_that_it_has_no_past() -> None:
    from tepm_opt.data.signals import Signals

    law = next(law for law in INPUT if law.delays)
    with pytest.raises(InputError, match="time_delay needs the past"):
        Simulator("m", Signals.from_names(["u"], ["y"])).effects([law], "u", signal=1.0, time=1.0)


def test_beginnings_of_runs_at_work_are_left_out() -> None:
    left = np.full((1000, 1, 1), 0.1)
    left[:60] = 3.0
    u = commands(1000)
    points = u[:, None, None] + 0.0
    run = run_of(u, points, start="measured")
    other = run_of(u, points, "b.csv", start="measured")
    shorter, remarks = remove_beginnings(RunSet.from_runs("x", [run, other]), [points + left, points + 0.1], 0.05)
    assert [each.rows for each in shorter.runs] == [900, 1000]
    assert remarks[0].startswith("The first 2 s of a.csv are left out")
    rests = [replace(each, start="equilibrium") for each in (run, other)]
    assert remove_beginnings(RunSet.from_runs("x", rests), [points + left, points + 0.1], 0.05)[1] == []


@pytest.mark.slow
def test_a_made_valve_is_found() -> None:
    """Euler steps of 1 ms, dead time in a queue: nothing of the plant's own."""
    runs = []
    for k in range(4):
        u, fine, p = commands(1200, seed=k), 20, 5.0
        line, out = np.repeat(u, fine), []
        for i in range(len(line)):
            if i % fine == 0:
                out.append(p)
            p += 1e-3 / 0.25 * (line[max(i - 650, 0)] - p)
        noisy = np.array(out) + 0.05 * np.random.default_rng(9 + k).normal(size=len(u))
        role = "validation" if k == 3 else "fit"
        runs.append(replace(run_of(u, noisy[:, None, None], f"r{k}.csv", start="measured"), role=role))
    verdict = discover(RunSet.from_runs("made", runs), valve(), np.array([[0.05]])).verdict
    assert [named.candidate.label for named in verdict.effects] == ["time_delay[command]"]
    assert verdict.effects[0].parameters["delay"].value == pytest.approx(0.65, abs=0.02)


@pytest.mark.slow
def test_a_measured_valve_has_a_dead_time() -> None:
    if not CASE.exists():
        pytest.skip(f"cases of {SHARED} are not on this machine")
    from tepm_opt.data.trials import read_trials

    plant = valve()
    data = read_trials(CASE / "valve", plant.signals)
    verdict = discover(data, plant, data.noise).verdict
    assert "time_delay[command]" in [named.candidate.label for named in verdict.effects]
    assert verdict.errors.corrected * (1.0 if verdict.unit == "psi" else 0.05) < 0.45
