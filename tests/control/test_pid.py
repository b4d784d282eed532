"""PID: closed forms, anti-windup, no kick."""

import numpy as np
import pytest

from tepm_opt.control.baselines.pid import Pid

ONE = np.ones(1)
WIDE = np.array([[-1e9], [1e9]])


def test_integral_and_proportional_of_a_constant_error():
    """out = bias + P e + I e t."""
    pid = Pid(1, 0.0)
    for _ in range(50):
        out = pid.step(0.1 * ONE, 2 * ONE, (3 * ONE, 4 * ONE, 0 * ONE), WIDE, 0.01)
    assert out == pytest.approx(2 + 0.3 + 4 * 0.1 * 0.5)


def test_filter_is_exact_for_a_step_and_gives_the_rate():
    """First-order: 1 − exp(−t / T) after a step; a ramp's rate in the long run."""
    pid = Pid(1, 0.05)
    pid.observe(np.zeros(1), 0.0)
    for _ in range(5):
        seen = pid.observe(ONE, 0.01)
    assert seen == pytest.approx(1 - np.exp(-1))
    for k in range(200):
        pid.observe(ONE * (1 + 0.02 * k), 0.01)
    assert pid.rate == pytest.approx(2.0)


def test_integral_stands_still_at_a_limit():
    """After long saturation the output leaves the limit as soon as the error changes its sign."""
    pid = Pid(1, 0.0)
    limits = np.array([[0.0], [1.0]])
    for _ in range(1000):
        assert pid.step(ONE, 0 * ONE, (ONE, ONE, 0 * ONE), limits, 0.01) <= 1
    assert abs(pid.integral[0]) < 0.1
    assert pid.step(-0.5 * ONE, 0 * ONE, (ONE, ONE, 0 * ONE), limits, 0.01) < 0.6
