"""Tether: whether a force that seems constant is that of a hose or cable, which pulls as a spring does to where it is tied.

Where a force itself is hardly above the noise, a law by place with its dozen of coefficients cannot be told from noise; a single
stiffness can.
"""

from __future__ import annotations

import numpy as np

from tepm_opt.discrepancy.problem.plant import Candidate, Network, as_network
from tepm_opt.discrepancy.problem.settings import SearchSettings
from tepm_opt.discrepancy.selection.fitting import Hypothesis
from tepm_opt.discrepancy.symbolic.curves import Powers
from tepm_opt.discrepancy.symbolic.places import Place
from tepm_opt.discrepancy.symbolic.responses import normal_equations_by_place, simulate_courses
from tepm_opt.discrepancy.symbolic.score import prior_of


def constant_force_probabilities(best: Hypothesis, settings: SearchSettings) -> dict[Candidate, float]:
    """Probability of each force in N of known form that it is constant, rather than that of a spring tied an arm's length away.

    Both are as likely before. The odds are the ratio of the likelihoods of a stiffness of force over length and of none (Kass and Raftery,
    Journal of the American Statistical Association 90, 1995). Only where no more than noise is left: else that, whatever it is, would
    decide. None where the plant is not a network.

    Args:
        best: fit of the effects.
        settings: of the search.

    Raises:
        PredictionError: the model cannot do a run.
    """
    network = as_network(best.estimate.plant)
    units = {free.name: free.unit for free in best.estimate.problem.free}
    forces = [e for e in best.effects if e.exact and e.acts == ("force",) and all(units.get(name) == "N" for name in e.parameters)]
    if not forces or network is None or not best.only_noise(settings):
        return {}
    stiffness, std, arm = _fit_spring(best, network)
    named, found = best.estimate.named, {}
    for effect in forces:
        tied = float(np.linalg.norm([named[name] - effect.null[name] for name in effect.parameters])) / arm
        log_ratio = (stiffness * tied - tied**2 / 2) / std**2
        found[effect] = float(1 / (1 + np.exp(np.clip(log_ratio, -700, 700))))
    return found


def _fit_spring(best: Hypothesis, network: Network) -> tuple[float, float, float]:
    """Stiffness in N/m of a spring at the tip beside the effects of a fit and its standard deviation, and the length of the arm in m.

    It is fitted to first order, with all parameters following. Its deviation allows for errors that are alike within a block
    of time (White, Econometrica 48, 1980, by blocks).
    """
    estimate, layout = best.estimate, network.model.layout
    courses, count = simulate_courses(network, estimate.problem.runs), len(estimate.problem.free)
    tip = np.concatenate([course.points[:, -1] for course in courses])
    affine = Place("force", layout.point_names[-1], "position", Powers(tuple(tip.mean(axis=0).tolist()), (1.0, 1.0, 1.0), 1))
    basis = np.zeros((count + affine.size, count + 1))
    basis[:count, :count] = np.eye(count)
    basis[[count + 1, count + 6, count + 11], count] = -1.0  # along each axis by its own coordinate
    precision, pull = prior_of(estimate.problem, estimate.values)
    runs = normal_equations_by_place(estimate, courses, [affine])[0]
    squares = np.concatenate([basis.T @ run.square @ basis for run in runs])  # (blocks, columns, columns)
    slopes = np.concatenate([run.slope @ basis for run in runs])
    square, slope = squares.sum(axis=0) + np.diag(np.append(precision, 0.0)), slopes.sum(axis=0) + np.append(pull, 0.0)
    scale = np.sqrt(np.maximum(np.diag(square), 1e-300))
    covariance = np.linalg.pinv(square / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    lengths = np.concatenate([course.lengths.reshape(len(course.lengths), layout.modules, -1) for course in courses])
    arm = float(lengths.mean(axis=2).sum(axis=1).mean())
    step = -covariance @ slope
    scatter = float(np.sum(((slopes + squares @ step) @ covariance[count]) ** 2))
    return float(step[count]), float(np.sqrt(max(covariance[count, count], scatter))), arm
