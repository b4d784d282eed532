"""Joint prior of a fit: the posterior of one recording as the prior of the next gives what both together give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tepm_opt.data.run import Run
from tepm_opt.discrepancy.adapters.equations import Equations
from tepm_opt.solvers.identification.identify import ParameterEstimate, Problem, identify
from tepm_opt.solvers.identification.prior import JointPrior
from tepm_opt.solvers.mechanics.plant import Free

NOISE = 0.05


def line(seed: int, rows: int = 400, correlated: bool = False) -> Problem:
    """y = a u + b with white noise, or with noise in which ten rows are alike."""
    m = Equations("line", laws=())
    u = m.input("u", size=1.0)
    m.output("y", m.parameter("a", 1.0, low=-9.0, high=9.0) * u + m.parameter("b", 0.0, low=-9.0, high=9.0))
    random = np.random.default_rng(seed)
    time = np.arange(rows) * 0.1
    inputs = 1.0 + np.repeat(random.normal(size=rows // 10), 10)[:, None]
    noise = np.repeat(random.normal(size=rows // 10), 10) if correlated else random.normal(size=rows)
    points = (2.0 * inputs[:, 0] + 0.5 + NOISE * noise)[:, None, None]
    plant = m.plant()
    return Problem(plant, (Run("r.csv", "fit", time, inputs, np.zeros((rows, 3)), points),), plant.free(plant.known), NOISE)


def as_prior(estimate: ParameterEstimate, weight: float = 1.0) -> JointPrior:
    return JointPrior(tuple(f.name for f in estimate.problem.free), estimate.values, estimate.covariance, weight)


def test_posterior_as_prior_is_the_fit_to_both() -> None:
    one, other = line(1), line(2)
    square = sum(r.by.T @ r.by for r in identify(one).residuals)
    exact = JointPrior(("a", "b"), identify(one).values, np.linalg.inv(square))
    together = identify(replace(one, runs=(*one.runs, *other.runs)))
    after = identify(replace(other, joint=exact))
    np.testing.assert_allclose(after.values, together.values, rtol=1e-5)
    np.testing.assert_allclose(after.std, together.std, rtol=0.3)


@pytest.mark.slow
def test_covariance_counts_prior_and_data_alike_where_samples_are_not_independent() -> None:
    """Ten alike samples are one measurement: with that weight the posterior scatters as it says it does."""
    found = []
    for seed in range(60):
        first = identify(line(2 * seed, correlated=True))
        found.append(identify(replace(line(2 * seed + 1, correlated=True), joint=as_prior(first, weight=10.0))))
    scatter = np.std([each.values for each in found], axis=0, ddof=1)
    told = np.mean([each.std for each in found], axis=0)
    np.testing.assert_allclose(scatter, told, rtol=0.35)
    alone = np.std([identify(line(2 * seed + 1, correlated=True)).values for seed in range(60)], axis=0, ddof=1)
    assert np.all(scatter < 0.9 * alone)


def test_tells_a_margin_and_nothing_of_what_an_effect_changed() -> None:
    prior = JointPrior(("a", "b"), np.array([1.0, 2.0]), np.array([[4.0, 1.0], [1.0, 1.0]]), 2.0)
    a, b, c = (Free(name, "1", 0.0, -9.0, 9.0, 1.0) for name in "abc")
    mean, precision = prior.terms((c, b))
    assert mean.tolist() == [0.0, 2.0]
    assert precision == pytest.approx(np.diag([0.0, 2.0]))  # b alone, whatever a is
    mean, precision = prior.terms((replace(a, changed=True), b))
    assert mean.tolist() == [0.0, 2.0]
    assert precision == pytest.approx(np.diag([0.0, 2.0]))
    both = prior.terms((b, a))[1]
    assert both == pytest.approx(2 * np.linalg.inv([[1.0, 1.0], [1.0, 4.0]]))
