"""The common factor of the regulators' lags, found from tracked points alone."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.control.actuation.actuators import Actuators
from tepm_opt.control.actuation.regulator_lags import RegulatorLags
from tepm_opt.control.estimation.kalman_filter import DiscreteModalModel, Estimator
from tepm_opt.control.mpc.lag_factor import CAUTION, LEAST_FACTOR, LagFactor
from tepm_opt.control.references.reference import Reference
from tepm_opt.hw.rig import Command
from tepm_opt.models.devices import Devices
from tepm_opt.solvers.linear.modal_model import modal_model

PERIOD, AREA, NOISE = 0.01, 4.5e-5, 3e-4
LIMITS, REST = np.full(6, 5e5), np.full(6, 2e5)
DEVICES = Devices(0.12, 0.24, np.inf, 0.0)


def actuators_with(factor: float) -> Actuators:
    """At rest, with lags that are a factor of those declared."""
    lags = RegulatorLags(DEVICES, PERIOD, LIMITS, REST)
    lags.factor = factor
    return Actuators(DEVICES, AREA, Command(REST, np.zeros(6), np.ones(6, dtype=bool)), lags)


def commands(count: int) -> list[np.ndarray]:
    """Pressures in steps of 20 kPa about the rest, (actuators,) in Pa each."""
    random = np.random.default_rng(3)
    steps = 2e4 * random.integers(-2, 3, size=(count // 8 + 1, 6))
    return [REST + steps[k // 8] for k in range(count)]


def test_slopes_are_differences_of_pressures() -> None:
    """Of two regulators that differ by little, whatever fills and exhausts."""
    factor, between, low, high = LagFactor(6, 1), actuators_with(0.7), actuators_with(0.7 - 1e-6), actuators_with(0.7 + 1e-6)
    factor.value = 0.7
    for pressures in commands(60):
        for each in (between, low, high):
            each.command = Command(pressures, np.zeros(6), np.ones(6, dtype=bool))
        start, end = factor.advance(between)
        for each in (between, low, high):
            each.advance()
        np.testing.assert_allclose(end, AREA * (high.pressure - low.pressure) / 2e-6, rtol=1e-3, atol=1e-4)
        assert start.shape == end.shape


@pytest.mark.parametrize("true", [0.25, 1.0, 2.0])
def test_the_factor_is_found(short: Reference, true: float) -> None:
    """Within three standard deviations that are small by then, from an arm that moves as its model does."""
    model = modal_model(short.equilibria[0])
    forces = AREA * REST
    operating = DiscreteModalModel.from_modal_model(model, forces, PERIOD)
    estimator, factor, known, arm = Estimator(operating, NOISE, 3.5), LagFactor(6, 56), actuators_with(1.0), actuators_with(true)
    assert len(estimator.mean) == 56
    factor.tell(known.lags)
    motion, random = np.zeros(20), np.random.default_rng(4)
    for pressures in commands(600):
        for each in (known, arm):
            each.command = Command(pressures, np.zeros(6), np.ones(6, dtype=bool))
        motion = operating.advance(motion, arm.advance())
        slopes = factor.advance(known)
        factor.predict(slopes, estimator.predict(known.advance(), np.zeros(6), np.zeros(6), operating).A, operating, operating)
        points = model.equilibrium.points + (model.observe @ motion[:10]).reshape(-1, 3)
        estimator.update(points + NOISE * random.normal(size=points.shape))
        factor.correct(estimator.correction, estimator, known)
    std = np.sqrt(factor.variance)
    assert std < 0.3
    assert abs(factor.value - true) < 3 * std
    assert known.lags.lead_factor == max(factor.value - CAUTION * std, LEAST_FACTOR)


def test_regulators_declared_at_once_stay_so() -> None:
    """Their share is all but one for every factor, so that slopes and times are finite."""
    lags = RegulatorLags(Devices(0.0, 1e-3, np.inf, 0.0), PERIOD, LIMITS, REST)
    factor, known = LagFactor(6, 1), Actuators(DEVICES, AREA, Command(REST, np.zeros(6), np.ones(6, dtype=bool)), lags)
    factor.tell(lags)
    for pressures in commands(20):
        known.command = Command(pressures, np.zeros(6), np.ones(6, dtype=bool))
        assert np.isfinite(factor.advance(known)).all()
        known.advance()
        np.testing.assert_allclose(known.pressure, pressures, rtol=1e-6)
    assert np.isfinite(lags.times).all()
    assert (lags.times < PERIOD / 5).all()


def test_nothing_is_learned_where_monitors_teach_the_lags() -> None:
    """A reading of each monitor, and forces do not depend on the factor any more."""
    factor, known = LagFactor(6, 1), actuators_with(1.0)
    known.lags.correct(REST, PERIOD)
    for pressures in commands(20):
        known.command = Command(pressures, np.zeros(6), np.ones(6, dtype=bool))
        assert not factor.advance(known).any()
        known.advance()
    assert not known.lags.unmonitored.any()


def test_nothing_is_learned_without_points(short: Reference) -> None:
    """A sample in which all points are lost leaves the factor alone."""
    estimator = Estimator(DiscreteModalModel.from_modal_model(modal_model(short.equilibria[0]), AREA * REST, PERIOD), NOISE, 3.5)
    factor, known = LagFactor(6, len(estimator.mean)), actuators_with(1.0)
    before = factor.value, factor.variance
    estimator.update(np.full((4, 3), np.nan))
    factor.correct(estimator.correction, estimator, known)
    assert (factor.value, factor.variance) == before
