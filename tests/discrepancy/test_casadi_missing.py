"""Runs with missing samples, and effects that are not there: neither changes what is predicted elsewhere."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.casadi_plant import CasadiPlant
from tepm_opt.discrepancy.adapters.equations import Equations
from tepm_opt.solvers.mechanics.plant import START

TIME = np.arange(0, 6.0, 0.02)
ROWS = np.delete(np.arange(len(TIME)), [*range(40, 44), *range(100, 140), 200])  # what is left of the samples


def machine(between: Literal["hold", "line"] = "line") -> CasadiPlant:
    m = Equations("a stiff spring", time=0.3)
    q, v = m.state("q"), m.state("v")
    force, spring = m.input("force", size=2.0), m.parameter("spring", 2000.0, "N/m")
    m.rate(q, v)
    m.rate(v, force - spring * q - 4.0 * v + m.axis("guide", q, v, force=2.0, speed=0.5, position=0.1))
    m.output("position", q, "m", size=0.1)
    return m.plant(between=between)


def run_of(rows: np.ndarray, inputs: np.ndarray, **others: object) -> Run:
    shape = np.zeros((len(rows), 1, 1))
    return Run("run.csv", "fit", TIME[rows], inputs[rows], np.zeros((len(rows), 3)), shape, **others)  # type: ignore[arg-type]


@pytest.mark.parametrize("between", ["hold", "line"])
def test_a_gap_is_gone_in_steps_of_the_usual_length(between: Literal["hold", "line"]) -> None:
    """One step over the longest gap would diverge: 0.8 s of a spring that swings in 0.14 s."""
    inputs = np.sin(TIME)[:, None]
    if between == "line":  # it goes straight to the sample after the gap
        inputs = np.interp(TIME, TIME[ROWS], inputs[ROWS, 0])[:, None]
    else:  # it stays
        inputs = inputs[ROWS][np.searchsorted(ROWS, np.arange(len(TIME)), side="right") - 1]
    plant = machine(between).with_values({"input_lag[force].time": 0.2})
    by = ["spring", "input_lag[force].time", f"{START}q"]
    whole, thinned = (plant.predict(run_of(rows, inputs, state=np.array([1e-3, 0.0])), by) for rows in (np.arange(len(TIME)), ROWS))
    np.testing.assert_allclose(thinned.points, whole.points[ROWS], atol=1e-12)
    np.testing.assert_allclose(thinned.by, whole.by[:, ROWS], atol=1e-9 * np.abs(whole.by).max())


def test_effects_at_their_null_cost_no_state_and_change_no_derivative() -> None:
    plant, run = machine(), run_of(np.arange(len(TIME)), np.sin(TIME)[:, None])
    bare = plant._active_motion(["spring"])
    assert bare.states == ("q", "v")
    every = ["spring", *(name for c in plant.candidates for name in c.parameters)]
    assert len(plant._active_motion(every).states) == len(plant.motion.states)
    small, large = plant.predict(run, ["spring"]), plant.predict(run, every)
    assert small.points == pytest.approx(large.points, abs=1e-15)
    np.testing.assert_allclose(small.by[0], large.by[0], atol=1e-12 * np.abs(large.by[0]).max())


def test_an_effect_acts_by_its_strength_or_where_its_strength_is_asked_for() -> None:
    plant = machine()
    shape, strength = "stribeck_friction[guide].speed", "stribeck_friction[guide].force"
    run = run_of(np.arange(len(TIME)), np.sin(TIME)[:, None])
    assert not plant.predict(run, [shape]).by.any()
    assert plant._active_motion(["hysteresis[guide].closing"]).states == ("q", "v")
    assert plant.predict(run, [strength]).by.any()
    assert plant.with_values({strength: 0.5}).predict(run, [shape]).by.any()
    lagging = plant.with_values({"sensor_lag[position].time": 0.3})._active_motion([])
    assert lagging.states == ("q", "v", "sensor_lag[position] 0")


def test_a_motion_whose_derivatives_no_square_holds_is_refused() -> None:
    m = Equations("what falls over", laws=())
    x, rate = m.state("x", 1e-300), m.parameter("rate", 50.0, "1/s")
    m.rate(x, rate * x)
    m.output("x", 0.0 * x + x)
    run = Run(
        "run.csv", "fit", TIME, np.zeros((len(TIME), 0)), np.zeros((len(TIME), 3)), np.zeros((len(TIME), 1, 1)), state=np.array([1e-200])
    )
    with pytest.raises(RuntimeError, match="no bounds"):
        m.plant(substeps=8).predict(run, [f"{START}x"])
