"""Force at the tip that seems constant: a spring that is tied far away is told from it although both leave hardly more than noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from tepm_opt.data.setpoints import SetPoints
from tepm_opt.discrepancy.adapters.network import SearchableNetwork
from tepm_opt.discrepancy.assessment.tether import constant_force_probabilities
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.fitting import Fits, Hypothesis
from tepm_opt.models.channels import channels_of
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.model import Model
from tepm_opt.solvers.identification.identify import Problem
from tepm_opt.solvers.mechanics.simulate import simulate
from tests.discrepancy.small import NOISE, STEP, cut, measured, planned

TIED, HANGING = np.array([0.25, -0.1, 0.2]), np.array([0.0, 0.0, 0.35])  # m
FILES = ("single_pressure.csv", "elongation.csv", "mixed.csv")
SETTINGS = SearchSettings()


@pytest.fixture(scope="module")
def network() -> SearchableNetwork:
    model = Model.from_robot("kang2017")
    return SearchableNetwork.from_model(model, channels_of(model.robot))


def coloured(white: np.ndarray, memory: float) -> np.ndarray:
    """Noise of unit variance that keeps a part of its value from sample to sample."""
    return np.asarray(lfilter([np.sqrt(1 - memory**2)], [1, -memory], white, axis=0))


def explained(network: SearchableNetwork, kang: CompiledModel, stiffness: float, constant: bool, memory: float = 0.0) -> Hypothesis:
    """Fit of a constant force to runs under that of a spring, or under a constant one as large as the spring's at rest."""
    random, runs = np.random.default_rng(5), []
    for run in measured(kang, planned(FILES), noise=0.0):
        points, forces = run.points, np.zeros_like(run.points)
        for _ in range(3):  # until force and motion agree
            forces[:, -1] = stiffness * (TIED - (HANGING if constant else points[:, -1]))
            points = simulate(kang, SetPoints(run.time, run.inputs, run.tip_force), step=STEP, loads=forces).complete().points
        runs.append(cut(replace(run, points=points + NOISE * coloured(random.normal(size=points.shape), memory)), 6.0))
    problem = Problem(network, tuple(runs), network.free(network.known), NOISE, step=0.01, derivatives_apart=network.derivatives_apart)
    fits = Fits(problem, SETTINGS)
    effect = next(c for c in network.candidates if c.name == "external_load")
    found = fits.fit((effect,), dict(effect.probes[0]))
    assert found is not None
    return fits.complete(found)


@pytest.mark.parametrize("stiffness", [0.1, 0.15])
@pytest.mark.parametrize("constant", [True, False])
def test_a_hose_is_told_from_a_weight(network: SearchableNetwork, kang: CompiledModel, stiffness: float, constant: bool) -> None:
    """Forces of some 0.03 N, which bend the arm by about the noise."""
    best = explained(network, kang, stiffness, constant)
    assert best.only_noise(SETTINGS)
    (found,) = constant_force_probabilities(best, SETTINGS).values()
    assert found > 0.9 if constant else found < 0.1


def test_coloured_noise_makes_no_hose(network: SearchableNetwork, kang: CompiledModel) -> None:
    """Taken for white, noise that remembers 0.9 of itself says with certainty that a constant force is a spring's."""
    (found,) = constant_force_probabilities(explained(network, kang, 0.1, True, memory=0.9), SETTINGS).values()
    assert found > 0.05
