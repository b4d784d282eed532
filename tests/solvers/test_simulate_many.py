"""Many motions side by side: each as it is alone, whatever the others do; order, filling of the lanes, failures, interruption."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.errors import InputError
from tepm_opt.models.compile import compile_model
from tepm_opt.outcome import Ending
from tepm_opt.solvers import simulate as module
from tepm_opt.solvers import simulate_many as many
from tepm_opt.solvers.simulate import Directions, simulate
from tepm_opt.solvers.simulate_many import Motion, simulate_many
from tests.solvers.dynamics import with_dynamics

SAME = 1e-12  # m, rounding


@pytest.fixture
def one_core(monkeypatch):
    """One core, so that lanes that are over take further motions."""
    monkeypatch.setattr(many, "cores", lambda: 1)


def drawn(model, count, seed, held=False, scatter=0.1):
    """Motions of different lengths, parameters, starts and inputs: jumps where they are held, else ramps."""
    rng, motions = np.random.default_rng(seed), []
    for k in range(count):
        time = np.arange(0, 0.4 + 0.3 * (k % 4) + 1e-9, 0.02)
        inputs = 0.3 * rng.random(model.layout.inputs) * model.input_max * np.ones((len(time), 1))
        changed = rng.random((2, model.layout.inputs))
        inputs[5:] *= changed[0]
        inputs[12:] *= changed[1]
        if not held:
            inputs = np.stack([np.interp(time, time[[0, 5, 12, -1]], column[[0, 5, 12, -1]]) for column in inputs.T], axis=1)
        force = np.zeros((len(time), 3))
        force[3:8, 0] = 0.02 * k
        theta = model.theta * rng.uniform(1 - scatter, 1 + scatter, len(model.theta))
        motions.append(Motion(SetPoints(time, inputs, force), theta))
    return motions


def alone(model, motions, **how):
    return [simulate(model.with_theta(motion.theta), motion.setpoints, loads=motion.loads, **how) for motion in motions]


def assert_same(found, expected):
    for one, other in zip(found, expected, strict=True):
        assert one.outcome == other.outcome
        assert one.points.shape == other.points.shape
        for name in ("points", "lengths", "levels"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0, atol=SAME)
        np.testing.assert_allclose(one.velocities, other.velocities, rtol=0, atol=1e3 * SAME)
        assert (one.effort.steps, one.effort.halvings) == (other.effort.steps, other.effort.halvings)
        assert one.effort.iterations == pytest.approx(other.effort.iterations, abs=2)
        np.testing.assert_allclose(one.error, other.error, rtol=1e-6)
        np.testing.assert_array_equal(one.model.theta, other.model.theta)


@pytest.mark.parametrize("held", [False, True], ids=["ramps", "jumps"])
@pytest.mark.parametrize("how", [{}, {"error": 1e-3}, {"step": 0.01}, {"step": 0.02}, {"method": "rk4"}], ids=str)
def test_each_is_as_it_is_alone(kang, one_core, how, held):
    motions = drawn(kang, 13, 1, held)
    found = simulate_many(kang, motions, hold=held, **how)
    assert_same(found, alone(kang, motions, hold=held, **how))
    assert all(one.solved for one in found)
    assert max(abs(one.levels[-1] - found[0].levels[-1]).max() for one in found[1:]) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("how", [{"step": 0.01}, {}, {"hold": True}, {"method": "rk4", "hold": True}], ids=str)
def test_effects_with_memory(one_core, how):
    model = compile_model(
        with_dynamics(
            structural_friction={"force": 0.3, "distance": 1e-3}, creep={"share": 0.2, "relaxation_time": 0.5},
            regulator_lag={"filling_time": 0.05, "exhausting_time": 0.1}, time_delay={"delay": 0.013},
            pressure_hysteresis={"width": 1e4, "distance": 2e4},
        )
    )  # fmt: skip
    motions = drawn(model, 13, 2, "hold" in how)
    assert_same(simulate_many(model, motions, **how), alone(model, motions, **how))


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4, 5, 9, 17])
def test_lanes_need_not_be_filled(kang, count):
    motions = drawn(kang, count, 3)
    assert_same(simulate_many(kang, motions, step=0.01), alone(kang, motions, step=0.01))


def test_the_model_s_own_parameters_and_further_loads(kang):
    motions = drawn(kang, 4, 4)
    loads = np.zeros((len(motions[0].setpoints.time), kang.layout.points, 3))
    loads[:, 1, 1] = 0.05
    given = [Motion(motions[0].setpoints, loads=loads), Motion(motions[0].setpoints), *motions[1:]]
    found = simulate_many(kang, given, step=0.01)
    assert_same(found[:2], [simulate(kang, motions[0].setpoints, step=0.01, loads=each) for each in (loads, None)])
    assert abs(found[0].points - found[1].points).max() > 1e-4


@pytest.mark.parametrize("how", [{"hold": True}, {"step": 0.01}], ids=str)
def test_one_that_diverges_and_one_that_is_stuck_leave_the_others_alone(kang, how):
    motions = drawn(kang, 11, 5)
    for k, size, rows in ((2, 1e12, 10), (3, 1e7, 10)):
        time, inputs, force = (getattr(motions[k].setpoints, name) for name in ("time", "inputs", "tip_force"))
        force = np.where(np.arange(len(time))[:, None] < rows, force, size)
        motions[k] = Motion(SetPoints(time, inputs, force), motions[k].theta)
    found, expected = simulate_many(kang, motions, **how), alone(kang, motions, **how)
    for k, why in ((3, "left all bounds"), (2, "has no solution nearby")):
        assert found[k].outcome.ending is Ending.FAILED
        assert why in found[k].outcome.message
        assert found[k].outcome == expected[k].outcome
        np.testing.assert_allclose(found[k].points, expected[k].points, rtol=0, atol=SAME)
        del found[k], expected[k]
    assert_same(found, expected)


@pytest.mark.parametrize("k", [0, 4])
def test_one_that_rk4_lets_diverge(kang, monkeypatch, k):
    motions = drawn(kang, 5, 5)
    monkeypatch.setattr(module, "_stable_step", lambda model, *_: 6e-4 if model.theta is motions[k].theta else 2e-4)
    found, expected = simulate_many(kang, motions, "rk4"), alone(kang, motions, method="rk4")
    assert [one.outcome.ending is Ending.FAILED for one in found] == [number == k for number in range(5)]
    assert "left all bounds" in found[k].outcome.message
    assert found[k].outcome == expected[k].outcome
    del found[k], expected[k]
    assert_same(found, expected)


def test_a_motion_that_cannot_start_is_named_before_any_moves(kang):
    motions = drawn(kang, 3, 6)
    motions[1] = Motion(motions[1].setpoints, 0 * kang.theta - 1)
    with pytest.raises(InputError, match=r"motion 2: set points: row 1: no stable equilibrium"):
        simulate_many(kang, motions)
    with pytest.raises(InputError, match=r"motion 1: step: -1 s; valid: above 0"):
        simulate_many(kang, motions, step=-1)


def test_without_a_compiler(kang_python):
    motions = drawn(kang_python, 2, 7)
    assert_same(simulate_many(kang_python, motions, step=0.02), alone(kang_python, motions, step=0.02))


def test_with_directions(kang):
    motions, directions = drawn(kang, 5, 8), Directions.of(kang, ["K_a"])
    found, expected = simulate_many(kang, motions, step=0.02, directions=directions), alone(kang, motions, step=0.02, directions=directions)
    assert_same(found, expected)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.sensitivities, other.sensitivities, rtol=1e-9)


def test_interrupted_it_leaves_what_there_is(kang, compiler):
    """After the first that is over: it is whole, the others are as far as they came, and that is right."""
    motions = drawn(kang, 12, 9)

    def interrupt(stage, done, of):
        raise KeyboardInterrupt

    found, expected = simulate_many(kang, motions, progress=interrupt), alone(kang, motions)
    endings = [one.outcome.ending for one in found]
    assert endings.count(Ending.SOLVED) in (1, 2)  # as many as threads
    assert endings.count(Ending.INTERRUPTED) == 12 - endings.count(Ending.SOLVED)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.points, other.points[: len(one.points)], rtol=0, atol=SAME)


def test_progress_counts_the_seconds_of_all(kang):
    motions, told = drawn(kang, 6, 10), []
    simulate_many(kang, motions, step=0.02, progress=lambda stage, done, of: told.append((done, of)))
    total = sum(float(motion.setpoints.time[-1]) for motion in motions)
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    np.testing.assert_allclose(told[-1], (total, total))


def test_two_runs_are_the_same_bytes(kang):
    """Whichever thread takes which motion."""
    motions = drawn(kang, 10, 11)
    first, second = simulate_many(kang, motions), simulate_many(kang, motions)
    assert [one.levels.tobytes() for one in first] == [one.levels.tobytes() for one in second]
