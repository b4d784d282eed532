"""The forecast along the last plan, beside the linear one and the moving network."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.control.estimation.kalman_filter import Operating
from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.controller import Mpc, MpcSettings
from tepm_opt.control.mpc.nonlinear_prediction import NonlinearForecast
from tepm_opt.control.mpc.prediction import Forecast, LinearForecast, Weights
from tepm_opt.control.references.reference import Reference
from tepm_opt.data.setpoints import SetPoints
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.models.compile import CompiledModel
from tepm_opt.solvers.modal_model import modal_model
from tepm_opt.solvers.simulate import simulate

STAGES, ROW = 15, 330
PUSH = np.array([-4.0, 2.0, 2.0, -4.0, 2.0, 2.0])  # N


@pytest.fixture(scope="module")
def operating(short: Reference) -> Operating:
    """On the circle."""
    return Operating.of(modal_model(short.equilibria[ROW]), short.forces[ROW], short.period)


def prepared(forecast: Forecast, operating: Operating, reference: Reference, motion: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Let a forecast stand at the point; H of its program."""
    hessian = forecast.prepare(operating, reference, np.full(STAGES + 9, ROW))
    forecast.about(motion, bias)
    return hessian


def tip_errors(forecast: Forecast, begin: np.ndarray, plan: np.ndarray) -> np.ndarray:
    """As foreseen at stages 1 … stages − 1, (stages − 1, 3) in m."""
    forecast.gradient(begin)
    horizon = forecast.horizon
    return (horizon.tip_free + horizon.tip_answer @ plan.ravel()).reshape(-1, 3)


def test_without_a_plan_it_is_the_linear_one_where_the_reference_stands(short, operating):
    """The same program, to rounding."""
    random = np.random.default_rng(5)
    motion, begin = np.append(4e-3 * random.normal(size=10), 1e-2 * random.normal(size=10)), random.normal(size=6)
    programs = []
    for kind in (LinearForecast, NonlinearForecast):
        forecast = kind(Weights(), STAGES)
        hessian = prepared(forecast, operating, short, motion, np.array([1e-3, 0.0, 2e-3]))
        programs.append((hessian, forecast.gradient(begin)))
    for one, other in zip(*programs, strict=True):
        np.testing.assert_allclose(other, one, atol=1e-8 * np.abs(one).max())


def test_large_motion_is_foreseen(kang: CompiledModel, short: Reference, operating: Operating):
    """From rest by forces that move the tip by 86 mm in 0.28 s: beside the moving network the linear forecast is off three times more."""
    part = np.minimum(np.arange(1, STAGES + 1) / 12, 1.0)
    plan, at = part[:, None] * PUSH, short.equilibria[ROW]
    more = np.vstack([np.zeros(6), plan])
    inputs = at.inputs + np.hstack([np.maximum(more, 0) / kang.values["A"], np.maximum(-more, 0)])
    time = 2 * short.period * np.arange(STAGES + 1)
    true = simulate(kang, SetPoints(time, inputs, np.zeros((STAGES + 1, 3))), step=2e-3).complete().points[1:-1, -1] - at.tip
    off = {}
    for kind in (LinearForecast, NonlinearForecast):
        forecast = kind(Weights(), STAGES)
        for _ in range(4):  # the plan is the same again and again: iterations that have converged
            prepared(forecast, operating, short, np.zeros(20), np.zeros(3))
            found = tip_errors(forecast, np.zeros(6), plan)
            forecast.take(plan)
        off[kind] = np.linalg.norm(found - true, axis=1)
    assert np.linalg.norm(true, axis=1).max() > 0.08
    assert off[NonlinearForecast].max() < 0.5 * off[LinearForecast].max()


def test_a_plan_without_an_equilibrium_is_left(short, operating):
    """A plan that cannot be: the forecast is along the reference then, and finite."""
    forecast = NonlinearForecast(Weights(), STAGES)
    for plan in (np.full((STAGES, 6), 500.0), None):
        hessian = prepared(forecast, operating, short, np.zeros(20), np.zeros(3))
        assert all(np.isfinite(part).all() for part in (hessian, forecast.gradient(np.zeros(6))))
        forecast.take(plan)
    hessian = prepared(forecast, operating, short, np.zeros(20), np.zeros(3))
    assert all(np.isfinite(part).all() for part in (hessian, forecast.gradient(np.zeros(6))))


@pytest.mark.slow
def test_it_closes_the_loop(kang, short, followed):
    """On the virtual prototype as near as the linear one; nothing falls back."""
    rig = SimulatedRig()
    rig.reseed(1)
    done = close_loop(rig, Mpc(kang, short, MpcSettings(nonlinear=True)), kang.robot)
    assert done.error() < 1.1 * followed.error()
    assert not done.fallbacks
