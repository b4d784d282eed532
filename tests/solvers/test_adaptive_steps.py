"""Adaptive steps: what they state as error is more than the error, whatever moves; inputs that jump and bend; sensitivities."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.models.compile import compile_model
from tepm_opt.models.model import Model
from tepm_opt.solvers.mechanics.simulate import Directions, simulate
from tests.models.test_backends import MODELS
from tests.models.test_time_stepping import gentle
from tests.tools import in_company, variant

MACHINES = {
    "kang2017": lambda: Model.from_robot("kang2017"),
    "one module of four actuators": MODELS["one module of four actuators"],
    "three modules": lambda: Model.from_robot(variant(geometry={"modules": 3, "segments_per_module": 4}, parameters={"m_d": 0.05})),
    "four modules": lambda: Model.from_robot(variant(geometry={"modules": 4, "segments_per_module": 3}, parameters={"m_d": 0.02})),
    "two segments": lambda: Model.from_robot(variant(geometry={"segments_per_module": 2})),
    "twelve segments": lambda: Model.from_robot(variant(geometry={"segments_per_module": 12})),
    "friction": lambda: in_company(structural_friction={"force": 0.5, "distance": 1e-3}),
    "lag and delay": lambda: in_company(regulator_lag={"filling_time": 0.05, "exhausting_time": 0.1}, time_delay={"delay": 0.02}),
    "creep and hysteresis": lambda: in_company(
        creep={"share": 0.2, "relaxation_time": 0.5}, pressure_hysteresis={"width": 1e4, "distance": 2e4}
    ),
}
TIME = np.arange(0, 1.601, 0.02)


def motions(model, rng):
    """Set points and whether they hold: a jump, the same as a steep ramp, sines, noise, ramps between knots, a force that lets go."""
    full, still = (0.3 if model.layout.modules < 3 else 0.15) * model.input_max, np.zeros((len(TIME), 3))
    jump = np.zeros((len(TIME), len(full)))
    jump[5:, [0, min(3, len(full) // 2 - 1)]] = full[0]
    sines = full * np.sin(np.outer(TIME, rng.uniform(0.5, 4, len(full)))) ** 2
    knots = np.arange(0, 2.1, 0.5)
    ramps = np.stack([np.interp(TIME, knots, column) for column in (full * rng.random((len(knots), len(full)))).T], axis=1)
    force = still.copy()
    force[:3, 0] = 0.2
    for name, inputs, push, hold in (
        ("jump", jump, still, True),
        ("steep ramp", jump, still, False),
        ("sines", sines, still, False),
        ("noise", full * rng.random(jump.shape), still, False),
        ("ramps", ramps, still, False),
        ("let go", 0 * jump, force, True),
    ):
        yield name, SetPoints(TIME, inputs, push), hold


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in ("kang2017", "friction") else pytest.mark.slow) for name in MACHINES]
)
def test_the_error_is_below_the_one_stated(name, compiler):
    """Against steps of 0.5 ms, with the robot's parameters and with random ones; fixed steps need a delay of whole samples."""
    rng, model = np.random.default_rng(3), compile_model(MACHINES[name](), backend="c")
    late = np.array([parameter.endswith(".delay") for parameter in model.network.parameter_names])
    for machine in (model, model.with_theta(model.theta * np.where(late, 1.0, rng.uniform(0.8, 1.25, len(late))))):
        for motion, setpoints, hold in motions(machine, rng):
            exact = simulate(machine, setpoints, step=5e-4, hold=hold, tolerance=1e-9).complete()
            for error in (3e-3, 1e-4):
                found = simulate(machine, setpoints, hold=hold, error=error).complete()
                true = np.linalg.norm(found.points - exact.points, axis=2).max()
                assert true < found.error < 2 * error, (motion, error)


def test_a_smaller_error_takes_more_steps(kang):
    setpoints = gentle(kang, 0.8, 41)
    steps = [simulate(kang, setpoints, error=error).effort.steps for error in (1e-2, 1e-3, 1e-4, 1e-5)]
    assert steps == sorted(steps)
    assert steps[-1] < 30 * steps[0]


def test_steps_go_beyond_samples(kang):
    """Samples are interpolated: asking for ten times as many changes neither the steps nor the motion."""
    knots = gentle(kang, 1.0, 3)
    dense = np.linspace(0, 1.0, 201)
    inputs = np.stack([np.interp(dense, knots.time, column) for column in knots.inputs.T], axis=1)
    force = np.stack([np.interp(dense, knots.time, column) for column in knots.tip_force.T], axis=1)
    few = simulate(kang, knots)
    many = simulate(kang, SetPoints(dense, inputs, force))
    assert many.step > 1.5 * (dense[1] - dense[0])
    assert abs(many.points[::100] - few.points).max() < few.error
    fine = simulate(kang, SetPoints(dense, inputs, force), step=5e-4)
    assert np.linalg.norm(many.points - fine.points, axis=2).max() < many.error
    assert abs(many.velocities - fine.velocities).max() < 0.01 * abs(fine.velocities).max()


def test_sensitivities_are_those_of_fine_steps(kang):
    setpoints = gentle(kang, 0.8, 41)
    directions = Directions.from_names(kang, ["K_a", "c_a", "m_d"], ["pressure_11", "tension_22"])
    fine = simulate(kang, setpoints, step=1e-3, directions=directions).sensitivities
    for error, close in ((1e-3, 1e-2), (1e-5, 1e-4)):
        found = simulate(kang, setpoints, error=error, directions=directions)
        for k, name in enumerate(directions.names):
            assert abs(found.sensitivities[k] - fine[k]).max() < close * abs(fine[k]).max(), name
        assert abs(found.points - simulate(kang, setpoints, error=error).points).max() < 0.01 * error


def test_without_an_estimate_none_is_stated(kang):
    setpoints = gentle(kang)
    assert np.isnan(simulate(kang, setpoints, step=0.01).error)
    assert "error" not in repr(simulate(kang, setpoints, step=0.01))
    assert "error 0." in repr(simulate(kang, setpoints))
